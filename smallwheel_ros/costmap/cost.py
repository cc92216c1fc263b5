# SPDX-License-Identifier: Apache-2.0
"""From the mobility margin and its uncertainty to a cost of 0 .. 100: the risk of getting stuck, in per cent.

The margin is drawbar pull over load at the reference slip: the tangent of the steepest slope that the
vehicle can climb at that slip. A vehicle that slips more is not stuck yet: the pull over load still rises, by
`beyond`, up to the slip at which the vehicle makes no way, where the map has 100.

    cost = 100 P(margin + beyond - slope < required margin), rounded; both sides normally distributed

A cost of 30 thus is ground of which three in ten places stop the vehicle. It falls with the margin
and rises with its uncertainty, up to 50 for ground that is expected to be passable.

Ground that the vehicle crossed has shown that it gives at least what it required there. The
distribution of the margin is cut off below that (`shown`), so that crossing a metre lowers its own cost:

    cost = 100 P(margin + beyond - slope < required margin | margin + beyond > shown)

100, which planners take for lethal, is used only where the vehicle was seen to make no way.
Expectations, of ground ahead or of ground crossed, cost 99 at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from smallwheel_ros.common.node_parameter import parameter
from smallwheel_ros.costmap.crossed_ground import side_of
from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError

Array = NDArray[np.float64]
Numbers = NDArray[np.floating[Any]]

PASSABLE = HIGHEST - 1  # highest cost of an expectation
STEEPEST = 2.0  # tangent of a slope: no wheel holds on 63 degrees of any soil
_EXACT = 1e-9  # standard deviation of a margin that is given as exact


def falls_short(
    margin: Numbers | float, deviation: Numbers | float, required: float | Numbers
) -> Numbers:
    """Probability that ground does not give the required pull at any slip; NaN where an argument is.

    Parameters
    ----------
    margin, deviation
        Largest pull over load that the ground gives at any slip (1), and its standard deviation; both of one
        shape, whatever it is. Single precision is kept.
    required
        Pull over load that is required, 1; a number, or an array of that shape.

    Returns
    -------
    ndarray
        Probability, 0 to 1, of the same shape.
    """
    return np.asarray(ndtr((required - np.asarray(margin)) / np.maximum(deviation, _EXACT)))


@dataclass(frozen=True)
class CostRules:
    """The rules by which a margin becomes a cost.

    Attributes
    ----------
    required_margin
        Margin needed beyond the slope of the ground, 1: tangent of a further slope, -2 to 2.

    Raises
    ------
    CostMapError
        If it is outside this range.
    """

    required_margin: float = 0.0

    def __post_init__(self) -> None:
        """Check the number."""
        if not abs(self.required_margin) <= STEEPEST:
            raise CostMapError(
                f"required_margin is {self.required_margin!r}, expected -{STEEPEST:g} to {STEEPEST:g}"
            )

    def cost(self, margin: float, deviation: float, shown: float = -math.inf) -> int:
        """Cost of a margin: the probability that it is below the required one, in per cent.

        Parameters
        ----------
        margin
            Largest pull over load that the ground gives at any slip, minus the slope, 1.
        deviation
            Standard deviation of the margin, 1.
        shown
            Pull over load that the ground was seen to give when it was crossed, minus the slope, 1: a lower
            limit of the margin. Minus infinity if it was not crossed.

        Returns
        -------
        int
            0 to 100; -1 where margin or deviation is NaN, or both are infinite.
        """
        spread = max(deviation, _EXACT)
        if math.isnan(margin / spread) or math.isnan(deviation):
            return UNKNOWN
        if shown == -math.inf:
            return round(HIGHEST * float(falls_short(margin, deviation, self.required_margin)))
        if shown >= self.required_margin:
            return 0
        # By logarithms, since the lower limit may be many deviations above the margin believed.
        enough, more = ((margin - least) / spread for least in (self.required_margin, shown))
        return round(-HIGHEST * math.expm1(float(log_ndtr(enough)) - float(log_ndtr(more))))

    def expected(self, margin: Numbers | float, deviation: Numbers | float) -> Cells:
        """Costs of ground that was not crossed.

        Parameters
        ----------
        margin, deviation
            Largest pull over load at any slip, minus the slope, and its standard deviation, 1; both of one
            shape, whatever it is.

        Returns
        -------
        ndarray
            int8 of that shape, 0 to 99; -1 where a number is NaN.
        """
        costs = np.minimum(
            np.rint(HIGHEST * falls_short(margin, deviation, self.required_margin)), PASSABLE
        )
        return np.where(np.isnan(costs), UNKNOWN, costs).astype(np.int8)


@dataclass(frozen=True, kw_only=True)
class CostSettings:
    """cost.*: the cost map's window and rules. Raises CostMapError for an impossible window."""

    resolution: float = parameter(
        0.1, "m", (0.01, 10.0), "Side of a cell of ~/cost and ~/cost_bare."
    )
    size: float = parameter(
        40.0,
        "m",
        (1.0, 2000.0),
        "Side of the window of crossed ground around the vehicle; at most 4 million cells.",
    )
    spread: float | None = parameter(
        None,
        "m",
        (0.0, 10.0),
        "Each cell of ~/cost takes the highest cost within this distance, for every planner (docs/nav2.md)."
        " Without it: from base_link to the wheels' outermost corner, and half a cell's diagonal.",
    )
    unknown: Literal["prior", "none"] = parameter(
        "prior",
        text="Cost of a terrain class that nothing is known of: that of any ground, or none (-1).",
    )
    required_margin: float = parameter(
        0.0, "1", (-1.0, 2.0),
        "Margin needed beyond the slope measured at a place. Cost: the risk, in per cent, that the ground"
        " does not give it at any slip.",
    )  # fmt: skip
    free_below: float | None = parameter(
        None,
        "1",
        (0.0, 99.0),
        "Crossed ground that costs up to this counts as free (0), like ground that nobody has seen. Without"
        " it: what any ground costs before driving, on a slope of 5 degrees.",
    )

    @property
    def rules(self) -> CostRules:
        """The rules by which a margin becomes a cost."""
        return CostRules(self.required_margin)

    def __post_init__(self) -> None:
        """Check how many cells there would be."""
        side_of(self.size, self.resolution)
