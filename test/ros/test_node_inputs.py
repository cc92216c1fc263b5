# SPDX-License-Identifier: Apache-2.0
"""The node's other ways of input, changes of parameters and restarts, over real DDS."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from node_peer import ONE_WHEEL, Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds

OTHER_WAYS = (
    ONE_WHEEL
    + """    velocity_topic: /radar/velocity
    odometry_from_wheels: true
    load:
      source: joint_states
      per_effort: 2.0
"""
).replace(
    "      width: 0.1\n",
    "      width: 0.1\n      range_height: 0.3\n      load_joint: leg\n",
)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "rover.yaml"
    path.write_text(text)
    return path


def test_range_efforts_and_a_velocity_of_its_own(peer: Peer, tmp_path: Path) -> None:
    from geometry_msgs.msg import TwistStamped
    from sensor_msgs.msg import JointState, Range

    # /front/sinkage carries ranges here.
    peer.node.destroy_publisher(peer.sinkage)
    peer.sinkage = peer.node.create_publisher(Range, "/front/sinkage", 100)
    log = tmp_path / "node.log"
    with NodeProcess([written(tmp_path, OTHER_WAYS)], log) as node:
        peer.wait_for_node()
        stamps = []
        for i in range(40):
            stamp = peer.send_odometry(0.01 * i, 0.5)
            stamps.append(stamp)
            joints = JointState(
                name=["leg", "front_joint"], velocity=[0.0, 0.5 / 0.125], effort=[30.0, 0.0]
            )
            peer.stamp(joints, stamp)
            peer.publish("/joint_states", joints)
            velocity = TwistStamped()
            peer.stamp(velocity, stamp)
            velocity.twist.linear.x = 0.3
            peer.publish("/radar/velocity", velocity)
            message = Range(min_range=0.05, max_range=2.0, range=0.29, variance=1e-6)
            peer.stamp(message, stamp)
            peer.sinkage.publish(message)
            peer.spin(0.02)
        peer.spin_until(lambda: peer.answered(stamps[-1]), "the last estimate")
        last = peer.mobility[-1]
        # 30 of effort are 60 N, but for what the filter believes of the scale of the cells.
        assert last.load == pytest.approx(60.0, rel=0.02)
        assert last.sinkage_measured == pytest.approx(0.01, abs=1e-6)  # ranges are float32
        # Odometry claims 0.5 m/s, as fast as the wheel turns; the radar knows better.
        assert last.slip == pytest.approx(0.4)
        assert last.traction_valid
        assert last.margin_valid
        inputs = peer.entry("inputs")
        keys = [value.key for value in inputs.values]
        assert "/joint_states, effort of joint leg" in keys
        assert "/radar/velocity" in keys
        assert node.death() is None
    assert "Traceback" not in log.read_text()


def test_a_load_that_nobody_measures_is_said(peer: Peer, tmp_path: Path) -> None:
    text = ONE_WHEEL + "    load:\n      source: static\n    vehicle:\n      mass: 6.0\n"
    log = tmp_path / "node.log"
    with NodeProcess([written(tmp_path, text)], log) as node:
        peer.wait_for_node()
        for _ in range(5):
            peer.send_sinkage(0.008, variance=1e-6)
            peer.spin(0.1)
        peer.spin_until(lambda: len(peer.mobility) >= 4, "estimates")
        message = peer.mobility[-1]
        assert message.load == pytest.approx(58.8399)
        assert "load not measured: 58.8 N as configured" in message.status_text
        peer.spin_until(
            lambda: (
                peer.entry("inputs") is not None
                and "loads are not measured" in peer.entry("inputs").message
            ),
            "the same in diagnostics",
        )
        assert "/front/load" not in " ".join(peer.counts())
        assert node.death() is None


def test_parameters_are_those_of_the_configuration(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.msg import SoilEstimate

    soils = peer.latched(SoilEstimate, "soil")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log) as node:
        peer.wait_for_node()
        peer.drive(0.0, 1.0)
        peer.spin_until(lambda: bool(soils) and soils[-1].measurements_accepted > 10, "a soil")

        # Refused: out of its range, of another type, not to be changed, and anything while active.
        for name, value, words in (
            ("noise.sinkage", -1.0, "noise.sinkage out of range Min: 1e-05"),
            (
                "noise.sinkage",
                True,
                "noise.sinkage is bool True, expected a double from 1e-05 to 1 m",
            ),
            ("wheels", ["rear"], "read-only"),
            ("noise.load", 6.0, "noise.load cannot be set while the node is active: deactivate it"),
        ):
            answer = peer.set_parameter(name, value)
            assert not answer.successful
            assert words in answer.reason, answer.reason

        # It goes on as if nothing had been asked.
        learnt = soils[-1].measurements_accepted
        peer.drive(1.0, 1.4)
        peer.spin_until(lambda: soils[-1].measurements_accepted > learnt, "the soil goes on")

        # Configured anew it goes by them: another topic, another prior, from which the soil starts.
        peer.configure_with("front.load_topic", "/scale")
        peer.spin_until(lambda: peer.load.get_subscription_count() == 0, "the old topic is left")
        assert peer.node.count_subscribers("/scale") == 1
        peer.configure_with("front.load_topic", "front/load")
        peer.configure_with("noise.sinkage", 0.004)
        peer.configure_with("soil.name", "moist_earth")
        peer.spin_until(lambda: soils[-1].m == pytest.approx(-0.49), "the prior")
        assert soils[-1].status == SoilEstimate.STATUS_PRIOR_ONLY
        peer.spin_until(lambda: peer.load.get_subscription_count() == 1, "the old topic is back")
        before = len(peer.mobility)
        peer.drive(2.0, 2.4, variance=0.0)  # not told
        peer.spin_until(lambda: len(peer.mobility) > before + 1, "further estimates")
        assert peer.mobility[-1].sinkage_measured_standard_deviation == pytest.approx(0.004)
        assert node.death() is None
    text = log.read_text()
    assert text.count("effective parameters") == 5
    assert "Traceback" not in text


def test_mobility_is_said_at_its_rate(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    """200 sinkages in 4 s, by stamps: 5 answers a second at the rate 5; the soil goes by all."""
    from smallwheel_ros.msg import SoilEstimate

    soils = peer.latched(SoilEstimate, "soil")
    with NodeProcess([one_wheel], tmp_path / "node.log", {"mobility.rate": "5.0"}) as node:
        peer.wait_for_node()
        peer.drive(0.0, 4.0, begin=peer.now())
        peer.spin_until(lambda: len(peer.mobility) >= 19, "answers")
        peer.wait_for_turn()
        assert len(peer.mobility) <= 22
        assert soils[-1].measurements_accepted > 100
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in peer.mobility]
        apart = [later - earlier for earlier, later in pairwise(stamps)]
        assert min(apart) >= 10**8  # half a period of slack
        assert node.death() is None


def test_a_publisher_that_is_restarted_is_heard_again(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log) as node:
        peer.wait_for_node()
        peer.drive(0.0, 0.5)
        peer.spin_until(lambda: len(peer.mobility) >= 10, "estimates")
        peer.node.destroy_publisher(peer.load)
        peer.spin_until(
            lambda: "/front/load: no message for" in peer.entry("inputs").message,
            "silence in diagnostics",
        )
        # Back with other QoS: best effort instead of reliable.
        profile = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.load = peer.node.create_publisher(WrenchStamped, "/front/load", profile)
        peer.spin_until(lambda: peer.load.get_subscription_count() == 1, "it is heard again")
        before = len(peer.mobility)
        peer.drive(0.5, 1.0)
        peer.spin_until(
            lambda: len(peer.mobility) > before and peer.mobility[-1].load_valid, "load again"
        )
        for _ in range(10):
            peer.drive(1.0, 1.5)
            if "all 4 inputs come in" in peer.entry("inputs").message:
                break
        assert "all 4 inputs come in" in peer.entry("inputs").message
        assert node.death() is None
    assert "Traceback" not in log.read_text()
