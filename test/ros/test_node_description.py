# SPDX-License-Identifier: Apache-2.0
"""A node that takes what its parameters do not give from /robot_description, over DDS."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from node_peer import ONE_WHEEL, Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds

URDF = """
<robot name="rover">
  <link name="base_link"/>
  <link name="tyre">
    <collision>
      <origin rpy="1.5707963 0 0"/>
      <geometry><cylinder radius="0.125" length="0.1"/></geometry>
    </collision>
  </link>
  <joint name="front_joint" type="continuous">
    <parent link="base_link"/>
    <child link="tyre"/>
    <origin xyz="0.3 0.2 0"/>
    <axis xyz="0 -1 0"/>
  </joint>
</robot>
"""


@pytest.fixture
def silent(tmp_path: Path) -> Path:
    """Parameters of one wheel without its size."""
    path = tmp_path / "silent.yaml"
    lines = ONE_WHEEL.splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "diameter" not in line))
    return path


def publish(peer: Peer, text: str) -> Any:
    """Publish a description as robot_state_publisher does: latched."""
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = peer.node.create_publisher(String, "/robot_description", profile)
    publisher.publish(String(data=text))
    return publisher


def parameters(peer: Peer, *names: str) -> list[object]:
    from rcl_interfaces.srv import GetParameters
    from rclpy.parameter import parameter_value_to_python

    request = GetParameters.Request(names=list(names))
    answer = peer.call(GetParameters, "get_parameters", request)
    return [parameter_value_to_python(value) for value in answer.values]


FILLED = ("front.diameter", "front.lateral_position", "front.joint_sign")


def test_a_node_without_diameters_waits_for_the_description(
    peer: Peer, silent: Path, tmp_path: Path
) -> None:
    log = tmp_path / "node.log"
    with NodeProcess([silent], log) as node:
        peer.spin_until(
            lambda: (
                "waiting for /robot_description" in getattr(peer.entry("inputs"), "message", "")
            ),
            "the node says what it waits for",
        )
        assert "front.diameter are not given" in peer.entry("inputs").message
        publish(peer, URDF)
        peer.wait_for_node()
        assert parameters(peer, *FILLED) == [0.25, 0.2, -1]
        peer.drive(0.0, 0.3)
        peer.spin_until(lambda: len(peer.mobility) > 5, "estimates")
        # What is set by hand stays so, whatever is described later; the rest follows.
        peer.configure_with("front.diameter", 0.2)
        changed = URDF.replace("0.125", "0.3").replace('"0.3 0.2 0"', '"0.3 0.4 0"')
        publish(peer, changed.replace("0 -1 0", "0 1 0"))
        peer.spin_until(lambda: "front.lateral_position=0.4" in log.read_text(), "the change")
        assert parameters(peer, *FILLED) == [0.2, 0.4, 1]
        # One that cannot be read changes nothing, and is in the diagnostics.
        publish(peer, "<robot>")
        peer.spin_until(
            lambda: (
                "robot description: it is no XML"
                in getattr(peer.entry("parameters"), "message", "")
            ),
            "a diagnostic",
        )
        assert parameters(peer, *FILLED) == [0.2, 0.4, 1]
        assert node.death() is None
    text = log.read_text()
    assert text.count("waiting for /robot_description") == 1
    assert "Traceback" not in text


def test_a_node_that_waits_takes_parameters_by_hand(
    peer: Peer, silent: Path, tmp_path: Path
) -> None:
    with NodeProcess([silent], tmp_path / "node.log"):
        assert peer.set_parameter("front.diameter", 0.25).successful
        peer.wait_for_node()


def test_a_description_without_what_is_missing_ends_the_start(
    peer: Peer, silent: Path, tmp_path: Path
) -> None:
    published = publish(peer, URDF.replace("front_joint", "drive"))
    command = [sys.executable, "-m", "smallwheel_ros.ros.mobility_estimator", "--ros-args"]
    done = subprocess.Popen(
        [*command, "--params-file", str(silent)], stderr=subprocess.PIPE, text=True
    )
    peer.spin_until(lambda: done.poll() is not None, "the node ends")
    _, words = done.communicate()
    assert published.get_subscription_count() == 0
    assert done.returncode == 2
    assert "parameter front.diameter is missing" in words
    assert "there is no joint 'front_joint', expected parameter front.joint to be" in words
    assert "Traceback" not in words


def test_a_manager_is_told_what_is_waited_for(peer: Peer, silent: Path, tmp_path: Path) -> None:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    log = tmp_path / "node.log"
    configure = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    with NodeProcess([silent], log, {"autostart": "false"}):
        assert not peer.call(ChangeState, "change_state", configure).success
        assert "parameter front.diameter is missing" in log.read_text()
        assert "waiting for /robot_description (std_msgs/msg/String): no pub" in log.read_text()
        publish(peer, URDF)
        peer.spin_until(lambda: "front.diameter=0.25" in log.read_text(), "the description")
        assert peer.call(ChangeState, "change_state", configure).success


def test_with_everything_given_nothing_is_listened_to(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    more = tmp_path / "more.yaml"
    more.write_text(
        "/**:\n  ros__parameters:\n    front:\n      lateral_position: 0.1\n"
        "      longitudinal_position: 0.2\n      joint_sign: 1\n      frame: front_hub\n"
        "      steering_joint: ''\n"
    )
    published = publish(peer, URDF)
    with NodeProcess([one_wheel, more], tmp_path / "node.log"):
        peer.wait_for_node()
        assert published.get_subscription_count() == 0
        assert parameters(peer, *FILLED) == [0.25, 0.1, 1]


WITH_VELOCITY = "/**:\n  ros__parameters:\n    velocity_topic: speed\n"


def diagnosis(peer: Peer) -> str:
    return getattr(peer.entry("parameters"), "message", "")


def send_velocity(peer: Peer, frame: str) -> None:
    from geometry_msgs.msg import TwistStamped

    message = TwistStamped()
    peer.stamp(message)
    message.header.frame_id = frame
    message.twist.linear.x = 0.1
    peer.publish("/speed", message)


def test_a_velocity_in_another_frame_is_said(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    more = tmp_path / "more.yaml"
    more.write_text(WITH_VELOCITY)
    with NodeProcess([one_wheel, more], tmp_path / "log"):
        peer.wait_for_node()
        send_velocity(peer, "radar")
        words = "velocity_topic is in frame 'radar', expected 'base_link': publish it in that frame"
        peer.spin_until(lambda: words in diagnosis(peer), "a diagnostic")
        send_velocity(peer, "base_link")
        peer.diagnostics.clear()
        peer.wait_for_turn()
        assert "velocity_topic is in frame" not in diagnosis(peer)
