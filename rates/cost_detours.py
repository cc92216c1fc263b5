# SPDX-License-Identifier: Apache-2.0
"""Subject: cost. What planners do with the cost map past where a robot got stuck, and out of there.

    python -m rates cost --seeds 500:520
    python -m rates.cost_detours PICTURE   # only draws one drive's map and a path

Simulated drives that end stuck on slippery ground or a slope, one a seed; their cost maps, and paths over
them by the rules of Nav2's planners: straight past the place, from 8 m before it to 3 m behind it, each end
moved along that line to where no wheel stands on ground of 50 and more; and out of there. Costs are spread
as the node does it (`cost.spread`) and, to show what that is for, not at all. `m dear`: way of the outer
wheels, beside base_link, on cells that the map without spread has at 50 and more; at the corners: of those
in front and behind.

Paths are shortest ones over 8 neighbours by the rules of Nav2's planners (1.3.13).

A cell of the grid becomes one of the costmap as KeepoutFilter has it, 0 to 254, unknown 0 (a costmap that
does not track unknown space); soil is not inflated, since filters come after inflation.

NavFn goes by base_link: a step costs its length times 50 + 0.8 of the cost (navfn.cpp: COST_NEUTRAL,
COST_FACTOR), and 253 and more cannot be entered.

SmacHybrid and SmacLattice know the footprint (collision_checker.cpp, inCollision) and look at it only
where the cost under base_link is at least that of InflationLayer at the circumscribed radius; then no edge of
it may be on 254. A step costs its length times 0.985 + 2 times the cost under base_link over 252
(node_hybrid.cpp, getTraversalCost). Turning radius and penalties of turns are left out: they change no cell
that is looked at.
"""

from __future__ import annotations

import math
import sys
import tempfile
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from examples.cost_map import cost_map
from rates.judges import Judge, Line, Subject, ratio, share
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.crossed_ground import Outline
from smallwheel_ros.costmap.grid import Grid, Pose, spread
from smallwheel_ros.ros import config_file
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

Array = NDArray[np.float64]
Planner = Literal["NavFn", "Smac"]
_STEPS = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)]
_INSCRIBED, _LETHAL = 253.0, 254.0
# InflationLayer in nav2_params.yaml: 1/m, m
_SCALING, _INFLATION = 3.0, 0.7
_BEFORE, _BEHIND = 8.0, 3.0  # m
_PLANNERS: tuple[Planner, ...] = ("NavFn", "Smac")


# --- Planners


def plan(
    grid: Grid,
    start: tuple[float, float],
    goal: tuple[float, float],
    outline: Outline,
    planner: Planner,
) -> Array | None:
    """Places (m) of the path, shape (places, 2); None where there is none."""
    costs = np.where(grid.cells < 0, 0.0, np.rint(2.54 * grid.cells))
    rows, columns = costs.shape
    numbers = np.arange(rows * columns).reshape(rows, columns)
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
        found[2].append(math.hypot(up, aside) * weight)
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
    rear, front = outline.rear - outline.radius, outline.front + outline.radius
    along = np.append(np.arange(rear, front, side / 2), front)
    across = np.append(np.arange(outline.right, outline.left, side / 2), outline.left)
    edge = [(a, b) for a in along for b in (outline.right, outline.left)]
    edge += [(a, b) for a in (rear, front) for b in across]
    shifts = {tuple(round(v / side) for v in pose.place(*place)) for place in edge}
    reach = max(max(abs(v) for v in shift) for shift in shifts)
    padded, found = np.pad(costs, reach), np.zeros_like(costs)
    for x, y in shifts:
        part = padded[
            reach + y : reach + y + costs.shape[0], reach + x : reach + x + costs.shape[1]
        ]
        np.maximum(found, part, out=found)
    return found


def dear_way(
    path: Array, grid: Grid, outline: Outline, *, corners: bool = False, least: int = 50
) -> float:
    """M of the path on which a wheel's track (beside base_link) is on cells of so much or more.

    corners: of the wheels in front and behind, which swing out in turns. The vehicle looks the way that its
    path goes over its own length: steps have eight directions only.
    """
    steps = np.diff(path, axis=0)
    length = np.hypot(*steps.T)
    half = max(1, round(0.5 * outline.length / grid.resolution))
    number = np.arange(1, len(path))
    chord = path[np.minimum(number + half, len(path) - 1)] - path[np.maximum(number - half, 0)]
    axles = (outline.rear, outline.front) if corners else (0.0,)
    on = np.zeros(len(steps), dtype=bool)
    for i, (x, y), (dx, dy) in zip(range(len(steps)), path[1:], chord, strict=True):
        pose = Pose(x, y, math.atan2(dy, dx))
        for ahead, left in product(axles, (outline.left, outline.right)):
            cell = grid.cell(*pose.place(ahead, 0.9 * left))
            on[i] |= cell is not None and grid.cells[cell] >= least
    return float(length[on].sum())


# --- Drives


def map_of(seed: int) -> tuple[CostMap, Pose, Array]:
    """The cost map after a drive without the vehicle on it, where that stands, and its places till then."""
    finish = ("slippery", "slope")[seed % 2]
    drive = simulate_drive(DriveSettings(seed=seed, distance=12.0, finish=finish))
    with tempfile.TemporaryDirectory() as folder:
        write_drive_bag(drive, Path(folder) / "bag")
        made, way = cost_map(Path(folder) / "bag", config_file("four_wheels.yaml"))
    assert made._pose is not None
    pose, made._pose = made._pose, None
    return made, pose, way


def grid_of(made: CostMap, reach: float, pose: Pose | None = None) -> Grid:
    """The map's grid with costs spread so far (m), and with the vehicle there."""
    made.spread, made._pose = reach, pose
    grid = made.grid()
    assert grid is not None
    return grid


def draw(seed: int, picture: Path) -> None:
    """Draw what a planner does that goes by base_link, past where a robot got stuck."""
    made, pose, way = map_of(seed)
    grid = grid_of(made, made.spread)
    start = way[np.argmin(np.abs(np.hypot(*(way - way[-1]).T) - _BEFORE))]
    path = plan(grid, tuple(start), pose.place(_BEHIND, 0.0), made.outline, "NavFn")
    draw_cost(grid, picture, way=way, planned=path, title="Stuck there; a path to behind it")


def _free_place(grid: Grid, outline: Outline, places: Array) -> tuple[float, float]:
    """The first place where no wheel would be on ground of 50 and more, whichever way the vehicle looks."""
    around = math.hypot(outline.length / 2, outline.half_width) + grid.resolution
    dear = spread(grid.cells, around / grid.resolution) >= 50
    for x, y in places.tolist():
        cell = grid.cell(x, y)
        if cell is not None and not dear[cell]:
            return x, y
    raise RuntimeError("all places are on dear ground")


PLANNED = [
    f"{planner}, {how}"
    for planner, how in product(_PLANNERS, ("as the node spreads", "not spread"))
]


def trial(_: str, seed: int) -> Line:
    """What planners do on the map of one drive: by planner and kind of map, by what is measured."""
    made, pose, _ = map_of(seed)
    outline, more = made.outline, np.arange(0.0, 5.0, 0.2)
    reaches = made.spread, 0.0
    raw = grid_of(made, 0.0)
    blank = replace(raw, cells=np.full_like(raw.cells, -1))
    # What stands on dear ground, or is to, can keep no wheel off it.
    start, behind = (
        _free_place(raw, outline, np.array([pose.place(x, 0.0) for x in line]))
        for line in (-_BEFORE - more, _BEHIND + more)
    )
    found: Line = {}
    for name, (planner, reach) in zip(PLANNED, product(_PLANNERS, reaches), strict=True):
        path = plan(grid_of(made, reach), start, behind, outline, planner)
        straight = plan(blank, start, behind, outline, planner)
        out = plan(grid_of(made, reach, pose), (pose.x, pose.y), start, outline, planner)
        row = {"plan": float(path is not None), "out": float(out is not None)}
        if path is not None and straight is not None:
            row |= {
                "m dear": dear_way(path, raw, outline),
                "m dear at the corners": dear_way(path, raw, outline, corners=True),
                "m dear, no grid": dear_way(straight, raw, outline),
            }
        found[name] = row
    return found


_WAYS = ("m dear", "m dear at the corners", "m dear, no grid")


def _value(planned: str, what: str, line: Line) -> float:
    return float(line[planned].get(what, 0.0))


def _has(planned: str, what: str, line: Line) -> int:
    return int(what in line[planned])


def _judge(planned: str, what: str) -> Judge:
    """How often there is a path; the mean of metres over the drives that have one."""
    value, has = partial(_value, planned, what), partial(_has, planned, what)
    return Judge(f"{planned}: {what}", ratio(value, has) if what in _WAYS else share(value, has))


JUDGES = [_judge(planned, what) for planned in PLANNED for what in ("plan", "out", *_WAYS)]
SUBJECTS = [Subject("cost", ["stuck"], trial, JUDGES, 10, 20.0)]

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("expected one argument, the picture's file")
    draw(500, Path(sys.argv[1]))
