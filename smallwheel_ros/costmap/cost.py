# SPDX-License-Identifier: Apache-2.0
"""From the mobility margin and its uncertainty to a cost of 0 .. 100: the risk of getting stuck, in per cent.

The margin is drawbar pull over load at the reference slip: the tangent of the slope that is held.

    cost = 100 P(margin - slope < required margin), rounded; margin and slope normally distributed

So a cost of 30 is ground of which three in ten places hold the vehicle back. It falls with the margin and
rises with what is not known of it, up to 50 for ground that is expected to be passable.

Ground that the vehicle got over has shown that it gives at least what was asked for there. Of what was
believed only that part is left, so that a metre that was crossed lowers its own cost:

    cost = 100 P(margin - slope < required margin | margin > what was asked for)

100, which planners take for lethal, is for places where the vehicle was seen to make no way. Whatever is
expected, of ground ahead or of ground that was crossed, costs 99 at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from smallwheel_ros.costmap.crossed_ground import side_of
from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError

Array = NDArray[np.float64]

PASSABLE = HIGHEST - 1  # the most that what is expected costs
STEEPEST = 2.0  # tangent of a slope: no wheel holds on 63 degrees of any soil
_EXACT = 1e-9  # standard deviation of a margin that is given as exact


@dataclass(frozen=True)
class CostRules:
    """How a margin becomes a cost.

    required_margin: tangent of the slopes that the vehicle has to climb beyond those it has met. Raises
    CostMapError where that is no such tangent.
    """

    required_margin: float = 0.0

    def __post_init__(self) -> None:
        """Check the number."""
        if not abs(self.required_margin) <= STEEPEST:
            raise CostMapError(
                f"required_margin is {self.required_margin!r}, expected -{STEEPEST:g} to {STEEPEST:g}"
            )

    def cost(self, margin: float, deviation: float, shown: float = -math.inf) -> int:
        """Cost of what a margin leaves beyond a slope (1), with its standard deviation.

        shown: what the ground there has given beyond that slope already. -1 where margin or deviation is not
        a number.
        """
        spread = max(deviation, _EXACT)
        if math.isnan(margin) or math.isnan(deviation):
            return UNKNOWN
        if shown == -math.inf:
            return round(HIGHEST * float(ndtr((self.required_margin - margin) / spread)))
        if shown >= self.required_margin:
            return 0
        # Of the logarithms, since what was shown may be far more than what was believed.
        enough, more = ((margin - least) / spread for least in (self.required_margin, shown))
        return round(-HIGHEST * math.expm1(float(log_ndtr(enough)) - float(log_ndtr(more))))

    def expected(self, margin: Array | float, deviation: Array | float) -> Cells:
        """Costs of ground that was not crossed, of any shape: 99 at most, -1 where a number is missing."""
        left = (np.asarray(margin) - self.required_margin) / np.maximum(deviation, _EXACT)
        costs = np.minimum(np.rint(HIGHEST * ndtr(-left)), PASSABLE)
        return np.where(np.isnan(costs), UNKNOWN, costs).astype(np.int8)


@dataclass(frozen=True)
class CostSettings:
    """What the cost map is to be: `cost.*` of the parameters.

    Attributes
    ----------
    resolution, size
        Sides of a cell and of the window of crossed ground, m.
    spread
        How far costs are spread in the grid for planners that check a point, m; None: to the wheels'
        outermost corner.
    unknown
        What ground costs of a terrain class that nothing is known of: as any ground, or nothing (-1).
    free_below
        Crossed ground that costs no more than this counts as free, 0; None: what any ground costs before
        driving on a slope of 5 degrees, since ground that nobody has seen is free to planners, and no
        leveller than that which was crossed.
    names
        Of terrain classes, by number; empty: without a name.
    reference_slip
        At which margins are worked out, 1.

    Raises CostMapError where there can be no such window, or no such cost.
    """

    resolution: float = 0.1
    size: float = 40.0
    spread: float | None = None
    unknown: Literal["prior", "none"] = "prior"
    rules: CostRules = field(default_factory=CostRules)
    free_below: float | None = None
    names: tuple[str, ...] = ()
    reference_slip: float = 0.4

    def __post_init__(self) -> None:
        """Check how many cells there would be, and the cost."""
        side_of(self.size, self.resolution)
        if self.free_below is not None and not 0.0 <= self.free_below <= PASSABLE:
            raise CostMapError(f"free_below is {self.free_below!r}, expected 0 to {PASSABLE}")
