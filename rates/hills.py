# SPDX-License-Identifier: Apache-2.0
"""Ground ahead: what the map expects of slopes before a wheel is on them, and how often that comes true.

`slopes`: a drive up a slope that steepens, with an elevation map of the field. Expected over seen stuck: the
forecast cost of each metre, as the bare grid stood before the front wheels came to it, summed over all metres
that the vehicle's middle came to, over how often it got stuck; and over the metres on which the ground gave
less at the reference slip than the slope asked for: one that goes on there slips by more for some metres.

`hills`: after a drive over soil, an elevation map of hills beyond it. A cell stops the vehicle where the
slope is more than the margin there, which differs from block to block as it did on the drive. And a ridge
across the way between level ground: do planners go round it, before a wheel is on it?
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter

from rates.drive_trial import turns_of, with_faults
from rates.drive_worlds import SLIP, Truth, WorldDrive, make_drive
from rates.judges import Line
from rates.planners import PLANNERS, Array, plan, under_footprint
from smallwheel_ros.costmap.cost import CostSettings
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.elevation import Elevation, slopes
from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.drive.ground_map import GroundMapper
from smallwheel_ros.drive.messages import margin_before_driving
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.simulate.world_ground import TrueGround

_STEEPENS = ("steepens", "steepens, 200 kg")
_LEVEL = ("soil, six", "soil, 80 kg", "soil, 200 kg", "loam", "soil")
SIDE = 0.1  # m, of a cell
NOISE, HOLES = 0.01, 0.15  # m, and share of the cells: of an elevation map made while driving
_FIRST = 3.0  # m of the way, from which forecasts are counted
_BLOCK = 1.0  # m over which ground has one margin
_FIELD, _STEEPEST = 20.0, 0.5  # m, side of a field of hills; tangent of their steepest slope


def mapper_of(drive: WorldDrive) -> tuple[GroundMapper, Pipeline]:
    """A map of a drive that has not begun."""
    settings = with_faults(drive).settings
    made = CostMap(CostSettings(), settings.wheels, margin_before_driving(settings))
    return GroundMapper(made, settings.wheels), Pipeline(settings)


def shown(heights: Array, corner: tuple[float, float], length: float, seed: int) -> Elevation:
    """An elevation map of a field, with noise and holes; corner: of the first cell, m."""
    rng = np.random.default_rng([seed, 7])
    seen = heights + NOISE * rng.standard_normal(heights.shape)
    seen[rng.uniform(size=heights.shape) < HOLES] = np.nan
    return Elevation("odom", SIDE, corner, *slopes(seen, SIDE, length))


def field_of(ground: TrueGround, half_width: float) -> tuple[Array, tuple[float, float]]:
    """Heights (m) of the field that a straight way leads over, and its corner."""
    x = np.arange(ground.at[0], ground.at[-1], SIDE) + 0.5 * SIDE
    y = np.arange(-half_width, half_width, SIDE) + 0.5 * SIDE
    ahead = np.tan(ground.east + ground.steepens)
    height = np.concatenate([[0.0], np.cumsum(0.5 * (ahead[1:] + ahead[:-1]) * np.diff(ground.at))])
    across = np.tan(np.interp(x, ground.at, ground.north))
    return np.interp(x, ground.at, height) + y[:, None] * across, (float(ground.at[0]), -half_width)


def slopes_trial(seed: int) -> Line:
    """Forecast and truth of each metre of one drive."""
    drive = make_drive(SLIP[_STEEPENS[seed % 2]], seed)
    mapper, pipeline = mapper_of(drive)
    outline = mapper.map.outline
    heights, corner = field_of(drive.ground, 4.0)
    mapper.map.take_elevation(shown(heights, corner, outline.length, seed))
    front, half = outline.front + outline.radius, outline.half_width
    forecast: dict[int, float] = {}
    for stamp, turns in turns_of(pipeline, with_faults(drive)):
        for turn in turns:
            mapper.add(turn.estimates, "odom")
        grids = mapper.map.grids()
        if grids is None:
            continue
        place = float(drive.truth.place[drive.at(np.array([stamp]))[0]]) + front
        first = math.ceil(place)
        for metre in range(first, first + 3):
            cells = _cells(grids.bare, metre, half)
            if cells.size:
                forecast[metre] = float(np.mean(cells)) / 100.0
    entered = range(math.ceil(_FIRST), math.ceil(drive.truth.place[-1]))
    known = [metre for metre in entered if metre in forecast]
    held = {math.floor(place) for place in drive.truth.place[drive.truth.reserve < 0.0]}
    return {
        "metres": len(known),
        "expected": float(sum(forecast[metre] for metre in known)),
        "was stuck": int(drive.truth.stuck is not None),
        "held back": len(held.intersection(known)),
    }


def _cells(grid: Grid, metre: int, half: float) -> Array:
    """Known costs of a metre of a straight way, over the vehicle's width."""
    (x, y), side = grid.origin, grid.resolution
    columns = np.arange(round((metre - x) / side), round((metre + 1 - x) / side))
    rows = np.arange(round((-half - y) / side), round((half - y) / side))
    rows, columns = (
        one[(one >= 0) & (one < size)]
        for one, size in zip((rows, columns), grid.cells.shape, strict=True)
    )
    cells = grid.cells[np.ix_(rows, columns)]
    return np.asarray(cells[cells >= 0], dtype=np.float64)


# --- Hills


def map_behind(seed: int) -> tuple[CostMap, Truth]:
    """The cost map after a drive over soil, and what was true on it."""
    drive = make_drive(SLIP[_LEVEL[seed % len(_LEVEL)]], seed)
    mapper, pipeline = mapper_of(drive)
    for _, turns in turns_of(pipeline, with_faults(drive)):
        for turn in turns:
            mapper.add(turn.estimates, "odom")
    return mapper.map, drive.truth


def corner_of(made: CostMap) -> tuple[float, float]:
    """The first cell of a field whose larger part lies ahead of the vehicle, m."""
    assert made._pose is not None
    return made._pose.x - 0.25 * _FIELD, made._pose.y - 0.5 * _FIELD


def hills_trial(seed: int) -> Line:
    """Forecasts of a field of hills behind a drive, and what planners do about a ridge."""
    made, truth = map_behind(seed)
    rng = np.random.default_rng([seed, 8])
    margins = truth.margin[truth.path > _FIRST]
    corner = corner_of(made)
    heights = hills(rng)
    made.take_elevation(shown(heights, corner, made.outline.length, seed))
    costs = made.ahead.by_slope()
    assert costs is not None
    stops = true_slope(heights, made.outline.length) > _margins(rng, margins, heights.shape)
    over, under = costs.cells > 90, (costs.cells >= 0) & (costs.cells < 10)
    line: Line = {
        "over": int(over.sum()), "over, stop": int((over & stops).sum()),
        "under": int(under.sum()), "under, stop": int((under & stops).sum()),
    }  # fmt: skip
    line["round the ramp"] = int(_goes_round(made, float(np.median(margins)), seed))
    return line


def hills(rng: np.random.Generator) -> Array:
    """Heights of a field whose steepest slope is given."""
    count = round(_FIELD / SIDE)
    found = sum(
        gaussian_filter(rng.standard_normal((count, count)), size / SIDE) * size**2
        for size in (1.5, 3.0)
    )
    slope = np.hypot(*np.gradient(found, SIDE))
    return np.asarray(found * _STEEPEST / np.quantile(slope, 0.99))


def true_slope(heights: Array, length: float) -> Array:
    """Tangent of the steepest way of the ground under a vehicle: mean of the slope over its length."""
    along = (gaussian_filter(part, 0.29 * length / SIDE) for part in np.gradient(heights, SIDE))
    return np.hypot(*along)


def _margins(rng: np.random.Generator, margins: Array, shape: tuple[int, ...]) -> Array:
    """Margins of a field, drawn by block from those that the drive met."""
    count = round(_BLOCK / SIDE)
    drawn = rng.choice(margins, [-(-size // count) for size in shape])
    return np.kron(drawn, np.ones((count, count)))[: shape[0], : shape[1]]


def see_ridge(made: CostMap, margin: float, seed: int) -> tuple[Array, Array]:
    """Show the map a ridge across the way that the vehicle cannot climb: its heights, and start and goal."""
    count, corner = round(_FIELD / SIDE), corner_of(made)
    y, x = (SIDE * (index + 0.5) for index in np.ogrid[:count, :count])
    middle, half = 0.25 * _FIELD + 4.0, 1.5  # m ahead of it, and half of the ridge's width
    steep, length = margin + 0.15, 2.0  # tangent, m: too steep by twice what places differ by
    up = np.clip(length - np.abs(x - middle), 0.0, None) * steep
    beside = np.clip((half + 0.3 - np.abs(y - 0.5 * _FIELD)) / 0.3, 0.0, 1.0)
    heights = up * beside
    made.take_elevation(shown(heights, corner, made.outline.length, seed + 1))
    along = np.array([0.25 * _FIELD, middle + 4.0]) + corner[0]
    return heights, np.stack([along, np.full(2, 0.5 * _FIELD + corner[1])], axis=1)


def _goes_round(made: CostMap, margin: float, seed: int) -> bool:
    """Whether no planner's way leads a wheel onto a ridge that the vehicle cannot climb."""
    heights, (start, goal) = see_ridge(made, margin, seed)
    corner, grids = corner_of(made), made.grids()
    assert grids is not None
    ridge = np.zeros(grids.bare.cells.shape)
    rows, columns = np.nonzero(heights > 0.02)
    at = np.array([SIDE * (rows + 0.5) + corner[1], SIDE * (columns + 0.5) + corner[0]])
    cells = np.floor((at - np.array(grids.bare.origin)[::-1, None]) / grids.bare.resolution).astype(
        int
    )
    ridge[tuple(cells)] = 1.0
    for planner in PLANNERS:
        path = plan(grids.spread, tuple(start), tuple(goal), made.outline, planner)
        if path is None or under_footprint(path, ridge, grids.bare, made.outline).max() > 0.0:
            return False
    return True
