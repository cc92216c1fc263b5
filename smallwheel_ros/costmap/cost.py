"""From the mobility margin and its uncertainty to a cost of 0 .. 100.

The margin is drawbar pull over load at the reference slip: the tangent of the slope that is held.

    pessimistic margin = margin - z * standard deviation      z: normal quantile of `confidence`
    cost = 99 * (easy_margin - pessimistic margin) / (easy_margin - hard_margin),
           rounded up, within 0 .. 99
    cost = 100 where the margin itself is 0 or less

So cost falls with the margin and rises with its uncertainty. 100, which planners take for lethal,
needs a vehicle that more likely than not cannot move on level ground; uncertainty alone stops at 99,
the most that can still be planned through: a robot on soil that it has hardly measured must not find
itself inside an obstacle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError

WORST_PASSABLE = HIGHEST - 1


@dataclass(frozen=True)
class CostRules:
    """How a margin becomes a cost.

    Attributes
    ----------
    easy_margin, hard_margin
        Pessimistic margins from which on ground costs nothing, and up to which it costs 99; 1. The
        second may be negative, as pessimistic margins are where a soil's strength is not known well.
    confidence
        Share of cases in which the margin is at least the pessimistic one, 0.5 .. 1.
    class_scatter
        Standard deviation of the margin between places of one terrain class, as long as too few of
        them have been crossed to tell, 1.

    Raises CostMapError where a number is outside its domain.
    """

    easy_margin: float = 0.1
    hard_margin: float = -0.1
    confidence: float = 0.95
    class_scatter: float = 0.05

    def __post_init__(self) -> None:
        """Check every number."""
        for name, low, high in (
            ("easy_margin", 1e-3, 10.0),
            ("hard_margin", -10.0, 10.0),
            ("confidence", 0.5, 0.9999),
            ("class_scatter", 0.0, 10.0),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise CostMapError(f"{name} is {value!r}, expected {low:g} to {high:g}")
        if self.hard_margin >= self.easy_margin:
            raise CostMapError(
                f"hard_margin is {self.hard_margin:g}, expected less than easy_margin, which is"
                f" {self.easy_margin:g}"
            )

    def cost(self, margin: ArrayLike, deviation: ArrayLike) -> Cells:
        """Cost of each margin (1) with its standard deviation; -1 where either is not a number."""
        mean = np.asarray(margin, dtype=np.float64)
        spread = np.asarray(deviation, dtype=np.float64)
        quantile = float(ndtri(self.confidence))
        with np.errstate(invalid="ignore", over="ignore"):
            pessimistic = mean - quantile * spread
            share = (self.easy_margin - pessimistic) / (self.easy_margin - self.hard_margin)
            graded = np.ceil(WORST_PASSABLE * share)
        cost = np.where(mean <= 0, HIGHEST, np.clip(graded, 0, WORST_PASSABLE))
        known = ~(np.isnan(mean) | np.isnan(spread) | np.isnan(cost))
        return np.where(known, cost, UNKNOWN).astype(np.int8)
