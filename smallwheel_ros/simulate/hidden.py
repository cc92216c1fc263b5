# SPDX-License-Identifier: Apache-2.0
"""Settings that rigs and drives have alike: above all the hidden effects, and how they are drawn.

A name may carry the size that the effect has, in SI units of its formula: `load_offset=-4`. Then
nothing of it is drawn, and `strength` has no say in it.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import click
import numpy as np

from smallwheel_ros.common.options import Option, options_of
from smallwheel_ros.simulate.hidden_effects import FORMS, LAWS, Form, HiddenEffect
from smallwheel_ros.simulate.truth import SimulationError, check_range

EFFECTS = {name: law for name, law in LAWS.items() if name != "column"}
MOISTURE = "moisture"  # a column like any other, only better known
_COLUMN = "column:"
# Unit in the header, low, high. Others are pure numbers between 0.5 and 1.5.
KNOWN_COLUMNS: dict[str, tuple[str, float, float]] = {
    MOISTURE: ("", 0.02, 0.14),
    "density": ("kg/m^3", 1400.0, 1700.0),
    "temperature": ("K", 268.0, 308.0),
}
# Columns that a measurements table knows: no effect can be driven by an extra one of that name.
_CONTRACT_COLUMNS = frozenset([
    "load", "diameter", "width", "sinkage", "resistance", "drawbar_pull", "sinkage_std",
    "resistance_std", "drawbar_pull_std", "slip", "slip_angle", "slope", "speed", "pass_number",
    "grouser_height", "contact", "soil", "run", "wheel",
])  # fmt: skip


def hidden_names() -> tuple[str, ...]:
    """Everything that `--hidden` takes."""
    return ("none", *EFFECTS, MOISTURE, f"{_COLUMN}NAME")


Seed = Annotated[int, Option("Same seed, same data.", (0, 2**63 - 1))]
Strength = Annotated[float, Option("Factor on the size of the hidden effects.", (0.0, 10.0))]
Hidden = Annotated[
    tuple[str, ...],
    Option(
        f"Effects and faults of instruments in the truth: {', '.join(hidden_names())}."
        " With a size, that is its amplitude in SI units: load_offset=-4.",
        words={"default": "none", "metavar": "EFFECT[=SIZE][,EFFECT]"},
    ),
]
FormOfHidden = Annotated[
    Form,
    Option(
        "Form of the hidden effects: the simulator's own, or one from the literature.",
        words={"type": click.Choice(FORMS)},
    ),
]


FRACTION = {"metavar": "FRACTION"}  # of options that are a share


def check_ranges(settings: Any) -> None:
    """Raise `SimulationError` for the first setting that is outside its range."""
    for name, option in options_of(type(settings)).items():
        if option.within:
            check_range(name.replace("_", " "), getattr(settings, name), *option.within)


def column_unit(column: str) -> str:
    """Unit of an extra column, empty for a pure number."""
    return KNOWN_COLUMNS.get(column, ("",))[0]


def split_size(text: str) -> tuple[str, float | None]:
    """Name and size of `NAME=SIZE`; the size is None where none is given.

    Raises
    ------
    SimulationError
        If the size is no finite number.
    """
    name, equals, size = text.partition("=")
    if not equals:
        return name, None
    if name == "none":
        raise SimulationError(f"hidden effect {text!r}: 'none' has no size")
    try:
        number = float(size)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise SimulationError(
            f"hidden effect {text!r}: its size is {size!r}, expected a number, as in {name}=0.1"
        )
    return name, number


def hidden_column(text: str) -> str | None:
    """Name of the extra column that drives an effect, None when it needs no column of its own."""
    name, _ = split_size(text)
    if name == MOISTURE:
        return MOISTURE
    return name[len(_COLUMN) :] if name.startswith(_COLUMN) else None


def in_drives(text: str) -> bool:
    """Whether a drive can have this effect: its driver and its instrument are there."""
    name, _ = split_size(text)
    return hidden_column(text) is None and LAWS[name].in_drives


def check_hidden(texts: Sequence[str]) -> tuple[str, ...]:
    """Return the effects without `none`; raise `SimulationError` for unknown ones."""
    names = [split_size(text)[0] for text in texts]
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
    return tuple(text for text in texts if text != "none")


def check_form(form: str) -> None:
    """Raise `SimulationError` unless the form of the hidden effects exists."""
    if form not in FORMS:
        raise SimulationError(f"form {form!r} is unknown: expected {' or '.join(FORMS)}")


def draw_effects(
    hidden: Sequence[str], rng: np.random.Generator, strength: float, form: Form
) -> tuple[HiddenEffect, ...]:
    """Draw the numbers of the named effects, in that order."""
    drawn = []
    for text in check_hidden(hidden):
        name, size = split_size(text)
        column = hidden_column(name)
        if column is None:
            effect = _drawn(name, rng, strength, form)
        else:
            _, low, high = KNOWN_COLUMNS.get(column, ("", 0.5, 1.5))
            middle, half = (low + high) / 2, (high - low) / 2
            numbers = {"column": column, "centre": middle, "half_range": half}
            effect = replace(_drawn("column", rng, strength, form), numbers=numbers)
        drawn.append(effect if size is None else replace(effect, amplitude=size))
    return tuple(drawn)


def _drawn(name: str, rng: np.random.Generator, strength: float, form: Form) -> HiddenEffect:
    """Draw an effect of about the typical size (within 15 %), or of that size and its numbers."""
    law = LAWS[name]
    amplitude = strength * law.forms[form].typical
    between = {key: at for key, at in law.numbers.items() if isinstance(at, tuple)}
    if law.either_sign and rng.uniform() >= 0.5:
        amplitude = -amplitude
    if not between:
        amplitude *= rng.uniform(0.85, 1.15)
    numbers = {key: rng.uniform(*ends) for key, ends in between.items()}
    return HiddenEffect(name, form, amplitude, {**law.numbers, **numbers})
