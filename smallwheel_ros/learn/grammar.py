# SPDX-License-Identifier: Apache-2.0
"""The grammar of laws: what a law can depend on, the shapes that it can have, and all terms made of these.

A term has a strength, which enters linearly, and at most one constant of shape, which is tried on a
grid and freed once the term is chosen. Shapes and drivers are each one line of Python, which the
search evaluates and a drafted file contains, so that the two cannot differ.
"""

from __future__ import annotations

import itertools
import json
import keyword
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import CodeType, SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.diagnosis.competitors import independent
from smallwheel_ros.effects.drafted import continued
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.columns import GRAVITY_COLUMN
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.wheel import GRAVITY

Array = NDArray[np.float64]

DEPTH = "sinkage/diameter"
SIZES = {"load": "N", "width": "m", "diameter": "m"}  # settings that every row has, with units
FEWEST_LEVELS = 3  # values of a driver of a law: two may differ as two days do
_FEWEST_FOR_PRODUCTS = 14  # settings from which laws of two drivers are tried
_QUANTILES = (0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85)
_LEVEL = 0.01  # of the range: values that differ by less are one level
_FAR = 0.6  # of the largest value: a range that begins above it is far from 0
# Variables of a drafted method that are no drivers.
_TAKEN = ("self", "conditions", "state", "sinkage", "diameter", "np", "u", "continued")
_CURVED = 4  # levels of a driver from which a shape with a constant is tried
_SCALES = (0.1, 0.2, 0.35, 0.6, 1.0)  # of a driver's span
# Of a driver's span; neighbours are an eighth apart. A longer wave is not seen whole: it is a bend.
_PERIODS = np.geomspace(0.2, 1.0, 15)
_A_WAVE = 4  # levels of a driver to a period: fewer do not show one
_PHASES = np.arange(6) / 12  # of a period: half of one is enough, since a strength has either sign
_STEP = 0.03  # of a driver's span: width of a step


@lru_cache(maxsize=4096)
def _compiled(code: str) -> CodeType:
    return compile(code, "<grammar>", "eval")


@dataclass(frozen=True)
class Shape:
    """A function of one driver u, such as u^2 or tanh(u/c), with at most one constant c.

    A term of a law is a product of shapes, one for each of its drivers.

    Attributes
    ----------
    name
        Name of the shape, such as `saturation`.
    code
        The function as a Python expression in u and c, which is evaluated.
    text
        The function as a formula to be shown, a format string with {u} and {c}.
    power
        Power of u's unit that the function's value has: 2 for u^2, 0 for a pure number.
    constant
        `none` if it has no c, `free` if c is fitted, `given` if c is `Driver.middle`.
    written
        Number of numbers in `code` besides c that the search chooses, such as the period of a wave. Each adds
        to the length of the law's description, as c does.
    alone
        Whether a term with this shape is never added to another term.
    side
        +1 if the function is 0 for u below 0, -1 if it is 0 for u above 0; else 0.
    """

    name: str
    code: str
    text: str
    power: float = 0.0
    constant: Literal["none", "given", "free"] = "none"
    written: int = 0
    alone: bool = False
    side: int = 0


LINEAR = Shape("linear", "u", "{u}", 1.0)
SQUARE = Shape("square", "u**2", "{u}^2", 2.0)
ROOT = Shape("root", "np.sqrt(np.abs(u))", "sqrt({u})", 0.5)
LOGARITHM = Shape("logarithm", "np.log(u / c)", "ln({u}/{c})", constant="given")
INVERSE = Shape("inverse", "1.0 / u", "1/{u}", -1.0)
SIZE = Shape("size", "np.abs(u)", "|{u}|", 1.0)
POSITIVE = Shape("positive", "np.maximum(u, 0.0)", "max({u}, 0)", 1.0, side=1)
NEGATIVE = Shape("negative", "np.maximum(-u, 0.0)", "max(-{u}, 0)", 1.0, side=-1)
POSITIVE_SQUARE = Shape("positive_square", "np.maximum(u, 0.0) ** 2", "max({u}, 0)^2", 2.0, side=1)
NEGATIVE_SQUARE = Shape("negative_square", "np.maximum(-u, 0.0) ** 2", "max(-{u}, 0)^2", 2.0,
                        side=-1)  # fmt: skip
OFFSET = Shape("offset", "u - c", "({u} - {c})", 1.0, "free")
HINGE = Shape("hinge", "np.maximum(u - c, 0.0)", "max({u} - {c}, 0)", 1.0, "free")
FALLING_HINGE = Shape("falling_hinge", "np.maximum(c - u, 0.0)", "max({c} - {u}, 0)", 1.0, "free")
OPTIMUM = Shape("optimum", "(u - c) ** 2", "({u} - {c})^2", 2.0, "free")
SATURATION = Shape("saturation", "np.tanh(u / c)", "tanh({u}/{c})", constant="free")
POSITIVE_SATURATION = Shape("positive_saturation", "np.tanh(np.maximum(u, 0.0) / c)",
                            "tanh(max({u}, 0)/{c})", constant="free", side=1)  # fmt: skip
NEGATIVE_SATURATION = Shape("negative_saturation", "np.tanh(np.maximum(-u, 0.0) / c)",
                            "tanh(max(-{u}, 0)/{c})", constant="free", side=-1)  # fmt: skip
DECAY = Shape("decay", "np.exp(-np.abs(u) / c)", "exp(-|{u}|/{c})", constant="free")
LOG_GROWTH = Shape("log_growth", "np.log1p(np.abs(u) / c)", "ln(1 + |{u}|/{c})", constant="free")
GROWTH = Shape("growth", "np.expm1(u / c)", "(exp({u}/{c}) - 1)", constant="free")


def step(width: float) -> Shape:
    """Shape of a step from 0 to 1 at c, over a width in u's unit: smooth, so that c can be fitted."""
    code = f"0.5 + 0.5 * np.tanh((u - c) / {width!r})"
    return Shape("step", code, f"step({{u}} - {{c}}, width {width:.2g})", constant="free")


def wave(period: float) -> Shape:
    """Shape of a sine of u with a period in u's unit; it rises through 0 at c.

    It is never added to another shape, since it would follow whatever residual that leaves.
    """
    code = f"np.sin({2.0 * np.pi / period!r} * (u - c))"
    text = f"sin(2 pi ({{u}} - {{c}})/{period:.3g})"
    return Shape("wave", code, text, constant="free", written=1, alone=True)


@dataclass(frozen=True)
class Driver:
    """A variable that a law can depend on: a setting, or a ratio of several; SI units.

    Attributes
    ----------
    name
        Name in formulas that are shown: a setting, such as `slip`, or a ratio, such as `width/diameter`.
    columns
        Settings from which it is computed; empty for `sinkage/diameter`.
    variable
        Name of the Python variable for it in the file of a law.
    code
        Python expression that computes it from `conditions` (and from `state`, a `WheelState`). The search
        evaluates this expression, and the file of a law contains it.
    unit
        SI unit; "1" for a pure number.
    weight
        Number of drivers that it counts as where laws with fewer drivers are preferred: 1 for a setting,
        more for a ratio.
    reference
        Value that is subtracted before a shape is applied, SI; 0 unless the measured range is far from zero,
        as that of a temperature in K.
    low, high
        Ends of the measured range, less `reference`, SI.
    middle
        Median of the measured |value - reference|, SI.
    quantiles
        Quantiles (0.15 to 0.85) of the measured values, less `reference`, SI.
    levels
        Number of different values that were measured.
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

    def values(self, conditions: Conditions, sinkage: Array | None = None) -> Array:
        """Compute the driver minus its reference, SI, shape (rows,).

        Parameters
        ----------
        conditions
            Settings of the rows, SI units.
        sinkage
            Sinkage, m, shape (rows,); needed by the driver sinkage/diameter only.
        """
        state = SimpleNamespace(sinkage=sinkage)
        found = eval(_compiled(self.code), {"np": np, "conditions": conditions, "state": state})
        return np.asarray(found) - self.reference

    @property
    def span(self) -> float:
        """Length of its range."""
        return self.high - self.low

    @property
    def python(self) -> str:
        """Python expression of the driver, minus its reference."""
        return f"{self.code} - {self.reference!r}" if self.reference else self.code

    @property
    def text(self) -> str:
        """The driver as written in a formula that is shown."""
        return f"({self.name} - {self.reference:.12g})" if self.reference else self.name

    def place(self, value: float) -> str:
        """A value of the driver, rounded to a hundredth of its range, but not to 0."""
        return f"{round(value + self.reference, 1 + _digits(self.span)):.12g}"

    def measured_at(self, x: Array) -> Driver:
        """The same driver, with range, middle and quantiles of these values, shape (points,)."""
        low, high = float(x.min()), float(x.max())
        far = low > _FAR * high and self.columns == (self.name,)  # a ratio has its zero at zero
        reference = _at_most(low, high - low) if far else 0.0
        return replace(
            self, reference=reference, low=low - reference, high=high - reference,
            middle=float(f"{np.median(np.abs(x - reference)):.2g}"),
            quantiles=tuple(np.quantile(x - reference, _QUANTILES).tolist()), levels=_levels(x),
        )  # fmt: skip


_COMPOUNDS = (
    Driver("width/diameter", ("width", "diameter"), "slenderness",
           "conditions.width / conditions.diameter", "1", 1.5),
    Driver("load/(width diameter)", ("load", "width", "diameter"), "pressure",
           "conditions.load / (conditions.width * conditions.diameter)", "Pa", 2.0),
)  # fmt: skip
_DEPTH = Driver(DEPTH, (), "depth", "state.sinkage / conditions.diameter", "1", 1.5)


def _froude(conditions: Conditions) -> Driver:
    """The driver Froude's number; gravity is a number in its code if it is the same in all rows."""
    columns: tuple[str, ...] = ("speed",)
    gravity = str(GRAVITY)
    if GRAVITY_COLUMN in conditions:
        given = conditions[GRAVITY_COLUMN]
        gravity = str(float(given[0]))
        if np.ptp(given) > 0.0:
            columns, gravity = ("speed", GRAVITY_COLUMN), f'conditions["{GRAVITY_COLUMN}"]'
    code = f'conditions["speed"] / np.sqrt({gravity} * conditions.diameter)'
    return Driver("speed/sqrt(g diameter)", columns, "froude", code, "1", 1.5)


def _at_most(low: float, span: float) -> float:
    """The lowest value, rounded down to a tenth of the span or finer: 293 for a range of 293.15 to 308."""
    if span <= 1e-9 * low:
        return low
    unit = 10.0 ** _digits(span)
    return math.floor(low * unit) / unit


def _digits(span: float) -> int:
    """Decimals of a number that is given to a tenth of the span's size."""
    return 1 - math.floor(math.log10(span))


def identifier(name: str) -> str:
    """A column's name as a Python variable."""
    made = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "column"
    taken = keyword.iskeyword(made) or made in _TAKEN
    return f"column_{made}" if taken or not made.isidentifier() else made


def drivers_of(points: Points, sinkage: Array) -> tuple[list[Driver], list[str]]:
    """List the drivers that vary over these points, and sentences on why other settings are not drivers.

    A setting with two values is a driver: its influence must not be attributed to another one, though
    no law of it can be learnt.

    Parameters
    ----------
    points
        The points of the fit.
    sinkage
        Sinkage predicted by the model without the law, m, shape (points,).
    """
    used, found = np.unique(points.row), []
    usable = independent(points)
    units = {**points.measurements.units, **SIZES}
    possible = []
    for name in dict.fromkeys(n for n in (*SIZES, *usable) if n in usable):
        # Its name is quoted in the code: it may have any character.
        code = f"conditions.{name}" if name in SIZES else f"conditions[{json.dumps(name)}]"
        possible.append(Driver(name, (name,), identifier(name), code, units.get(name) or "1"))
    compounds = (*_COMPOUNDS, _froude(points.conditions))
    possible += [compound for compound in compounds if _says_more(compound, usable)]
    if "resistance" in points.channels:
        possible.append(_DEPTH)
    for driver in possible:
        x = driver.values(points.conditions, sinkage)[used]
        if np.ptp(x) >= 1e-3 * np.abs(x).max() > 0.0:
            found.append(driver.measured_at(x))
    return found, [f"{n} follows other settings" for n in points.varied if n not in usable]


def _says_more(compound: Driver, usable: Mapping[str, Array]) -> bool:
    """Whether a compound can be a driver: its columns are usable, and one has three levels or more.

    Two columns of two values each make a compound of four, but no more evidence than two differences.
    """
    columns = {*compound.columns, "diameter"}  # each is of the diameter
    graded = [c for c in columns & usable.keys() if _levels(usable[c]) >= FEWEST_LEVELS]
    return columns <= usable.keys() and bool(graded)


def _levels(x: Array) -> int:
    """Number of different values, within `_LEVEL` of the range."""
    return int(np.unique(np.round((x - x.min()) / max(float(np.ptp(x)), 1e-300) / _LEVEL)).size)


@dataclass(frozen=True)
class Term:
    """A product of shapes, one for each driver; without drivers it is the constant 1.

    Attributes
    ----------
    factors
        Each driver with its shape; at most one shape has a free constant.
    constant
        Starting value of the free constant c, in its driver's unit; 1 without one.
    bounds
        Lowest and highest value of c.
    cost
        Length of its description in nats, apart from the place where it acts.
    """

    factors: tuple[tuple[Driver, Shape], ...]
    constant: float = 1.0
    bounds: tuple[float, float] = (0.0, 0.0)
    cost: float = 0.0

    @property
    def free(self) -> bool:
        """Whether its constant is fitted."""
        return any(shape.constant == "free" for _, shape in self.factors)

    @property
    def alone(self) -> bool:
        """Whether it is a law by itself, and never in a sum with another term."""
        return any(shape.alone for _, shape in self.factors)

    @property
    def side(self) -> int:
        """On which side of its one driver's zero it acts; 0: on both, or with several drivers."""
        single = len(self.factors) == 1 and not self.factors[0][0].reference
        return self.factors[0][1].side if single else 0

    @cached_property
    def drivers(self) -> frozenset[str]:
        """Names of its drivers."""
        return frozenset(driver.name for driver, _ in self.factors)

    @cached_property
    def kind(self) -> tuple[tuple[str, str], ...]:
        """Identifies the term regardless of its constant."""
        return tuple((driver.name, shape.name) for driver, shape in self.factors)

    @property
    def numbers(self) -> int:
        """Number of its parameters: its strength, and those of its shapes."""
        return 1 + self.free + sum(shape.written for _, shape in self.factors)

    @property
    def of_depth(self) -> bool:
        """Whether it depends on the sinkage itself, which only a law of the resistance may do."""
        return DEPTH in self.drivers

    def of(self, values: Callable[[Driver], Array], constant: ArrayLike | None = None) -> Any:
        """Compute the term for given values of the drivers: an array of their shape, or 1.0 without drivers.

        Parameters
        ----------
        values
            Returns the values of a driver minus its reference, SI.
        constant
            The free constant c, in its driver's unit; None: `self.constant`.
        """
        if not self.factors:
            return 1.0
        c = self.constant if constant is None else constant
        names = {driver.name: f"x{i}" for i, (driver, _) in enumerate(self.factors)}
        known = {names[driver.name]: values(driver) for driver, _ in self.factors}
        code = _compiled(self.python("c", names))
        return eval(code, {"np": np, "continued": continued, "c": c, **known})

    def at(self, conditions: Conditions, sinkage: Array) -> Array:
        """Compute the term at each row of the conditions, with its own constant, shape (rows,).

        Parameters
        ----------
        conditions
            Settings of the rows, SI units.
        sinkage
            Sinkage, m, shape (rows,), for the driver sinkage/diameter.
        """
        value = self.of(lambda driver: driver.values(conditions, sinkage))
        return np.broadcast_to(value, len(conditions))

    def python(self, constant: str, variables: Mapping[str, str]) -> str:
        """The term as a Python expression, continued along its tangent beyond the measured range.

        Parameters
        ----------
        constant
            Python for the free constant c: a name or a number.
        variables
            Python names of the drivers' values, by the name of the driver.
        """
        made = []
        for driver, shape in self.factors:
            held = constant if shape.constant == "free" else repr(driver.middle)
            code = re.sub(r"\bc\b", held, shape.code)
            u = variables[driver.name]
            made.append(f"continued(lambda u: {code}, {u}, {driver.low!r}, {driver.high!r})")
        if not made:
            return "np.ones(len(conditions))"
        return made[0] if len(made) == 1 else f"({' * '.join(made)})"

    def text(self, constant: float | None) -> str:
        """The term in a formula that is shown. constant: the free constant c; None for a term without one."""
        parts = []
        for driver, shape in self.factors:
            c = constant if shape.constant == "free" else driver.middle
            u, shown = driver.text, f"{c:.3g}"
            if driver.reference and ("u - c" in shape.code or "c - u" in shape.code):
                # (x - reference) - c reads better as x - (reference + c)
                u, shown = driver.name, driver.place(c or 0.0)
            parts.append(shape.text.format(u=u, c=shown))
        return " ".join(parts).replace("- -", "+ ")


def terms_of(drivers: Sequence[Driver], settings: int) -> list[Term]:
    """List the terms that the grammar allows: the constant, then every term of these drivers.

    A term with a constant of shape is listed once for each value of its grid. Products are formed only of
    drivers with at least `FEWEST_LEVELS` levels that share no column.

    Parameters
    ----------
    drivers
        Drivers that vary over the points.
    settings
        Number of settings that were measured: products of two drivers are listed from 14 on. It also sets
        the cost of each number of a term, 1/2 ln(settings).
    """
    single = [term for driver in drivers for term in _single(driver)]
    pairs: list[Term] = []
    graded = [driver for driver in drivers if driver.levels >= FEWEST_LEVELS]
    if settings >= _FEWEST_FOR_PRODUCTS:
        for one, other in itertools.combinations(graded, 2):
            if not set(one.columns) & set(other.columns):
                pairs += _products(one, other)
    constant = 0.5 * np.log(settings)
    listed = [Term((), cost=constant)]
    for group in (single, pairs):
        forms = np.log(max(len({term.kind for term in group}), 1))
        listed += [replace(t, cost=forms + constant * t.numbers) for t in group]
    return listed


def _plain(driver: Driver) -> list[Shape]:
    """Shapes without a fitted constant; only the linear one for a driver of two values, which fits both."""
    if driver.levels < FEWEST_LEVELS:
        return [LINEAR]
    if driver.low < 0.0:
        return [LINEAR, SQUARE, SIZE, POSITIVE, NEGATIVE]
    away = driver.low > 1e-3 * driver.high and not driver.reference
    more = [LOGARITHM, INVERSE] if away else []
    return [LINEAR, SQUARE, ROOT, *more]


def _single(driver: Driver) -> Iterator[Term]:
    for shape in _plain(driver):
        yield Term(((driver, shape),))
    if driver.levels < _CURVED:
        return
    low, high, span = driver.low, driver.high, driver.span

    def made(shape: Shape, constants: Sequence[float], bounds: tuple[float, float]) -> list[Term]:
        """A term of the shape for each constant, with these bounds of it."""
        return [Term(((driver, shape),), float(c), bounds) for c in constants]

    # A kink stays where there are settings on either side: at an edge it would fit a single one.
    inner = sorted(set(driver.quantiles))
    if inner[0] < inner[-1]:
        for shape in (HINGE, FALLING_HINGE, step(_STEP * span)):
            yield from made(shape, inner, (inner[0], inner[-1]))
    optima = np.linspace(low - 0.1 * span, high + 0.1 * span, 9)
    yield from made(OPTIMUM, optima.tolist(), (low - 0.3 * span, high + 0.3 * span))
    scales = [q * span for q in _SCALES]
    for shape in (SATURATION, DECAY, LOG_GROWTH):
        yield from made(shape, scales, (0.03 * span, 3.0 * span))
    if low < 0.0 < high and not driver.reference:  # of a slip that drives and brakes
        yield Term(((driver, POSITIVE_SQUARE),))
        yield Term(((driver, NEGATIVE_SQUARE),))
        for shape in (POSITIVE_SATURATION, NEGATIVE_SATURATION):
            yield from made(shape, scales, (0.03 * span, 3.0 * span))
    yield from made(GROWTH, scales[1:4], (0.12 * span, 5.0 * span))
    for period in (_PERIODS * span).tolist():
        if period * driver.levels >= _A_WAVE * span:
            starts = low + _PHASES * period
            bounds = (low - 0.5 * period, low + period)
            yield from made(wave(period), starts.tolist(), bounds)


def _products(one: Driver, other: Driver) -> Iterator[Term]:
    for first, second in itertools.product(_plain(one), _plain(other)):
        yield Term(((one, first), (other, second)))
    for a, b in ((one, other), (other, one)):
        inner = (0.25, 0.5, 0.75) if not a.reference else (-0.5, 0.25, 0.5, 0.75, 1.5)
        curved = LOGARITHM if LOGARITHM in _plain(b) else SQUARE
        bounds = (a.low - a.span, a.high + a.span)
        for share, shape in itertools.product(inner, (LINEAR, curved)):
            yield Term(((a, OFFSET), (b, shape)), a.low + share * a.span, bounds)
