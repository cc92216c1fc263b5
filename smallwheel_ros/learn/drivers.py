# SPDX-License-Identifier: Apache-2.0
"""What a missing law can follow: settings of the table, and numbers made of them."""

from __future__ import annotations

import json
import keyword
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import CodeType, SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.settings import independent
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

DEPTH = "sinkage/diameter"
FEWEST_LEVELS = 3  # of a law: two values are a difference between two days
QUANTILES = (0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85)
_GRAVITY = 9.81  # m/s^2
_LEVEL = 0.01  # of the range: what differs by less is one level
_FAR = 0.6  # of the largest value: a range that begins beyond it has its zero far away
SIZES = {"load": "N", "width": "m", "diameter": "m"}  # what every row has, with units
# Variables of a drafted method that are no drivers.
_TAKEN = ("self", "conditions", "state", "sinkage", "diameter", "np", "u", "continued")


@dataclass(frozen=True)
class Driver:
    """A number that a law can follow, SI units.

    columns: settings that it is made of; none is of the depth. code: Python of `conditions` (and
    `state`) that works it out: the search computes this line, and a drafted file contains it. variable:
    its name there. weight: what it counts as when drivers are counted.

    Where it was measured: reference: what is taken off it. low, high: range after that. middle: median
    size. quantiles: `QUANTILES` of its values. levels: how many different ones there are.
    """

    name: str
    columns: tuple[str, ...]
    variable: str
    code: str
    unit: str
    weight: float = 1.0
    reference: float = 0.0
    low: float = 0.0
    high: float = 0.0
    middle: float = 0.0
    quantiles: tuple[float, ...] = ()
    levels: int = 0

    @cached_property
    def _compiled(self) -> CodeType:
        return compile(self.code, "<driver>", "eval")

    def values(self, conditions: Conditions, sinkage: Array | None = None) -> Array:
        """Its values, shape (rows,). sinkage: m, of a driver that is made of it."""
        state = SimpleNamespace(sinkage=sinkage)
        found = eval(self._compiled, {"np": np, "conditions": conditions, "state": state})
        return np.asarray(found) - self.reference

    @property
    def span(self) -> float:
        """Length of its range."""
        return self.high - self.low

    @property
    def python(self) -> str:
        """What works it out, less its reference."""
        return f"{self.code} - {self.reference!r}" if self.reference else self.code

    @property
    def text(self) -> str:
        """It, in a formula for people."""
        return f"({self.name} - {self.reference:.12g})" if self.reference else self.name

    def place(self, value: float) -> str:
        """A value less its reference as the value itself, to a hundredth of its range, which is not 0."""
        return f"{round(value + self.reference, 1 + _digits(self.span)):.12g}"

    def measured_at(self, x: Array) -> Driver:
        """The driver of points where it has these values, shape (points,)."""
        low, high = float(x.min()), float(x.max())
        far = low > _FAR * high and self.columns == (self.name,)  # a ratio has its zero at zero
        reference = _at_most(low, high - low) if far else 0.0
        return replace(
            self, reference=reference, low=low - reference, high=high - reference,
            middle=float(f"{np.median(np.abs(x - reference)):.2g}"),
            quantiles=tuple(np.quantile(x - reference, QUANTILES).tolist()), levels=_levels(x),
        )  # fmt: skip


_COMPOUNDS = (
    Driver("width/diameter", ("width", "diameter"), "slenderness",
           "conditions.width / conditions.diameter", "1", 1.5),
    Driver("load/(width diameter)", ("load", "width", "diameter"), "pressure",
           "conditions.load / (conditions.width * conditions.diameter)", "Pa", 2.0),
    Driver("speed/sqrt(g diameter)", ("speed",), "froude",
           f'conditions["speed"] / np.sqrt({_GRAVITY} * conditions.diameter)', "1", 1.5),
)  # fmt: skip
_DEPTH = Driver(DEPTH, (), "depth", "state.sinkage / conditions.diameter", "1", 1.5)


def _at_most(low: float, span: float) -> float:
    """The lowest value, rounded down to a tenth of the span or less: 293 of 293.15 to 308."""
    if span <= 1e-9 * low:
        return low
    unit = 10.0 ** _digits(span)
    return math.floor(low * unit) / unit


def _digits(span: float) -> int:
    """Of a number that is given to a tenth of the span's size, behind the point."""
    return 1 - math.floor(math.log10(span))


def identifier(name: str) -> str:
    """A column's name as a Python variable."""
    made = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "column"
    taken = keyword.iskeyword(made) or made in _TAKEN
    return f"column_{made}" if taken or not made.isidentifier() else made


def _column(name: str, units: Mapping[str, str]) -> Driver:
    """A setting as it is. Its name is quoted in the code: it may have any character."""
    code = f"conditions.{name}" if name in SIZES else f"conditions[{json.dumps(name)}]"
    return Driver(name, (name,), identifier(name), code, SIZES.get(name, units.get(name) or "1"))


def drivers_of(points: Points, sinkage: Array) -> tuple[list[Driver], list[str]]:
    """The drivers that these points vary, and why other settings are none, in words.

    A setting with two values is a driver: what follows it must not be laid at another's door, though
    no law can be learnt of it. sinkage: as the base model has it, m, shape (points,).
    """
    used = np.unique(points.row)
    usable = independent(points)
    names = [n for n in SIZES if n in usable] + [n for n in usable if n not in SIZES]
    possible = [_column(name, points.measurements.units) for name in names]
    possible += [compound for compound in _COMPOUNDS if _says_more(compound, usable)]
    if "resistance" in points.channels:
        possible.append(_DEPTH)
    found = []
    for driver in possible:
        x = driver.values(points.conditions, sinkage)[used]
        if np.ptp(x) >= 1e-3 * np.abs(x).max() > 0.0:
            found.append(driver.measured_at(x))
    return found, [f"{n} follows other settings" for n in points.varied if n not in usable]


def _says_more(compound: Driver, usable: Mapping[str, Array]) -> bool:
    """Whether a compound says something that its columns alone do not.

    Columns of two values each make a compound of four, which are still two days by two days.
    """
    columns = {*compound.columns, "diameter"}  # each is of the diameter
    if not columns <= usable.keys():
        return False
    return any(_levels(usable[column]) >= FEWEST_LEVELS for column in columns)


def _levels(x: Array) -> int:
    """How many different values there are."""
    return int(np.unique(np.round((x - x.min()) / max(float(np.ptp(x)), 1e-300) / _LEVEL)).size)
