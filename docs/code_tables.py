# SPDX-License-Identifier: Apache-2.0
"""Tables of the site that are made from the code: forms of effects, parameters of the node, constants.

Each is a list of lines of Markdown. The directive `code-table NAME ARGUMENT` (table_directive.py) shows one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from smallwheel_ros.common.node_parameter import WHEEL, NodeParameter, written
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families
from smallwheel_ros.fitting import constants as constants_of_fits
from smallwheel_ros.onboard.declared import GENERAL, PER_WHEEL


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table; a bar inside of a cell is no border of it."""
    escaped = [[cell.replace("|", r"\|") for cell in row] for row in rows]
    lines = [header, ["---"] * len(header), *escaped]
    return [f"| {' | '.join(line)} |" for line in lines]


# --- Forms of an effect


def _published(form: type[Effect]) -> str:
    """Names of a form's parameters, each with its unit and the range that was published."""
    names = []
    for known in form.parameters():
        unit = "" if known.unit in ("", "1") else f" [{known.unit}]"
        span = f" ({known.published[0]:g} to {known.published[1]:g})" if known.published else ""
        names.append(f"`{known.name}`{unit}{span}")
    return ", ".join(names) or "-"


def effect(id: str) -> list[str]:
    """The forms of an effect and, of an instrument's fault, how the instrument is checked."""
    forms = families()[id]
    rows = [(f"`{f.form}`", f"`{f.formula}`", _published(f), f.source) for f in forms]
    checked = ["", forms[0].next_step] if forms[0].kind == "instrument" else []
    return [
        *table(["form", "formula", "parameters (published range)", "source"], rows),
        *checked,
    ]


# --- Parameters of the node


def _cells(parameter: NodeParameter) -> tuple[str, ...]:
    """One parameter: name, type, default, range, meaning with unit."""
    default = "*required*" if parameter.required else "*optional*"
    if parameter.default is not None:
        default = f"`{written(parameter.default)}`"
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    at_start = " *At start.*" if parameter.at_start else ""
    meaning = f"{parameter.description}{unit}{at_start}"
    cells = (parameter.name, parameter.kind, default, parameter.allowed, meaning)
    return tuple(cell.replace(WHEEL, "*wheel*") for cell in cells)


def parameters(which: str) -> list[str]:
    """The node's own parameters (`general`), or those of each wheel (`wheel`)."""
    rows = {"general": GENERAL, "wheel": PER_WHEEL}[which]
    return table(["name", "type", "default", "range", "meaning"], [_cells(row) for row in rows])


# --- Constants of fits and diagnoses


class Constant(NamedTuple):
    """A constant, as the comment above it has it."""

    name: str
    value: float
    why: str


def constants_with_reasons() -> list[Constant]:
    """What the comment above each constant says: its name, a dash, and why."""
    found = []
    source = Path(constants_of_fits.__file__).read_text(encoding="utf-8")
    for comment, value in re.findall(r"((?:^# .*\n)+)^[A-Z_]+ = (.*)$", source, re.MULTILINE):
        lines = re.sub(r"^#\s+", "", comment, flags=re.MULTILINE).split("\n")
        name, why = " ".join(lines).split(" - ", 1)
        found.append(Constant(name.strip(), float(value), why.strip()))
    return found


def constants(_: str) -> list[str]:
    """The constants of fitting/constants.py."""
    rows = [(c.name, f"{c.value:g}", c.why) for c in constants_with_reasons()]
    return table(["constant", "value", "why"], rows)


TABLES: dict[str, Callable[[str], list[str]]] = {
    "effect": effect,
    "parameters": parameters,
    "constants": constants,
}
