# SPDX-License-Identifier: Apache-2.0
"""Nothing that comes over ROS or from a file ends the node, runs code, or leaves it half changed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from node_peer import Peer, refused_start

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds
MANAGED = {"autostart": "false"}


def state(peer: Peer) -> str:
    from lifecycle_msgs.srv import GetState

    return str(peer.call(GetState, "get_state", GetState.Request()).current_state.label)


def delete_parameter(peer: Peer, name: str) -> Any:
    from rcl_interfaces.msg import Parameter
    from rcl_interfaces.srv import SetParameters

    request = SetParameters.Request(parameters=[Parameter(name=name)])
    return peer.call(SetParameters, "set_parameters", request).results[0]


def test_no_parameter_ends_a_running_node(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    effects, proof = tmp_path / "effects.py", tmp_path / "was_run"
    effects.write_text(f"open({str(proof)!r}, 'w').close()\n")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log) as node:
        peer.wait_for_node()
        for name, value, words in (
            ("soil.file", "~nouser/x", "parameter soil.file is '~nouser/x', expected the path"),
            ("soil.file", "x" * 5000, "File name too long"),
            ("front.sinkage_topic", "a b", "front.sinkage_topic is 'a b', expected the name of a"),
            ("front.load_topic", "1st", "expected the name of a topic"),
            ("front.load_topic", "a//b", "expected the name of a topic"),
            ("front.load_topic", "a/", "expected the name of a topic"),
            ("velocity_topic", "v" * 300, "expected the name of a topic, at most 200 letters"),
            ("front.load_topic", "/odom", "cannot be set while the node is active: deactivate it"),
            ("model_file", "/dev/zero", "cannot be set while the node is active: deactivate it"),
            ("effects_file", str(effects), "read-only"),
            ("noise.sinkage", float("nan"), "noise.sinkage"),
            ("front.width", [1, 2], "front.width is list"),
        ):
            answer = peer.set_parameter(name, value)
            assert not answer.successful, name
            assert words in answer.reason, answer.reason
        for name in ("front.width", "soil.name"):
            answer = delete_parameter(peer, name)
            assert not answer.successful
            assert "cannot be deleted" in answer.reason
        # A type that there is not makes rclpy itself raise, and nobody answers.
        wrong = Parameter(name="front.width", value=ParameterValue(type=200))
        client = peer.node.create_client(SetParameters, "/mobility_estimator/set_parameters")
        peer.spin_until(client.service_is_ready, "the service")
        client.call_async(SetParameters.Request(parameters=[wrong]))
        peer.spin_until(lambda: "a callback failed" in log.read_text(), "it is loud")
        # What is still waited for is said, every topic of it.
        peer.spin_until(lambda: "still waiting" in log.read_text(), "a line on missing topics")
        # Everything is as it was: it listens, estimates, and takes parameters that are right.
        peer.drive(0.0, 0.5)
        peer.spin_until(lambda: len(peer.mobility) > 5, "estimates")
        # Not active, it takes them; what makes no sense together keeps it from being configured.
        assert peer.transition(label="deactivate")
        for name, value, words in (
            ("front.load_topic", "/odom", "/odom would be geometry_msgs/msg/WrenchStamped and nav"),
            ("front.load_topic", "/rosout", "/rosout would be rcl_interfaces/msg/Log and geometry"),
            ("front.load_topic", "/mobility_estimator/soil", "smallwheel_ros/msg/SoilEstimate"),
            ("model_file", "/dev/zero", "it is a device or a pipe"),
        ):
            before = peer.value(name)
            assert peer.set_parameter(name, value).successful
            peer.transition(label="cleanup")  # the first time
            assert not peer.transition(label="configure")
            peer.spin_until(
                lambda w=words: w in getattr(peer.entry("parameters"), "message", ""), "the reason"
            )
            assert peer.set_parameter(name, before).successful
        assert peer.set_parameter("soil.name", "moist_earth").successful
        assert peer.transition(label="configure")
        assert peer.transition(label="activate")
        assert node.death() is None
    assert not proof.exists()
    text = log.read_text()
    assert text.count("Traceback") == 1  # of the callback
    for topic in ("/front/load", "/front/sinkage", "/odom", "/joint_states"):
        assert f"still waiting for {topic} (" in text


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("soil.file", "~nouser/x", "soil.file is '~nouser/x', expected the path of a file"),
        (
            "front.sinkage_topic",
            "a b",
            "front.sinkage_topic is 'a b', expected the name of a topic",
        ),
        (
            "front.load_topic",
            "/odom",
            "/odom would be geometry_msgs/msg/WrenchStamped and nav_msgs/",
        ),
        ("model_file", "/dev/zero", "/dev/zero: cannot be read: it is a device or a pipe"),
    ],
)
def test_the_same_at_the_start_is_one_message(
    capfd: pytest.CaptureFixture[str], one_wheel: Path, name: str, value: object, words: str
) -> None:
    written = f"'{value}'" if isinstance(value, str) else value
    said = refused_start(capfd, "--params-file", str(one_wheel), "-p", f"{name}:={written}")
    assert said.count(words) == 1, said


def test_transitions_that_do_not_fit_are_answered(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from lifecycle_msgs.msg import Transition

    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log) as node:
        peer.wait_for_node()
        # A lifecycle manager with a node that has started itself.
        assert not peer.transition(Transition.TRANSITION_CONFIGURE)
        assert not peer.transition(Transition.TRANSITION_CLEANUP)
        assert not peer.transition(200)
        assert not peer.transition(label="nonsense")
        assert state(peer) == "active"
        assert peer.transition(Transition.TRANSITION_DEACTIVATE)
        assert not peer.transition(Transition.TRANSITION_DEACTIVATE)
        assert peer.trigger("reset").success
        assert peer.transition(Transition.TRANSITION_CLEANUP)
        for service in ("reset", "save_soil"):
            answer = peer.trigger(service)
            assert not answer.success
            assert "not configured" in answer.message
        assert peer.transition(Transition.TRANSITION_CONFIGURE)
        assert peer.transition(Transition.TRANSITION_INACTIVE_SHUTDOWN)
        assert state(peer) == "finalized"
        assert not peer.transition(Transition.TRANSITION_CONFIGURE)
        assert node.death() is None
    text = log.read_text()
    assert "transition 1 does not fit the state, active" in text
    assert "Traceback" not in text


def test_a_configuration_that_fails_leaves_nothing_behind(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from lifecycle_msgs.msg import Transition

    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, {**MANAGED, "mobility.rate": "-5.0"}) as node:
        assert not peer.transition(Transition.TRANSITION_CONFIGURE)
        assert state(peer) == "unconfigured"
        peer.spin_until(lambda: peer.entry("parameters") is not None, "diagnostics")
        assert "mobility.rate is -5.0, expected" in peer.entry("parameters").message
        peer.wait_for_turn()
        assert peer.node.count_publishers("/mobility_estimator/soil") == 0
        assert peer.trigger("save_soil").message == "not configured: there is no soil to save"
        assert peer.set_parameter("mobility.rate", 10.0).successful
        # A model that is not there: the same, and it can be mended.
        assert peer.set_parameter("model_file", str(tmp_path / "none.yaml")).successful
        assert not peer.transition(Transition.TRANSITION_CONFIGURE)
        assert peer.set_parameter("model_file", "").successful
        assert peer.transition(Transition.TRANSITION_CONFIGURE)
        assert peer.transition(Transition.TRANSITION_ACTIVATE)
        assert state(peer) == "active"
        assert node.death() is None
    assert "Traceback" not in log.read_text()


def test_what_was_dumped_says_nothing_of_itself(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    """N24: `ros2 param dump` wrote qos_overrides.* that the next start warned of."""
    from rcl_interfaces.srv import ListParameters

    with NodeProcess([one_wheel], tmp_path / "node.log"):
        peer.wait_for_node()
        names = peer.call(ListParameters, "list_parameters", ListParameters.Request()).result.names
    assert "front.diameter" in names
    assert not [name for name in names if "qos_overrides" in name]


@pytest.mark.parametrize(
    "content", ["[" * 100_000, '{"format": "smallwheel soil state", "version": 1}', None]
)
def test_no_saved_soil_stops_the_start(
    one_wheel: Path, tmp_path: Path, content: str | None
) -> None:
    """What the node does then is in test_node_saved_soil.py."""
    from smallwheel_ros.drive.soil_file import SoilFile
    from smallwheel_ros.onboard.parameters import read_parameters, settings_from
    from smallwheel_ros.pipeline.pipeline import Pipeline

    file = tmp_path / "soil.json"
    if content is None:
        os.mkfifo(file)
    else:
        file.write_text(content)
    soil_file = SoilFile(str(file))
    assert soil_file.restore(Pipeline(settings_from(read_parameters(one_wheel)).onboard)) == ""
    assert soil_file.problem.startswith(f"the saved soil is not used: {file}")


def saving(peer: Peer) -> str:
    answer = peer.trigger("save_soil")
    return "" if answer.success else str(answer.message)


def test_saving_replaces_nothing_but_a_saved_soil(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    precious, good = tmp_path / "precious.txt", tmp_path / "soil.json"
    precious.write_text("precious")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, {"soil.file": str(good)}) as node:
        peer.wait_for_node()
        peer.drive(0.0, 1.0)
        peer.spin_until(lambda: peer.trigger("save_soil").success, "a soil is saved")
        assert peer.trigger("save_soil").success  # its own file may be replaced
        for path in (precious, Path("/dev/null"), tmp_path):
            peer.configure_with("soil.file", str(path))
            peer.spin_until(lambda: peer.load.get_subscription_count() == 1, "it listens")
            peer.drive(1.0, 1.6)
            peer.spin_until(lambda p=path: f"nothing saved: {p}: " in saving(peer), "refused")
        assert precious.read_text() == "precious"
        assert {file.name for file in tmp_path.iterdir() if "soil" in file.name} == {
            "soil.json",
            "soil.json.cost_map.yaml",
            "soil.json.cost_map.pgm",
            "soil.json.cost_map.before.yaml",  # of the soil before, until this one is there
            "soil.json.cost_map.before.pgm",
        }
        assert node.death() is None
    assert "Traceback" not in log.read_text()


def test_what_fails_half_way_leaves_it_unconfigured(
    peer: Peer, one_wheel: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node in this process, where its parts can be made to fail."""
    from rclpy.lifecycle import TransitionCallbackReturn
    from rclpy.parameter import Parameter

    from smallwheel_ros.onboard.parameters import read_parameters
    from smallwheel_ros.ros.cost_publisher import CostPublisher
    from smallwheel_ros.ros.inputs import Inputs
    from smallwheel_ros.ros.mobility_estimator import MobilityEstimator
    from smallwheel_ros.ros.outputs import Outputs

    def fail(*_: object) -> None:
        raise RuntimeError("no network")

    def current() -> str:
        return str(node._state_machine.current_state[1])

    values = read_parameters(one_wheel)
    given = [Parameter(name, value=value) for name, value in values.items()]
    node = MobilityEstimator(parameter_overrides=given)
    success = TransitionCallbackReturn.SUCCESS
    own = {publisher.topic_name for publisher in node.publishers}
    try:
        for part, name in (
            (CostPublisher, "__init__"),
            (Outputs, "publish_soil"),
            (Inputs, "listen"),
        ):
            with monkeypatch.context() as patch:
                patch.setattr(part, name, fail)
                configured = node.trigger_configure() == success
                assert not configured or node.trigger_activate() != success
            assert current() == "unconfigured"
            assert "no network" in node.problem
            assert not any("front" in listened.topic_name for listened in node.subscriptions)
            assert {publisher.topic_name for publisher in node.publishers} == own
        # and it can be configured again
        assert node.trigger_configure() == success
        assert node.trigger_activate() == success
        assert node.problem == ""
        assert current() == "active"
    finally:
        node.destroy_node()
