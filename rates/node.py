# SPDX-License-Identifier: Apache-2.0
"""The node over DDS: what it costs beside one that only receives, how late its estimates are, how it starts.

    python -m rates.node [--rounds N] [--wheels W] [--rate HZ]

Limit: a receiver, an rclpy node with the same subscriptions and QoS that appends each serialised message
to a list and does nothing else. Both get the same messages, in turns of one run: at each tick loads, odometry
and joint states, then the sinkages, all with one stamp. Target: at most 1.6 times the receiver's processor
time, a median delay of 60 ms from a sinkage to its estimate, and no turn of more than 40 ms. The node is as
it is shipped: every message counts for the soil, ten estimates a second of each wheel go out.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.common.stamps import SECOND

MOST_PROCESSOR, MOST_DELAY, LONGEST_TURN = 1.6, 60.0, 40.0  # times the receiver's, ms, ms
PHASE, SETTLE = 4.0, 1.0  # s of a turn, and of its beginning that does not count for delays
KEPT = 10_000  # messages, of which the receiver forgets the oldest


def names(wheels: int) -> list[str]:
    return [f"wheel_{i}" for i in range(wheels)]


def receive(wheels: int) -> None:
    """Listen to everything that the node listens to, and do nothing with it."""
    from collections import deque

    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from smallwheel_ros.msg import WheelSinkage

    from smallwheel_ros.ros.parameters import INPUT, NO_SUBSCRIPTION_EVENTS

    rclpy.init(args=sys.argv)
    node = Node("mobility_estimator")
    kept: deque[bytes] = deque(maxlen=KEPT)

    def keep(raw: bytes) -> None:
        kept.append(raw)

    topics = {"odom": Odometry, "joint_states": JointState}
    for name in names(wheels):
        topics |= {f"{name}/load": WrenchStamped, f"{name}/sinkage": WheelSinkage}
    for name, kind in topics.items():
        node.create_subscription(
            kind, name, keep, INPUT, raw=True, event_callbacks=NO_SUBSCRIPTION_EVENTS
        )
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


class Vehicle:
    """Publishes what a vehicle's sensors say into one namespace, and times the answers."""

    def __init__(self, node: Any, space: str, wheels: int) -> None:
        from geometry_msgs.msg import WrenchStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import JointState
        from smallwheel_ros.msg import MobilityEstimate, WheelSinkage

        self.latencies: list[float] = []
        self.ticks = 0
        self._node, self._names = node, names(wheels)
        self._times: dict[tuple[str, int], float] = {}
        make = partial(node.create_publisher, qos_profile=100)
        self._loads = [make(WrenchStamped, f"/{space}/{n}/load") for n in self._names]
        self._sinkages = [make(WheelSinkage, f"/{space}/{n}/sinkage") for n in self._names]
        self._odometry = make(Odometry, f"/{space}/odom")
        self._joints = make(JointState, f"/{space}/joint_states")
        for name in self._names:
            topic = f"/{space}/mobility_estimator/{name}/mobility"
            node.create_subscription(MobilityEstimate, topic, self._on_answer, 1000)
        self._odometry_message, self._joints_message = Odometry(), JointState()
        self._odometry_message.header.frame_id = "odom"
        self._odometry_message.pose.pose.orientation.w = 1.0
        self._odometry_message.twist.twist.linear.x = 0.5
        self._joints_message.name = [f"{n}_joint" for n in self._names]
        self._joints_message.velocity = [0.5 / 0.9 / 0.125] * wheels
        self._load_message, self._sinkage_message = WrenchStamped(), WheelSinkage(variance=1e-6)
        self._rng = np.random.default_rng(1)

    @property
    def heard(self) -> bool:
        """Whether the other side listens to everything."""
        publishers = (*self._loads, *self._sinkages, self._odometry, self._joints)
        return all(p.get_subscription_count() > 0 for p in publishers)

    def tick(self, stamp: int, counts: bool) -> None:
        """Publish one instant; counts: its latencies are measured."""
        parts = divmod(stamp, SECOND)

        def stamped(message: Any) -> Any:
            message.header.stamp.sec, message.header.stamp.nanosec = parts
            return message

        self._odometry_message.pose.pose.position.x = 0.005 * self.ticks
        self._odometry.publish(stamped(self._odometry_message))
        self._joints.publish(stamped(self._joints_message))
        loads = 60.0 * (1.0 + 0.3 * np.sin(0.05 * self.ticks + np.arange(len(self._names))))
        for publisher, load in zip(self._loads, loads.tolist(), strict=True):
            self._load_message.wrench.force.z = load
            publisher.publish(stamped(self._load_message))
        depths = 0.008 * (loads / 60.0) ** 0.7 * self._rng.normal(1.0, 0.05, loads.size)
        for publisher, name, depth in zip(
            self._sinkages, self._names, depths.tolist(), strict=True
        ):
            self._sinkage_message.sinkage = depth
            if counts:
                self._times[name, stamp] = time.perf_counter()
            publisher.publish(stamped(self._sinkage_message))
        self.ticks += 1

    def _on_answer(self, message: Any) -> None:
        now = time.perf_counter()
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        sent = self._times.pop((message.header.frame_id, stamp), None)
        if sent is not None:
            self.latencies.append(now - sent)


@contextmanager
def started(command: list[str], space: str, log: Path) -> Iterator[int]:
    """Run a process in a namespace of its own; give its number."""
    with log.open("w") as stream:
        command = [sys.executable, *command, "-r", f"__ns:=/{space}"]
        process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)
    try:
        yield process.pid
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()


def processor_seconds(pid: int) -> float:
    """Time that a process has had on a processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def megabytes(pid: int) -> float:
    """Memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Measured:
    """What is measured of the two. busy: share of a processor in each turn, of each."""

    def __init__(self) -> None:
        self.busy: dict[str, list[float]] = {}
        self.start = self.start_processor = 0.0
        self.turns: list[float] = []  # ms, the longest of each second
        self.memory: list[float] = []  # MB, of the node after each of its turns
        self.vehicle: Vehicle | None = None

    def on_diagnostics(self, message: Any) -> None:
        """Keep the longest turn of the last second, where the node says it."""
        values = [value for status in message.status for value in status.values]
        self.turns += [float(v.value) for v in values if v.key == "longest turn [ms]"]


def measure(wheels: int, rate: float, rounds: int, folder: Path) -> Measured:
    """Start the node, then the receiver, and let them take turns."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    rclpy.init(args=[])
    node, found = Node("vehicle"), Measured()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    parameters = folder / "rover.yaml"
    sizes = "".join(f"    {n}: {{diameter: 0.25, width: 0.1}}\n" for n in names(wheels))
    listing = ", ".join(names(wheels))
    parameters.write_text(f"/**:\n  ros__parameters:\n    wheels: [{listing}]\n{sizes}")
    estimator = ["-m", "smallwheel_ros.ros.mobility_estimator", "--ros-args"]
    estimator += ["--params-file", str(parameters)]
    receiver = ["-m", "rates.node", "--receive", "--wheels", str(wheels), "--ros-args"]
    vehicles = {space: Vehicle(node, space, wheels) for space in ("node", "receiver")}
    found.vehicle = vehicles["node"]

    def wait_for(space: str) -> None:
        deadline = time.monotonic() + 60
        while not vehicles[space].heard:
            executor.spin_once(timeout_sec=0.01)
            if time.monotonic() > deadline:
                sys.exit(f"{space} does not listen; its log is in {folder}")

    begin = time.perf_counter()
    with started(estimator, "node", folder / "node.log") as its:
        wait_for("node")
        found.start, found.start_processor = time.perf_counter() - begin, processor_seconds(its)
        node.create_subscription(DiagnosticArray, "/diagnostics", found.on_diagnostics, 10)
        with started(receiver, "receiver", folder / "receiver.log") as other:
            wait_for("receiver")
            numbers = {"receiver": other, "node": its}
            for _ in range(rounds):
                for space, pid in numbers.items():
                    start, used = time.perf_counter(), processor_seconds(pid)
                    for i in range(round(PHASE * rate)):
                        vehicles[space].tick(time.time_ns(), counts=i >= SETTLE * rate)
                        while time.perf_counter() < start + (i + 1) / rate:
                            executor.spin_once(timeout_sec=0.0005)
                    took = time.perf_counter() - start
                    share = (processor_seconds(pid) - used) / took
                    found.busy.setdefault(space, []).append(share)
                    end = time.perf_counter() + 0.5  # what is late is not lost
                    while time.perf_counter() < end:
                        executor.spin_once(timeout_sec=0.01)
                found.memory.append(megabytes(its))
    rclpy.shutdown()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheels", type=int, default=6)
    parser.add_argument("--rate", type=float, default=200.0, help="Hz of every topic")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--receive", action="store_true", help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.receive:
        receive(options.wheels)
        return
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ROS_LOG_DIR"] = folder
        found = measure(options.wheels, options.rate, options.rounds, Path(folder))
    messages = (2 * options.wheels + 2) * options.rate
    print(
        f"{options.wheels} wheels at {options.rate:g} Hz ({messages:g} messages a second), {options.rounds}"
        f" turns of {PHASE:g} s each; others' load on {os.cpu_count()} processors before: {before:.1f}"
    )
    for space, shares in found.busy.items():
        spread = f"{min(shares):.0%} to {max(shares):.0%}"
        print(f"{space:<10} {np.median(shares):5.0%} of a processor ({spread})")
    ratio = np.median(np.array(found.busy["node"]) / np.array(found.busy["receiver"]))
    assert found.vehicle is not None
    delays = 1e3 * np.array(found.vehicle.latencies)
    median, most = np.percentile(delays, (50, 99)) if delays.size else (np.nan, np.nan)
    longest = max(found.turns, default=float("nan"))
    print(f"node over receiver: {ratio:.2f}")
    print(
        f"from a sinkage to its estimate: median {median:.1f} ms, 99 % {most:.1f} ms, of {delays.size}"
    )
    print(f"longest turn: {longest:.1f} ms (of {len(found.turns)} seconds)")
    print(
        f"start until it listens: {found.start:.2f} s, {found.start_processor:.2f} s of processor"
    )
    print(f"memory of the node after each turn: {', '.join(f'{m:.0f}' for m in found.memory)} MB")
    met = ratio <= MOST_PROCESSOR and median <= MOST_DELAY and longest <= LONGEST_TURN
    print(
        f"target {MOST_PROCESSOR:g}, {MOST_DELAY:g} ms, {LONGEST_TURN:g} ms: {'met' if met else 'MISSED'}"
    )


if __name__ == "__main__":
    main()
