# SPDX-License-Identifier: Apache-2.0
"""Paths by the rules of Nav2's planners (1.3.13) over a cost grid, and the vehicle's footprint along them.

Paths are shortest ones over 8 neighbours. A cell of the grid becomes one of the costmap as KeepoutFilter has
it, 0 to 254, unknown 0 (a costmap that does not track unknown space); soil is not inflated, since filters
come after inflation.

NavFn goes by base_link: a step costs its length times 50 + 0.8 of the cost (navfn.cpp: COST_NEUTRAL,
COST_FACTOR), and 253 and more cannot be entered.

SmacHybrid and SmacLattice know the footprint (collision_checker.cpp, inCollision) and look at it only
where the cost under base_link is at least that of InflationLayer at the circumscribed radius; then no edge of
it may be on 254. A step costs its length times 0.985 + 2 times the cost under base_link over 252
(node_hybrid.cpp, getTraversalCost). Turning radius and penalties of turns are left out: they change no cell
that is looked at.

Controllers (RegulatedPurePursuit), is_path_valid and BackUp lay the footprint over the local costmap.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from smallwheel_ros.costmap.crossed_ground import Outline
from smallwheel_ros.costmap.grid import Grid, Pose

Array = NDArray[np.float64]
Planner = Literal["NavFn", "Smac"]
PLANNERS: tuple[Planner, ...] = ("NavFn", "Smac")
_STEPS = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)]
_INSCRIBED, _LETHAL = 253.0, 254.0
_TIE = 1e-5  # 1/m
# InflationLayer in nav2_params.yaml: 1/m, m
_SCALING, _INFLATION = 3.0, 0.7


def plan(
    grid: Grid,
    start: tuple[float, float],
    goal: tuple[float, float],
    outline: Outline,
    planner: Planner,
) -> Array | None:
    """Places (m) of the path, shape (places, 2); None where there is none.

    Of paths that cost the same the one nearest to the straight line counts: those planners smooth theirs.
    """
    costs = np.where(grid.cells < 0, 0.0, np.rint(2.54 * grid.cells))
    rows, columns = costs.shape
    numbers = np.arange(rows * columns).reshape(rows, columns)
    off = _TIE * _off_line(grid, start, goal)
    found: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for up, aside in _STEPS:
        r, c = slice(max(-up, 0), rows - max(up, 0)), slice(max(-aside, 0), columns - max(aside, 0))
        to_r, to_c = (
            slice(max(up, 0), rows - max(-up, 0)),
            slice(max(aside, 0), columns - max(-aside, 0)),
        )
        there, free = costs[to_r, to_c], costs[to_r, to_c] < _INSCRIBED
        if planner == "Smac":
            edges = _under_edges(costs, grid.resolution, outline, (up, aside))[to_r, to_c]
            free &= (there < possible_collision(outline)) | (edges < _LETHAL)
            weight = 0.985 + 2.0 * there[free] / 252.0
        else:
            weight = 50.0 + 0.8 * there[free]
        found[0].append(numbers[r, c][free])
        found[1].append(numbers[to_r, to_c][free])
        found[2].append(math.hypot(up, aside) * weight * (1.0 + off[to_r, to_c][free]))
    edges = [np.concatenate(part) for part in found]
    graph = csr_matrix((edges[2], (edges[0], edges[1])), shape=(rows * columns,) * 2)
    begin, end = (grid.cell(*place) for place in (start, goal))
    assert begin is not None
    assert end is not None
    if costs[begin] >= _INSCRIBED:
        return None
    far, before = dijkstra(graph, indices=numbers[begin], return_predecessors=True)
    if not np.isfinite(far[numbers[end]]):
        return None
    path = [numbers[end]]
    while path[-1] != numbers[begin]:
        path.append(before[path[-1]])
    at_row, at_column = np.divmod(np.array(path[::-1]), columns)
    return np.stack([at_column + 0.5, at_row + 0.5], 1) * grid.resolution + np.array(grid.origin)


def _off_line(grid: Grid, start: tuple[float, float], goal: tuple[float, float]) -> Array:
    """Distance of each cell from the straight line from start to goal, m."""
    y, x = (
        grid.resolution * (index + 0.5)
        for index in np.ogrid[: grid.cells.shape[0], : grid.cells.shape[1]]
    )
    ahead, aside = goal[0] - start[0], goal[1] - start[1]
    across = ahead * (y + grid.origin[1] - start[1]) - aside * (x + grid.origin[0] - start[0])
    found: Array = np.abs(across) / max(math.hypot(ahead, aside), grid.resolution)
    return found


def possible_collision(outline: Outline) -> float:
    """Cost from which on SmacHybrid looks at the footprint: InflationLayer's, at the circumscribed radius.

    0 where the inflation does not reach so far: it always looks then (utils.hpp, findCircumscribedCost).
    """
    ends = outline.front + outline.radius, outline.radius - outline.rear
    sides = outline.left, -outline.right
    around, within = math.hypot(max(ends), max(sides)), min(*ends, *sides)
    if around > _INFLATION:
        return 0.0
    return math.floor(252.0 * math.exp(-_SCALING * (around - within)))


def _under_edges(costs: Array, side: float, outline: Outline, step: tuple[int, int]) -> Array:
    """The dearest cell under the edges of the footprint of a vehicle that heads along a step."""
    pose = Pose(0.0, 0.0, math.atan2(*step))
    along, across = _lines(outline, side)
    edge = [(a, b) for a in along for b in (outline.right, outline.left)]
    edge += [(a, b) for a in (along[0], along[-1]) for b in across]
    shifts = {tuple(round(v / side) for v in pose.place(*place)) for place in edge}
    reach = max(max(abs(v) for v in shift) for shift in shifts)
    padded, found = np.pad(costs, reach), np.zeros_like(costs)
    for x, y in shifts:
        part = padded[
            reach + y : reach + y + costs.shape[0], reach + x : reach + x + costs.shape[1]
        ]
        np.maximum(found, part, out=found)
    return found


def _lines(outline: Outline, side: float) -> tuple[Array, Array]:
    """Places along the footprint and across it, half a cell apart, m from base_link."""
    rear, front = outline.rear - outline.radius, outline.front + outline.radius
    along = np.append(np.arange(rear, front, side / 2), front)
    across = np.append(np.arange(outline.right, outline.left, side / 2), outline.left)
    return along, across


# --- The vehicle along a path


def headings(path: Array, outline: Outline, side: float) -> Array:
    """Which way the vehicle looks at each place of a path, rad: the way that it goes over its own length.

    A step has eight directions only.
    """
    half, number = max(1, round(0.5 * outline.length / side)), np.arange(len(path))
    chord = path[np.minimum(number + half, len(path) - 1)] - path[np.maximum(number - half, 0)]
    return np.arctan2(chord[:, 1], chord[:, 0])


def under_footprint(path: Array, values: Array, grid: Grid, outline: Outline) -> Array:
    """The largest value under the whole footprint at each place of a path, NaN outside.

    values: of each cell of `grid`.
    """
    along, across = (one.ravel() for one in np.meshgrid(*_lines(outline, grid.resolution)))
    yaw = headings(path, outline, grid.resolution)[:, None]
    x = path[:, :1] + np.cos(yaw) * along - np.sin(yaw) * across
    y = path[:, 1:] + np.sin(yaw) * along + np.cos(yaw) * across
    row = np.floor((y - grid.origin[1]) / grid.resolution).astype(int)
    column = np.floor((x - grid.origin[0]) / grid.resolution).astype(int)
    inside = (row >= 0) & (row < values.shape[0]) & (column >= 0) & (column < values.shape[1])
    row, column = (
        np.clip(one, 0, size - 1) for one, size in zip((row, column), values.shape, strict=True)
    )
    found: Array = np.where(inside, values[row, column], -np.inf).max(axis=1)
    return found


def length_of(path: Array, some: NDArray[np.bool_]) -> float:
    """M of a path whose places are among some."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    return float(steps[some[1:]].sum())
