"""The node `mobility_estimator`: converts, calls `Onboard`, publishes.

It is a lifecycle node that configures and activates itself unless the parameter autostart is false.
Where it cannot be configured it says why in one message; with autostart it then ends with exit code
2, otherwise it stays unconfigured and says so in its diagnostics.
"""

from __future__ import annotations

import gc
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial, wraps
from typing import Any, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import (
    LifecycleNode,
    LifecycleState,
    TransitionCallbackReturn,
)
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from smallwheel_ros.onboard.feed import Feed, Topic
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.parameters import NODE_NAME, ParametersError
from smallwheel_ros.ros import qos
from smallwheel_ros.ros.cost_publisher import TERRAIN_CLASSES
from smallwheel_ros.ros.diagnostics import ERROR, OK, WARN, alarms, entries, status
from smallwheel_ros.ros.listening import Listening
from smallwheel_ros.ros.node_parameters import NodeParameters
from smallwheel_ros.ros.outputs import Outputs
from smallwheel_ros.ros.reporting import Reporter, inputs_of
from smallwheel_ros.ros.soil_file import SoilFile

_FLUSH_AFTER = 2.0  # s without any message: what waits for others is worked on without them
_WAITING_EVERY = 5.0  # s
_MARKERS_EVERY = 0.2  # s
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
        self._listening = Listening(self)
        self._ticking: list[Timer] = []
        self._alarm = ""  # the newest, in words
        self._last_arrival = time.monotonic()
        self.problem = ""  # why it could not be configured
        self._table = NodeParameters(
            self, in_use=lambda: self._onboard is not None, changed=self._on_parameters
        )
        for text in self._table.unknown:
            self.get_logger().warning(text)
        # From a wall clock: diagnostics must come even while /clock stands still.
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", 10, event_callbacks=qos.no_events()
        )
        self.create_timer(1.0, self._publish_diagnostics, clock=self._wall)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/save_soil", self._on_save_soil)

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
        self._onboard = Onboard(self._settings.onboard, on_result=self._answer)
        for text in self._onboard.undeterminable:
            self.get_logger().warning(text)
        self._time_jumps = 0
        self._feed_with(Feed(self._onboard, self._settings))
        self._outputs = Outputs(self, self._settings, self._report)
        self._soil_file = SoilFile(self._settings.soil_file)
        restored = self._soil_file.restore(self._onboard)
        if self._soil_file.problem:
            self.get_logger().warning(restored)
        elif restored:
            self.get_logger().info(restored)
        return super().on_configure(state)

    @_says_why
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and publish the soil as it is believed before any measurement."""
        result = super().on_activate(state)
        self._listen()
        assert self._onboard is not None
        self._outputs.publish_soil_of(self._onboard, self._feed.odometry_frame)
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
            self._outputs.destroy()
        self._onboard = None
        self._reporter = Reporter(self, [])

    # --- Parameters and services

    def _on_parameters(self, changes: str) -> None:
        """Go by parameters that were changed while they are in use; they have been checked."""
        assert self._onboard is not None
        try:
            before, self._settings = self._settings, self._table.settings()
        except ParametersError as error:  # a file that they name has changed since the check
            self.get_logger().error(f"parameters not changed: {error}")
            return
        if before == self._settings:
            return
        active = self._listening.on
        if active:
            self._keep(self._onboard.flush())
        words = [f"parameters changed: {changes}"]
        if before.onboard != self._settings.onboard and self._onboard.apply(self._settings.onboard):
            words.append("the soil starts over")
            if active:
                self._outputs.publish_soil_of(self._onboard, self._feed.odometry_frame)
        self._soil_file = SoilFile(self._settings.soil_file)
        self._feed_with(Feed(self._onboard, self._settings, self._feed.odometry_frame))
        if self._outputs.apply(self._settings):
            words.append("the cost map starts over")
        if active:
            self._stop_listening()
            self._listen()
        self.get_logger().info("; ".join(words))

    def _on_save_soil(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._onboard is None:
            response.message = "not configured: there is no soil to save"
        else:
            response.success, response.message = self._soil_file.save(self._onboard)
        self.get_logger().info(f"save_soil: {response.message}")
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._onboard is None:
            response.message = "not configured: there is nothing to reset"
            return response
        self._onboard.reset()
        self._outputs.start_over()
        if self._listening.on:
            self._outputs.publish_soil_of(self._onboard, self._feed.odometry_frame)
        response.success = True
        response.message = "soil, cost map and buffers start over; the counts go on"
        self.get_logger().info(f"reset: {response.message}")
        return response

    # --- Topics

    def _feed_with(self, feed: Feed) -> None:
        self._feed = feed
        self._reporter.inputs = {i.stream: i for i in inputs_of(self, self._feed.topics)}

    def _listen(self) -> None:
        self._last_arrival = time.monotonic()
        classes = partial(self._safely, TERRAIN_CLASSES, self._outputs.cost.on_classes)
        self._listening.start(self._feed.topics, self._take, classes)
        self._ticking = [
            self.create_timer(period, partial(self._safely, name, work), clock=self._wall)
            for name, period, work in (
                ("flush", 0.5, self._flush),
                ("inputs", _WAITING_EVERY, self._say_what_is_missing),
                ("~/cost", self._settings.cost.period, self._outputs.publish_cost),
                ("~/markers", _MARKERS_EVERY, self._publish_markers),
            )
        ]

    def _stop_listening(self) -> None:
        self._listening.stop()
        for timer in self._ticking:
            self.destroy_timer(timer)
        self._ticking = []

    # --- Messages: feed them, publish what comes of it

    def _take(self, topic: Topic, message: Any) -> None:
        if self._onboard is not None:
            self._last_arrival = time.monotonic()
            self._safely(topic.name, self._handle, topic, message)
            self._reporter.log_problems(self._onboard.take_problems())

    def _handle(self, topic: Topic, message: Any) -> None:
        self._keep(topic.handle(message, self.get_clock().now().nanoseconds))

    def _safely(self, name: str, work: Callable[..., None], *values: Any) -> None:
        """Do something of which a defect must not take a robot's node down; it is loud all the same.

        name: what to count a defect under.
        """
        try:
            work(*values)
        except Exception:
            if not rclpy.ok():
                raise
            self._report(name, "internal_error", f"failed:\n{traceback.format_exc()}")

    def _report(self, topic: str, reason: str, text: str) -> None:
        if self._onboard is not None:
            self._onboard.report(self.resolve_topic_name(topic), reason, text)
            self._reporter.log_problems(self._onboard.take_problems())

    def _answer(self, result: Result) -> None:
        """Publish a result at once: those of the other wheels are worked out after it."""
        self._safely("~/mobility", self._outputs.answer, result)

    def _keep(self, results: Sequence[Result]) -> None:
        assert self._onboard is not None
        if self._time_jumps != self._onboard.time_jumps:
            self._time_jumps = self._onboard.time_jumps
            self._outputs.start_over()
        self._outputs.keep(results, self._feed.odometry_frame)

    # --- Timers, all of the wall clock

    def _flush(self) -> None:
        """Let nothing wait for messages that do not come."""
        if self._onboard is None:
            return
        if time.monotonic() - self._last_arrival > _FLUSH_AFTER:
            self._keep(self._onboard.flush())
            self._reporter.log_problems(self._onboard.take_problems())
        self._outputs.publish_waiting_soil(self._feed.odometry_frame)

    def _say_what_is_missing(self) -> None:
        if self._onboard is not None:
            for text in self._reporter.waiting_for(self._onboard):
                self.get_logger().warning(f"still waiting for {text}")

    def _publish_markers(self) -> None:
        self._outputs.publish_markers(self._feed.odometry_frame)

    def _say_alarms(self) -> None:
        """Log an alarm when it is new: not everybody looks at diagnostics."""
        assert self._onboard is not None
        newest = [result.mobility for result in self._outputs.newest.values()]
        alarm = "; ".join(alarms(self._onboard, newest))
        if alarm and alarm != self._alarm:
            self.get_logger().error(alarm)
        self._alarm = alarm

    def _publish_diagnostics(self) -> None:
        name = self.get_fully_qualified_name().lstrip("/")
        if self.problem:
            found = [status(f"{name}: parameters", ERROR, self.problem)]
        elif self._onboard is None or not self._listening.on:
            text = "not active: it waits for a lifecycle manager"
            found = [status(f"{name}: inputs", OK, text)]
        else:
            self._say_alarms()
            self._outputs.report_deaf_subscribers()
            newest = [result.mobility for result in self._outputs.newest.values()]
            found = entries(name, self._onboard, self._reporter, newest, self._outputs.cost)
            if self._soil_file.problem:
                found.append(status(f"{name}: saved soil", WARN, self._soil_file.problem))
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
        # What the start has made lives as long as the node: looking it all through for what can be
        # thrown away would hold up messages for a tenth of a second now and then.
        gc.collect()
        gc.freeze()
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
