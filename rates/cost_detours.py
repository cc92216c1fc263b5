# SPDX-License-Identifier: Apache-2.0
"""Subject: cost. What the map says of drives that got stuck, and what planners do with it.

    python -m rates cost --seeds 500:520
    python -m rates.cost_detours KIND PICTURE   # only draws a map and a path: round, home or hill

World `stuck`: simulated drives that end stuck on slippery ground or a slope, one a seed.

- Own way on 100: how far back from where it stands the bare grid has 100 on base_link's own way, m.
- Paths by the rules of Nav2's planners (`planners`) over ~/cost. Round: from 8 m before the place to 3 m
behind
  it, each end moved along that line to where no wheel stands on ground of 50 and more. Home: from where it
  stands, with the vehicle there, and over the map that is saved from 2 m back; to 8 m before.
- Metres on 100: of the planned way, on which the footprint touches a 100 of ~/cost_bare, the grid that the
  local costmap has.
- On proven ground: share of the way home on ground that the vehicle has crossed, and without any grid.
"""

from __future__ import annotations

import math
import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from examples.cost_map import cost_map
from rates.hills import hills_trial, map_behind, see_ridge, slopes_trial
from rates.judges import Judge, Line, Subject, pooled, ratio, share
from rates.planners import PLANNERS, Array, length_of, plan, under_footprint
from smallwheel_ros.costmap.cost_map import CostGrids, CostMap
from smallwheel_ros.costmap.cost_picture import draw_cost
from smallwheel_ros.costmap.crossed_ground import Outline
from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Grid, Pose
from smallwheel_ros.costmap.spread import spread
from smallwheel_ros.ros import config_file
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

_BEFORE, _BEHIND, _BACK = 8.0, 3.0, 2.0  # m
_DRAWN = 500  # seed of the pictures
_GRADED = 20  # of costs between free and lethal, as a planner notices


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


def grids_of(made: CostMap, pose: Pose | None = None) -> CostGrids:
    """The map's grids with the vehicle there."""
    made._pose = pose
    grids = made.grids()
    made._pose = None
    assert grids is not None
    return grids


def draw_round(picture: Path) -> None:
    """Draw what a planner does that goes by base_link, past where a robot got stuck."""
    made, pose, way = map_of(_DRAWN)
    grid = grids_of(made).spread
    path = plan(grid, _before(way), pose.place(_BEHIND, 0.0), made.outline, "NavFn")
    draw_cost(grid, picture, way=way, planned=path, title="Stuck there; a path to behind it")


def draw_home(picture: Path) -> None:
    """Draw the way home from where a robot got stuck."""
    made, pose, way = map_of(_DRAWN)
    grid = grids_of(made, pose).spread
    path = plan(grid, (pose.x, pose.y), _before(way), made.outline, "NavFn")
    draw_cost(grid, picture, way=way, planned=path, title="Stuck there; a path home")


def draw_hill(picture: Path) -> None:
    """Draw the way round a ridge that no wheel has been on."""
    made, truth = map_behind(_DRAWN)
    _, (start, goal) = see_ridge(made, float(np.median(truth.margin)), _DRAWN)
    grids = made.grids()
    assert grids is not None
    path = plan(grids.spread, tuple(start), tuple(goal), made.outline, "NavFn")
    title = "A ridge ahead that no wheel has been on; a path round it"
    draw_cost(grids.spread, picture, planned=path, title=title)


def _before(way: Array) -> tuple[float, float]:
    """The place of a way that is as far before its end as paths begin."""
    x, y = way[np.argmin(np.abs(np.hypot(*(way - way[-1]).T) - _BEFORE))]
    return float(x), float(y)


def _free_place(grid: Grid, outline: Outline, places: Array) -> tuple[float, float]:
    """The first place where no wheel would be on ground of 50 and more, whichever way the vehicle looks."""
    around = math.hypot(outline.length / 2, outline.half_width) + grid.resolution
    dear = spread(grid.cells, around / grid.resolution) >= 50
    for x, y in places.tolist():
        cell = grid.cell(x, y)
        if cell is not None and not dear[cell]:
            return x, y
    raise RuntimeError("all places are on dear ground")


def _values(grid: Grid, places: Array) -> Array:
    """Costs at places, shape (places, 2); -1 outside."""
    cells = [grid.cell(*place) for place in places.tolist()]
    return np.array([UNKNOWN if cell is None else int(grid.cells[cell]) for cell in cells])


def stuck_trial(seed: int) -> Line:
    """What the map of one drive says, and what planners do on it."""
    made, pose, way = map_of(seed)
    outline, more = made.outline, np.arange(0.0, 5.0, 0.2)
    grids, standing, saved = grids_of(made), grids_of(made, pose), made.spread_whole()
    assert saved is not None
    bare = grids.bare
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    left = gone[-1] - gone
    costs = _values(bare, way)
    on = left[costs == HIGHEST]
    lethal = np.argwhere(bare.cells == HIGHEST)[:, ::-1] * bare.resolution + np.array(bare.origin)
    near = np.hypot(*(lethal + 0.5 * bare.resolution - np.array(pose[:2])).T) < 1.0
    found: Line = {
        "own way on 100": float(on.max(initial=0.0)),
        "graded": int((costs[left < on.max(initial=0.0) + 3.0] >= _GRADED).any()),
        "100 where it is": int(near.any()),
    }
    # What stands on dear ground, or is to, can keep no wheel off it.
    start, behind = (
        _free_place(bare, outline, np.array([pose.place(x, 0.0) for x in line]))
        for line in (-_BEFORE - more, _BEHIND + more)
    )
    home, back = (tuple(way[np.argmin(np.abs(left - far))]) for far in (_BEFORE, _BACK))
    crossed, blank = bare.cells != UNKNOWN, replace(bare, cells=np.full_like(bare.cells, UNKNOWN))
    for planner in PLANNERS:
        row = {}
        ways = {
            "round": plan(grids.spread, start, behind, outline, planner),
            "home": plan(standing.spread, (pose.x, pose.y), home, outline, planner),
            "home, saved": plan(saved, back, home, outline, planner),
            "home, no grid": plan(blank, (pose.x, pose.y), home, outline, planner),
        }
        for name, path in ways.items():
            row[name] = int(path is not None)
            if path is None:
                continue
            # A way home begins where the vehicle stands: its grid lets it out.
            over = standing.bare if name == "home" else bare
            under = under_footprint(path, over.cells, over, outline)
            row[f"{name}, m"] = length_of(path, np.ones(len(path), dtype=bool))
            row[f"{name}, m on 100"] = length_of(path, under == HIGHEST)
            proven = np.array([crossed[bare.cell(*place)] for place in path.tolist()])
            row[f"{name}, m proven"] = length_of(path, proven)
        found[planner] = row
    return found


def trial(world: str, seed: int) -> Line:
    """One drive of a world."""
    return {"stuck": stuck_trial, "slopes": slopes_trial, "hills": hills_trial}[world](seed)


# --- Judges


def _of(name: str, line: Line) -> float:
    """A number of a line; 0 where its world has none."""
    return float(line.get(name, 0.0))


def _planned(planner: str, name: str, line: Line) -> float:
    return float(line.get(planner, {}).get(name, 0.0))


def _in(name: str, line: Line) -> int:
    return int(name in line)


def _clear(planner: str, name: str, line: Line) -> int:
    """Whether there is a way, and the footprint is on no 100 along it."""
    row = line.get(planner, {})
    return int(bool(row.get(name)) and row[f"{name}, m on 100"] == 0.0)


def _short(most: float, name: str, line: Line) -> int:
    return int(name in line and line[name] <= most)


def _of_planner(planner: str) -> list[Judge]:
    of = partial(_in, planner)
    judges = [
        Judge(f"{planner}: {name}", share(partial(_clear, planner, name), of), least)
        for name, least in (("round", 0.95), ("home", 0.95), ("home, saved", 0.95))
    ]
    for name in ("home", "home, no grid"):
        sums = (partial(_planned, planner, f"{name}, m{what}") for what in (" proven", ""))
        least = 0.38 if name == "home" else None
        judges.append(Judge(f"{planner}: {name}, share on proven ground", ratio(*sums), least))
    return judges


_STUCK = partial(_in, "own way on 100")
JUDGES = [
    Judge("100 where it got stuck", share(partial(_of, "100 where it is"), _STUCK), 0.95),
    Judge("own way on 100, m", ratio(partial(_of, "own way on 100"), _STUCK), None, 1.2),
    Judge("own way on 100 by 1.2 m at most", share(partial(_short, 1.2, "own way on 100"), _STUCK), 0.95),
    Judge("grades before the 100", share(partial(_of, "graded"), _STUCK), 0.95),
    *(judge for planner in PLANNERS for judge in _of_planner(planner)),
    Judge("expected over seen stuck", pooled(partial(_of, "expected"), partial(_of, "was stuck")), 0.5, 2.0),
    Judge(
        "expected over metres that hold it back",
        pooled(partial(_of, "expected"), partial(_of, "held back")), 0.5, 2.0,
    ),
    Judge("stops, of cells over 90", ratio(partial(_of, "over, stop"), partial(_of, "over")), 0.8),
    Judge("stops, of cells under 10", ratio(partial(_of, "under, stop"), partial(_of, "under")), None, 0.02),
    Judge("goes round a ramp", share(partial(_of, "round the ramp"), partial(_in, "round the ramp")), 0.95),
]  # fmt: skip
SUBJECTS = [Subject("cost", ["stuck", "slopes", "hills"], trial, JUDGES, 10, 20.0)]

DRAWN = {"round": draw_round, "home": draw_home, "hill": draw_hill}

if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[1] not in DRAWN:
        sys.exit(f"expected one of {', '.join(DRAWN)}, and the picture's file")
    DRAWN[sys.argv[1]](Path(sys.argv[2]))
