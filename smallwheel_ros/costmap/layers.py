# SPDX-License-Identifier: Apache-2.0
"""What is done to whole grids: one laid over another, and costs spread."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from smallwheel_ros.costmap.grid import UNKNOWN, Cells, Grid, check_count
from smallwheel_ros.costmap.vehicle import HERE, Pose


def lay_over(costs: Grid, above: Grid, pose: Pose = HERE) -> None:
    """Write the known cells of a grid into another one: of several in one cell, the dearest.

    pose: of the upper grid's frame in that of the lower one.
    """
    # The dearest last: of several that are written to one cell, the last one stays.
    known = np.flatnonzero(above.cells >= 0)
    known = known[np.argsort(above.cells.ravel()[known], kind="stable")]
    rows, columns = np.divmod(known, above.cells.shape[1])
    # Where its cells are the coarser ones, or turned, each covers several: look at their parts.
    scale = above.resolution / costs.resolution * (1.0 if pose.heading == 0.0 else math.sqrt(2.0))
    count = math.ceil(scale - 1e-9)
    parts = (np.arange(count) + 0.5) / count
    along = above.origin[0] + above.resolution * (columns[:, None, None] + parts)
    across = above.origin[1] + above.resolution * (rows[:, None, None] + parts[:, None])
    cosine, sine = math.cos(pose.heading), math.sin(pose.heading)
    x = (pose.x + cosine * along - sine * across - costs.origin[0]) / costs.resolution
    y = (pose.y + sine * along + cosine * across - costs.origin[1]) / costs.resolution
    at_row, at_column = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
    inside = (at_row >= 0) & (at_row < costs.cells.shape[0])
    inside &= (at_column >= 0) & (at_column < costs.cells.shape[1])
    cost = np.broadcast_to(above.cells[rows, columns][:, None, None], at_row.shape)
    costs.cells[at_row[inside], at_column[inside]] = cost[inside]


def union(frame: str, layers: Sequence[tuple[Grid, Pose]]) -> Grid:
    """Lay grids over each other, the last on top, each with its frame's pose in the common one."""
    side = min(grid.resolution for grid, _ in layers)
    corners = np.array(
        [
            pose.place(grid.origin[0] + across, grid.origin[1] + along)
            for grid, pose in layers
            for across in (0.0, grid.cells.shape[1] * grid.resolution)
            for along in (0.0, grid.cells.shape[0] * grid.resolution)
        ]
    )
    low = np.floor(corners.min(axis=0) / side + 1e-6)
    columns, rows = (np.ceil(corners.max(axis=0) / side - 1e-6) - low).astype(int)
    check_count(rows * columns)
    cells: Cells = np.full((rows, columns), UNKNOWN, dtype=np.int8)
    whole = Grid(frame, side, (float(low[0]) * side, float(low[1]) * side), cells)
    for grid, pose in layers:
        lay_over(whole, grid, pose)
    return whole


def wide(grid: Grid, reach: float) -> Grid:
    """Return a grid that costs are spread in by so many m, with as much ground more around it."""
    more = math.ceil(reach / grid.resolution)
    cells = np.pad(grid.cells, more, constant_values=UNKNOWN)
    origin = (grid.origin[0] - more * grid.resolution, grid.origin[1] - more * grid.resolution)
    return Grid(grid.frame, grid.resolution, origin, spread(cells, reach / grid.resolution))


def spread(cells: Cells, reach: float) -> Cells:
    """Give each cell the dearest cost within so many cells, middle to middle; unknown ones cost nothing."""
    whole: Cells = cells.copy()
    known = cells >= 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    steps = math.floor(reach)
    if steps < 1 or rows.size == 0:
        return whole
    # Only where something is known, and so far around it.
    top, left = max(rows[0] - steps, 0), max(columns[0] - steps, 0)
    part = whole[top : rows[-1] + steps + 1, left : columns[-1] + steps + 1]
    padded = np.pad(part, steps, constant_values=UNKNOWN)
    height, width = part.shape
    # Row by row of the disc, from its narrow end to its middle: the dearest of a wider and wider run.
    run: Cells = padded[:, steps : steps + width].copy()
    reached = 0
    for down in range(steps, -1, -1):
        for aside in range(reached + 1, math.floor(math.sqrt(reach**2 - down**2)) + 1):
            np.maximum(run, padded[:, steps + aside : steps + aside + width], out=run)
            np.maximum(run, padded[:, steps - aside : steps - aside + width], out=run)
            reached = aside
        np.maximum(part, run[steps + down : steps + down + height], out=part)
        np.maximum(part, run[steps - down : steps - down + height], out=part)
    return whole
