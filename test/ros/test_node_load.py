# SPDX-License-Identifier: Apache-2.0
"""The node under load: six wheels at 200 Hz for half an hour, nothing lost, flat memory.

Messages go at the pace of their stamps; where the machine cannot keep up, the sender holds back while
too many sinkages are without answer, and the stamps fall behind the clock. What is printed in the end
(pytest -rP) says what rate that was, and how long sinkages waited for their answers, as seen by this
process, which sends 2800 messages a second besides. SMALLWHEEL_LOAD_MINUTES shortens it.
"""

from __future__ import annotations

import math
import os
import time
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_peer import NODE, SECOND, Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = [pytest.mark.dds, pytest.mark.slow]

MINUTES = float(os.environ.get("SMALLWHEEL_LOAD_MINUTES", "30"))
RATE = 200
WHEELS = [f"wheel_{i}" for i in range(6)]
# A turn is taken every 50 ms, in which 60 come: of two turns and a half, less than the depth of the queues.
MOST_UNANSWERED = 150
# m, of a field: who comes round once meets no new ground, for which the map needs memory.
RADIUS, SPEED = 30.0, 0.5
LAP = 2.0 * math.pi * RADIUS


def resident(pid: int) -> float:
    """Memory of a process, MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def processor_seconds(pid: int) -> float:
    """Time that a process has had on a processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Rover:
    """Publishes for six wheels, and counts the answers."""

    def __init__(self, peer: Peer) -> None:
        from geometry_msgs.msg import WrenchStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import JointState
        from smallwheel_ros.msg import MobilityEstimate, WheelSinkage

        self.peer = peer
        node = peer.node
        self.loads = [node.create_publisher(WrenchStamped, f"/{n}/load", 200) for n in WHEELS]
        self.sinkages = [node.create_publisher(WheelSinkage, f"/{n}/sinkage", 200) for n in WHEELS]
        self.odometry = node.create_publisher(Odometry, "/odom", 200)
        self.joints = node.create_publisher(JointState, "/joint_states", 200)
        self.sent = self.answered = self.unusable = 0
        self.sent_at: dict[tuple[str, int], float] = {}  # by wheel and stamp, until it is answered
        self.waited = array("f")  # s, from each sinkage to its answer
        self.answers = [
            node.create_subscription(
                MobilityEstimate, f"/{NODE}/{name}/mobility", self._on_answer, 2000
            )
            for name in WHEELS
        ]
        self.pose, self.turning = Odometry(), JointState(name=[f"{n}_joint" for n in WHEELS])
        self.pose.header.frame_id = "odom"
        self.pose.pose.pose.orientation.w = 1.0
        self.pose.twist.twist.linear.x = SPEED
        self.wrench, self.depth = WrenchStamped(), WheelSinkage(variance=1e-6)

    @property
    def topics(self) -> list[str]:
        return [publisher.topic_name for publisher in (*self.loads, *self.sinkages)]

    @property
    def heard(self) -> bool:
        publishers = (*self.loads, *self.sinkages, self.odometry, self.joints)
        return all(p.get_subscription_count() > 0 for p in publishers)

    def take_answers(self) -> bool:
        """Take what has come, without the executor's wait and task for each; whether any has."""
        before = self.answered
        for answers in self.answers:
            with answers.handle:
                while taken := answers.handle.take_message(answers.msg_type, False):
                    self._on_answer(taken[0])
        return self.answered > before

    def _on_answer(self, message: Any) -> None:
        stamp = message.header.stamp
        sent_at = self.sent_at.pop((message.header.frame_id, stamp.sec * SECOND + stamp.nanosec))
        self.waited.append(time.monotonic() - sent_at)
        self.answered += 1
        self.unusable += not message.load_valid or not message.slip_valid

    def tick(self, i: int, begin: int) -> None:
        stamp = begin + i * SECOND // RATE
        x = SPEED * i / RATE
        # Around a field, so that the window of the cost map moves and comes back.
        self.pose.pose.pose.position.x = RADIUS * math.cos(x / RADIUS)
        self.pose.pose.pose.position.y = RADIUS * math.sin(x / RADIUS)
        # Odometry that goes as far as the wheels by one factor all the time would be made of them.
        slip = 0.1 + 0.04 * math.sin(0.7 * x)
        self.turning.velocity = [SPEED / (1.0 - slip) / 0.125] * len(WHEELS)
        for message, publisher in ((self.pose, self.odometry), (self.turning, self.joints)):
            self.peer.stamp(message, stamp)
            publisher.publish(message)
        for w, (load, sinkage) in enumerate(zip(self.loads, self.sinkages, strict=True)):
            force = 60.0 * (1.0 + 0.3 * math.sin(3.0 * x + w))
            self.wrench.wrench.force.z = force
            self.peer.stamp(self.wrench, stamp)
            load.publish(self.wrench)
            texture = 1.0 + 0.05 * math.sin(17.0 * x + 2.0 * w)
            self.depth.sinkage = 0.008 * (force / 60.0) ** 0.7 * texture
            self.peer.stamp(self.depth, stamp)
            self.sent_at[WHEELS[w], stamp] = time.monotonic()
            sinkage.publish(self.depth)
            self.sent += 1


def test_six_wheels_at_200_hz_lose_nothing_and_need_no_more_memory(
    peer: Peer, tmp_path: Path
) -> None:
    sizes = "".join(f"    {n}: {{diameter: 0.25, width: 0.1}}\n" for n in WHEELS)
    parameters = tmp_path / "rover.yaml"
    # It may be slower than the stamps: they then fall behind the clock.
    timing = "    timing: {maximum_age: 36000.0}\n    mobility: {rate: 0.0}\n"
    wheels = ", ".join(WHEELS)
    parameters.write_text(f"/**:\n  ros__parameters:\n    wheels: [{wheels}]\n{sizes}{timing}")
    log = tmp_path / "node.log"
    rover = Rover(peer)
    tenth = MINUTES * 60 / 10
    ticks = 0
    memory: list[float] = []
    way: list[float] = []  # m, at each
    with NodeProcess([parameters], log) as node:
        peer.spin_until(lambda: rover.heard, "the node listens")
        peer.wait_until_known("/odom", "/joint_states", *rover.topics)
        begin, start = peer.now(), time.monotonic()
        busy = processor_seconds(node.process_id)
        held = 0.0
        while len(memory) < 10:
            rover.tick(ticks, begin)
            ticks += 1
            due, deadline = start + held + ticks / RATE, time.monotonic() + 60.0
            while (late := rover.sent - rover.answered > MOST_UNANSWERED) or (
                time.monotonic() < due
            ):
                if not rover.take_answers():
                    time.sleep(0.0005)
                assert not late or node.death() is None, node.death()
                assert time.monotonic() < deadline, f"{rover.answered} of {rover.sent} answered"
            held += max(0.0, time.monotonic() - due)
            if time.monotonic() >= start + (len(memory) + 1) * tenth:
                memory.append(resident(node.process_id))
                way.append(SPEED * ticks / RATE)
        took = time.monotonic() - start
        share = (processor_seconds(node.process_id) - busy) / took
        peer.spin_until(lambda: rover.answered == rover.sent, "the last answers", 60.0)
        peer.wait_for_turn()  # its counts are then those of all messages
        median, most, all_but_few = 1e3 * np.quantile(rover.waited, (0.5, 0.99, 0.999))
        print(
            f"{rover.sent / took:.0f} of {RATE * len(WHEELS)} sinkages a second for"
            f" {took / 60:.1f} minutes (load of the machine {os.getloadavg()[2]:.1f}); the node had"
            f" {share:.0%} of a processor; {rover.answered} of {rover.sent} sinkages answered, in"
            f" {median:.1f} ms (median), {most:.1f} ms (99 %), {all_but_few:.1f} ms (99.9 %); memory"
            f" after each tenth: {', '.join(f'{size:.1f}' for size in memory)} MB"
        )
        assert rover.sent == ticks * len(WHEELS)
        assert rover.unusable == 0
        counts = peer.counts()
        for name in WHEELS:
            assert f", {ticks} received" in "".join(v for k, v in counts.items() if name in k)
        assert not [key for key in counts if ": " in key and "gate" not in key], counts
        # From the second lap on; a run, or a machine, that does not get so far: all of it.
        round_it = [size for size, at in zip(memory, way, strict=True) if at > LAP]
        steady = round_it if len(round_it) > 1 else memory
        assert max(steady) - steady[0] < 5.0, memory
    assert "Traceback" not in log.read_text()
