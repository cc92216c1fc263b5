# SPDX-License-Identifier: Apache-2.0
"""What planners do with the cost map: past where a robot got stuck, out of there, and on good ground.

    python benchmarks/cost_detours.py --drives 20

Simulated drives (truth simulator) that end stuck on slippery ground or a slope, one a seed, and as many
that do not; their cost maps, and paths over them by the rules of Nav2's planners (`_grid_planner`):
straight past the place, from 8 m before it to 3 m behind it, out of there, and along the good drives, each
end moved along that line to where no wheel stands on ground of 50 and more. Costs are spread as the node
does it (`cost.spread`) and, to show what that is for, not at all. `m dear`: way of the outer wheels, beside
base_link, on cells that the map without spread has at 50 and more; at the corners: of those in front and
behind. Intervals (95 %): bootstrap over drives for means, Clopper-Pearson for counts.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, bootstrap

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

from cost_map import cost_map

from benchmarks._grid_planner import Planner, dear_way, near_share, plan
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.grid import Grid, spread
from smallwheel_ros.ros import config_file
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

_BEFORE, _BEHIND = 8.0, 3.0  # m
_PLANNERS: tuple[Planner, ...] = ("NavFn", "Smac")
Found = dict[str, dict[str, float]]


def map_of(seed: int, stuck: bool) -> tuple[CostMap, NDArray[np.float64]]:
    """The cost map after a drive, and the places of the robot on it."""
    finish = ("slippery", "slope")[seed % 2] if stuck else "none"
    drive = simulate_drive(DriveSettings(seed=seed, distance=12.0, finish=finish))
    with tempfile.TemporaryDirectory() as folder:
        write_drive_bag(drive, Path(folder) / "bag")
        return cost_map(Path(folder) / "bag", config_file("four_wheels.yaml"))


def draw(seed: int, picture: Path) -> None:
    """Draw what a planner does that goes by base_link, past where a robot got stuck."""
    made, way = map_of(seed, stuck=True)
    pose, made._pose = made._pose, None
    grid = made.grid()
    assert pose is not None
    assert grid is not None
    start = way[np.argmin(np.abs(np.hypot(*(way - way[-1]).T) - _BEFORE))]
    path = plan(grid, tuple(start), pose.place(_BEHIND, 0.0), made.outline, "NavFn")
    draw_cost(grid, picture, way=way, planned=path, title="Stuck there; a path to behind it")


def _free(grid: Grid, made: CostMap, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """At which places no wheel would be on ground of 50 and more, whichever way the vehicle looks."""
    around = math.hypot(made.outline.length / 2, made.outline.half_width) + grid.resolution
    dear = spread(grid.cells, around / grid.resolution) >= 50
    cells = [grid.cell(*place) for place in places]
    return np.array([cell is not None and not dear[cell] for cell in cells])


def one_drive(seed: int, stuck: bool) -> Found:
    """What planners do on the map of one drive: by kind of map and planner, by what is measured."""
    made, way = map_of(seed, stuck)
    outline, reached = made.outline, made.spread
    pose = made._pose
    assert pose is not None
    found: Found = {}
    made.spread = 0.0
    raw = made.grid()
    assert raw is not None
    blank = replace(raw, cells=np.full_like(raw.cells, -1))
    # What stands on dear ground, or is to, can keep no wheel off it.
    starts, ends = way, way[::-1]
    if stuck:
        more = np.arange(0.0, 5.0, 0.2)
        starts, ends = (
            np.array([pose.place(x, 0.0) for x in line])
            for line in (-_BEFORE - more, _BEHIND + more)
        )
    start, behind = (tuple(on[_free(raw, made, on)][0]) for on in (starts, ends))
    for planner, reach in product(_PLANNERS, (reached, 0.0)):
        made.spread = reach
        standing = made.grid()
        gone, made._pose = made._pose, None  # the vehicle is elsewhere
        left, made._pose = made.grid(), gone
        assert standing is not None
        assert left is not None
        name = f"{planner}, {'as the node spreads' if reach else 'not spread'}"
        path = plan(left, start, behind, outline, planner)
        straight = plan(blank, start, behind, outline, planner)
        assert straight is not None
        row = {"plan": float(path is not None)}
        if path is not None:
            row |= {
                "m dear": dear_way(path, raw, outline),
                "m dear at the corners": dear_way(path, raw, outline, corners=True),
                "m dear, no grid": dear_way(straight, raw, outline),
                "near old track": near_share(path, way),
                "near old track, no grid": near_share(straight, way),
            }
        if stuck:
            row["out"] = float(
                plan(standing, (pose.x, pose.y), start, outline, planner) is not None
            )
        found[name] = row
    return found


def main() -> None:
    """Print a table for drives that got stuck and one for those that did not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--first", type=int, default=500)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--picture", type=Path, help="only draw the first drive's map and a path")
    given = parser.parse_args()
    if given.picture:
        draw(given.first, given.picture)
        return
    seeds = range(given.first, given.first + given.drives)
    with ProcessPoolExecutor(given.processes) as pool:
        for title, stuck in (("stuck", True), ("good ground", False)):
            rows = list(pool.map(one_drive, seeds, [stuck] * given.drives))
            for name in rows[0]:
                print(f"{title}; {name}")
                for what in dict.fromkeys(key for row in rows for key in row[name]):
                    print(
                        f"    {what}: {_words(what, [r[name][what] for r in rows if what in r[name]])}"
                    )


def _words(what: str, values: list[float]) -> str:
    if what in ("plan", "out"):
        ends = binomtest(int(sum(values)), len(values)).proportion_ci(0.95)
        return f"{sum(values):.0f} of {len(values)} ({ends.low:.2f} to {ends.high:.2f})"
    if len(set(values)) == 1:
        return f"{values[0]:.2f} in all {len(values)}"
    ends = bootstrap((values,), np.mean, method="percentile", rng=1).confidence_interval
    interval = f"({ends.low:.2f} to {ends.high:.2f})"
    return f"{np.mean(values):.2f} {interval}, worst {max(values):.2f}, n {len(values)}"


if __name__ == "__main__":
    main()
