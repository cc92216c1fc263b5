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
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped, WrenchStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import (
    LifecycleNode,
    LifecyclePublisher,
    LifecycleState,
    TransitionCallbackReturn,
)
from rclpy.qos import QoSProfile, qos_policy_name_from_kind
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState, Range
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from smallwheel_ros.msg import MobilityEstimate as MobilityMessage
from smallwheel_ros.msg import SoilEstimate as SoilMessage
from smallwheel_ros.msg import WheelSinkage
from smallwheel_ros.onboard.feed import Feed, Topic
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.parameters import NODE_NAME, NodeSettings, ParametersError
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.conversions import mobility_message, soil_message
from smallwheel_ros.ros.cost_publisher import TERRAIN_CLASSES, CostPublisher
from smallwheel_ros.ros.diagnostics import ERROR, OK, WARN, entries, status
from smallwheel_ros.ros.markers import markers
from smallwheel_ros.ros.node_parameters import NodeParameters
from smallwheel_ros.ros.reporting import Reporter, inputs_of

_SOIL_PERIOD = SECOND // 10  # by stamps: no more than ten times a second
_FLUSH_AFTER = 2.0  # s without any message: what waits for others is worked on without them
_WAITING_EVERY = 5.0  # s
_MARKERS_EVERY = 0.2  # s
EXIT_BAD_INPUT = 2

_TYPES = {
    "geometry_msgs/msg/TwistStamped": TwistStamped,
    "geometry_msgs/msg/WrenchStamped": WrenchStamped,
    "nav_msgs/msg/Odometry": Odometry,
    "sensor_msgs/msg/JointState": JointState,
    "sensor_msgs/msg/Range": Range,
    "smallwheel_ros/msg/WheelSinkage": WheelSinkage,
}

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
        self._newest: dict[str, Result] = {}
        self._soil_sent: int | None = None
        self._soil_waits: Result | None = None
        self._time_jumps = 0
        self._last_arrival = time.monotonic()
        self.problem = ""  # why it could not be configured
        self._table = NodeParameters(
            self, in_use=lambda: self._onboard is not None, changed=self._on_parameters
        )
        for text in self._table.unknown:
            self.get_logger().warning(text)
        # From a wall clock: diagnostics must come even while /clock stands still.
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics, clock=self._wall)
        self.create_service(Trigger, "~/reset", self._on_reset)

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
        self._feed_with(self._settings)
        self._mobility = self._output(MobilityMessage, "~/mobility", qos.ESTIMATE)
        self._soil = self._output(SoilMessage, "~/soil", qos.LATCHED)
        self._markers = self._output(MarkerArray, "~/markers", qos.ESTIMATE)
        self._cost_output = self._output(OccupancyGrid, "~/cost", qos.LATCHED)
        self._cost = CostPublisher(
            self._settings.cost, self._wheels, self._cost_output, self._report
        )
        return super().on_configure(state)

    @_says_why
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and publish the soil as it is believed before any measurement."""
        result = super().on_activate(state)
        self._listen()
        self._publish_soil_as_it_is()
        return result

    @_says_why
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen no more; what was learnt is kept for the next activation."""
        self._stop_listening()
        return super().on_deactivate(state)

    @_says_why
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything."""
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
            for publisher in (self._mobility, self._soil, self._markers, self._cost_output):
                self.destroy_lifecycle_publisher(publisher)
        self._onboard = None
        self._reporter = Reporter(self, [])
        self._newest, self._soil_sent, self._soil_waits = {}, None, None

    # --- Parameters and services

    def _on_parameters(self) -> None:
        """Go by parameters that were changed while they are in use; they have been checked."""
        assert self._onboard is not None
        before, self._settings = self._settings, self._table.settings()
        if before == self._settings:
            return
        self._publish(self._onboard.flush())
        words = []
        if before.onboard != self._settings.onboard and self._onboard.apply(self._settings.onboard):
            words.append("the soil starts over")
            self._publish_soil_as_it_is()
        self._feed_with(self._settings)
        if self._cost.apply(self._settings.cost, self._wheels):
            words.append("the cost map starts over")
        if self._listening:
            self._stop_listening()
            self._listen()
        self.get_logger().info("; ".join(["parameters changed", *words]))

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._onboard is None:
            response.message = "not configured: there is nothing to reset"
            return response
        self._onboard.reset()
        self._start_over()
        self._publish_soil_as_it_is()
        response.success = True
        response.message = "soil, cost map and buffers start over; the counts go on"
        self.get_logger().info(f"reset: {response.message}")
        return response

    def _start_over(self) -> None:
        self._cost.clear()
        self._newest, self._soil_sent, self._soil_waits = {}, None, None

    # --- Topics

    @property
    def _wheels(self) -> dict[str, Wheel]:
        return {wheel.name: wheel for wheel in self._settings.onboard.wheels}

    def _feed_with(self, settings: NodeSettings) -> None:
        assert self._onboard is not None
        self._feed = Feed(self._onboard, settings)
        self._reporter.inputs = {i.stream: i for i in inputs_of(self, self._feed.topics)}

    def _listen(self) -> None:
        self._last_arrival = time.monotonic()
        for topic in self._feed.topics:
            self._input(_TYPES[topic.type], topic.name, partial(self._take, topic), qos.INPUT)
        # A classifier's grids come as they are made, a map server's one grid was there before us.
        for profile in (qos.INPUT, qos.LATCHED):
            self._input(OccupancyGrid, TERRAIN_CLASSES, self._on_classes, profile)
        self._ticking = [
            self.create_timer(0.5, self._flush, clock=self._wall),
            self.create_timer(_WAITING_EVERY, self._say_what_is_missing, clock=self._wall),
            self.create_timer(self._settings.cost.period, self._publish_cost, clock=self._wall),
            self.create_timer(_MARKERS_EVERY, self._publish_markers, clock=self._wall),
        ]

    def _stop_listening(self) -> None:
        for subscription in self._listening:
            self.destroy_subscription(subscription)
        for timer in self._ticking:
            self.destroy_timer(timer)
        self._listening, self._ticking = [], []

    def _input(
        self, kind: Any, topic: str, callback: Callable[[Any], None], profile: QoSProfile
    ) -> None:
        # Each event handler costs time at every wait: what they would tell of inputs, the reporter
        # finds out where a topic stays silent.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._listening.append(
            self.create_subscription(kind, topic, callback, profile, event_callbacks=events)
        )

    def _output(self, kind: Any, topic: str, profile: QoSProfile) -> LifecyclePublisher:
        def incompatible(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            text = f"a subscriber asks for QoS that is not offered ({policy}): it gets nothing"
            self._report(topic, "incompatible_qos", text)

        events = PublisherEventCallbacks(incompatible_qos=incompatible, use_default_callbacks=False)
        return self.create_lifecycle_publisher(kind, topic, profile, event_callbacks=events)

    # --- Messages: feed them, publish what comes of it

    def _take(self, topic: Topic, message: Any) -> None:
        if self._onboard is None:
            return
        self._last_arrival = time.monotonic()
        try:
            self._publish(topic.handle(message, self.get_clock().now().nanoseconds))
        except Exception:
            # A defect of this package must not take a robot's node down; it is loud all the same.
            text = f"a message of {topic.type} failed:\n{traceback.format_exc()}"
            self._report(topic.name, "internal_error", text)
        self._reporter.log_problems(self._onboard.take_problems())

    def _on_classes(self, message: OccupancyGrid) -> None:
        self._cost.on_classes(message)

    def _report(self, topic: str, reason: str, text: str) -> None:
        if self._onboard is not None:
            self._onboard.report(self.resolve_topic_name(topic), reason, text)
            self._reporter.log_problems(self._onboard.take_problems())

    def _publish(self, results: Sequence[Result]) -> None:
        assert self._onboard is not None
        if self._time_jumps != self._onboard.time_jumps:
            self._time_jumps = self._onboard.time_jumps
            self._start_over()
        for result in results:
            self._mobility.publish(mobility_message(result.mobility))
            self._cost.add(result, self._feed.odometry_frame)
            self._newest[result.mobility.wheel] = result
            stamp = result.mobility.stamp
            sent = self._soil_sent
            if sent is None or not sent <= stamp < sent + _SOIL_PERIOD:
                self._publish_soil(result)
            else:
                self._soil_waits = result

    def _publish_soil(self, result: Result) -> None:
        stamp, frame = result.mobility.stamp, self._feed.odometry_frame
        self._soil.publish(soil_message(result.soil, stamp, frame, result.rejected))
        self._soil_sent, self._soil_waits = stamp, None

    def _publish_soil_as_it_is(self) -> None:
        assert self._onboard is not None
        stamp, frame = self.get_clock().now().nanoseconds, self._feed.odometry_frame
        self._soil.publish(soil_message(self._onboard.soil, stamp, frame, self._onboard.rejected))

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

    def _publish_cost(self) -> None:
        self._cost.publish(self.get_clock().now().nanoseconds)

    def _publish_markers(self) -> None:
        if self._newest and self._markers.get_subscription_count():
            frame = self._feed.odometry_frame
            self._markers.publish(markers(self._newest, self._wheels, frame))

    def _publish_diagnostics(self) -> None:
        name = self.get_fully_qualified_name().lstrip("/")
        if self.problem:
            found = [status(f"{name}: parameters", ERROR, self.problem)]
        elif self._onboard is None or not self._listening:
            text = "not active: it waits for a lifecycle manager"
            found = [status(f"{name}: inputs", OK, text)]
        else:
            newest = [result.mobility for result in self._newest.values()]
            found = entries(name, self._onboard, self._reporter, newest, self._cost)
        if self._table.unknown and not self.problem:
            found.append(status(f"{name}: parameters", WARN, "; ".join(self._table.unknown)))
        array = DiagnosticArray(status=found)
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
    except Exception:
        # A signal ends ROS at any moment: what was about to be published then fails.
        if rclpy.ok():
            raise
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
