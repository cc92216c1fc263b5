# SPDX-License-Identifier: Apache-2.0
"""From the mobility margin and its uncertainty to a cost of 0 .. 100: the risk of getting stuck.

The margin is drawbar pull over load at the reference slip: the tangent of the slope that is held.

    cost = 100 * P(margin < required margin), rounded; margin normally distributed

So a cost of 30 is ground of which three in ten places hold the vehicle back. It falls with the margin
and rises with what is not known of it, up to 50 for ground that is expected to be passable: a planner
that avoids cost is wary of soil that has hardly been measured. 100, which planners take for lethal,
is for places that certainly cannot be crossed (a risk of 99.5 % and more, or a wheel that got stuck
there): uncertainty alone does not make an obstacle.

What the wheels have found on each terrain class, spread over all cells of that class.

A place of a class that has not been crossed is taken for one more draw from the places that have
been: mean of their margins, and variance

    of the soil's estimate, mean over the places           (all of them share that error)
  + scatter^2 (1 + 1/N)                                    N: places crossed
    scatter^2 = (2 class_scatter^2 + sum of squared deviations from the mean) / (N + 1)

the posterior of a normal spread whose prior is worth two places. So a class touched once costs more
than one that has been crossed at length, and one never crossed is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from smallwheel_ros.common.parameter import Parameter, out_of_range
from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError, Grid
from smallwheel_ros.physics.wheel import Quantity

_EXACT = 1e-9  # standard deviation of a margin that is told as exact
_CLASSES = 128  # int8 from 0 on; below is "not classified"
_PRIOR_PLACES = 2.0
NOTHING_HELD = Quantity(-1.0, 0.0)  # of a wheel that is stuck: its own load holds it back


@dataclass(frozen=True)
class CostRules:
    """How a margin becomes a cost. Raises CostMapError where a number is outside its range."""

    required_margin: float = Parameter(0.0, "1", -1.0, 2.0, "cost.required_margin").means(
        "Mobility margin that the vehicle needs everywhere beyond that (see cost.slope): tangent of the"
        " slopes that it has to climb."
        " Cost is the risk, in per cent, that the ground does not give it (docs/nav2.md)."
    )
    class_scatter: float = Parameter(0.05, "1", 0.0, 10.0, "cost.class_scatter").means(
        "Standard deviation of the margin between places of one terrain class, until enough of them"
        " have been crossed to tell."
    )

    def __post_init__(self) -> None:
        """Check every number."""
        wrong = out_of_range(self)
        if wrong:
            raise CostMapError(wrong)

    def cost(self, margin: ArrayLike, deviation: ArrayLike) -> Cells:
        """Cost of each margin (1) with its standard deviation; -1 where either is not a number."""
        mean = np.asarray(margin, dtype=np.float64)
        spread = np.maximum(np.asarray(deviation, dtype=np.float64), _EXACT)
        with np.errstate(invalid="ignore", over="ignore"):
            risk = ndtr((self.required_margin - mean) / spread)
        known = ~np.isnan(risk)
        cost = np.rint(HIGHEST * np.where(known, risk, 0.0))
        return np.where(known, cost, UNKNOWN).astype(np.int8)


@dataclass
class _Class:
    places: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared deviations from the mean
    variance: float = 0.0  # mean of the estimate's own
    stuck: int = 0  # places of those where no vehicle moves on

    def add(self, margin: Quantity) -> None:
        self.places += 1
        step = margin.value - self.mean
        self.mean += step / self.places
        self.squares += step * (margin.value - self.mean)
        self.variance += (margin.standard_deviation**2 - self.variance) / self.places


class TerrainClasses:
    """Margins by terrain class, and the costs that follow from them.

    apart: places of one wheel nearer than this (m) count once.
    """

    def __init__(self, rules: CostRules, apart: float) -> None:
        self.rules = rules
        self._apart = apart
        self._classes: dict[int, _Class] = {}
        self._last: dict[str, tuple[int, float, float]] = {}

    def clear(self) -> None:
        """Forget what was found."""
        self._classes.clear()
        self._last.clear()

    def learn(self, wheel: str, x: float, y: float, terrain: int, margin: Quantity) -> bool:
        """Take a wheel's margin at a place (m) of a class; return whether it counted."""
        if terrain < 0:
            return False
        last = self._last.get(wheel)
        if (
            last is not None
            and last[0] == terrain
            and math.hypot(x - last[1], y - last[2]) < self._apart
        ):
            return False
        self._last[wheel] = (terrain, x, y)
        known = self._classes.setdefault(terrain, _Class())
        known.add(margin)
        known.stuck += margin == NOTHING_HELD
        return True

    def contradictions(self) -> list[str]:
        """Say of each class on which the vehicle was stuck and more often was not, that it is both."""
        return [
            f"terrain class {terrain} is both: stuck at {known.stuck} of {known.places} places: the"
            " classifier does not tell them apart, and its cost is that of the mean with their scatter"
            for terrain, known in sorted(self._classes.items())
            if 0 < known.stuck < 0.5 * known.places
        ]

    def margin(self, terrain: int) -> Quantity | None:
        """What to expect at a new place of a class; None where no wheel has been on it."""
        known = self._classes.get(terrain)
        if known is None:
            return None
        scatter = (_PRIOR_PLACES * self.rules.class_scatter**2 + known.squares) / (
            known.places + _PRIOR_PLACES - 1.0
        )
        variance = known.variance + scatter * (1.0 + 1.0 / known.places)
        return Quantity(known.mean, math.sqrt(variance))

    def places(self) -> dict[int, int]:
        """How many places of each class have been crossed."""
        return {terrain: known.places for terrain, known in sorted(self._classes.items())}

    def table(self) -> Cells:
        """Cost of each class number, shape (256,), by the byte that an int8 is."""
        table: Cells = np.full(256, UNKNOWN, dtype=np.int8)
        for terrain in self._classes:
            margin = self.margin(terrain)
            assert margin is not None
            if terrain < _CLASSES:
                table[terrain] = self.rules.cost(margin.value, margin.standard_deviation)
        return table

    def costs(self, classes: Grid) -> Grid:
        """Turn a grid of class numbers into one of costs."""
        cells = np.take(self.table(), np.ascontiguousarray(classes.cells).view(np.uint8))
        return Grid(classes.frame, classes.resolution, classes.origin, cells)
