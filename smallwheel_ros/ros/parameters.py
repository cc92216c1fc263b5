# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from one table: declared with descriptors, checked, never silently ignored.

They are read when the node is configured. None can be set while it is active, so that the estimate always
uses the values that were logged at the configuration. Parameters that are not given are taken from the
robot's description.
"""

from __future__ import annotations

import textwrap
from array import array
from collections.abc import Callable, Mapping, Sequence

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from smallwheel_ros.common.errors import SmallwheelError, reason
from smallwheel_ros.common.node_parameter import NodeParameter, Value
from smallwheel_ros.onboard.declared import parameters_for
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    settings_from,
    unknown_parameters,
    wheel_names,
)
from smallwheel_ros.onboard.robot_description import (
    DESCRIPTION_TYPE,
    Filled,
    fill_silent,
    needs_description,
    silent_parameters,
)
from smallwheel_ros.onboard.settings import NodeSettings

_WHAT_TO_DO = (
    "deactivate it, set the parameter, then clean up, configure and activate it (ros2 lifecycle set"
    " /mobility_estimator deactivate, and so on), or start it again with the parameter in its file"
)
_WIDTH = 148  # characters of a line of the log: of 200, less what ROS puts before it


def parameter_lines(changed: Mapping[str, object]) -> list[str]:
    """Return the log's lines about parameters that are not at their defaults, of at most 148 characters.

    A single longer word, such as a path, stays whole. changed: values by the parameter's full name.
    """
    words = ", ".join(f"{name}={value}" for name, value in changed.items())
    return textwrap.wrap(
        f"effective parameters, the others have their defaults: {words}",
        _WIDTH,
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


class NodeParameters:
    """The parameters of a node, which must declare all overrides automatically.

    Each known parameter is declared with its type, range and description. A value that does not fit is
    not declared but remembered, so that the node can say in its own words what is wrong, and a user can
    correct it while the node runs.

    Parameters
    ----------
    node
        The node.
    is_active
        Returns whether the node is active, so that no parameter can be set now.
    filled
        Called, with names and values in words, when `fill` has changed parameters that were not given.

    Attributes
    ----------
    unknown
        A sentence for each given parameter that does not exist.
    problems
        A sentence for each parameter with an impossible value, by the parameter's full name.
    """

    def __init__(
        self, node: Node, is_active: Callable[[], bool], filled: Callable[[str], None]
    ) -> None:
        self._node = node
        self._is_active, self._filled = is_active, filled
        found = node.get_parameters_by_prefix("")
        given = {name: _plain(parameter.value) for name, parameter in found.items()}
        self.problems: dict[str, str] = {}
        self._table: dict[str, NodeParameter] = {}
        try:
            wheels = wheel_names(given.get("wheels"))
        except ParametersError as error:
            wheels = []
            self.problems["wheels"] = str(error)
        self.unknown = unknown_parameters(given, wheels) if wheels else []
        for parameter in parameters_for(wheels):
            # `ros2 param dump` writes null for one that is not set, which ROS reads as a text.
            if given.get(parameter.name) == "null" and parameter.default is None:
                del given[parameter.name]
            self._declare(parameter, given.get(parameter.name))
        known = given.keys() & self._table.keys()
        self._given = {name for name in known if given[name] is not None}
        self._described: dict[str, Value] = {}
        self._filling = False
        node.add_pre_set_parameters_callback(self._taken)
        node.add_on_set_parameters_callback(self._judge)

    def values(self) -> dict[str, object]:
        """Return the value of each known parameter by full name; None if it has none."""
        return {name: _plain(self._node.get_parameter_or(name).value) for name in self._table}

    def changed(self) -> dict[str, object]:
        """Return the value of each known parameter that is not at its default, by full name."""
        return {name: v for name, v in self.values().items() if v != self._table[name].default}

    def given(self) -> dict[str, object]:
        """Return the value of each parameter that the user has given, by full name."""
        return {name: value for name, value in self.values().items() if name in self._given}

    def fill(self, values: Mapping[str, Value]) -> str:
        """Set parameters that the user has not given; those that are given keep their values.

        Parameters
        ----------
        values
            Values by full name of the parameter.

        Returns
        -------
        str
            Why that is impossible, in words; empty if it was done.
        """
        silent = silent_parameters(self.given())
        self._described = {name: value for name, value in values.items() if name in silent}
        changes = [
            RosParameter(name, value=value)
            for name, value in self._described.items()
            if value != self._node.get_parameter_or(name).value
        ]
        if not changes:
            return ""
        self._filling = True
        try:
            result = self._node.set_parameters_atomically(changes)
        finally:
            self._filling = False
        if not result.successful:
            return str(result.reason)
        self._filled(", ".join(f"{change.name}={change.value}" for change in changes))
        return ""

    def read(self) -> NodeSettings:
        """Turn the parameters into settings; models and effects are read from their files.

        Raises
        ------
        ParametersError
            With one sentence for each parameter that is missing or wrong.
        """
        if self.problems:
            raise ParametersError("; ".join(self.problems.values()))
        return settings_from(self.given(), self._described)

    def _declare(self, parameter: NodeParameter, value: object) -> None:
        name = parameter.name
        self._table[name] = parameter
        if self._node.has_parameter(name):
            self._node.undeclare_parameter(name)
        problem = None if value is None else parameter.problem(value)
        if problem is not None:
            self.problems.setdefault(name, problem)
        value = parameter.taken(value)
        if value is None or name in self.problems:
            value = parameter.default
        descriptor = _descriptor(parameter)
        self._node.declare_parameter(name, value, descriptor, ignore_override=True)

    def _taken(self, changes: Sequence[RosParameter]) -> list[RosParameter]:
        """Convert integers to doubles where a parameter is a double."""
        return [
            RosParameter(change.name, value=self._table[change.name].taken(change.value))
            if change.name in self._table and type(change.value) is int
            else change
            for change in changes
        ]

    def _judge(self, changes: Sequence[RosParameter]) -> SetParametersResult:
        for change in changes:
            problem = self._problem(change.name, _plain(change.value))
            if problem is not None:
                return SetParametersResult(successful=False, reason=problem)
        for change in changes:
            self.problems.pop(change.name, None)
            if not self._filling:
                self._given.add(change.name)
        return SetParametersResult(successful=True)

    def _problem(self, name: str, value: object) -> str | None:
        """Reason in words why a parameter cannot be set to a value now; None if it can."""
        active, parameter = self._is_active(), self._table.get(name)
        if parameter is None:
            return None
        if value is None:
            return f"parameter {name} cannot be deleted, expected {parameter.expected}"
        problem = parameter.problem(value)
        if problem is None and active and not self._filling:
            return f"parameter {name} cannot be set while the node is active: {_WHAT_TO_DO}"
        return problem


def _plain(value: object) -> object:
    """Turn the arrays that ROS gives into lists."""
    return list(value) if isinstance(value, (tuple, array)) else value


def _descriptor(parameter: NodeParameter) -> ParameterDescriptor:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=f"{parameter.description}{unit}",
        read_only=parameter.at_start,
        # For a value of another type rclpy names neither the parameter nor what to write: we do.
        dynamic_typing=True,
    )
    if parameter.choices:
        allowed = ", ".join(str(choice) for choice in parameter.choices)
        descriptor.additional_constraints = f"one of: {allowed}"
    low, high = parameter.low, parameter.high
    if low is not None and high is not None:
        if parameter.kind == "integer":
            span = IntegerRange(from_value=int(low), to_value=int(high))
            descriptor.integer_range = [span]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor


# --- The robot description


class RobotDescription:
    """Listens to the robot description, and passes its values to the parameters.

    It does not listen if every parameter that a description can fill is given.

    Parameters
    ----------
    node
        The node.
    table
        The parameters of the node.

    Attributes
    ----------
    lacking
        A sentence for each parameter that the newest description could not fill.
    """

    def __init__(self, node: Node, table: NodeParameters) -> None:
        self._node, self._table = node, table
        self.lacking: list[str] = []
        self._topic = ""  # that it listens to
        self._arrived = False
        topic = str(table.values()["robot_description_topic"])
        if not topic or not silent_parameters(table.given()):
            return
        try:
            node.create_subscription(
                String, topic, self._take, LATCHED, event_callbacks=NO_SUBSCRIPTION_EVENTS
            )
            self._topic = node.resolve_topic_name(topic)
        except Exception as error:  # rcl's, of which rclpy makes no type public
            words = f"robot description: cannot listen to {topic!r}: {reason(error)}"
            self.lacking.append(words)

    @property
    def waiting(self) -> str:
        """What the node waits for before it can be configured, in words; empty if nothing."""
        if not self._topic or self._arrived or self._table.problems:
            return ""
        needed = needs_description(self._table.given())
        if not needed:
            return ""
        publishers = self._node.count_publishers(self._topic)
        why = "its publisher has sent nothing yet" if publishers else "no publisher"
        return (
            f"waiting for {self._topic} ({DESCRIPTION_TYPE}): {why}; {', '.join(needed)} are not"
            " given and come from it"
        )

    def _take(self, message: String) -> None:
        self._arrived = True
        try:
            filled = fill_silent(message.data, self._table.given())
            problem = self._table.fill(filled.values)
        except SmallwheelError as error:
            filled, problem = Filled(), str(error)
        self.lacking = [f"robot description: {problem}"] if problem else filled.lacking
        log = self._node.get_logger()
        if not problem:
            log.info(f"from {self._topic}: {filled.text}")
        for text in self.lacking:
            log.warning(text)


def velocity_elsewhere(base: str, frame: str) -> list[str]:
    """Warn if the messages of `velocity_topic` are not in the base frame.

    Parameters
    ----------
    base
        Name of the base frame.
    frame
        frame_id of the newest message; empty counts as the base frame.

    Returns
    -------
    list of str
        One sentence, or none if the frame is right.
    """
    if frame in ("", base):
        return []
    return [f"velocity_topic is in frame {frame!r}, expected {base!r}: publish it in that frame"]


# --- Quality of service

# Waiting for events costs time at every turn, and the diagnostics show the same once a second.
NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
# Deep enough for a second at 200 Hz in which the processor is busy with something else: messages that do not
# fit are lost without notice, also those of reliable topics.
_DEEP = 200
# Matches reliable and best-effort publishers alike.
INPUT = QoSProfile(depth=_DEEP, reliability=ReliabilityPolicy.BEST_EFFORT)
ESTIMATE = QoSProfile(depth=_DEEP, reliability=ReliabilityPolicy.RELIABLE)
# A late subscriber gets the newest.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# For large messages of which only the newest counts.
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
# The newest message of each publisher of static transforms, as tf2 subscribes.
STATIC_TRANSFORMS = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
