"""What a missing law can follow: settings of the table, and numbers made of them."""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.settings import independent
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

# Variables of a drafted method that are no drivers, and those of compounds.
_TAKEN = ("self", "conditions", "state", "sinkage", "np", "u", "continued")
GRAVITY = 9.81  # m/s^2
DEPTH = "sinkage/diameter"
FEWEST_LEVELS = 3  # of a law: two values are a difference between two days
_LEVEL = 0.01  # of the range: what differs by less is one level
QUANTILES = (0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85)
_FAR = 0.6  # of the largest value: a range that begins beyond it has its zero far away


@dataclass(frozen=True)
class Driver:
    """A number that a law can follow, SI units.

    columns: settings that it is made of. code: Python that works it out of `conditions` (and
    `state`). reference: what is taken off it. low, high: range that was measured, after that.
    middle: median size. quantiles: `QUANTILES` of its values. weight: what it counts as when
    drivers are counted.
    """

    name: str
    columns: tuple[str, ...]
    code: str
    reference: float
    low: float
    high: float
    middle: float
    quantiles: tuple[float, ...]
    levels: int
    unit: str = "1"
    weight: float = 1.0

    @property
    def variable(self) -> str:
        """Its name as a Python variable."""
        return _COMPOUND[self.name].variable if self.name in _COMPOUND else identifier(self.name)

    @property
    def span(self) -> float:
        """Length of its range."""
        return self.high - self.low

    def values(self, conditions: Conditions, sinkage: Array | None = None) -> Array:
        """Its values, shape (rows,). sinkage: m, of a driver that is made of it."""
        return _raw(self.name, conditions, sinkage) - self.reference

    @property
    def text(self) -> str:
        """It, in a formula for people."""
        return f"({self.name} - {self.reference:g})" if self.reference else self.name


@dataclass(frozen=True)
class _Compound:
    columns: tuple[str, ...]
    variable: str
    code: str
    weight: float
    unit: str
    value: Callable[[Conditions], Array]


_COMPOUND: Mapping[str, _Compound] = {
    "width/diameter": _Compound(
        ("width", "diameter"), "slenderness", "conditions.width / conditions.diameter", 1.5, "1",
        lambda c: c.width / c.diameter,
    ),
    "load/(width diameter)": _Compound(
        ("load", "width", "diameter"), "pressure",
        "conditions.load / (conditions.width * conditions.diameter)", 2.0, "Pa",
        lambda c: c.load / (c.width * c.diameter),
    ),
    "speed/sqrt(g diameter)": _Compound(
        ("speed",), "froude",
        f'conditions["speed"] / np.sqrt({GRAVITY} * conditions.diameter)', 1.5, "1",
        lambda c: c["speed"] / np.sqrt(GRAVITY * c.diameter),
    ),
    DEPTH: _Compound(
        (), "depth", "state.sinkage / conditions.diameter", 1.5, "1", lambda c: c.diameter
    ),
}  # fmt: skip


def identifier(name: str) -> str:
    """A column's name as a Python variable."""
    made = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "column"
    taken = keyword.iskeyword(made) or made in _TAKEN
    return f"column_{made}" if taken or not made.isidentifier() else made


def _raw(name: str, conditions: Conditions, sinkage: Array | None) -> Array:
    if name == DEPTH:
        assert sinkage is not None
        return np.asarray(sinkage / conditions.diameter)
    if name in _COMPOUND:
        return np.asarray(_COMPOUND[name].value(conditions))
    return conditions[name]


def drivers_of(points: Points, sinkage: Array) -> tuple[list[Driver], list[str]]:
    """The drivers that these points vary, and why other settings are none, in words.

    A setting with two values is a driver: what follows it must not be laid at another's door, though
    no law can be learnt of it.
    sinkage: as the base model has it, m, shape (points,).
    """
    used = np.unique(points.row)
    conditions, z = points.conditions.take(used), sinkage[used]
    usable = independent(points)
    found: list[Driver] = []
    refused = [f"{name} follows other settings" for name in points.varied if name not in usable]
    names: list[str] = [n for n in ("load", "width", "diameter") if n in usable]
    names += [n for n in usable if n not in names]
    made = [n for n, c in _COMPOUND.items() if n != DEPTH and _both(n, c, usable)]
    for name in [*names, *made, *([DEPTH] if "resistance" in points.channels else [])]:
        driver = _driver(name, conditions, z, points)
        if isinstance(driver, Driver):
            found.append(driver)
        else:
            refused += [driver] if name in names else []
    return found, refused


def _both(name: str, compound: _Compound, usable: Mapping[str, Array]) -> bool:
    """Whether a compound says something that its columns alone do not.

    Columns of two values each make a compound of four, which are still two days by two days.
    """
    columns = {*compound.columns, *(("diameter",) if name == "speed/sqrt(g diameter)" else ())}
    if not columns <= usable.keys():
        return False
    return any(_levels(usable[column]) >= FEWEST_LEVELS for column in columns)


def _levels(x: Array) -> int:
    """How many different values there are."""
    low, high = float(x.min()), float(x.max())
    return int(np.unique(np.round((x - low) / max(high - low, 1e-300) / _LEVEL)).size)


def _driver(name: str, conditions: Conditions, sinkage: Array, points: Points) -> Driver | str:
    x = _raw(name, conditions, sinkage)
    low, high = float(x.min()), float(x.max())
    size = max(abs(low), abs(high))
    if high - low < 1e-3 * size or size == 0.0:
        return f"{name} is constant"
    levels = _levels(x)
    reference = float(f"{low:.3g}") if low > _FAR * high and name not in _COMPOUND else 0.0
    known = _COMPOUND.get(name)
    unit = known.unit if known else _unit(name, points)
    columns = known.columns if known else (name,)
    code = known.code if known else _code(name)
    return Driver(
        name, columns, code, reference, low - reference, high - reference,
        float(f"{np.median(np.abs(x - reference)):.2g}"),
        tuple(np.quantile(x - reference, QUANTILES).tolist()), levels, unit,
        known.weight if known else 1.0,
    )  # fmt: skip


def _code(name: str) -> str:
    if name in ("load", "width", "diameter"):
        return f"conditions.{name}"
    return f"conditions[{json.dumps(name)}]"  # quoted: a name may have any character


def _unit(name: str, points: Points) -> str:
    fixed = {"load": "N", "width": "m", "diameter": "m"}
    return fixed.get(name) or points.measurements.units.get(name) or "1"
