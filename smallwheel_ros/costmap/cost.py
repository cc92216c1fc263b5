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

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from smallwheel_ros.common.parameter import Parameter, out_of_range
from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError

_EXACT = 1e-9  # standard deviation of a margin that is told as exact


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
