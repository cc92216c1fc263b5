# SPDX-License-Identifier: Apache-2.0
"""The grammar of laws: terms of one driver or of two, and what each costs to describe.

A term has a strength, which enters linearly, and at most one constant of shape, which is tried on a
grid and freed once the term is chosen.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.effects.drafted import continued
from smallwheel_ros.learn import shapes
from smallwheel_ros.learn.drivers import DEPTH, FEWEST_LEVELS, Driver
from smallwheel_ros.learn.shapes import Shape
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

FEWEST_FOR_PRODUCTS = 14  # settings from which laws of two drivers are tried
_CURVED = 4  # levels of a driver from which a shape with a constant is tried
_SCALES = (0.1, 0.2, 0.35, 0.6, 1.0)  # of a driver's span
# Of a driver's span; neighbours are an eighth apart. Of a longer one no whole wave was seen: that is a bend.
_PERIODS = np.geomspace(0.2, 1.0, 15)
_A_WAVE = 4  # levels of a driver to a period: fewer do not show one
_PHASES = np.arange(6) / 12  # of a period: over half of one, since a strength has either sign
_STEP = 0.03  # of a driver's span: width of a step


@dataclass(frozen=True)
class Term:
    """A product of shapes, one for each driver; none is the constant 1.

    constant: c of the shape in which it is free, else 1. bounds: of that c. cost: nats that it takes
    to describe, without its place.
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
        """Whether it is a law by itself, and in no sum with another."""
        return any(shape.alone for _, shape in self.factors)

    @property
    def side(self) -> int:
        """On which side of its one driver's zero it acts; 0: on both, or of several drivers."""
        single = len(self.factors) == 1 and not self.factors[0][0].reference
        return self.factors[0][1].side if single else 0

    @cached_property
    def drivers(self) -> frozenset[str]:
        """Names of its drivers."""
        return frozenset(driver.name for driver, _ in self.factors)

    @cached_property
    def kind(self) -> tuple[tuple[str, str], ...]:
        """What tells it from others, whatever its constant."""
        return tuple((driver.name, shape.name) for driver, shape in self.factors)

    @property
    def numbers(self) -> int:
        """How many numbers it takes to describe: its strength, and those of its shapes."""
        return 1 + self.free + sum(shape.written for _, shape in self.factors)

    @property
    def of_depth(self) -> bool:
        """Whether it follows the sinkage itself: only the resistance, which comes after, can."""
        return DEPTH in self.drivers

    def of(self, values: Callable[[Driver], Array], constant: ArrayLike | None = None) -> Any:
        """Its value where each driver has these values. constant: c, its own where None."""
        value: Any = 1.0
        c = self.constant if constant is None else constant
        for driver, shape in self.factors:
            held = driver.middle if shape.constant == "given" else c
            value = value * continued(
                partial(shape, c=held), values(driver), driver.low, driver.high
            )
        return value

    def at(self, conditions: Conditions, sinkage: Array) -> Array:
        """Its value at each row, shape (rows,). sinkage: m."""
        value = self.of(lambda driver: driver.values(conditions, sinkage))
        return np.broadcast_to(value, len(conditions))

    def python(self, constant: str, variables: Mapping[str, str]) -> str:
        """It as Python. constant: its c; variables: names of its drivers' values there."""
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
        """It in a formula for people."""
        parts = []
        for driver, shape in self.factors:
            c = constant if shape.constant == "free" else driver.middle
            if shape.moved and driver.reference:
                # (x - reference) - c reads better as x - (reference + c)
                text = shape.text.format(u=driver.name, c=driver.place(c or 0.0))
            else:
                text = shape.text.format(u=driver.text, c=f"{c:.3g}")
            parts.append(text)
        return " ".join(parts).replace("- -", "+ ")


def terms_of(drivers: Sequence[Driver], settings: int) -> list[Term]:
    """Every term of these drivers. settings: how many were measured."""
    single = [term for driver in drivers for term in _single(driver)]
    pairs: list[Term] = []
    graded = [driver for driver in drivers if driver.levels >= FEWEST_LEVELS]
    if settings >= FEWEST_FOR_PRODUCTS:
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
    """Shapes without a fitted constant. Of two values one shape is as good as another."""
    if driver.levels < FEWEST_LEVELS:
        return [shapes.LINEAR]
    if driver.low < 0.0:
        return [shapes.LINEAR, shapes.SQUARE, shapes.SIZE, shapes.POSITIVE, shapes.NEGATIVE]
    away = driver.low > 1e-3 * driver.high and not driver.reference
    more = [shapes.LOGARITHM, shapes.INVERSE] if away else []
    return [shapes.LINEAR, shapes.SQUARE, shapes.ROOT, *more]


def _curved(driver: Driver) -> Shape:
    """The logarithm, where the driver stays away from zero, else the square."""
    return shapes.LOGARITHM if shapes.LOGARITHM in _plain(driver) else shapes.SQUARE


def _single(driver: Driver) -> Iterator[Term]:
    for shape in _plain(driver):
        yield Term(((driver, shape),))
    if driver.levels < _CURVED:
        return
    low, high, span = driver.low, driver.high, driver.span

    def made(shape: Shape, constants: Sequence[float], bounds: tuple[float, float]) -> list[Term]:
        return [Term(((driver, shape),), float(c), bounds) for c in constants]

    # A kink stays where there are settings on either side: at an edge it would fit a single one.
    inner = sorted(set(driver.quantiles))
    if inner[0] < inner[-1]:
        for shape in (shapes.HINGE, shapes.FALLING_HINGE, shapes.step(_STEP * span)):
            yield from made(shape, inner, (inner[0], inner[-1]))
    optima = np.linspace(low - 0.1 * span, high + 0.1 * span, 9)
    yield from made(shapes.OPTIMUM, optima.tolist(), (low - 0.3 * span, high + 0.3 * span))
    scales = [q * span for q in _SCALES]
    for shape in (shapes.SATURATION, shapes.DECAY, shapes.LOG_GROWTH):
        yield from made(shape, scales, (0.03 * span, 3.0 * span))
    if low < 0.0 < high and not driver.reference:  # of a slip that drives and brakes
        yield Term(((driver, shapes.POSITIVE_SQUARE),))
        yield Term(((driver, shapes.NEGATIVE_SQUARE),))
        for shape in (shapes.POSITIVE_SATURATION, shapes.NEGATIVE_SATURATION):
            yield from made(shape, scales, (0.03 * span, 3.0 * span))
    yield from made(shapes.GROWTH, scales[1:4], (0.12 * span, 5.0 * span))
    for period in (_PERIODS * span).tolist():
        if period * driver.levels >= _A_WAVE * span:
            starts = low + _PHASES * period
            bounds = (low - 0.5 * period, low + period)
            yield from made(shapes.wave(period), starts.tolist(), bounds)


def _products(one: Driver, other: Driver) -> Iterator[Term]:
    for first, second in itertools.product(_plain(one), _plain(other)):
        yield Term(((one, first), (other, second)))
    for a, b in ((one, other), (other, one)):
        inner = (0.25, 0.5, 0.75) if not a.reference else (-0.5, 0.25, 0.5, 0.75, 1.5)
        for share in inner:
            for shape in (shapes.LINEAR, _curved(b)):
                yield Term(
                    ((a, shapes.OFFSET), (b, shape)), a.low + share * a.span,
                    (a.low - a.span, a.high + a.span),
                )  # fmt: skip
