# SPDX-License-Identifier: Apache-2.0
"""What a configured node has, from its configuration to its cleanup."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock
from rclpy.lifecycle import LifecycleNode
from rclpy.timer import Timer

from smallwheel_ros.common.errors import reason
from smallwheel_ros.onboard.feed import Feed, Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import ParametersError
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.robot_description import DESCRIPTION_TYPE
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.onboard.soil_file import SoilFile
from smallwheel_ros.onboard.statements import Kind, Statement, alarms
from smallwheel_ros.ros.diagnostics import WARN, entries, status
from smallwheel_ros.ros.inputs import Inputs
from smallwheel_ros.ros.outputs import OUTPUTS, TERRAIN_CLASSES, Outputs

_FLUSH_AFTER = 2.0  # s without any message: what waits for others is worked on without them
_WAITING_EVERY = 5.0  # s
_MARKERS_EVERY = 0.2  # s
# Topics that every node of rclpy has, and their types.
_OF_ROS = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
    "/rosout": "rcl_interfaces/msg/Log",
}


def _check_topics(node: LifecycleNode, feed: Feed) -> None:
    """Look whether the node can have its topics.

    Raises
    ------
    ParametersError
        If a name is not possible, or a topic would carry two types (DDS allows that to no node).
    """
    classes = node.resolve_topic_name(TERRAIN_CLASSES)
    published = {
        node.resolve_topic_name(name): f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        for name, (kind, _) in OUTPUTS.items()
    }
    types = {**_OF_ROS, **published, classes: "nav_msgs/msg/OccupancyGrid"}
    listened = [(topic.name, topic.type) for topic in feed.topics]
    if feed.settings.robot_description_topic:
        listened.append((feed.settings.robot_description_topic, DESCRIPTION_TYPE))
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


class Session:
    """The estimate of a configured node, with its topics; it is made whole or raises.

    wall: a clock that goes on while /clock stands still. warnings: what is to be said once of the
    configuration. restored: what saved soil and cost map it goes on from, in words; empty where there is
    none.
    velocity_frame: frame of the newest message of velocity_topic; empty until there is one.

    Raises
    ------
    ParametersError
        If the node cannot work with these settings.
    """

    def __init__(self, node: LifecycleNode, settings: NodeSettings, wall: Clock) -> None:
        self._node, self._settings, self._wall = node, settings, wall
        self._onboard = Onboard(settings.onboard)
        feed = Feed(self._onboard, settings)
        _check_topics(node, feed)
        self._soil_file = SoilFile(settings.soil_file)
        restored = self._soil_file.restore(self._onboard)
        said = self._soil_file.problem, settings.onboard.unknown_positions
        self.warnings = [*self._onboard.undeterminable, *filter(None, said)]
        self._inputs = Inputs(node, feed)
        self._timers: list[Timer] = []
        self.velocity_frame = ""
        self._time_jumps = 0
        self._alarms: dict[Kind, Statement] = {}  # as they were when they were looked at last
        self._last_arrival = time.monotonic()
        self._outputs = Outputs(node, feed, self._report)
        # A result is published at once: those of the other wheels are worked out after it.
        self._onboard.on_result = partial(self._safely, "~/mobility", self._outputs.answer)
        remembered = self._soil_file.restore_map(self._outputs.cost.map)
        self.restored = "; ".join(filter(None, [restored, remembered]))

    @property
    def active(self) -> bool:
        """Whether it listens and publishes."""
        return bool(self._timers)

    # --- Transitions, services

    def activate(self) -> None:
        """Listen, and publish the soil as it is believed before any measurement."""
        self._last_arrival = time.monotonic()
        self._inputs.listen(
            self._take,
            partial(self._safely, TERRAIN_CLASSES, self._outputs.cost.on_classes),
            partial(self._safely, "/tf", self._outputs.cost.on_transforms),
            partial(self._safely, "/tf_static", self._outputs.cost.on_static_transforms),
        )
        self._inputs.say_what_is_expected()
        for name, period, work in (
            ("flush", 0.5, self._flush),
            ("inputs", _WAITING_EVERY, self._inputs.say_what_is_missing),
            ("~/cost", self._settings.cost.period, self._outputs.publish_cost),
            ("~/markers", _MARKERS_EVERY, self._outputs.publish_markers),
        ):
            timer = partial(self._safely, name, work)
            self._timers.append(self._node.create_timer(period, timer, clock=self._wall))
        self._outputs.publish_soil()

    def deactivate(self) -> None:
        """Listen no more; what was learnt is kept for the next activation."""
        self._outputs.delete_markers()
        self._inputs.stop()
        for timer in self._timers:
            self._node.destroy_timer(timer)
        self._timers = []

    def destroy(self) -> None:
        """Take all topics away."""
        self.deactivate()
        self._outputs.cost.empty()
        self._outputs.destroy()

    def save(self) -> tuple[bool, str]:
        """Save the soil; return whether that worked, and in words what came of it."""
        return self._soil_file.save(self._onboard, self._outputs.cost.map)

    def terrain_margins(self) -> tuple[bool, str]:
        """What terrain classes hold, as JSON: margin, its standard deviation and places, by class."""
        classes = self._outputs.cost.map.classes
        found, places = {}, classes.places()
        for terrain, margin in classes.margins().items():
            known = {"margin": margin.value, "standard_deviation": margin.standard_deviation}
            found[str(terrain)] = known | {"places": places[terrain]}
        return True, json.dumps(found)

    def reset(self) -> tuple[bool, str]:
        """Forget soil, cost map and buffers."""
        self._onboard.reset()
        self._outputs.start_over()
        if self.active:
            self._outputs.publish_soil()
        return True, "soil, cost map and buffers start over; the counts go on"

    # --- Messages: feed them, publish what comes of it

    def _take(self, topic: Topic, message: Any) -> None:
        self._last_arrival = time.monotonic()
        if topic.name == self._settings.velocity_topic:
            self.velocity_frame = message.header.frame_id
        now = self._node.get_clock().now().nanoseconds
        self._safely(topic.name, lambda: self._keep(topic.handle(message, now)))
        self._log_problems()

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
        name = self._node.resolve_topic_name(topic)
        self._onboard.problems.add(name, reason, text, unused=False)
        self._log_problems()

    def _log_problems(self) -> None:
        self._inputs.log(self._onboard.take_problems())

    def _keep(self, results: Sequence[Result]) -> None:
        if self._time_jumps != self._onboard.time_jumps:
            self._time_jumps = self._onboard.time_jumps
            self._outputs.start_over()
        self._outputs.keep(results)

    # --- Timers

    def _flush(self) -> None:
        """Let nothing wait for messages that do not come."""
        if time.monotonic() - self._last_arrival > _FLUSH_AFTER:
            self._keep(self._onboard.flush())
            self._log_problems()
        self._outputs.publish_waiting_soil()
        self._inputs.say_when_all_are_here()

    def diagnostics(self) -> list[DiagnosticStatus]:
        """Return the entries of an active node; log which alarms begin and end."""
        newest = self._outputs.newest.values()
        self._outputs.report_deaf_subscribers()
        self._onboard.look_for_slip_tests()
        found = [self._inputs.status(), *entries(self._onboard, newest, self._outputs.cost)]
        self._log_alarms(newest)
        if self._soil_file.problem:
            found.append(status("saved soil", WARN, self._soil_file.problem))
        return found

    def _log_alarms(self, newest: Iterable[Result]) -> None:
        """Say once that an alarm begins, and that it has ended: not everybody looks at diagnostics."""
        log, now = self._node.get_logger(), {a.kind: a for a in alarms(self._onboard, newest)}
        for alarm in now.values():
            if alarm.kind in self._alarms:
                continue
            if alarm.is_error:
                log.error(alarm.text)
            else:
                log.warning(alarm.text)
        for alarm in self._alarms.values():
            if alarm.kind not in now:
                log.info(f"no longer: {alarm.text}")
        self._alarms = now
