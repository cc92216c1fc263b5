# SPDX-License-Identifier: Apache-2.0
"""Writes config/template.yaml and docs/parameters.md from the declarations of the node's parameters.

`python docs/parameter_pages.py` writes both anew.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

from smallwheel_ros.common.node_parameter import WHEEL, NodeParameter, Value, written
from smallwheel_ros.onboard.declared import GENERAL, PER_WHEEL

_EXAMPLE_WHEEL = "front_left"
_EXAMPLES: dict[str, Value] = {
    "wheels": [_EXAMPLE_WHEEL],
    f"{_EXAMPLE_WHEEL}.diameter": 0.25,
    f"{_EXAMPLE_WHEEL}.width": 0.10,
}
_INTRODUCTION = (
    "Made by `python docs/parameter_pages.py` from `smallwheel_ros/onboard/declared.py`, as"
    " [config/template.yaml](../config/template.yaml) is. An integer is taken where a `double` is meant."
    " `all_wheels.`*name* gives each wheel a parameter that has none of its own; `<wheel>` in a text is the"
    " wheel's name. Then counts the robot's description, then `vehicle.track` and `vehicle.wheelbase`, then"
    " the default. A name"
    " that is unknown is a warning; one that is missing or wrong is an error: the node is not configured, a"
    " replay has exit code 2. *At start*: only from a"
    " file or the command line."
)


def _span(parameter: NodeParameter) -> str:
    """What a value may be, in words; empty: anything."""
    if parameter.choices:
        return " or ".join(map(str, parameter.choices))
    if parameter.low is None or parameter.high is None:
        return ""
    return f"{parameter.low:g} to {parameter.high:g}"


def template() -> str:
    """Return a parameter file with every parameter, its meaning and its default."""
    lines = [
        "# All parameters of mobility_estimator. Made by python docs/parameter_pages.py;",
        "# copy it and keep what you change. A line that begins with # is a default or optional.",
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
        words, span = parameter.description, _span(parameter)
        words += f" [{parameter.unit}]" if parameter.unit else ""
        words += f" {span}." if span else ""
        lines += [f"{indent}# {line}" for line in textwrap.wrap(words, 92 - len(indent))]
        value = _EXAMPLES.get(parameter.name, parameter.default)
        text = "" if value is None else f" {written(value)}"
        lines.append(f"{indent}{'' if parameter.required else '# '}{name}:{text}")
    return "\n".join(lines) + "\n"


def reference() -> str:
    """Return docs/parameters.md."""
    lines = [
        "# Parameters of `mobility_estimator`",
        "",
        *textwrap.wrap(_INTRODUCTION, 100, break_on_hyphens=False, break_long_words=False),
        "",
    ]
    for title, table in (("General", GENERAL), ("Of each wheel", PER_WHEEL)):
        lines += [f"## {title}", "", "| name | type | default | range | meaning |"]
        lines.append("| --- | --- | --- | --- | --- |")
        for p in table:
            default = "*required*" if p.required else "*optional*"
            if p.default is not None:
                default = f"`{written(p.default)}`"
            unit = f" [{p.unit}]" if p.unit else ""
            at_start = " *At start.*" if p.at_start else ""
            row = (p.name, p.kind, default, _span(p), f"{p.description}{unit}{at_start}")
            lines.append(f"| {' | '.join(row)} |".replace(WHEEL, "*wheel*"))
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Write template and documentation into the checkout."""
    root = Path(__file__).resolve().parent.parent
    for name, text in (("config/template.yaml", template()), ("docs/parameters.md", reference())):
        path = root / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
