# SPDX-License-Identifier: Apache-2.0
"""Costs spread over their surroundings, for planners that only check the cell under base_link."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from smallwheel_ros.costmap.grid import UNKNOWN, Cells, Grid, ends

# Cells that are processed at once: the arrays for so many stay in a processor's second cache (1 to 2 MB).
_AT_ONCE = 250_000


def spread(costs: Cells, reach: float) -> Cells:
    """Give each cell the highest cost within a distance, measured between the middles of cells.

    Parameters
    ----------
    costs
        Costs, shape (rows, columns); -1 is unknown.
    reach
        Distance, in cells.

    Returns
    -------
    ndarray
        New costs of the same shape; -1 where no cell within reach is known.
    """
    whole: Cells = costs.copy()
    rows, columns = ends(costs >= 0)
    steps = math.floor(reach)
    if steps < 1 or rows.start == rows.stop:
        return whole
    # Only where something is known, and within reach around it.
    bottom, right = (
        min(one.stop + steps, n) for one, n in zip((rows, columns), costs.shape, strict=True)
    )
    aside = slice(max(columns.start - steps, 0), right)
    height = max(_AT_ONCE // (right - aside.start), 4 * steps)
    for first in range(max(rows.start - steps, 0), bottom, height):
        last, begin = min(first + height, bottom), max(first - steps, 0)
        dearest = _dearest(costs[begin : last + steps, aside], reach)
        whole[first:last, aside] = dearest[first - begin : last - begin]
    return whole


def _dearest(costs: Cells, reach: float) -> Cells:
    """The highest cost within reach of each cell."""
    height, wide, steps = *costs.shape, math.floor(reach)
    width = wide + 2 * steps
    padded: Cells = np.full((height + 2 * steps + 2, width), UNKNOWN, dtype=np.int8)
    padded[steps + 1 : -steps - 1, steps:-steps] = costs
    # All rows in one array, with unknown cells between them: a step down is a step of a row's width.
    run: Cells = padded.ravel()
    begin, size = (steps + 1) * width, height * width
    dearest, other, long = run[begin : begin + size].copy(), np.empty_like(run), 1
    # Row by row of the disc, from its narrow end to its middle: the maximum of a longer and longer run.
    for down in range(steps, -1, -1):
        aside = math.floor(math.sqrt(reach**2 - down**2))
        while long < 2 * aside + 1:
            more = min(long, 2 * aside + 1 - long)
            longer = np.maximum(run[:-more], run[more:], out=other[: run.size - more])
            run, other, long = longer, run, long + more
        for first in {begin + down * width - aside, begin - down * width - aside}:
            np.maximum(dearest, run[first : first + size], out=dearest)
    return dearest.reshape(height, width)[:, steps:-steps]


def wide(grid: Grid, reach: float) -> Grid:
    """Return a grid that is enlarged on all sides by a distance, with its costs spread over that distance.

    Parameters
    ----------
    grid
        The grid, which is not changed.
    reach
        Distance over which costs are spread, m.
    """
    more = math.ceil(reach / grid.resolution)
    cells = np.pad(grid.cells, more, constant_values=UNKNOWN)
    origin = (grid.origin[0] - more * grid.resolution, grid.origin[1] - more * grid.resolution)
    return Grid(grid.frame, grid.resolution, origin, spread(cells, reach / grid.resolution))


class Spreader:
    """Spreads the costs of one map repeatedly, recomputing only around cells that have changed.

    Parameters
    ----------
    reach
        Distance over which a cost is spread, m.
    """

    def __init__(self, reach: float) -> None:
        self.reach = reach
        self._last: tuple[Grid, Cells] | None = None  # before and after it was spread

    def spread(self, grid: Grid) -> Grid:
        """The grid with each cell at the highest cost within the reach."""
        reach, last = self.reach / grid.resolution, self._last
        if last is None or last[0].geometry != grid.geometry:
            cells = spread(grid.cells, reach)
        else:
            cells = last[1]
            _spread_changes(cells, last[0].cells, grid.cells, reach)
        self._last = replace(grid, cells=grid.cells.copy()), cells
        return replace(grid, cells=cells.copy())


def _spread_changes(result: Cells, before: Cells, costs: Cells, reach: float) -> None:
    """Update `result`, the spread of the costs `before`, in place to that of `costs`; reach in cells."""
    changed = ends(costs != before)
    if changed[0].start == changed[0].stop:
        return
    steps = math.floor(reach)
    reached = tuple(
        _wider(one, steps, size) for one, size in zip(changed, costs.shape, strict=True)
    )
    around = tuple(_wider(one, steps, size) for one, size in zip(reached, costs.shape, strict=True))
    within = tuple(
        slice(one.start - whole.start, one.stop - whole.start)
        for one, whole in zip(reached, around, strict=True)
    )
    result[reached] = spread(costs[around], reach)[within]


def _wider(part: slice, steps: int, size: int) -> slice:
    """Extend a slice by `steps` at each end, within 0 to `size`."""
    return slice(max(part.start - steps, 0), min(part.stop + steps, size))
