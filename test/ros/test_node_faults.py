# SPDX-License-Identifier: Apache-2.0
"""Faults from outside while the node runs: nothing is lost but what docs/node.md says."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from node_peer import NODE, SECOND, Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds

HOUR = 3600 * SECOND

# A participant of its own, that can be killed: it gives loads, and listens to all answers.
OTHER = f"""
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from smallwheel_ros.msg import MobilityEstimate, SoilEstimate

rclpy.init()
node = Node("other")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(MobilityEstimate, "/{NODE}/front/mobility", lambda message: None, 10)
node.create_subscription(SoilEstimate, "/{NODE}/soil", lambda message: None, latched)
publisher = node.create_publisher(WrenchStamped, "/front/load", 10)

def send():
    message = WrenchStamped()
    message.header.stamp = node.get_clock().now().to_msg()
    message.wrench.force.z = 60.0
    publisher.publish(message)

node.create_timer(0.02, send)
rclpy.spin(node)
"""


@contextmanager
def other(peer: Peer) -> Iterator[subprocess.Popen[bytes]]:
    """Run the other participant, from when the node hears it; in the end it is killed."""
    from geometry_msgs.msg import WrenchStamped

    loads: list[WrenchStamped] = []
    listening = peer.node.create_subscription(WrenchStamped, "/front/load", loads.append, 10)
    process = subprocess.Popen([sys.executable, "-c", OTHER])
    try:
        peer.spin_until(lambda: len(loads) > 10, "the other publishes")
        peer.node.destroy_subscription(listening)
        yield process
    finally:
        process.kill()
        process.wait()


def test_nodes_of_one_name_and_one_namespace_are_told(peer: Peer) -> None:
    from rclpy.node import Node

    from smallwheel_ros.ros.mobility_estimator import namesakes

    one = Node("rover", namespace="/a")
    elsewhere = Node("rover", namespace="/b")
    assert namesakes(one) == ""
    another = Node("rover", namespace="/a")
    peer.spin_until(lambda: namesakes(one) != "", "it is told")
    assert namesakes(one).startswith("another node is called /a/rover too")
    assert namesakes(elsewhere) == ""
    another.destroy_node()
    peer.spin_until(lambda: namesakes(one) == "", "the name is its own again")
    elsewhere.destroy_node()
    one.destroy_node()


@pytest.mark.slow
def test_two_nodes_of_one_name_are_said_and_answer_alike(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    """That they may save to one file at a time is in test_killed.py."""
    logs = [tmp_path / "first.log", tmp_path / "second.log"]
    with NodeProcess([one_wheel], logs[0]) as first:
        peer.wait_for_node()
        assert peer.entry("name") is None
        with NodeProcess([one_wheel], logs[1]) as second:
            peer.spin_until(lambda: peer.entry("name") is not None, "it is said")
            assert f"another node is called /{NODE} too" in peer.entry("name").message
            peer.spin_until(lambda: peer.sinkage.get_subscription_count() == 2, "both listen")
            peer.wait_for_turn()
            peer.drive(0.0, 0.4)
            answers: dict[int, list[object]] = {}
            peer.spin_until(lambda: len(peer.mobility) == 40, "each sinkage has two answers")
            for message in peer.mobility:
                stamp = message.header.stamp
                answers.setdefault(stamp.sec * SECOND + stamp.nanosec, []).append(message)
            assert all(one == another for one, another in answers.values())
            assert first.death() is None
            assert second.death() is None
        # The one that ended took leave: the name is the first one's again.
        peer.diagnostics.clear()
        peer.wait_for_turn()
        assert peer.entry("name") is None
    assert not any("Traceback" in log.read_text() for log in logs)


@pytest.mark.slow
def test_a_participant_that_is_killed_takes_nothing_with_it(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    """It listened reliably and gave the loads, and DDS misses it only after 20 s."""
    from smallwheel_ros.msg import MobilityEstimate, SoilEstimate

    peer.node.destroy_publisher(peer.load)
    soils = peer.latched(SoilEstimate, "soil")
    log = tmp_path / "node.log"

    def drive(count: int) -> None:
        """Send sinkages, each of which is answered to this side."""
        before = len(peer.mobility)
        for i in range(count):
            stamp = peer.send_odometry(0.02 * (before + i), 1.0)
            peer.send_wheel_speed(1.1 / 0.125, stamp)
            peer.send_sinkage(0.008 + 1e-4 * (i % 3), stamp, variance=1e-7)
            peer.spin(0.02)
        peer.spin_until(lambda: len(peer.mobility) == before + count, "each is answered")

    with NodeProcess([one_wheel], log) as node:
        peer.spin_until(lambda: peer.sinkage.get_subscription_count() > 0, "the node listens")
        with other(peer) as process:
            peer.send_odometry(0.0, 1.0)
            peer.send_wheel_speed(1.1 / 0.125)
            peer.wait_until_known("/front/load", "/front/sinkage", "/odom", "/joint_states")
            drive(100)
            assert peer.mobility[-1].load_valid
            peer.spin_until(lambda: soils[-1].measurements_accepted > 30, "a soil")
            process.send_signal(signal.SIGKILL)
            process.wait()
            drive(100)
            assert peer.mobility[-1].status == MobilityEstimate.STATUS_LOAD_MISSING
            peer.spin_until(
                lambda: "/front/load: no message for" in peer.entry("inputs").message, "it is said"
            )
        accepted = soils[-1].measurements_accepted
        assert accepted > 30
        with other(peer):
            drive(100)
            assert peer.mobility[-1].load_valid
            peer.spin_until(lambda: soils[-1].measurements_accepted > accepted + 30, "it goes on")
        assert node.death() is None
    assert "Traceback" not in log.read_text()


@pytest.mark.slow
def test_a_disk_that_takes_no_more_costs_nothing_but_what_was_to_be_written(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    """A limit on the size of files fails as a full disk does: log and soil cannot be written."""
    file, log = tmp_path / "soil.json", tmp_path / "node.log"
    with NodeProcess([one_wheel], log, {"soil.file": str(file)}) as node:
        peer.wait_for_node()
        peer.drive(0.0, 1.0)
        assert peer.trigger("save_soil").success
        saved = file.read_bytes()
        _, most = resource.prlimit(node.process_id, resource.RLIMIT_FSIZE)
        resource.prlimit(node.process_id, resource.RLIMIT_FSIZE, (1000, most))
        length = log.stat().st_size
        peer.drive(1.0, 2.0)
        answer = peer.trigger("save_soil")
        assert not answer.success
        assert f"nothing saved: {file}: cannot be written: File too large" in answer.message
        assert file.read_bytes() == saved
        assert log.stat().st_size == length  # what is logged meanwhile is lost
        resource.prlimit(node.process_id, resource.RLIMIT_FSIZE, (most, most))
        assert peer.trigger("save_soil").success
        assert file.read_bytes() != saved
        assert [path.name for path in tmp_path.glob(".soil*")] == []
        peer.spin_until(lambda: len(peer.mobility) == 100, "each sinkage is answered")
        assert node.death() is None
    assert "Traceback" not in log.read_text()


@pytest.mark.slow
def test_a_clock_that_goes_forth_and_back(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    """Each sinkage is answered or counted; the soil is lost only where stamps go back with the clock."""
    from rosgraph_msgs.msg import Clock
    from smallwheel_ros.msg import SoilEstimate

    soils = peer.latched(SoilEstimate, "soil")
    log = tmp_path / "node.log"
    now = 1_000_000 * SECOND

    def tick() -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now, SECOND)
        peer.publish("/clock", message)
        peer.spin(0.005)

    def go(by: int) -> None:
        nonlocal now
        now += by
        tick()
        peer.spin(0.5)  # nothing else of the new time before the clock itself

    def drive(start: float, ahead: int = 0) -> None:
        """Drive a metre by the clock, with stamps that are ahead of it."""
        nonlocal now
        for i in range(50):
            now += SECOND // 50
            tick()
            x, depth = start + 0.02 * i, 0.008 + 1e-4 * (i % 3)
            peer.drive(x, x + 0.01, sinkage=depth, begin=now + ahead)

    def count(reason: str) -> int:
        peer.wait_for_turn()
        return int(peer.counts().get(f"/front/sinkage: {reason}", 0))

    with NodeProcess([one_wheel], log, {"use_sim_time": "true"}) as node:
        tick()
        peer.wait_for_node()
        drive(0.0)
        peer.spin_until(lambda: len(peer.mobility) == 50, "each sinkage is answered")
        peer.spin_until(lambda: soils[-1].measurements_accepted > 10, "a soil")
        go(HOUR)  # stamps and clock go forth together
        drive(1.0)
        peer.spin_until(lambda: len(peer.mobility) == 100, "each sinkage is answered")
        accepted = soils[-1].measurements_accepted
        assert accepted > 20
        go(-HOUR)  # the clock alone goes back: the stamps are of the future
        drive(2.0, ahead=HOUR)
        assert count("stamp_in_future") == 50
        assert len(peer.mobility) == 100
        go(HOUR)  # and forth again
        drive(3.0)
        peer.spin_until(lambda: len(peer.mobility) == 150, "each sinkage is answered")
        assert soils[-1].measurements_accepted > accepted
        go(-HOUR)  # both go back: soil and buffers start over
        drive(4.0)
        peer.spin_until(
            lambda: len(peer.mobility) + count("dropped_by_reset") == 200, "each is told of"
        )
        assert soils[-1].measurements_accepted < 50
        assert node.death() is None
    text = log.read_text()
    assert text.count("time went back by") == 1
    assert "Traceback" not in text
