# SPDX-License-Identifier: Apache-2.0
"""The node over DDS: latency from sinkage in to mobility out, and how much it keeps up with.

    python benchmarks/node.py [--rounds N] [--wheels W] [--rate HZ]

Limit: a relay that does nothing, an rclpy node with the same subscriptions and QoS which answers
each sinkage with an empty MobilityEstimate. Both get the same messages, in turns of one run: at each
tick loads, odometry and joint states, then the sinkages, all with one stamp. Target: median and
99th percentile at most twice the relay's, with 4 wheels at 100 Hz.

The node is measured twice: as it is shipped, where a sinkage waits for those of the other wheels
from the same instant or before it, and with timing.reorder_time 0, where it waits for nothing. It
takes every sinkage in and answers mobility.rate of them a second (10 for each wheel); the relay answers all.
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

TARGET = 2.0
SECOND = 10**9
PHASE, SETTLE = 4.0, 1.0  # s of a turn, and of its beginning that does not count
PATIENCE = 1.0  # s without an answer that end a turn


def names(wheels: int) -> list[str]:
    return [f"wheel_{i}" for i in range(wheels)]


def relay(wheels: int) -> None:
    """Answer every sinkage at once, and look at nothing else."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from smallwheel_ros.msg import MobilityEstimate, WheelSinkage

    from smallwheel_ros.ros.parameters import ESTIMATE, INPUT

    rclpy.init(args=sys.argv)
    node = Node("mobility_estimator")
    publisher = node.create_publisher(MobilityEstimate, "~/mobility", ESTIMATE)

    def answer(name: str, message: WheelSinkage) -> None:
        estimate = MobilityEstimate()
        estimate.header.stamp = message.header.stamp
        estimate.header.frame_id = name
        publisher.publish(estimate)

    for name in names(wheels):
        node.create_subscription(WrenchStamped, f"{name}/load", lambda _: None, INPUT)
        node.create_subscription(WheelSinkage, f"{name}/sinkage", partial(answer, name), INPUT)
    node.create_subscription(Odometry, "odom", lambda _: None, INPUT)
    node.create_subscription(JointState, "joint_states", lambda _: None, INPUT)
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
        self.sent = self.answered = self.ticks = 0
        self._node, self._names = node, names(wheels)
        self._times: dict[tuple[str, int], float] = {}
        make = partial(node.create_publisher, qos_profile=100)
        self._loads = [make(WrenchStamped, f"/{space}/{n}/load") for n in self._names]
        self._sinkages = [make(WheelSinkage, f"/{space}/{n}/sinkage") for n in self._names]
        self._odometry = make(Odometry, f"/{space}/odom")
        self._joints = make(JointState, f"/{space}/joint_states")
        topic = f"/{space}/mobility_estimator/mobility"
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
                self.sent += 1
            publisher.publish(stamped(self._sinkage_message))
        self.ticks += 1

    def _on_answer(self, message: Any) -> None:
        now = time.perf_counter()
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        sent = self._times.pop((message.header.frame_id, stamp), None)
        if sent is not None:
            self.answered += 1
            self.latencies.append(now - sent)


@contextmanager
def processes(wheels: int, folder: Path) -> Iterator[dict[str, int]]:
    """Start relay and nodes, each in a process and a namespace of its own; give their numbers."""
    parameters = folder / "rover.yaml"
    sizes = "".join(f"    {n}: {{diameter: 0.25, width: 0.1}}\n" for n in names(wheels))
    listing = ", ".join(names(wheels))
    parameters.write_text(f"/**:\n  ros__parameters:\n    wheels: [{listing}]\n{sizes}")
    node = [sys.executable, "-m", "smallwheel_ros.ros.mobility_estimator", "--ros-args"]
    node += ["--params-file", str(parameters)]
    commands = {
        "relay": [sys.executable, __file__, "--relay", "--wheels", str(wheels), "--ros-args"],
        "shipped": node,
        "unordered": [*node, "-p", "timing.reorder_time:=0.0"],
    }
    started = {}
    try:
        for space, command in commands.items():
            with (folder / f"{space}.log").open("w") as log:
                started[space] = subprocess.Popen(
                    [*command, "-r", f"__ns:=/{space}"], stdout=log, stderr=subprocess.STDOUT
                )
        yield {space: process.pid for space, process in started.items()}
    finally:
        for process in started.values():
            process.terminate()
        for process in started.values():
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def processor_seconds(pid: int) -> float:
    """Time that a process has had on a processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(wheels: int, rate: float, rounds: int, folder: Path) -> tuple[Any, dict[str, float]]:
    """Let all of them take turns; return the vehicles and the processor's share of each."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    rclpy.init(args=[])
    node = Node("vehicle")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    busy = dict.fromkeys(("relay", "shipped", "unordered"), 0.0)
    with processes(wheels, folder) as numbers:
        vehicles = {space: Vehicle(node, space, wheels) for space in numbers}
        deadline = time.monotonic() + 60
        while not all(vehicle.heard for vehicle in vehicles.values()):
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline:
                sys.exit(f"not everybody listens; their logs are in {folder}")
        for _ in range(rounds):
            for space, vehicle in vehicles.items():
                start, used = time.perf_counter(), processor_seconds(numbers[space])
                ticks = round(PHASE * rate)
                for i in range(ticks):
                    vehicle.tick(time.time_ns(), counts=i >= SETTLE * rate)
                    while time.perf_counter() < start + (i + 1) / rate:
                        executor.spin_once(timeout_sec=0.0005)
                busy[space] += processor_seconds(numbers[space]) - used
                # What is late is not lost.
                answered, end = vehicle.answered, time.perf_counter() + PATIENCE
                while time.perf_counter() < end and vehicle.answered < vehicle.sent:
                    executor.spin_once(timeout_sec=0.01)
                    if vehicle.answered > answered:
                        answered, end = vehicle.answered, time.perf_counter() + PATIENCE
    rclpy.shutdown()
    return vehicles, {space: value / (rounds * PHASE) for space, value in busy.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheels", type=int, default=4)
    parser.add_argument("--rate", type=float, default=100.0, help="Hz of every topic")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--relay", action="store_true", help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.relay:
        relay(options.wheels)
        return
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ROS_LOG_DIR"] = folder
        vehicles, busy = measure(options.wheels, options.rate, options.rounds, Path(folder))
    print(
        f"{options.wheels} wheels at {options.rate:g} Hz, {options.rounds} turns of"
        f" {PHASE - SETTLE:g} s each; others' load on {os.cpu_count()} processors before: {before:.1f}"
    )
    print("                                  median          99 %   answered        processor")
    labels = {
        "relay": "relay that does nothing",
        "shipped": "node as shipped",
        "unordered": "node, reorder_time 0",
    }
    limits: np.ndarray | None = None
    worst = 0.0
    for space, vehicle in vehicles.items():
        quantiles = 1e3 * np.percentile(vehicle.latencies, (50, 99))
        if limits is None:
            limits = quantiles
        ratios = quantiles / limits
        worst = max(worst, *ratios.tolist())
        print(
            f"{labels[space]:<26} {quantiles[0]:6.2f} ms {ratios[0]:4.1f}x {quantiles[1]:7.2f} ms"
            f" {ratios[1]:4.1f}x {vehicle.answered:>5}/{vehicle.sent} {busy[space]:>8.0%}"
        )
    print(f"target: at most {TARGET:g}x: {'met' if worst <= TARGET else 'MISSED'}")


if __name__ == "__main__":
    main()
