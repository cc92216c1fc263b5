# SPDX-License-Identifier: Apache-2.0
"""A parameter file with every parameter of the node, from their declarations."""

from __future__ import annotations

import textwrap

from smallwheel_ros.common.node_parameter import Value, written
from smallwheel_ros.onboard.declared import GENERAL, PER_WHEEL

_EXAMPLE_WHEEL = "front_left"
_EXAMPLES: dict[str, Value] = {
    "wheels": [_EXAMPLE_WHEEL],
    f"{_EXAMPLE_WHEEL}.diameter": 0.25,
    f"{_EXAMPLE_WHEEL}.width": 0.10,
}


def template() -> str:
    """Return a parameter file with every parameter, its meaning and its default."""
    lines = [
        "# All parameters of mobility_estimator, as `smallwheel init --template` prints them: copy it, and",
        "# keep what you change. A line that begins with # is a default or optional.",
        "/**:",
        "  ros__parameters:",
    ]
    table = (*GENERAL, *(row.for_wheel(_EXAMPLE_WHEEL) for row in PER_WHEEL))
    needed = {p.name.split(".")[0] for p in table if p.required}
    group = ""
    for parameter in table:
        *above, name = parameter.name.split(".")
        indent = "    " + "  " * len(above)
        if above and above[0] != group:
            group = above[0]
            lines += ["", f"    {'' if group in needed else '# '}{group}:"]
        words, allowed = parameter.description, parameter.allowed
        words += f" [{parameter.unit}]" if parameter.unit else ""
        words += f" {allowed}." if allowed else ""
        words += " At start." if parameter.at_start else ""
        lines += [f"{indent}# {line}" for line in textwrap.wrap(words, 92 - len(indent))]
        value = _EXAMPLES.get(parameter.name, parameter.default)
        text = "" if value is None else f" {written(value)}"
        lines.append(f"{indent}{'' if parameter.required else '# '}{name}:{text}")
    return "\n".join(lines) + "\n"
