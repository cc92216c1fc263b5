"""The node `mobility_estimator`: converts, calls `Onboard`, publishes.

It is a lifecycle node that configures and activates itself unless the parameter autostart is false.
Where it cannot be configured it says why in one message; with autostart it then ends with exit code
2, otherwise it stays unconfigured and says so in its diagnostics.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial, wraps
from typing import Any, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import (
    LifecycleNode,
    LifecyclePublisher,
    LifecycleState,
    TransitionCallbackReturn,
)
from rclpy.qos import qos_policy_name_from_kind
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState

from smallwheel_ros.msg import MobilityEstimate as MobilityMessage
from smallwheel_ros.msg import SoilEstimate as SoilMessage
from smallwheel_ros.msg import WheelSinkage
from smallwheel_ros.onboard.intake import ODOMETRY
from smallwheel_ros.onboard.mobility import MobilityEstimate
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.parameters import NODE_NAME, NodeSettings, ParametersError
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.conversions import mobility_message, nanoseconds_of, soil_message
from smallwheel_ros.ros.node_parameters import NodeParameters
from smallwheel_ros.ros.reporting import Reporter, inputs_of, status

_SOIL_PERIOD = SECOND // 10  # by stamps: no more than ten times a second
_FLUSH_AFTER = 2.0  # s without any message: what waits for others is worked on without them
_WAITING_EVERY = 5.0  # s
EXIT_BAD_INPUT = 2

Transition = TypeVar("Transition", bound=Callable[..., TransitionCallbackReturn])


def _says_why(transition: Transition) -> Transition:
    """Log what a transition raises: rclpy swallows it."""

    @wraps(transition)
    def guarded(self: MobilityEstimator, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except Exception:
            self.get_logger().error(f"{transition.__name__} failed:\n{traceback.format_exc()}")
            return TransitionCallbackReturn.FAILURE

    return guarded  # type: ignore[return-value]  # the same signature, by construction


class MobilityEstimator(LifecycleNode):  # type: ignore[misc]  # rclpy has no types
    """Wheel loads, odometry, wheel speeds and measured sinkage in; soil and mobility out."""

    def __init__(self, **options: Any) -> None:
        super().__init__(NODE_NAME, automatically_declare_parameters_from_overrides=True, **options)
        self._onboard: Onboard | None = None
        self._reporter = Reporter(self, [])
        self._listening: list[Subscription] = []
        self._ticking: list[Timer] = []
        self._newest: dict[str, MobilityEstimate] = {}
        self._soil_sent: int | None = None
        self._soil_waits: Result | None = None
        self._odometry_frame = ""
        self._last_arrival = time.monotonic()
        self.problem = ""  # why it could not be configured
        self._table = NodeParameters(self, may_change=lambda: self._onboard is None)
        for text in self._table.unknown:
            self.get_logger().warning(text)
        # From a wall clock: diagnostics must come even while /clock stands still.
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics, clock=self._wall)

    @property
    def autostart(self) -> bool:
        """Whether the node is to configure and activate itself."""
        return self._table.values()["autostart"] is not False

    # --- Transitions

    @_says_why
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, and make everything but the subscriptions."""
        try:
            self._settings = self._table.settings()
        except ParametersError as error:
            self.problem = f"cannot be configured: {error}"
            self.get_logger().error(self.problem)
            return TransitionCallbackReturn.FAILURE
        self.problem = ""
        values = ", ".join(f"{k}={v}" for k, v in self._table.values().items() if v is not None)
        self.get_logger().info(f"effective parameters: {values}")
        self._onboard = Onboard(self._settings.onboard)
        self._reporter = Reporter(self, inputs_of(self, self._settings, self._onboard.streams))
        self._mobility = self._output(MobilityMessage, "~/mobility", qos.ESTIMATE)
        self._soil = self._output(SoilMessage, "~/soil", qos.LATCHED)
        return super().on_configure(state)

    @_says_why
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and publish the soil as it is believed before any measurement."""
        result = super().on_activate(state)
        self._listen(self._settings)
        self._ticking = [
            self.create_timer(0.5, self._flush, clock=self._wall),
            self.create_timer(_WAITING_EVERY, self._say_what_is_missing, clock=self._wall),
        ]
        assert self._onboard is not None
        stamp = self.get_clock().now().nanoseconds
        self._soil.publish(soil_message(self._onboard.soil, stamp, "", self._onboard.rejected))
        return result

    @_says_why
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen no more; what was learnt is kept for the next activation."""
        self._stop_listening()
        return super().on_deactivate(state)

    @_says_why
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything: parameters may change now."""
        result = super().on_cleanup(state)
        self._forget()
        return result

    @_says_why
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good."""
        self._stop_listening()
        result = super().on_shutdown(state)
        self._forget()
        return result

    def _forget(self) -> None:
        if self._onboard is not None:
            self.destroy_lifecycle_publisher(self._mobility)
            self.destroy_lifecycle_publisher(self._soil)
        self._onboard = None
        self._reporter = Reporter(self, [])
        self._newest, self._soil_sent, self._soil_waits = {}, None, None

    # --- Topics

    def _listen(self, settings: NodeSettings) -> None:
        assert self._onboard is not None
        self._last_arrival = time.monotonic()
        for name, inputs in settings.inputs.items():
            self._input(WrenchStamped, inputs.load_topic, partial(self._on_load, name))
            if inputs.sinkage_topic:
                self._input(WheelSinkage, inputs.sinkage_topic, partial(self._on_sinkage, name))
        if ODOMETRY in self._onboard.streams:
            self._input(Odometry, "odom", self._on_odometry)
            self._wheels_of = {
                inputs.joint: name
                for name, inputs in settings.inputs.items()
                if f"{name}/wheel_speed" in self._onboard.streams
            }
            self._input(JointState, "joint_states", self._on_joint_states)

    def _stop_listening(self) -> None:
        for subscription in self._listening:
            self.destroy_subscription(subscription)
        for timer in self._ticking:
            self.destroy_timer(timer)
        self._listening, self._ticking = [], []

    def _input(self, kind: Any, topic: str, callback: Callable[[Any], None]) -> None:
        # Each event handler costs time at every wait: what they would tell of inputs, the reporter
        # finds out where a topic stays silent.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._listening.append(
            self.create_subscription(kind, topic, callback, qos.INPUT, event_callbacks=events)
        )

    def _output(self, kind: Any, topic: str, profile: Any) -> LifecyclePublisher:
        def incompatible(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            text = f"a subscriber asks for QoS that is not offered ({policy}): it gets nothing"
            self._report(self.resolve_topic_name(topic), "incompatible_qos", text)

        events = PublisherEventCallbacks(incompatible_qos=incompatible, use_default_callbacks=False)
        return self.create_lifecycle_publisher(kind, topic, profile, event_callbacks=events)

    # --- Messages: convert, call, publish

    def _on_load(self, wheel: str, message: WrenchStamped) -> None:
        load = self._settings.load_sign * message.wrench.force.z
        self._take("on_load", wheel, nanoseconds_of(message.header.stamp), load)

    def _on_sinkage(self, wheel: str, message: WheelSinkage) -> None:
        stamp = nanoseconds_of(message.header.stamp)
        self._take("on_sinkage", wheel, stamp, message.sinkage, message.variance)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry_frame = message.header.frame_id
        place, twist = message.pose.pose.position, message.twist.twist
        stamp = nanoseconds_of(message.header.stamp)
        self._take("on_odometry", stamp, place.x, place.y, twist.linear.x, twist.angular.z)

    def _on_joint_states(self, message: JointState) -> None:
        known = [
            (i, self._wheels_of[n]) for i, n in enumerate(message.name) if n in self._wheels_of
        ]
        if known and len(message.velocity) != len(message.name):
            text = f"{len(message.name)} joints have {len(message.velocity)} velocities"
            self._report("joint_states", "no_velocity", text)
            return
        stamp = nanoseconds_of(message.header.stamp)
        for i, wheel in known:
            self._take("on_wheel_speed", wheel, stamp, message.velocity[i])

    def _take(self, method: str, *values: Any) -> None:
        if self._onboard is None:
            return
        self._last_arrival = time.monotonic()
        try:
            now = self.get_clock().now().nanoseconds
            self._publish(getattr(self._onboard, method)(*values, now=now))
        except Exception:
            # A defect of this package must not take a robot's node down; it is loud all the same.
            text = f"{method}{values} failed:\n{traceback.format_exc()}"
            self._report(method, "internal_error", text)
        self._reporter.log_problems(self._onboard.take_problems())

    def _report(self, stream: str, reason: str, text: str) -> None:
        if self._onboard is not None:
            self._onboard.report(stream, reason, text)
            self._reporter.log_problems(self._onboard.take_problems())

    def _publish(self, results: Sequence[Result]) -> None:
        for result in results:
            self._mobility.publish(mobility_message(result.mobility))
            self._newest[result.mobility.wheel] = result.mobility
            stamp = result.mobility.stamp
            sent = self._soil_sent
            if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
                self._publish_soil(result)
            else:
                self._soil_waits = result

    def _publish_soil(self, result: Result) -> None:
        stamp = result.mobility.stamp
        self._soil.publish(soil_message(result.soil, stamp, self._odometry_frame, result.rejected))
        self._soil_sent, self._soil_waits = stamp, None

    # --- Timers, all of the wall clock

    def _flush(self) -> None:
        """Let nothing wait for messages that do not come."""
        if self._onboard is None:
            return
        if time.monotonic() - self._last_arrival > _FLUSH_AFTER:
            self._publish(self._onboard.flush())
            self._reporter.log_problems(self._onboard.take_problems())
        if self._soil_waits is not None:
            self._publish_soil(self._soil_waits)

    def _say_what_is_missing(self) -> None:
        if self._onboard is not None:
            for text in self._reporter.waiting_for(self._onboard):
                self.get_logger().warning(f"still waiting for {text}")

    def _publish_diagnostics(self) -> None:
        name = self.get_fully_qualified_name().lstrip("/")
        listening = self._onboard if self._listening else None
        entries = self._reporter.entries(name, listening, self._newest.values())
        if self.problem:
            entries = [status(f"{name}: parameters", DiagnosticStatus.ERROR, self.problem)]
        elif self._table.unknown:
            text = "; ".join(self._table.unknown)
            entries.append(status(f"{name}: parameters", DiagnosticStatus.WARN, text))
        array = DiagnosticArray(status=entries)
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code: 0 ended as asked, 2 wrong parameters or arguments."""
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
        node = MobilityEstimator()
    except Exception as error:
        # rcl explains what is wrong with ROS arguments or a parameter file, in several lines.
        reason = " ".join(str(error).split()) or type(error).__name__
        print(f"{NODE_NAME}: cannot start: {reason}", file=sys.stderr)
        rclpy.try_shutdown()
        return EXIT_BAD_INPUT
    try:
        if node.autostart:
            node.trigger_configure()
            if node.problem:
                return EXIT_BAD_INPUT
            node.trigger_activate()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
