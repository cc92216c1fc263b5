# SPDX-License-Identifier: Apache-2.0
"""The work of a configured node, from its configuration to its cleanup."""

from __future__ import annotations

import json
import math
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock
from rclpy.lifecycle import LifecycleNode
from rclpy.timer import Timer

from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.cost_map import COST_PERIOD
from smallwheel_ros.costmap.grid import HIGHEST
from smallwheel_ros.drive.autosave import Autosave
from smallwheel_ros.drive.ground_ahead import CLASSES, ELEVATION
from smallwheel_ros.drive.soil_file import SoilFile
from smallwheel_ros.drive.statements import WARNINGS, Kind, Statement, alarms
from smallwheel_ros.onboard.parameters import ParametersError, idle_remaps
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.intake.inputs import topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.ros.conversions import message_class
from smallwheel_ros.ros.diagnostics import WARN, entries, status
from smallwheel_ros.ros.inputs import Inputs
from smallwheel_ros.ros.outputs import SPEED_LIMIT, Outputs, outputs_of

# s: an estimate waits half of it on average for its turn; of a turn's processor time half does not depend on
# how much it has to do.
_TURN = 0.05
_WITHIN = 0.8 * _TURN  # s of a turn, for messages; the rest is for what else is due
# ns of stamps that are worked on before a look at the clock: shorter ones cost a node that catches up more.
_SPAN = SECOND // 4
_FLUSH_AFTER = 2.0  # s without any message: what waits for others is worked on without them
_WAITING_EVERY = 5.0  # s
_MARKERS_EVERY = 0.2  # s
_SAVED_AFTER = 0.5  # s: how often it is looked whether soil and map are written
_SOIL_AFTER = 0.5  # s: the newest soil goes out though its period is not over
_AFTER_A_DEFECT = (
    "what was saved before a turn failed is kept: ~/save_soil or ~/reset lets saving go on"
)
# Topics that every node of rclpy has, and their types.
_OF_ROS = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
    "/rosout": "rcl_interfaces/msg/Log",
}


def _check_topics(node: LifecycleNode, settings: NodeSettings) -> None:
    """Check that the node can subscribe to and publish all of its topics.

    Raises
    ------
    ParametersError
        If a name is not possible, a topic would carry two types, which DDS allows no node, or the package of
        its type is not installed.
    """
    for parameter, kind in (("elevation_topic", ELEVATION), ("speed_limit_topic", SPEED_LIMIT)):
        package = kind.split("/")[0]
        if getattr(settings, parameter) and message_class(kind) is None:
            raise ParametersError(
                f"{parameter} needs package {package}, which is not installed: sudo apt install"
                f" ros-jazzy-{package.replace('_', '-')}, or leave the parameter empty"
            )
    published = {
        node.resolve_topic_name(name): f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        for name, (kind, _) in outputs_of(settings).items()
    }
    types = {**_OF_ROS, **published}
    listened = [(topic.name, topic.type) for topic in topics_of(settings)]
    if settings.elevation_topic:
        listened.append((settings.elevation_topic, ELEVATION))
    if settings.terrain_classes_topic:
        listened.insert(0, (settings.terrain_classes_topic, CLASSES))
    if settings.robot_description_topic:
        listened.append((settings.robot_description_topic, DESCRIPTION_TYPE))
    for given, kind in listened:
        try:
            name = node.resolve_topic_name(given)
        except Exception as error:  # rcl's, of which rclpy makes no type public
            raise ParametersError(f"topic {given!r} is not possible: {reason(error)}") from None
        if types.setdefault(name, kind) != kind:
            raise ParametersError(
                f"topic {name} would be {types[name]} and {kind}, expected one type: a node"
                " can have no topic of two"
            )


def _is_remapped(node: LifecycleNode, name: str) -> bool:
    """Whether a remap of the node gives a topic another name."""
    return bool(node.resolve_topic_name(name) != node.resolve_topic_name(name, only_expand=True))


@dataclass
class _Job:
    """Work that is repeated.

    Attributes
    ----------
    name
        Topic under which its failures are counted.
    period
        Time between two executions, s.
    work
        Does the work.
    due
        Time at which it is done next, by time.monotonic(), s.
    """

    name: str
    period: float
    work: Callable[[], None]
    due: float = 0.0  # by time.monotonic()


class Session:
    """Pipeline, subscriptions, publishers and saved soil of a configured node.

    One timer does all the work: each turn decodes the messages that have arrived, takes them through the
    pipeline, and publishes the results.

    Parameters
    ----------
    node
        The node.
    settings
        Its settings.
    wall
        Steady clock of the timer; it runs even while simulated time (/clock) stands still.

    Attributes
    ----------
    warnings
        Sentences about the configuration, to be logged once.
    restored
        The saved soil and cost map from which the estimate continues, in words; empty if there are none.

    Raises
    ------
    ParametersError
        If the node cannot work with these settings.
    """

    def __init__(self, node: LifecycleNode, settings: NodeSettings, wall: Clock) -> None:
        self._node, self._settings, self._wall = node, settings, wall
        _check_topics(node, settings)
        self._pipeline = Pipeline(settings.onboard)
        self._soil_file = SoilFile(settings.soil.file)
        restored = self._soil_file.restore(self._pipeline)
        period = settings.soil.autosave_period
        self._autosave = Autosave(self._soil_file) if settings.soil.file and period > 0.0 else None
        onboard = settings.onboard
        of_classes = settings.terrain.without_prior
        said = self._soil_file.problem, onboard.unknown_positions, onboard.model_note, of_classes
        idle = [why for name, why in idle_remaps(settings).items() if _is_remapped(node, name)]
        self.warnings = [*idle, *self._pipeline.undeterminable, *filter(None, said)]
        self._inputs = Inputs(node, settings, self._pipeline)
        self._timer: Timer | None = None
        self._jobs: list[_Job] = []
        self._longest = 0.0  # s, turn since the last diagnostics
        self._flushed = False  # since the newest message
        self._behind = False  # whether the newest turn left something for the next one
        self._alarms: dict[Kind, Statement] = {}  # as they were when they were looked at last
        self._outputs = Outputs(node, settings, self._pipeline, self._report)
        remembered = self._soil_file.restore_map(self._outputs.cost.map)
        self.restored = "; ".join(filter(None, [restored, remembered]))

    @property
    def active(self) -> bool:
        """Whether it is subscribed and publishes."""
        return self._timer is not None

    @property
    def _frame(self) -> str:
        """Frame of the odometry."""
        return self._inputs.frame(self._settings.odom_topic)

    @property
    def velocity_frame(self) -> str:
        """Frame of the newest message of velocity_topic; empty until there is one."""
        name = self._settings.velocity_topic
        return self._inputs.frame(name) if name else ""

    # --- Transitions, services

    def activate(self) -> None:
        """Subscribe to all inputs, and publish the soil as believed before any measurement."""
        cost, outputs, inputs = self._outputs.cost, self._outputs, self._inputs

        def guarded(name: str, work: Callable[[Any], None]) -> Callable[[Any], None]:
            """Make a callback of `work` whose failures are counted under topic `name`."""
            return lambda message: self._safely(name, work, message)

        inputs.listen(
            guarded(self._settings.terrain_classes_topic, cost.on_classes),
            guarded("/tf", cost.on_transforms),
            guarded("/tf_static", cost.on_static_transforms),
            guarded(self._settings.elevation_topic, cost.on_elevation),
        )
        inputs.say_what_is_expected()
        self._jobs = [
            _Job("~/soil", _SOIL_AFTER, lambda: outputs.publish_waiting_soil(self._frame)),
            _Job("inputs", _SOIL_AFTER, inputs.say_when_all_are_here),
            _Job("inputs", _WAITING_EVERY, inputs.say_what_is_missing),
            _Job("~/cost", COST_PERIOD, outputs.publish_cost),
            _Job(self._settings.speed_limit_topic, COST_PERIOD, outputs.publish_speed_limit),
            _Job("~/markers", _MARKERS_EVERY, lambda: outputs.publish_markers(self._frame)),
        ]
        if self._autosave is not None:
            period = self._settings.soil.autosave_period
            looks = _Job("~/save_soil", _SAVED_AFTER, self._look_at_what_was_written)
            self._jobs += [looks, _Job("~/save_soil", period, self._save_by_itself)]
        for job in self._jobs:
            job.due = time.monotonic() + job.period
        self._timer = self._node.create_timer(_TURN, self._work, clock=self._wall)
        outputs.publish_soil(self._frame)

    def deactivate(self) -> None:
        """Unsubscribe; what was learnt is kept for the next activation."""
        if self._timer is not None:
            self._turn()
            self.save_at_end()
            self._node.destroy_timer(self._timer)
        self._outputs.delete_markers()
        self._inputs.stop()
        self._timer = None

    def destroy(self) -> None:
        """Remove all publishers and subscriptions."""
        self.deactivate()
        self._outputs.cost.empty()
        self._outputs.destroy()

    def save(self) -> tuple[bool, str]:
        """Save the soil; return whether that worked, and a sentence for the user."""
        self._turn()
        saved, words = self._soil_file.save(self._pipeline, self._outputs.cost.map)
        if saved and self._autosave is not None:
            self._autosave.go_on()
        return saved, words

    def _save_by_itself(self) -> None:
        assert self._autosave is not None
        self._autosave.begin(self._pipeline, self._outputs.cost.map)

    def _look_at_what_was_written(self) -> None:
        assert self._autosave is not None
        failures = self._autosave.failures
        if not self._autosave.writes() and self._autosave.failures > failures:
            self._report("~/save_soil", "not_saved", self._autosave.problem)

    def save_at_end(self) -> None:
        """Save soil and cost map at once, if they have changed and are saved automatically."""
        if self._autosave is not None:
            self._safely(
                "~/save_soil", self._autosave.finish, self._pipeline, self._outputs.cost.map
            )
            if self._autosave.problem:
                self._node.get_logger().error(self._autosave.problem)

    def terrain_margins(self) -> tuple[bool, str]:
        """Return True, and margins of terrain classes as JSON.

        For each class, by its number: margin and standard_deviation, 1, and places, the number of places of
        it that have been crossed.
        """
        classes = self._outputs.cost.map.ahead.classes
        found, places = {}, classes.places()
        for terrain, margin in classes.margins().items():
            known = {"margin": margin.value, "standard_deviation": margin.standard_deviation}
            found[str(terrain)] = known | {"places": places[terrain]}
        return True, json.dumps(found)

    def clear_cost(self) -> tuple[bool, str]:
        """Forget the costs of the ground but not the soil, and publish empty grids at once.

        Returns whether there were any, and a sentence for the user.
        """
        cost = self._outputs.cost
        whole = cost.map.whole()
        if whole is None:
            text = "there is no cost yet: no ground has been crossed"
            self._report("~/clear_cost", "no_cost", text)
            return False, text
        known, stuck = (int(np.sum(whole.cells >= least)) for least in (0, HIGHEST))
        cost.clear()
        self._outputs.publish_cost()
        return True, f"{known} cells are forgotten, {stuck} of them 100; the soil goes on"

    def reset(self) -> tuple[bool, str]:
        """Forget soil, cost map and buffered rows; return True, and a sentence for the user."""
        self._turn()
        self._start_over()
        if self._autosave is not None and not self._soil_file.problem:
            self._autosave.go_on()
        if self.active:
            self._outputs.publish_soil(self._frame)
        return True, "soil, cost map and buffers start over; the counts go on"

    def _start_over(self) -> None:
        self._pipeline.reset()
        self._outputs.start_over()

    # --- Turns

    def _work(self) -> None:
        """Process the messages that have arrived, and do all jobs that are due."""
        self._turn(within=_WITHIN)
        now = time.monotonic()
        for job in self._jobs:
            if now >= job.due:
                job.due = now + job.period
                self._safely(job.name, job.work)

    def _turn(self, within: float = math.inf) -> None:
        """Process the messages that have arrived, and publish the results.

        If nothing arrives for a while, rows that wait for other messages are processed without them. within:
        longest duration, s. Messages are processed in slices; a slice that would exceed it, if it took as
        long as the last one, is left to the next call, so that a node that catches up still answers.
        """
        begin = time.monotonic()
        try:
            came = self._inputs.take()
            quiet = begin - self._inputs.arrived > _FLUSH_AFTER
            if came or self._behind or (quiet and not self._flushed):
                self._flushed, self._behind = quiet, False
                before = begin
                for turn in self._pipeline.turns(last=quiet, span=_SPAN):
                    self._safely("~/vehicle", self._outputs.publish, turn, self._frame)
                    now = time.monotonic()
                    self._behind = now - begin + (now - before) > within
                    if self._behind:
                        break
                    before = now
        except Exception:
            if not rclpy.ok():
                raise
            # What it is in the middle of is not to be trusted.
            text = f"a turn failed, soil and cost map start over:\n{traceback.format_exc()}"
            self._report("~/vehicle", "internal_error", text)
            self._start_over()
            if self._autosave is not None:
                self._autosave.hold(_AFTER_A_DEFECT)
        self._inputs.log(self._pipeline.take_problems())
        self._longest = max(self._longest, time.monotonic() - begin)

    def _safely(self, name: str, work: Callable[..., None], *values: Any) -> None:
        """Call `work` with `values`; an exception is reported, and does not end the robot's node.

        name: topic under which failures are counted.
        """
        try:
            work(*values)
        except Exception:
            if not rclpy.ok():
                raise
            self._report(name, "internal_error", f"failed:\n{traceback.format_exc()}")

    def _report(self, topic: str, reason: str, text: str) -> None:
        name = self._node.resolve_topic_name(topic)
        self._pipeline.note(name, reason, text, unused=False)
        self._inputs.log(self._pipeline.take_problems())

    def diagnostics(self) -> list[DiagnosticStatus]:
        """Return the diagnostics of an active node, and log which alarms begin and end."""
        newest = self._outputs.newest
        self._outputs.report_deaf_subscribers()
        self._outputs.report_waiting_for_what_went()
        longest, self._longest = self._longest, 0.0
        inputs = self._inputs.status(longest)
        found = [inputs, *entries(self._pipeline, newest, self._outputs.cost)]
        self._log_alarms()
        autosave = self._autosave
        of_saving = [] if autosave is None else [autosave.held, autosave.problem]
        if said := [text for text in (self._soil_file.problem, *of_saving) if text]:
            found.append(status("saved soil", WARN, "; ".join(said)))
        return found

    def _log_alarms(self) -> None:
        """Log once that an alarm begins, and that it has ended: not everybody looks at diagnostics."""
        log, said = self._node.get_logger(), alarms(self._pipeline)
        now = {alarm.kind: alarm for alarm in said}
        another_level = not now.keys().isdisjoint(WARNINGS)
        for alarm in now.values():
            if alarm.kind in self._alarms:
                continue
            if alarm.is_error:
                log.error(alarm.text)
            else:
                log.warning(alarm.text)
        for alarm in self._alarms.values():
            if alarm.kind not in now and not (another_level and alarm.kind in WARNINGS):
                log.info(f"no longer: {alarm.text}")
        self._alarms = now
