"""The hidden effects by name: what `--hidden` takes, and how their numbers are drawn for a seed."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np

from smallwheel_ros.simulate.hidden_effects import (
    FORMS,
    Bulldozing,
    ColumnEffect,
    ElasticRebound,
    Form,
    Grouser,
    Hardpan,
    HiddenEffect,
    LoadDependentModulus,
    Multipass,
    PenetrationRate,
    SinkageOffset,
    SkidSinkage,
    SlipAngleSinkage,
    SlipSinkage,
    Unrecorded,
    WidthDependentModulus,
)
from smallwheel_ros.simulate.truth import SimulationError

EFFECTS: dict[str, type[HiddenEffect]] = {
    kind.name: kind
    for kind in (
        SlipSinkage,
        SkidSinkage,
        SlipAngleSinkage,
        Bulldozing,
        PenetrationRate,
        LoadDependentModulus,
        WidthDependentModulus,
        Multipass,
        Hardpan,
        Grouser,
        SinkageOffset,
        ElasticRebound,
        Unrecorded,
    )
}
MOISTURE = "moisture"  # a column like any other, only better known
_COLUMN = "column:"
# Unit in the header, low, high. Others are pure numbers between 0.5 and 1.5.
KNOWN_COLUMNS: dict[str, tuple[str, float, float]] = {
    MOISTURE: ("", 0.02, 0.14),
    "density": ("kg/m^3", 1400.0, 1700.0),
    "temperature": ("K", 268.0, 308.0),
}
# Columns that a measurements table knows: no effect can be driven by an extra one of that name.
_CONTRACT_COLUMNS = frozenset(
    [
        "load",
        "diameter",
        "width",
        "sinkage",
        "resistance",
        "drawbar_pull",
        "sinkage_std",
        "resistance_std",
        "drawbar_pull_std",
        "slip",
        "slip_angle",
        "slope",
        "speed",
        "pass_number",
        "grouser_height",
        "contact",
        "soil",
        "run",
        "wheel",
    ]
)


def hidden_names() -> tuple[str, ...]:
    """Everything that `--hidden` takes."""
    return ("none", *EFFECTS, MOISTURE, f"{_COLUMN}NAME")


def column_unit(column: str) -> str:
    """Unit of an extra column, empty for a pure number."""
    return KNOWN_COLUMNS.get(column, ("",))[0]


def hidden_column(name: str) -> str | None:
    """Name of the extra column that drives an effect, None when it needs no column of its own."""
    if name == MOISTURE:
        return MOISTURE
    return name[len(_COLUMN) :] if name.startswith(_COLUMN) else None


def check_hidden(names: Sequence[str]) -> tuple[str, ...]:
    """Return the effects' names without `none`; raise `SimulationError` for unknown ones."""
    for name in names:
        known = name == "none" or name in EFFECTS
        column = hidden_column(name)
        if not known and (column is None or not column.isidentifier()):
            close = difflib.get_close_matches(name, hidden_names(), n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise SimulationError(
                f"hidden effect {name!r} is unknown; {hint}It can be: {', '.join(hidden_names())}"
            )
        if column in _CONTRACT_COLUMNS:
            raise SimulationError(
                f"hidden effect {name!r}: a column {column!r} has a meaning of its own already;"
                " take another name"
            )
    if "none" in names and len(names) > 1:
        raise SimulationError("hidden effect 'none' together with others: give either")
    if len({hidden_column(name) or name for name in names}) < len(names):
        raise SimulationError(f"hidden effects {', '.join(names)}: one of them is given twice")
    return tuple(name for name in names if name != "none")


def check_form(form: str) -> None:
    """Raise `SimulationError` unless the form of the hidden effects exists."""
    if form not in FORMS:
        raise SimulationError(f"form {form!r} is unknown: expected {' or '.join(FORMS)}")


def draw_effects(
    names: Sequence[str], rng: np.random.Generator, strength: float, form: Form
) -> tuple[HiddenEffect, ...]:
    """Draw the numbers of the named effects, in that order."""
    drawn = []
    for name in check_hidden(names):
        column = hidden_column(name)
        if column is None:
            drawn.append(EFFECTS[name].draw(rng, strength, form))
            continue
        _, low, high = KNOWN_COLUMNS.get(column, ("", 0.5, 1.5))
        amplitude = strength * ColumnEffect.typical[form] * rng.uniform(0.85, 1.15)
        middle, half = (low + high) / 2, (high - low) / 2
        drawn.append(ColumnEffect(form, amplitude, column, middle, half))
    return tuple(drawn)
