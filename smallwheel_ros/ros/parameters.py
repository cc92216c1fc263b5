# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from the one table: declared with descriptors, checked, never silently ignored.

They are read when the node is configured. While it is active none can be set: what the estimate goes by
then is what its log says that it was configured with.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from smallwheel_ros.common.parameter import Parameter
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    settings_from,
    unknown_parameters,
    wheel_names,
)
from smallwheel_ros.onboard.robot_description import silent_parameters
from smallwheel_ros.onboard.settings import GENERAL, NodeSettings, parameters_for
from smallwheel_ros.ros.qos import OVERRIDES

_WHAT_TO_DO = (
    "deactivate it, set the parameter, then clean up, configure and activate it (ros2 lifecycle set"
    " /mobility_estimator deactivate, and so on), or start it again with the parameter in its file"
)
# Where the velocity sensor is and looks: tf may say so where nothing is given.
VELOCITY_SENSOR = ("velocity_lateral_position", "velocity_yaw")


class NodeParameters:
    """The parameters of a node, which must be made to declare all overrides by itself.

    Whatever was given is kept as it is until now; here each known parameter is declared with its
    type, range and description. A value that does not fit is not declared but remembered, so that
    the node can say in its own words what is wrong, and somebody can mend it while it runs.

    Parameters
    ----------
    is_active
        Whether the node works by the parameters now: then nobody can set one.
    filled
        Called, with names and values in words, when parameters that nobody gave have got another value.

    Attributes
    ----------
    unknown
        A sentence for each given parameter that nobody knows.
    """

    def __init__(
        self, node: Node, is_active: Callable[[], bool], filled: Callable[[str], None]
    ) -> None:
        self._node = node
        self._is_active, self._filled = is_active, filled
        given = {
            name: _plain(parameter.value)
            for name, parameter in node.get_parameters_by_prefix("").items()
        }
        self._overrides = [name for name in given if name.startswith(OVERRIDES)]
        self._problems: dict[str, str] = {}
        self._table: dict[str, Parameter] = {}
        try:
            wheels = wheel_names(given.get("wheels"))
        except ParametersError as error:
            wheels = []
            self._problems["wheels"] = str(error)
        self.unknown = unknown_parameters(given, wheels) if wheels else []
        for parameter in parameters_for(wheels) if wheels else GENERAL:
            # `ros2 param dump` writes null for one that is not set, which ROS reads as a text.
            if given.get(parameter.name) == "null" and parameter.default is None:
                del given[parameter.name]
            self._declare(parameter, given.get(parameter.name))
        self._silent = set(silent_parameters(given)) | (set(VELOCITY_SENSOR) - given.keys())
        self._filling = False
        node.add_on_set_parameters_callback(self._judge)

    def overrides(self) -> dict[str, object]:
        """Return the value of each parameter `qos_overrides.*` that was given at the start."""
        return {name: _plain(self._node.get_parameter_or(name).value) for name in self._overrides}

    def values(self) -> dict[str, object]:
        """Return the value of each known parameter, None where there is none."""
        return {name: _plain(self._node.get_parameter_or(name).value) for name in self._table}

    def changed(self) -> dict[str, object]:
        """Return the value of each known parameter that is not at its default."""
        defaults = {name: parameter.default for name, parameter in self._table.items()}
        return {name: v for name, v in self.values().items() if v != defaults[name]}

    def given(self) -> dict[str, object]:
        """Return the value of each known parameter that is not left to URDF or tf."""
        return {name: v for name, v in self.values().items() if name not in self._silent}

    def fill(self, values: Mapping[str, float | int]) -> str:
        """Take values for parameters that were not given; return why that is impossible, or ""."""
        changes = [
            RosParameter(name, value=value)
            for name, value in values.items()
            if name in self._silent and value != self._node.get_parameter(name).value
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

    @property
    def wrong(self) -> bool:
        """Whether a value was given that does not fit its parameter."""
        return bool(self._problems)

    def read(self) -> NodeSettings:
        """Return what the parameters say; models and effects are read from their files.

        Raises
        ------
        ParametersError
            With one sentence for each parameter that is missing or wrong.
        """
        if self._problems:
            raise ParametersError("; ".join(self._problems.values()))
        return settings_from(self.values())

    def _declare(self, parameter: Parameter, value: object) -> None:
        name = parameter.name
        self._table[name] = parameter
        if self._node.has_parameter(name):
            self._node.undeclare_parameter(name)
        if value is not None and name not in self._problems:
            problem = parameter.problem(value)
            if problem is not None:
                self._problems[name] = problem
        if value is None or name in self._problems:
            value = parameter.default
        descriptor = _descriptor(parameter)
        self._node.declare_parameter(name, value, descriptor, ignore_override=True)

    def _judge(self, changes: Sequence[RosParameter]) -> SetParametersResult:
        known = {c.name: _plain(c.value) for c in changes if c.name in self._table}
        problem = self._problem(known) or self._problem_of_quality([c.name for c in changes])
        if problem is None:
            for name in known:
                self._problems.pop(name, None)
            if not self._filling:
                self._silent -= known.keys()
        return SetParametersResult(successful=problem is None, reason=problem or "")

    def _problem(self, values: Mapping[str, object]) -> str | None:
        for name, value in values.items():
            parameter = self._table[name]
            if value is None:
                return f"parameter {name} cannot be deleted, expected {parameter.expected}"
            problem = parameter.problem(value)
            if problem is not None:
                return problem
            if self._is_active() and not self._filling:
                return f"parameter {name} cannot be set while the node is active: {_WHAT_TO_DO}"
        return None

    def _problem_of_quality(self, names: Sequence[str]) -> str | None:
        for name in names:
            # The first time it is rclpy that declares it, for a topic that is being made.
            if name.startswith(OVERRIDES) and self._is_active() and self._node.has_parameter(name):
                return f"parameter {name} only counts at the start of the node"
        return None


def _plain(value: object) -> object:
    """Turn the arrays that ROS gives into lists."""
    return list(value) if isinstance(value, (tuple, array)) else value


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=f"{parameter.description}{unit}",
        read_only=parameter.at_start,
        # Of another type rclpy says neither which parameter it is nor what to write: we do.
        dynamic_typing=True,
    )
    if parameter.choices:
        allowed = ", ".join(str(choice) for choice in parameter.choices)
        descriptor.additional_constraints = f"one of: {allowed}"
    if parameter.low is not None and parameter.high is not None:
        if parameter.kind == "integer":
            descriptor.integer_range = [
                IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high))
            ]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=parameter.low, to_value=parameter.high)
            ]
    return descriptor
