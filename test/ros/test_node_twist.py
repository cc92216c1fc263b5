# SPDX-License-Identifier: Apache-2.0
"""The vehicle's twist over DDS, as a filter such as robot_localization's takes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_peer import SECOND, Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds

ROVER = """/**:
  ros__parameters:
    wheels: [left, right]
    left: {diameter: 0.25, width: 0.1, lateral_position: 0.3, sinkage_topic: ""}
    right: {diameter: 0.25, width: 0.1, lateral_position: -0.3, sinkage_topic: ""}
    load: {source: static}
    vehicle: {mass: 20.0}
    imu_topic: imu
    odometry_from_wheels: true
"""


def roll(peer: Peer, seconds: float, speed: float = 0.5, rate: int = 50) -> list[int]:
    """Roll straight ahead on level ground; return the stamps of the wheel speeds."""
    from sensor_msgs.msg import Imu, JointState

    peer.announce(joint_states=JointState, imu=Imu)
    stamps = []
    for i in range(round(seconds * rate)):
        imu = Imu()
        stamp = peer.stamp(imu)
        imu.orientation.w = 1.0
        imu.linear_acceleration.z = 9.81
        imu.angular_velocity.z = 0.001 * (-1) ** i
        peer.publish("/imu", imu)
        joints = JointState(
            name=["left_joint", "right_joint"], velocity=[speed / 0.125 + 0.01 * (i % 3)] * 2
        )
        peer.stamp(joints, stamp)
        peer.publish("/joint_states", joints)
        stamps.append(stamp)
        peer.spin(1.0 / rate)
    return stamps


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec * SECOND + message.header.stamp.nanosec)


def test_twists_come_with_covariances_that_a_filter_can_take(peer: Peer, tmp_path: Path) -> None:
    from geometry_msgs.msg import TwistWithCovarianceStamped

    parameters, log = tmp_path / "rover.yaml", tmp_path / "node.log"
    parameters.write_text(f"{ROVER}    twist: {{publish: true}}\n")
    twists: list[TwistWithCovarianceStamped] = []
    with NodeProcess([parameters], log) as node:
        peer.listen(TwistWithCovarianceStamped, "twist", twists.append)
        peer.spin_until(lambda: peer.diagnosed > 0, "the node knows this side")
        stamps = roll(peer, 4.0)
        peer.spin_until(lambda: len(twists) > 100, "twists")
        assert node.death() is None
    found = [stamp_of(message) for message in twists]
    assert found == sorted(set(found))
    assert set(found) <= set(stamps)
    for message in twists:
        assert message.header.frame_id == "base_link"
        covariance = np.array(message.twist.covariance).reshape(6, 6)
        assert np.isfinite(covariance).all()
        assert (np.diag(covariance) > 0.0).all()  # 0 would be certain
        assert (covariance == covariance.T).all()
    last = twists[-1].twist
    assert last.twist.linear.x == pytest.approx(0.5, abs=0.1)
    assert last.twist.angular.z == pytest.approx(0.0, abs=0.05)
    assert last.covariance[0] < 10.0 < last.covariance[14]  # v_z is not measured
    assert "Traceback" not in log.read_text()


def test_without_the_parameter_there_is_no_such_topic(peer: Peer, tmp_path: Path) -> None:
    parameters = tmp_path / "rover.yaml"
    parameters.write_text(ROVER)
    with NodeProcess([parameters], tmp_path / "node.log"):
        peer.spin_until(lambda: peer.diagnosed > 0, "the node is there")
        assert peer.node.count_publishers("/mobility_estimator/vehicle") == 1
        assert peer.node.count_publishers("/mobility_estimator/twist") == 0
