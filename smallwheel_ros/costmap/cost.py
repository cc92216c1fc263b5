# SPDX-License-Identifier: Apache-2.0
"""From the mobility margin and its uncertainty to a cost of 0 .. 100: the risk of getting stuck.

The margin is drawbar pull over load at the reference slip: the tangent of the slope that is held.

    cost = 100 * P(margin < required margin), rounded; margin normally distributed

So a cost of 30 is ground of which three in ten places hold the vehicle back. It falls with the margin
and rises with what is not known of it, up to 50 for ground that is expected to be passable: a planner
that avoids cost is wary of soil that has hardly been measured. 100, which planners take for lethal,
is for places that certainly cannot be crossed (a risk of 99.5 % and more, or a wheel that got stuck
there): uncertainty alone does not make an obstacle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError

_EXACT = 1e-9  # standard deviation of a margin that is told as exact


@dataclass(frozen=True)
class CostRules:
    """How a margin becomes a cost.

    Attributes
    ----------
    required_margin
        What the vehicle needs everywhere, 1: the tangent of the slopes that it has to climb.
    class_scatter
        Standard deviation of the margin between places of one terrain class, as long as too few of
        them have been crossed to tell, 1.

    Raises CostMapError where a number is outside its domain.
    """

    required_margin: float = 0.0
    class_scatter: float = 0.05

    def __post_init__(self) -> None:
        """Check every number."""
        for name, low, high in (("required_margin", -1.0, 2.0), ("class_scatter", 0.0, 10.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise CostMapError(f"{name} is {value!r}, expected {low:g} to {high:g}")

    def cost(self, margin: ArrayLike, deviation: ArrayLike) -> Cells:
        """Cost of each margin (1) with its standard deviation; -1 where either is not a number."""
        mean = np.asarray(margin, dtype=np.float64)
        spread = np.maximum(np.asarray(deviation, dtype=np.float64), _EXACT)
        with np.errstate(invalid="ignore", over="ignore"):
            risk = ndtr((self.required_margin - mean) / spread)
        known = ~np.isnan(risk)
        cost = np.rint(HIGHEST * np.where(known, risk, 0.0))
        return np.where(known, cost, UNKNOWN).astype(np.int8)
