# SPDX-License-Identifier: Apache-2.0
"""The other side of the node in tests: publishes and listens in the test's own process."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ONE_WHEEL = """/**:
  ros__parameters:
    wheels: [front]
    front:
      diameter: 0.25
      width: 0.1
    timing:
      reorder_time: 0.05
    mobility:
      rate: 0.0
"""
NODE = "mobility_estimator"
SECOND = 10**9


def documented_reasons(repository: Path) -> set[str]:
    """Reasons that messages are counted by, as the table in docs/node.md has them."""
    text = (repository / "docs" / "node.md").read_text()
    table = text.split("| reason | means | what to do |")[1].split("\n### ")[0]
    names = (line.split("|")[1] for line in table.splitlines() if line.startswith("|"))
    return {name.strip() for cell in names for name in cell.split(",")}


def refused_start(capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Start the node in this process with ROS arguments; return what it says as it ends with 2."""
    from smallwheel_ros.ros.mobility_estimator import EXIT_BAD_INPUT, main

    capfd.readouterr()
    assert main(["--ros-args", *arguments]) == EXIT_BAD_INPUT
    said = capfd.readouterr().err
    assert "Traceback" not in said
    return said


class Peer:
    """Publishes for one wheel, `front`, and collects everything that the node publishes."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import WrenchStamped
        from rclpy.node import Node
        from smallwheel_ros.msg import MobilityEstimate, VehicleMobility, WheelSinkage

        rclpy.init(args=[])
        self.rclpy = rclpy
        self.node = Node("peer")
        self.mobility: list[Any] = []
        self.diagnostics: dict[str, Any] = {}
        self.diagnosed = 0  # times that the node has published its diagnostics
        self.vehicle: list[Any] = []
        self.listen(MobilityEstimate, "front/mobility", self.mobility.append)
        self.listen(VehicleMobility, "vehicle", self.vehicle.append)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 10)
        self.load = self.node.create_publisher(WrenchStamped, "/front/load", 100)
        self.sinkage = self.node.create_publisher(WheelSinkage, "/front/sinkage", 100)
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}

    def close(self) -> None:
        self.node.destroy_node()
        self.rclpy.try_shutdown()

    def _diagnose(self, message: Any) -> None:
        for status in message.status:
            self.diagnostics[status.name] = status
        self.diagnosed += any(status.name.startswith(NODE) for status in message.status)

    # --- Listening

    def listen(self, kind: Any, output: str, callback: Callable[[Any], Any]) -> Any:
        return self.node.create_subscription(kind, f"/{NODE}/{output}", callback, 100)

    def latched(self, kind: Any, output: str) -> list[Any]:
        """Collect a latched output; a subscription made late gets the newest."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        found: list[Any] = []
        profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(kind, f"/{NODE}/{output}", found.append, profile)
        return found

    def spin_until(self, done: Callable[[], bool], what: str, seconds: float = 60.0) -> None:
        """Wait for an event; the limit is far beyond what it takes on a busy machine."""
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, f"not within {seconds} s: {what}"
            self.rclpy.spin_once(self.node, timeout_sec=0.02)

    def spin(self, seconds: float) -> None:
        """Let time pass: the pace of what is published, not a wait for something to happen."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.rclpy.spin_once(self.node, timeout_sec=0.02)

    def wait_for_node(self) -> None:
        """Wait until the node listens to this side, and knows that this side listens to it.

        DDS announces the subscriptions of one side in the order in which they were made: once the
        diagnostics come, the node knows the subscription to mobility as well.
        """
        self.diagnostics.clear()
        self.spin_until(lambda: self.sinkage.get_subscription_count() > 0, "the node listens")
        self.wait_until_known(self.load.topic_name, self.sinkage.topic_name)

    def wait_until_known(self, *topics: str) -> None:
        """Wait until the node says nothing of lacking the publishers of these topics."""

        def known() -> bool:
            inputs = self.entry("inputs")
            lacking = r"waiting for {} \([^)]*\): no publisher"
            return inputs is not None and not any(
                re.search(lacking.format(re.escape(topic)), inputs.message) for topic in topics
            )

        self.spin_until(known, f"the node knows the publishers of {', '.join(topics)}")

    def wait_for_turn(self) -> None:
        """Wait until the node's timers have run once more: what was to be published has come."""
        until = self.diagnosed + 2  # the next one may be under way already
        self.spin_until(lambda: self.diagnosed >= until, "further diagnostics")

    # --- Publishing

    def announce(self, **kinds: Any) -> None:
        """Make the publishers of these topics that are not there, and wait until they are known."""
        made = {f"/{topic}": kind for topic, kind in kinds.items()}
        new = [topic for topic in made if topic not in self._publishers]
        for topic in new:
            self._publishers[topic] = self.node.create_publisher(made[topic], topic, 100)
        if new:
            self.wait_until_known(*new)

    def publish(self, topic: str, message: Any) -> None:
        """Publish, by a publisher that is made the first time."""
        self.announce(**{topic.lstrip("/"): type(message)})
        self._publishers[topic].publish(message)

    def now(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def stamp(self, message: Any, stamp: int | None = None) -> int:
        stamp = self.now() if stamp is None else stamp
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, SECOND)
        return stamp

    def send_load(self, force: float, stamp: int | None = None) -> int:
        from geometry_msgs.msg import WrenchStamped

        message = WrenchStamped()
        stamp = self.stamp(message, stamp)
        message.wrench.force.z = force
        self.load.publish(message)
        return stamp

    def send_sinkage(self, sinkage: float, stamp: int | None = None, variance: float = 0.0) -> int:
        from smallwheel_ros.msg import WheelSinkage

        message = WheelSinkage(sinkage=sinkage, variance=variance)
        stamp = self.stamp(message, stamp)
        self.sinkage.publish(message)
        return stamp

    def send_odometry(
        self, x: float, speed: float, stamp: int | None = None, frame: str = "odom", y: float = 0.0
    ) -> int:
        from nav_msgs.msg import Odometry

        message = Odometry(child_frame_id="base_link")
        stamp = self.stamp(message, stamp)
        message.header.frame_id = frame
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.w = 1.0
        message.twist.twist.linear.x = speed
        self.publish("/odom", message)
        return stamp

    def send_wheel_speed(self, turning: float, stamp: int | None = None) -> int:
        from sensor_msgs.msg import JointState

        message = JointState(name=["front_joint"], velocity=[turning])
        stamp = self.stamp(message, stamp)
        self.publish("/joint_states", message)
        return stamp

    def drive(
        self,
        start: float,
        end: float,
        *,
        sinkage: float = 0.008,
        step: float = 0.02,
        load: float = 60.0,
        frame: str = "odom",
        begin: int | None = None,
        slip: float = 0.1,
        period: float = 0.02,
        variance: float = 1e-7,
    ) -> int:
        """Drive along x, publishing everything at each step; return the last stamp.

        begin: first stamp; later ones follow at the period, however fast this runs.
        """
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import JointState

        self.announce(odom=Odometry, joint_states=JointState)
        count = math.ceil((end - start) / step)
        speed = step / period
        stamp = 0
        for i in range(count):
            # Loads vary, or n would never be told from the pressure.
            force = load * (1.0 + 0.3 * math.sin(0.7 * i))
            depth = sinkage * (force / load) ** 0.7
            moment = None if begin is None else begin + round(i * period * SECOND)
            stamp = self.send_odometry(start + i * step, speed, moment, frame)
            self.send_wheel_speed(speed / (1.0 - slip) / 0.125, stamp)
            self.send_load(force, stamp)
            self.send_sinkage(depth, stamp, variance)
            self.spin(period)
        return stamp

    # --- Asking

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Ask the node, once it is known to know this side: an answer to a stranger is lost.

        A service is ready as soon as this side knows of it. The middleware of the other waits 0.1 s
        for whoever asked, which on a busy machine may not be enough to discover a participant.
        """
        self.spin_until(lambda: self.diagnosed > 0, "the node knows this side")
        client = self._clients.get(service)
        if client is None:
            client = self.node.create_client(kind, f"/{NODE}/{service}")
            self._clients[service] = client
        self.spin_until(client.service_is_ready, f"service {service}")
        future = client.call_async(request)
        self.spin_until(future.done, f"answer of {service}")
        return future.result()

    def trigger(self, service: str) -> Any:
        from std_srvs.srv import Trigger

        return self.call(Trigger, service, Trigger.Request())

    def set_parameter(self, name: str, value: object) -> Any:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.call(SetParameters, "set_parameters", request).results[0]

    def value(self, name: str) -> Any:
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        answer = self.call(GetParameters, "get_parameters", GetParameters.Request(names=[name]))
        return parameter_value_to_python(answer.values[0])

    def transition(self, number: int = 0, label: str = "") -> bool:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        request = ChangeState.Request(transition=Transition(id=number, label=label))
        return bool(self.call(ChangeState, "change_state", request).success)

    def configure_with(self, name: str, value: object) -> None:
        """As the refusal of a change says: deactivate, set, clean up, configure, activate."""
        assert self.transition(label="deactivate")
        assert self.set_parameter(name, value).successful
        for label in ("cleanup", "configure", "activate"):
            assert self.transition(label=label), label

    def answered(self, stamp: int) -> bool:
        """Whether the newest estimate is of that stamp."""
        if not self.mobility:
            return False
        newest = self.mobility[-1].header.stamp
        return bool(newest.sec * SECOND + newest.nanosec == stamp)

    def entry(self, name: str) -> Any:
        return self.diagnostics.get(f"{NODE}: {name}")

    def counts(self) -> dict[str, str]:
        status = self.entry("inputs")
        return {} if status is None else {v.key: v.value for v in status.values}
