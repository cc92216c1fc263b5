# SPDX-License-Identifier: Apache-2.0
"""The node `mobility_estimator`: its lifecycle, parameters and services; `session` does its work.

It is a lifecycle node that configures and activates itself unless the parameter autostart is false.
If it cannot be configured, one message says why; with autostart it then ends with exit code 2,
otherwise it stays unconfigured and reports the reason in its diagnostics.
"""

from __future__ import annotations

import gc
import math
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial, wraps
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from smallwheel_ros.common.errors import reason
from smallwheel_ros.onboard.parameters import NODE_NAME, ParametersError
from smallwheel_ros.ros.diagnostics import ERROR, OK, WARN, status
from smallwheel_ros.ros.parameters import (
    NO_PUBLISHER_EVENTS,
    NodeParameters,
    RobotDescription,
    parameter_lines,
    velocity_elsewhere,
)
from smallwheel_ros.ros.session import Session

EXIT_BAD_INPUT = 2
_PATIENCE = 2.0  # s after SIGINT, from when on another one breaks off whatever goes on

_SUCCESS = TransitionCallbackReturn.SUCCESS
_Service = Callable[[ChangeState.Request, ChangeState.Response], ChangeState.Response]

# What does the work of a service, and what is lacking for it in a node that is not configured.
_SERVICES = {
    "clear_cost": (Session.clear_cost, "there is no cost to clear"),
    "reset": (Session.reset, "there is nothing to reset"),
    "save_soil": (Session.save, "there is no soil to save"),
    "terrain_margins": (Session.terrain_margins, "there are no terrain classes"),
}
_Transition = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def _says_why(transition: _Transition) -> _Transition:
    """Decorate a transition so that it logs an exception, which rclpy would hide, and ends in on_error."""

    @wraps(transition)
    def guarded(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except Exception as error:
            self.problem = f"{transition.__name__} failed: {reason(error)}"
            self.get_logger().error(f"{self.problem}\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR

    return guarded


class MobilityEstimator(LifecycleNode):  # type: ignore[misc]  # rclpy has no types
    """The lifecycle node: wheel loads, odometry, wheel speeds and sinkages in; soil and mobility out.

    Parameters
    ----------
    options
        Passed on to rclpy's LifecycleNode.

    Attributes
    ----------
    problem
        Why the node could not be configured, or a transition failed, in words; empty if nothing failed.
    description
        Listens to the robot description.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(NODE_NAME, automatically_declare_parameters_from_overrides=True, **options)
        self._session: Session | None = None
        self.problem = ""  # why it could not be configured, or is no more
        self._doubled = ""  # what was reported about other nodes of its name
        self._table = NodeParameters(self, self._is_active, self._configure_anew)
        for text in self._table.unknown:
            self.get_logger().warning(text)
        self.description = RobotDescription(self, self._table)
        # From a wall clock: diagnostics must come even while /clock stands still.
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", 10, event_callbacks=NO_PUBLISHER_EVENTS
        )
        self.create_timer(1.0, self._publish_diagnostics, clock=self._wall)
        for name in _SERVICES:
            self.create_service(Trigger, f"~/{name}", partial(self._serve, name))
        # rclpy (#1209) lets a transition that does not fit the state raise: the caller would get no answer.
        (service,) = (s for s in self.services if s.srv_type is ChangeState)
        service.callback = partial(self._on_change_state, service.callback)

    @property
    def autostart(self) -> bool:
        """Whether the node is to configure and activate itself."""
        return self._table.values()["autostart"] is not False

    # --- Transitions

    @_says_why
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, and make everything but the subscriptions."""
        try:
            settings = self._table.read()
            session = Session(self, settings, self._wall)
        except ParametersError as error:
            why = [str(error), self.description.waiting, *self.description.lacking]
            self.problem = f"cannot be configured: {'; '.join(filter(None, why))}"
            self.get_logger().error(self.problem)
            return TransitionCallbackReturn.FAILURE
        self._session, self.problem = session, ""
        for text in parameter_lines(self._table.changed()):
            self.get_logger().info(text)
        for text in session.warnings:
            self.get_logger().warning(text)
        if session.restored:
            self.get_logger().info(session.restored)
        return super().on_configure(state)

    @_says_why
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to all inputs, and publish the soil as believed before any measurement."""
        result = super().on_activate(state)
        assert self._session is not None
        self._session.activate()
        return result

    @_says_why
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unsubscribe; what was learnt is kept for the next activation."""
        assert self._session is not None
        self._session.deactivate()
        return super().on_deactivate(state)

    @_says_why
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the session with everything learnt."""
        result = super().on_cleanup(state)
        self._forget()
        return result

    @_says_why
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the node."""
        self._forget()
        return super().on_shutdown(state)

    @_says_why
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything after a transition that failed: the node can be configured again."""
        self._forget()
        return _SUCCESS

    def save_at_end(self) -> None:
        """Save what was learnt, if the node saves automatically, when a signal ends it."""
        if self._is_active():
            assert self._session is not None
            self._session.save_at_end()

    def _forget(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.destroy()

    def _is_active(self) -> bool:
        return self._session is not None and self._session.active

    def _on_change_state(
        self, change: _Service, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return change(request, response)
        except Exception:  # rcl's, of which rclpy makes no type public
            asked = request.transition.label or request.transition.id
            state = "not configured" if self._session is None else "inactive"
            state = "active" if self._is_active() else state
            self.get_logger().warning(f"transition {asked} does not fit the state, {state}")
            response.success = False
            return response

    def _configure_anew(self, changes: str) -> None:
        """Configure the node again if it is configured, as the robot description has changed parameters.

        changes: names and values in words.
        """
        if self._session is None:
            return
        self.get_logger().info(f"configured anew, the soil starts over: {changes}")
        steps = [self.trigger_cleanup, self.trigger_configure]
        if self._session.active:
            steps = [self.trigger_deactivate, *steps, self.trigger_activate]
        all(step() == _SUCCESS for step in steps)  # as far as it goes; it says why itself

    # --- Services

    def _serve(self, name: str, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer a service, also if its work raises, so that no client is left waiting."""
        work, lacking = _SERVICES[name]
        try:
            if self._session is None:
                response.message = f"not configured: {lacking}"
            else:
                response.success, response.message = work(self._session)
            if name == "save_soil" or (name in ("reset", "clear_cost") and response.success):
                self.get_logger().info(f"{name}: {response.message}")
        except Exception as error:
            self.get_logger().error(f"{name} failed:\n{traceback.format_exc()}")
            response.success = False
            response.message = f"failed: {type(error).__name__}: {error}"
        return response

    def _publish_diagnostics(self) -> None:
        unknown = [*self._table.unknown, *self.description.lacking]
        if self._session is not None:
            base = str(self._table.values()["base_frame"])
            unknown += velocity_elsewhere(base, self._session.velocity_frame)
        if self.problem:
            found, unknown = [status("parameters", ERROR, self.problem)], []
        elif self._session is None and self.autostart and self.description.waiting:
            found = [status("inputs", WARN, self.description.waiting)]
        elif self._session is None or not self._session.active:
            found = [status("inputs", OK, "not active: it waits for a lifecycle manager")]
        else:
            found = self._session.diagnostics()
        if unknown:
            found.append(status("parameters", WARN, "; ".join(unknown)))
        doubled = namesakes(self)
        if doubled:
            found.append(status("name", WARN, doubled))
        if doubled and not self._doubled:
            self.get_logger().warning(doubled)
        self._doubled = doubled
        for entry in found:
            own = self.get_fully_qualified_name().lstrip("/")
            entry.name, entry.hardware_id = f"{own}: {entry.name}", own
        array = DiagnosticArray(status=found)
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def namesakes(node: LifecycleNode) -> str:
    """Return a warning in words if other nodes have the same name; empty if there are none."""
    own = (node.get_name(), node.get_namespace())
    if node.get_node_names_and_namespaces().count(own) < 2:
        return ""
    return (
        f"another node is called {node.get_fully_qualified_name()} too: listeners get the answers of"
        " both, a service reaches either, and both save to one soil.file; end one, or give it another"
        " name (--ros-args -r __node:=NAME). One that was killed seems alive for 20 s"
    )


def _spin(
    node: MobilityEstimator, executor: SingleThreadedExecutor, goes_on: Callable[[], object]
) -> None:
    """Let the node work as long as ROS runs and `goes_on` returns true.

    An exception in a callback is logged, and the node continues.
    """
    while rclpy.ok() and goes_on():
        try:
            executor.spin_once()
        except Exception:
            # A signal ends ROS at any moment: what was about to be published then fails.
            if rclpy.ok():
                node.get_logger().error(f"a callback failed:\n{traceback.format_exc()}")


class _Gently:
    """Handler of SIGINT: the work in hand is finished and saved; a signal over 2 s later interrupts it.

    A launch file passes on a signal that the whole process group has had already, so a second one soon after
    the first counts as the same.
    """

    def __init__(self) -> None:
        self._first = math.inf

    def __call__(self, *_: object) -> None:
        now = time.monotonic()
        self._first = min(self._first, now)
        if now - self._first > _PATIENCE:
            raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is asked to end.

    Parameters
    ----------
    arguments
        Command line, with ROS arguments after `--ros-args`; None: that of the process.

    Returns
    -------
    int
        Exit code: 0 if it ended as requested, 2 for wrong parameters or arguments.
    """
    signal.signal(signal.SIGINT, _Gently())  # before rclpy's own, which calls it
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
        node = MobilityEstimator()
    except KeyboardInterrupt:
        rclpy.try_shutdown()
        return 0
    except Exception as error:
        # rcl explains what is wrong with ROS arguments or a parameter file, in several lines.
        words = reason(error)
        if type(error).__name__ == "UnknownROSArgsError":  # rclpy makes the type not public
            words = f"arguments that ROS does not know: {words}"
        print(f"{NODE_NAME}: cannot start: {words}", file=sys.stderr)
        rclpy.try_shutdown()
        return EXIT_BAD_INPUT
    executor = SingleThreadedExecutor()
    try:
        executor.add_node(node)
        if node.autostart and (waiting := node.description.waiting):
            node.get_logger().warning(waiting)
            _spin(node, executor, lambda: node.description.waiting)
        steps = (node.trigger_configure, node.trigger_activate) if node.autostart else ()
        if rclpy.ok() and any(step() != _SUCCESS for step in steps):
            return EXIT_BAD_INPUT
        # What the start has made lives as long as the node: looking it all through for what can be
        # thrown away would hold up messages for a tenth of a second now and then.
        gc.collect()
        gc.freeze()
        _spin(node, executor, lambda: True)
    except KeyboardInterrupt:
        pass
    except Exception:
        if rclpy.ok():
            raise
        # A signal ends ROS at any moment, in the middle of a transition, too.
    finally:
        # A launch file passes on the signal that the whole group has had: once is enough.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node.save_at_end()
        executor.shutdown(1.0)  # its guard conditions cannot be destroyed once ROS has ended
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
