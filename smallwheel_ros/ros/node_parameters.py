"""ROS parameters from the one table: declared with descriptors, checked, never silently ignored."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from smallwheel_ros.onboard.parameter import Parameter
from smallwheel_ros.onboard.parameter_table import GENERAL
from smallwheel_ros.onboard.parameters import (
    NodeSettings,
    ParametersError,
    parameters_for,
    settings_from,
    unknown_parameters,
    wheel_names,
)


class NodeParameters:
    """The parameters of a node, which must be made to declare all overrides by itself.

    Whatever was given is kept as it is until now; here each known parameter is declared with its
    type, range and description. A value that does not fit is not declared but remembered, so that
    the node can say in its own words what is wrong, and somebody can mend it while it runs.

    Parameters
    ----------
    in_use
        Whether the node goes by the parameters now: then all of them together must make sense.
    changed
        Called after a change of them while they are in use, with names and values in words.

    Attributes
    ----------
    unknown
        A sentence for each given parameter that nobody knows.
    """

    def __init__(
        self, node: Node, in_use: Callable[[], bool], changed: Callable[[str], None]
    ) -> None:
        self._node = node
        self._in_use = in_use
        self._changed = changed
        given = {
            name: _plain(parameter.value)
            for name, parameter in node.get_parameters_by_prefix("").items()
        }
        self._problems: dict[str, str] = {}
        self._table: dict[str, Parameter] = {}
        try:
            wheels = wheel_names(given.get("wheels"))
        except ParametersError as error:
            wheels = []
            self._problems["wheels"] = str(error)
        self.unknown = unknown_parameters(given, wheels) if wheels else []
        table = parameters_for(wheels) if wheels else GENERAL
        for parameter in table:
            self._declare(parameter, given.get(parameter.name))
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._after)

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
        known = [change for change in changes if change.name in self._table]
        for change in known:
            parameter, value = self._table[change.name], _plain(change.value)
            optional = value is None and not parameter.required
            problem = None if optional else parameter.problem(value)
            if problem is not None:
                return SetParametersResult(successful=False, reason=problem)
        if known and self._in_use():
            try:
                settings_from(self.values() | {c.name: _plain(c.value) for c in known})
            except ParametersError as error:
                return SetParametersResult(successful=False, reason=str(error))
        for change in known:
            self._problems.pop(change.name, None)
        return SetParametersResult(successful=True)

    def _after(self, changes: Sequence[RosParameter]) -> None:
        words = ", ".join(f"{c.name}={_plain(c.value)}" for c in changes if c.name in self._table)
        if words and self._in_use():
            self._changed(words)

    def values(self) -> dict[str, object]:
        """Return the value of each known parameter, None where there is none."""
        return {name: _plain(self._node.get_parameter_or(name).value) for name in self._table}

    def settings(self) -> NodeSettings:
        """Return what the parameters say now.

        Raises
        ------
        ParametersError
            With one sentence for each parameter that is missing or wrong.
        """
        if self._problems:
            raise ParametersError("; ".join(self._problems.values()))
        return settings_from(self.values())


def _plain(value: object) -> object:
    """Turn the arrays that ROS gives into lists."""
    return list(value) if isinstance(value, (tuple, array)) else value


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=f"{parameter.description}{unit}",
        read_only=parameter.read_only,
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
