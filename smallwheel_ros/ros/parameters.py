# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from the one table: declared with descriptors, checked, never silently ignored."""

from __future__ import annotations

import traceback
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

from smallwheel_ros.onboard.parameter import Parameter
from smallwheel_ros.onboard.parameter_table import GENERAL, parameters_for
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    StartingModels,
    read_models,
    settings_from,
    unknown_parameters,
    wheel_names,
)
from smallwheel_ros.onboard.robot_description import silent_parameters
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.ros.qos import OVERRIDES

# Where the velocity sensor is and looks: tf may say so where nothing is given.
VELOCITY_SENSOR = ("velocity_lateral_position", "velocity_yaw")


class NodeParameters:
    """The parameters of a node, which must be made to declare all overrides by itself.

    Whatever was given is kept as it is until now; here each known parameter is declared with its
    type, range and description. A value that does not fit is not declared but remembered, so that
    the node can say in its own words what is wrong, and somebody can mend it while it runs.

    Parameters
    ----------
    check
        Called with settings before they are taken on; raises for those that the node cannot use.
    apply
        Called with settings after a change, with names and values in words.

    Attributes
    ----------
    in_use
        Whether the node goes by the parameters now: then all of them together must make sense.
    unknown
        A sentence for each given parameter that nobody knows.
    """

    def __init__(
        self,
        node: Node,
        check: Callable[[NodeSettings], object],
        apply: Callable[[NodeSettings, str], None],
    ) -> None:
        self._node = node
        self._check = check
        self._apply = apply
        self.in_use = False
        self._models = StartingModels()
        self._checked: NodeSettings | None = None  # what the newest change makes
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
        node.add_post_set_parameters_callback(self._after)

    def overrides(self) -> dict[str, object]:
        """Return the value of each parameter `qos_overrides.*` that was given at the start."""
        return {name: _plain(self._node.get_parameter_or(name).value) for name in self._overrides}

    def values(self) -> dict[str, object]:
        """Return the value of each known parameter, None where there is none."""
        return {name: _plain(self._node.get_parameter_or(name).value) for name in self._table}

    def given(self) -> dict[str, object]:
        """Return the value of each known parameter that is not left to URDF or tf."""
        return {name: v for name, v in self.values().items() if name not in self._silent}

    def fill(self, values: Mapping[str, float | int]) -> str:
        """Take values for parameters that were not given; return why that is impossible, or ""."""
        changes = [RosParameter(n, value=v) for n, v in values.items() if n in self._silent]
        self._filling = True
        try:
            result = self._node.set_parameters_atomically(changes)
        finally:
            self._filling = False
        return "" if result.successful else result.reason

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
        values = self.values()
        self._models = read_models(values)
        return settings_from(values, self._models)

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
        try:
            problem = self._problem(changes)
        except ParametersError as error:
            problem = str(error)
        except Exception as error:  # a defect must not end the node
            self._node.get_logger().error(f"change of parameters:\n{traceback.format_exc()}")
            problem = f"the change cannot be judged: {type(error).__name__}: {error}"
        return SetParametersResult(successful=problem is None, reason=problem or "")

    def _problem(self, changes: Sequence[RosParameter]) -> str | None:
        known = {c.name: _plain(c.value) for c in changes if c.name in self._table}
        for name, value in known.items():
            parameter = self._table[name]
            if value is None:
                return f"parameter {name} cannot be deleted, expected {parameter.expected}"
            if self.in_use and parameter.changes != "always":
                return f"parameter {name} can only be changed while the node is not configured"
            problem = parameter.problem(value)
            if problem is not None:
                return problem
        for change in changes:
            # The first time it is rclpy that declares it, for a topic that is being made.
            overrides = change.name.startswith(OVERRIDES) and self._node.has_parameter(change.name)
            if self.in_use and overrides:
                return f"parameter {change.name} only counts at the start of the node"
        if known and self.in_use:
            self._checked = settings_from(self.values() | known, self._models)
            self._check(self._checked)
        for name in known:
            self._problems.pop(name, None)
        return None

    def _after(self, changes: Sequence[RosParameter]) -> None:
        words = ", ".join(f"{c.name}={_plain(c.value)}" for c in changes if c.name in self._table)
        settings, self._checked = self._checked, None
        if not self._filling:
            self._silent -= {change.name for change in changes}
        if words and settings is not None and self.in_use:
            self._apply(settings, words)


def _plain(value: object) -> object:
    """Turn the arrays that ROS gives into lists."""
    return list(value) if isinstance(value, (tuple, array)) else value


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=f"{parameter.description}{unit}",
        read_only=parameter.changes == "at start",
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
