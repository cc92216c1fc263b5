# SPDX-License-Identifier: Apache-2.0
"""What a missing law can follow: settings of the table, and numbers made of them."""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass
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
_SIZES = {"load": "N", "width": "m", "diameter": "m"}  # what every row has, with units
# Variables of a drafted method that are no drivers.
_TAKEN = ("self", "conditions", "state", "sinkage", "diameter", "np", "u", "continued")


@dataclass(frozen=True)
class Source:
    """Where a driver's values come from.

    columns: settings that it is made of. code: Python of `conditions` (and `state`) that works it out:
    the search computes this line, and a drafted file contains it. variable: its name there. weight:
    what it counts as when drivers are counted.
    """

    name: str
    columns: tuple[str, ...]
    variable: str
    code: str
    unit: str
    weight: float = 1.0

    @cached_property
    def _compiled(self) -> CodeType:
        return compile(self.code, "<driver>", "eval")

    def values(self, conditions: Conditions, sinkage: Array | None) -> Array:
        """Its values, shape (rows,). sinkage: m, of one that is made of it."""
        state = SimpleNamespace(sinkage=sinkage)
        found = eval(self._compiled, {"np": np, "conditions": conditions, "state": state})
        return np.asarray(found)


_COMPOUNDS = (
    Source("width/diameter", ("width", "diameter"), "slenderness",
           "conditions.width / conditions.diameter", "1", 1.5),
    Source("load/(width diameter)", ("load", "width", "diameter"), "pressure",
           "conditions.load / (conditions.width * conditions.diameter)", "Pa", 2.0),
    Source("speed/sqrt(g diameter)", ("speed",), "froude",
           f'conditions["speed"] / np.sqrt({_GRAVITY} * conditions.diameter)', "1", 1.5),
)  # fmt: skip
_DEPTH = Source(DEPTH, (), "depth", "state.sinkage / conditions.diameter", "1", 1.5)


@dataclass(frozen=True)
class Driver:
    """A number that a law can follow, SI units.

    reference: what is taken off it. low, high: range that was measured, after that. middle: median
    size. quantiles: `QUANTILES` of its values. levels: how many different ones there are.
    """

    source: Source
    reference: float
    low: float
    high: float
    middle: float
    quantiles: tuple[float, ...]
    levels: int

    @property
    def name(self) -> str:
        """As in documents and formulas."""
        return self.source.name

    @property
    def columns(self) -> tuple[str, ...]:
        """Settings that it is made of; none is of the depth."""
        return self.source.columns

    @property
    def span(self) -> float:
        """Length of its range."""
        return self.high - self.low

    def values(self, conditions: Conditions, sinkage: Array | None = None) -> Array:
        """Its values, shape (rows,). sinkage: m, of a driver that is made of it."""
        return self.source.values(conditions, sinkage) - self.reference

    @property
    def text(self) -> str:
        """It, in a formula for people."""
        return f"({self.name} - {self.reference:g})" if self.reference else self.name


def identifier(name: str) -> str:
    """A column's name as a Python variable."""
    made = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "column"
    taken = keyword.iskeyword(made) or made in _TAKEN
    return f"column_{made}" if taken or not made.isidentifier() else made


def _column(name: str, units: Mapping[str, str]) -> Source:
    """A setting as it is. Its name is quoted in the code: it may have any character."""
    code = f"conditions.{name}" if name in _SIZES else f"conditions[{json.dumps(name)}]"
    return Source(name, (name,), identifier(name), code, _SIZES.get(name, units.get(name) or "1"))


def drivers_of(points: Points, sinkage: Array) -> tuple[list[Driver], list[str]]:
    """The drivers that these points vary, and why other settings are none, in words.

    A setting with two values is a driver: what follows it must not be laid at another's door, though
    no law can be learnt of it. sinkage: as the base model has it, m, shape (points,).
    """
    used = np.unique(points.row)
    usable = independent(points)
    names = [n for n in _SIZES if n in usable] + [n for n in usable if n not in _SIZES]
    sources = [_column(name, points.measurements.units) for name in names]
    sources += [source for source in _COMPOUNDS if _says_more(source, usable)]
    if "resistance" in points.channels:
        sources.append(_DEPTH)
    found = []
    for source in sources:
        x = source.values(points.conditions, sinkage)[used]
        if np.ptp(x) >= 1e-3 * np.abs(x).max() > 0.0:
            found.append(_driver(source, x))
    return found, [f"{n} follows other settings" for n in points.varied if n not in usable]


def _says_more(compound: Source, usable: Mapping[str, Array]) -> bool:
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


def _driver(source: Source, x: Array) -> Driver:
    """The driver with these values, shape (points,)."""
    low, high = float(x.min()), float(x.max())
    far = low > _FAR * high and source not in _COMPOUNDS
    reference = float(f"{low:.3g}") if far else 0.0
    return Driver(
        source, reference, low - reference, high - reference,
        float(f"{np.median(np.abs(x - reference)):.2g}"),
        tuple(np.quantile(x - reference, QUANTILES).tolist()), _levels(x),
    )  # fmt: skip
