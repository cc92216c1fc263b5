# SPDX-License-Identifier: Apache-2.0
"""A shortest path over 8 neighbours with the costs of Nav2's NavFn, by base_link or by footprint.

A cell of the grid becomes one of the costmap as KeepoutFilter has it, 0 to 254, unknown 0 (a costmap that
does not track unknown space); a step costs its length times 50 + 0.8 of that (navfn.cpp: COST_NEUTRAL,
COST_FACTOR), and 253 and more cannot be entered.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from smallwheel_ros.costmap.crossed_ground import Outline
from smallwheel_ros.costmap.grid import Grid, Pose

Array = NDArray[np.float64]
_STEPS = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)]
_LETHAL = 253.0


def plan(
    grid: Grid,
    start: tuple[float, float],
    goal: tuple[float, float],
    outline: Outline | None = None,
) -> Array | None:
    """Places (m) of the path, shape (places, 2); None where there is none.

    outline: of a planner that looks at all cells below the vehicle as it heads; None: by base_link.
    """
    costs = np.where(grid.cells < 0, 0.0, np.rint(2.54 * grid.cells))
    rows, columns = costs.shape
    numbers = np.arange(rows * columns).reshape(rows, columns)
    found: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for up, aside in _STEPS:
        below = costs if outline is None else _below(costs, grid.resolution, outline, (up, aside))
        r, c = slice(max(-up, 0), rows - max(up, 0)), slice(max(-aside, 0), columns - max(aside, 0))
        to_r, to_c = (
            slice(max(up, 0), rows - max(-up, 0)),
            slice(max(aside, 0), columns - max(-aside, 0)),
        )
        there = below[to_r, to_c]
        free = there < _LETHAL
        found[0].append(numbers[r, c][free])
        found[1].append(numbers[to_r, to_c][free])
        found[2].append(math.hypot(up, aside) * (50.0 + 0.8 * there[free]))
    edges = [np.concatenate(part) for part in found]
    graph = csr_matrix((edges[2], (edges[0], edges[1])), shape=(rows * columns,) * 2)
    begin, end = (grid.cell(*place) for place in (start, goal))
    assert begin is not None
    assert end is not None
    if costs[begin] >= _LETHAL:
        return None
    far, before = dijkstra(graph, indices=numbers[begin], return_predecessors=True)
    if not np.isfinite(far[numbers[end]]):
        return None
    path = [numbers[end]]
    while path[-1] != numbers[begin]:
        path.append(before[path[-1]])
    at_row, at_column = np.divmod(np.array(path[::-1]), columns)
    return np.stack([at_column + 0.5, at_row + 0.5], 1) * grid.resolution + np.array(grid.origin)


def _below(costs: Array, side: float, outline: Outline, step: tuple[int, int]) -> Array:
    """The dearest cell below a vehicle that heads along a step."""
    pose = Pose(0.0, 0.0, math.atan2(*step))
    along = np.arange(
        outline.rear - outline.radius, outline.front + outline.radius + side / 2, side / 2
    )
    across = np.arange(outline.right, outline.left + side / 2, side / 2)
    shifts = {tuple(round(v / side) for v in pose.place(a, b)) for a in along for b in across}
    reach = max(max(abs(v) for v in shift) for shift in shifts)
    padded, found = np.pad(costs, reach), costs.copy()
    for x, y in shifts:
        part = padded[
            reach + y : reach + y + costs.shape[0], reach + x : reach + x + costs.shape[1]
        ]
        np.maximum(found, part, out=found)
    return found


def dear_way(path: Array, grid: Grid, outline: Outline, least: int = 50) -> float:
    """M of the path on which a wheel's track (the outer edges) is on cells of so much or more."""
    steps = np.diff(path, axis=0)
    length = np.hypot(*steps.T)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    on = np.zeros(len(steps), dtype=bool)
    for left in (outline.left, outline.right):
        for (x, y), angle, i in zip(path[1:], heading, range(len(steps)), strict=True):
            cell = grid.cell(*Pose(x, y, angle).place(0.0, 0.9 * left))
            on[i] |= cell is not None and grid.cells[cell] >= least
    return float(length[on].sum())


def near_share(path: Array, way: Array, within: float = 0.3) -> float:
    """Share of the path's places that are so near (m) to an old way."""
    gaps = np.hypot(*(path[:, None, :] - way[None, ::5, :]).transpose(2, 0, 1)).min(axis=1)
    return float(np.mean(gaps < within))
