# SPDX-License-Identifier: Apache-2.0
"""The node over real DDS: bad input, lifecycle, parameters. It runs in a process of its own.

Tests `inputs.py`, `mobility_estimator.py` and `outputs.py`.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from node_peer import ONE_WHEEL, Peer, documented_reasons, refused_start

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds


def all_finite(message: Any) -> bool:
    values = [getattr(message, name) for name in message.get_fields_and_field_types()]
    return all(math.isfinite(v) for v in values if isinstance(v, float))


def test_bad_messages_are_named_and_counted_and_the_node_goes_on(
    peer: Peer, one_wheel: Path, tmp_path: Path, repository: Path
) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from smallwheel_ros.msg import MobilityEstimate
    from std_msgs.msg import String

    log = tmp_path / "node.log"
    # A topic with a publisher of another type, one without publisher, one with too high a demand.
    wrong_type = peer.node.create_publisher(String, "/joint_states", 10)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(
        MobilityEstimate, "/mobility_estimator/front/mobility", lambda _: None, latched
    )
    # And one that still waits for what went.
    peer.listen(MobilityEstimate, "mobility", lambda _: None)
    # One parameter that nobody knows.
    with NodeProcess([one_wheel], log, {"front.widht": "0.1"}) as node:
        peer.wait_for_node()
        for _ in range(20):
            peer.send_load(math.nan)
        for force in (math.inf, -60.0, 0.0):
            peer.send_load(force)
        second = 10**9
        peer.send_load(60.0, stamp=0)
        peer.send_load(60.0, stamp=peer.now() + 60 * second)
        peer.send_load(60.0, stamp=peer.now() - 60 * second)
        peer.send_sinkage(math.nan)
        twice = peer.send_load(60.0)
        peer.send_load(60.0, stamp=twice)
        wanted = {
            "/front/load: not_finite": "21",
            "/front/load: load_not_positive": "2",
            "/front/load: stamp_zero": "1",
            "/front/load: stamp_in_future": "1",
            "/front/load: stamp_too_old": "1",
            "/front/load: duplicate": "1",
            "/front/sinkage: not_finite": "1",
            "/mobility_estimator/front/mobility: incompatible_qos": "1",
        }
        peer.spin_until(lambda: wanted.items() <= peer.counts().items(), f"counts {wanted}")
        assert {key.split(": ")[1] for key in wanted} <= documented_reasons(repository)
        assert peer.mobility == []

        # No load near this one: it is answered, and said.
        peer.spin_until(lambda: peer.now() - twice > second, "a stamp far from all loads")
        lonely = peer.send_sinkage(0.01)
        peer.spin(0.5)  # or the next load would be near it
        # and then all is well
        good = []
        for _ in range(20):
            peer.spin(0.05)
            peer.send_load(60.0)
            good.append(peer.send_sinkage(0.008, variance=1e-6))
        stamps = [lonely, *good]
        peer.spin_until(lambda: len(peer.mobility) >= len(stamps), "all sinkages answered")
        heard = [m.header.stamp.sec * second + m.header.stamp.nanosec for m in peer.mobility]
        assert heard == stamps
        assert all(m.header.frame_id == "front" for m in peer.mobility)
        assert all(all_finite(m) for m in peer.mobility)
        first, last = peer.mobility[0], peer.mobility[-1]
        assert first.status == MobilityEstimate.STATUS_LOAD_MISSING
        assert not first.load_valid
        assert not first.prediction_valid
        assert last.load_valid
        assert last.load == pytest.approx(60.0)
        assert last.prediction_valid
        assert not last.slip_valid
        assert last.status == MobilityEstimate.STATUS_SLIP_UNKNOWN
        peer.spin_until(lambda: "load_missing" in str(peer.counts()), "load_missing counted")
        peer.spin_until(lambda: "still waiting for /odom" in log.read_text(), "waiting for odom")
        status = peer.diagnostics["mobility_estimator: inputs"]
        assert status.level == b"\x01"
        assert "still waiting for /odom (nav_msgs/msg/Odometry): no publisher" in status.message
        text = peer.diagnostics["mobility_estimator: parameters"].message
        assert "front.widht is unknown and not used: did you mean 'front.width'?" in text
        assert node.death() is None
    lines = log.read_text().splitlines()
    # Twenty of a kind are one line, which names topic, value and what was expected.
    named = [
        line for line in lines if "/front/load: load is" in line and "expected a number" in line
    ]
    assert len(named) == 1
    went = [
        line for line in lines if "a subscriber waits on /mobility_estimator/mobility, wh" in line
    ]
    assert len(went) == 1
    assert (
        "(/mobility_estimator/front/mobility), the vehicle /mobility_estimator/vehicle" in went[0]
    )
    for words in (
        "N, expected more than 0: the wheel is in the air",
        "the publisher must stamp its messages",
        "s ahead of the clock",
        "s behind the clock",
        "came twice",
        "/front/sinkage: sinkage is nan: no reading",
        "/front/sinkage: no usable load within 0.2 s",
        "/mobility_estimator/front/mobility: a subscriber asks for QoS that is not offered, and gets"
        " nothing: ERROR: Volatile publisher and transient local subscription",
        "/joint_states (sensor_msgs/msg/JointState, joint front_joint): its publisher has another"
        " type, std_msgs/msg/String",
    ):
        assert sum(words in line for line in lines) >= 1, words
    assert "Traceback" not in log.read_text()
    assert wrong_type is not None


def test_what_cannot_be_read_is_counted_and_said(
    peer: Peer, one_wheel: Path, tmp_path: Path, repository: Path
) -> None:
    """Bytes that are no message of the type, and joint states without the joint."""
    from sensor_msgs.msg import JointState

    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log) as node:
        peer.wait_for_node()
        for raw in (
            b"\x00\x01\x00\x00",
            b"\x00\x01\x00\x00\xff\xff",
            b"\x00\x01\x00\x00" + 60 * b"\xff",
        ):
            peer.load.publish(raw)
        joints = JointState(name=["arm", "mast"], velocity=[0.0, 1.0])
        peer.stamp(joints)
        peer.publish("/joint_states", joints)
        wanted = {"/front/load: not_readable": "3", "/joint_states: no_value": "1"}
        peer.spin_until(lambda: wanted.items() <= peer.counts().items(), f"counts {wanted}")
        assert {key.split(": ")[1] for key in wanted} <= documented_reasons(repository)
        # and then all is well
        peer.drive(0.0, 0.5)
        peer.spin_until(lambda: len(peer.mobility) > 5, "estimates")
        assert all(all_finite(m) for m in peer.mobility)
        assert node.death() is None
    text = log.read_text()
    assert "Traceback" not in text
    assert "has no value of its joint; it has arm, mast" in text


def test_lifecycle_and_parameters_by_a_manager(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from rclpy.parameter import Parameter
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from smallwheel_ros.msg import SoilEstimate

    def set_parameter(name: str, value: object) -> Any:
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return peer.call(SetParameters, "set_parameters", request).results[0]

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(peer.call(ChangeState, "change_state", request).success)

    def state() -> int:
        return int(peer.call(GetState, "get_state", GetState.Request()).current_state.id)

    bad = {"autostart": "false", "front.width": "true", "imu_yaw": "1"}
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, bad) as node:
        assert state() == State.PRIMARY_STATE_UNCONFIGURED
        # A bool for a double: it stays unconfigured, says why, and can be mended.
        assert not change(Transition.TRANSITION_CONFIGURE)
        assert state() == State.PRIMARY_STATE_UNCONFIGURED
        sentence = "front.width is bool True, expected a double from 0.001 to 5 m"
        name = "mobility_estimator: parameters"
        peer.spin_until(lambda: name in peer.diagnostics, "diagnostics of the parameters")
        assert peer.diagnostics[name].level == b"\x02"
        assert sentence in peer.diagnostics[name].message
        refused = set_parameter("front.width", -0.1)
        assert not refused.successful
        assert "front.width" in refused.reason
        assert not set_parameter("imu_yaw", True).successful
        assert repr(peer.value("imu_yaw")) == "1.0"  # an integer, where a double is meant
        assert set_parameter("imu_yaw", 2).successful
        assert repr(peer.value("imu_yaw")) == "2.0"
        assert set_parameter("front.width", 0.12).successful
        assert change(Transition.TRANSITION_CONFIGURE)
        assert state() == State.PRIMARY_STATE_INACTIVE
        # Inactive, a change counts from the next configuration on, which judges all together.
        assert set_parameter("load.source", "static").successful
        assert change(Transition.TRANSITION_CLEANUP)
        assert not change(Transition.TRANSITION_CONFIGURE)
        peer.spin_until(
            lambda: "vehicle.mass is missing" in peer.diagnostics[name].message, "the reason"
        )
        assert set_parameter("load.source", "wrench").successful
        assert set_parameter("front.width", 0.13).successful
        assert change(Transition.TRANSITION_CONFIGURE)

        # The soil is latched: subscribed to before or after, the prior is there when active.
        soils: list[Any] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic = "/mobility_estimator/soil"
        assert change(Transition.TRANSITION_ACTIVATE)
        peer.node.create_subscription(SoilEstimate, topic, soils.append, latched)
        peer.spin_until(lambda: bool(soils), "the latched soil")
        assert soils[0].status == SoilEstimate.STATUS_PRIOR_ONLY
        assert soils[0].reference_pressure > 0
        assert not soils[0].k_identifiable
        peer.spin_until(lambda: peer.sinkage.get_subscription_count() > 0, "the node listens")
        refused = set_parameter("front.width", 0.14)
        assert not refused.successful
        assert "front.width cannot be set while the node is active: deactivate" in refused.reason
        assert change(Transition.TRANSITION_DEACTIVATE)
        peer.spin_until(lambda: peer.sinkage.get_subscription_count() == 0, "it listens no more")
        assert change(Transition.TRANSITION_CLEANUP)
        assert set_parameter("front.width", 0.14).successful
        assert change(Transition.TRANSITION_CONFIGURE)
        assert change(Transition.TRANSITION_ACTIVATE)
        assert state() == State.PRIMARY_STATE_ACTIVE

        request = DescribeParameters.Request(names=["front.width", "wheels"])
        width, wheels = peer.call(DescribeParameters, "describe_parameters", request).descriptors
        assert "Width of the wheel." in width.description
        assert width.floating_point_range[0].to_value == 5.0
        assert wheels.read_only
        assert node.death() is None
    assert log.read_text().count("effective parameters") == 3
    assert re.findall(r"front\.width=(\S+?),?\s", log.read_text()) == ["0.12", "0.13", "0.14"]
    assert sentence in log.read_text()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            ONE_WHEEL.replace("0.25", "0.0").replace("width: 0.1", "width: true"),
            r"cannot be configured: parameter front\.diameter is 0\.0, expected a double from"
            r" 0\.005 to 5 m; parameter front\.width is bool True, expected a double",
        ),
        ("/**:\n  ros__parameters:\n    reference_slip: 0.3\n", "parameter wheels is missing"),
        ("/**:\n  ros__parameters: [\n", "mobility_estimator: cannot start: .*rover.yaml"),
    ],
)
def test_bad_parameters_end_it_with_one_message(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "rover.yaml"
    path.write_text(text)
    said = refused_start(capfd, "--params-file", str(path))
    assert len(re.findall(words, said)) == 1, said
