# SPDX-License-Identifier: Apache-2.0
"""The cost map: from margins to costs, on the ground that was crossed and by terrain class.

    map = CostMap(CostSettings(), wheels)
    map.add(wheel, "odom", Pose(3.1, 0.2, 0.0), 17.4, Quantity(0.12, 0.02))
    grid = map.grid()

From the mobility margin and its uncertainty to a cost of 0 .. 100: the risk of getting stuck.

The margin is drawbar pull over load at the reference slip: the tangent of the slope that is held.

    cost = 100 * P(margin < required margin), rounded; margin normally distributed

So a cost of 30 is ground of which three in ten places hold the vehicle back. It falls with the margin
and rises with what is not known of it, up to 50 for ground that is expected to be passable: a planner
that avoids cost is wary of soil that has hardly been measured. 100, which planners take for lethal,
is for places that certainly cannot be crossed (a risk of 99.5 % and more, or a wheel that got stuck
there): uncertainty alone does not make an obstacle.

What the wheels have found on each terrain class, spread over all cells of that class.

A place of a class that has not been crossed is taken for one more draw from the places that have
been: mean of their margins, and variance

    of the soil's estimate, mean over the places           (all of them share that error)
  + scatter^2 (1 + 1/N)                                    N: places crossed
    scatter^2 = (2 CLASS_SCATTER^2 + sum of squared deviations from the mean) / (N + 1)

the posterior of a normal spread whose prior is worth two places. So a class touched once costs more
than one that has been crossed at length, and one never crossed is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from smallwheel_ros.common.node_parameter import parameter
from smallwheel_ros.costmap.crossed_ground import LONGEST_STEP, CrossedGround, Outline, side_of
from smallwheel_ros.costmap.grid import (
    HERE,
    HIGHEST,
    UNKNOWN,
    Cells,
    CostMapError,
    Grid,
    Pose,
    lay_over,
    spread,
    union,
    wide,
)
from smallwheel_ros.physics.wheel import Quantity, Wheel

_PASSABLE = HIGHEST - 1
_EXACT = 1e-9  # standard deviation of a margin that is told as exact
_PRIOR_PLACES = 2.0
# Standard deviation of the margin between places of one class, until they tell. The friction angle of one
# sand differs from place to place by 5 to 15 % (Cherubini and Orr 1999); with 9 %, tan(phi) of 32 degrees
# differs by 0.07. Of that a wheel at the reference slip 0.4 mobilises 0.65 (Janosi and Hanamoto, 0.1 m of
# contact, K 15 mm). In the worlds of rates/drive_worlds.py it is 0.04 on sand, 0.06 on soils of any
# kind.
CLASS_SCATTER = 0.05
_STEEPEST = 2.0  # tangent of a slope: no wheel holds on 63 degrees of any soil
COST_PERIOD = 1.0  # s between two grids at least: planners plan anew about once a second
NOTHING_HELD = Quantity(-1.0, 0.0)  # of a wheel that is stuck: its own load holds it back


@dataclass(frozen=True)
class CostRules:
    """How a margin becomes a cost.

    required_margin: tangent of the slopes that the vehicle has to climb beyond those it has met. Raises
    CostMapError where that is no such tangent.
    """

    required_margin: float = 0.0

    def __post_init__(self) -> None:
        """Check the number."""
        if not abs(self.required_margin) <= _STEEPEST:
            raise CostMapError(
                f"required_margin is {self.required_margin!r}, expected -{_STEEPEST:g} to"
                f" {_STEEPEST:g}"
            )

    def cost(self, margin: float, deviation: float) -> int:
        """Cost of a margin (1) with its standard deviation; -1 where either is not a number."""
        risk = float(ndtr((self.required_margin - margin) / max(deviation, _EXACT)))
        return UNKNOWN if math.isnan(risk) else round(HIGHEST * risk)


@dataclass
class _Class:
    places: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared deviations from the mean
    variance: float = 0.0  # mean of the estimate's own
    stuck: int = 0  # places of those where no vehicle moves on

    def add(self, margin: Quantity) -> None:
        self.places += 1
        step = margin.value - self.mean
        self.mean += step / self.places
        self.squares += step * (margin.value - self.mean)
        self.variance += (margin.standard_deviation**2 - self.variance) / self.places


class TerrainClasses:
    """Margins by terrain class, and the costs that follow from them.

    apart: places of one wheel nearer than this (m) count once.
    """

    def __init__(self, rules: CostRules, apart: float) -> None:
        self.rules = rules
        self._apart = apart
        self._classes: dict[int, _Class] = {}
        self._last: dict[str, tuple[int, float, float]] = {}

    def clear(self) -> None:
        """Forget what was found."""
        self._classes.clear()
        self._last.clear()

    def learn(self, wheel: str, x: float, y: float, terrain: int, margin: Quantity) -> bool:
        """Take a wheel's margin at a place (m) of a class; return whether it counted."""
        if terrain < 0:
            return False
        last = self._last.get(wheel)
        if (
            last is not None
            and last[0] == terrain
            and math.hypot(x - last[1], y - last[2]) < self._apart
        ):
            return False
        self._last[wheel] = (terrain, x, y)
        known = self._classes.setdefault(terrain, _Class())
        known.add(margin)
        known.stuck += margin == NOTHING_HELD
        return True

    def contradictions(self) -> list[str]:
        """Say of each class on which the vehicle was stuck and more often was not, that it is both."""
        return [
            f"terrain class {terrain} is both: stuck at {known.stuck} of {known.places} places: the"
            " classifier does not tell them apart, and its cost is that of the mean with their scatter"
            for terrain, known in sorted(self._classes.items())
            if 0 < known.stuck < 0.5 * known.places
        ]

    def margins(self) -> dict[int, Quantity]:
        """What to expect at a new place of each class that a wheel has been on."""
        found, prior = {}, _PRIOR_PLACES * CLASS_SCATTER**2
        for terrain, known in sorted(self._classes.items()):
            scatter = (prior + known.squares) / (known.places + _PRIOR_PLACES - 1.0)
            variance = known.variance + scatter * (1.0 + 1.0 / known.places)
            found[terrain] = Quantity(known.mean, math.sqrt(variance))
        return found

    def places(self) -> dict[int, int]:
        """How many places of each class have been crossed."""
        return {terrain: known.places for terrain, known in sorted(self._classes.items())}

    def table(self) -> Cells:
        """Cost of each class number, shape (256,), by the byte that an int8 is."""
        table: Cells = np.full(256, UNKNOWN, dtype=np.int8)
        for terrain, margin in self.margins().items():
            table[terrain] = self.rules.cost(margin.value, margin.standard_deviation)
        return table

    def costs(self, classes: Grid) -> Grid:
        """Turn a grid of class numbers into one of costs."""
        cells = np.take(self.table(), np.ascontiguousarray(classes.cells).view(np.uint8))
        return Grid(classes.frame, classes.resolution, classes.origin, cells)


@dataclass(frozen=True)
class CostSettings:
    """cost.*: what the cost map is to be. Raises CostMapError where there can be no such window."""

    resolution: float = parameter(0.1, "m", (0.01, 10.0), "Side of a cell of ~/cost.")
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
        "Each cell takes the highest cost within this distance, for every planner (docs/nav2.md). Without"
        " it: to the outermost corner.",
    )
    unknown: Literal["prior", "none"] = parameter(
        "prior",
        text="Cost of a terrain class that has not been crossed yet: that of any ground, or none (-1).",
    )
    required_margin: float = parameter(
        0.0, "1", (-1.0, 2.0),
        "Margin needed beyond the slope measured at a place. Cost: the risk, in per cent, that the ground"
        " does not give it.",
    )  # fmt: skip

    @property
    def rules(self) -> CostRules:
        """How a margin becomes a cost."""
        return CostRules(self.required_margin)

    def __post_init__(self) -> None:
        """Check how many cells there would be."""
        side_of(self.size, self.resolution)


class CostMap:
    """Costs of ground, from wheels' margins as they come.

    prior: the vehicle's margin as it was believed of any ground before driving, None where not known
    (`pipeline.answers.margin_before_driving`).

    Attributes
    ----------
    spread
        How far costs are spread, m.
    changed
        Whether the grid differs from the one given last.
    frame
        Of positions; empty as long as it is not known.
    class_grid
        The newest grid of terrain classes.
    remembered
        What was found on earlier drives.
    """

    def __init__(
        self, settings: CostSettings, wheels: Sequence[Wheel], prior: Quantity | None = None
    ) -> None:
        self.settings = settings
        self.prior = prior
        self.outline = Outline(wheels)
        # To the outermost corner, and as far again as a cell's corner is from its middle.
        corner = self.outline.around + math.sqrt(0.5) * settings.resolution
        self.spread = corner if settings.spread is None else settings.spread
        self.changed = False
        self.classes = TerrainClasses(settings.rules, settings.resolution)
        self._ground = CrossedGround(settings.size, settings.resolution, self.outline.length)
        self.class_grid: Grid | None = None
        self.remembered: Grid | None = None
        self.frame = ""
        self._frames: dict[str, Pose] = {}  # of our frame in those above it
        self._pose: Pose | None = None
        # Cells that base_link was in, row and column, and whether it was not stuck there.
        self._track: dict[tuple[int, int], bool] = {}
        # Where it was on ground that cannot be crossed, at the last grid.
        self._held: Pose | None = None

    def clear(self) -> None:
        """Forget all that wheels have found and what was remembered; the classes' grid stays."""
        self._ground.clear()
        self.classes.clear()
        self._pose = self._held = self.remembered = None
        self._track.clear()
        self.changed = True

    def add(
        self,
        wheel: Wheel,
        frame: str,
        pose: Pose,
        travel: float,
        margin: Quantity | None,
        *,
        stuck: bool = False,
        risk: float = 0.0,
        slope: float = 0.0,
    ) -> None:
        """Take what the vehicle, at its pose after so much travel (m), has found where a wheel is.

        slope: of the ground there, a tangent; terrain classes are learnt without it.
        margin: None where nothing is known there. stuck: it was seen not to move on there, whatever the
        margin is: sunk to its axle, or spinning on the spot. risk: that it gets stuck, by the warning;
        0: none.
        What is expected costs 99 at most: it drives there.
        """
        self._enter(frame)
        self._follow(pose, stuck=stuck)
        self._pose = pose
        self.changed |= self._ground.follow(pose.x, pose.y)
        if self._held is not None and math.dist(pose[:2], self._held[:2]) > (
            0.5 * self.settings.resolution
        ):
            self.changed = True
        cost = mark = UNKNOWN
        if margin is not None:
            cost = self.settings.rules.cost(margin.value - slope, margin.standard_deviation)
            learner, learnt = wheel.name, margin
        if stuck:
            # A place of its own, although the wheel has not moved since it last counted.
            mark, learner, learnt = HIGHEST, f"{wheel.name}, stuck", NOTHING_HELD
        elif risk > 0.0:
            mark = min(round(HIGHEST * risk), _PASSABLE)
        if cost == mark == UNKNOWN:
            self._ground.skip(wheel.name)
            return
        across = self.outline.across(pose, wheel)
        self.changed |= self._ground.cross(wheel.name, across, travel, min(cost, _PASSABLE), mark)
        if not stuck and margin is None:
            return
        classes = self.class_grid
        if classes is None or classes.frame != self.frame:
            return
        x, y = pose.place(wheel.longitudinal_position, wheel.lateral_position)
        cell = classes.cell(x, y)
        if cell is not None:
            terrain = int(classes.cells[cell])
            self.changed |= self.classes.learn(learner, x, y, terrain, learnt)

    def take_classes(self, grid: Grid) -> None:
        """Take a grid of terrain classes: whole numbers from 0 on, below 0 is not classified."""
        before = self.class_grid
        if (
            before is not None
            and before.geometry == grid.geometry
            and np.array_equal(before.cells, grid.cells)
        ):
            return
        self.class_grid = grid
        self.changed = True

    # --- What was found before

    def remember(self, grid: Grid) -> None:
        """Take costs that were found on an earlier drive; what is found now counts before them."""
        self.remembered, self.changed = grid, True

    def place_frame(self, above: str, pose: Pose) -> None:
        """Note where the frame of positions is in the one above it, such as odom in map."""
        self.changed |= self.remembered is not None and self._frames.get(above) != pose
        self._frames = {above: pose}

    def whole(self) -> Grid | None:
        """Return what was crossed, now and before, in the frame above that of positions if there is one.

        None where nothing was crossed.
        """
        ground, old = self._ground.whole(self.frame), self.remembered
        for above, pose in self._frames.items():
            if ground is not None:
                ground = union(above, [(ground, pose)])
        if old is None or ground is None or old.frame != ground.frame:
            return ground if ground is not None else old
        return union(ground.frame, [(old, HERE), (ground, HERE)])

    def spread_whole(self) -> Grid | None:
        """Return `whole` as planners that know base_link alone need it."""
        ground = self.whole()
        if ground is None:
            return None
        ground = wide(ground, self.spread)
        self._leave_way_home(ground)
        return ground

    # --- The grid

    def grid(self) -> Grid | None:
        """Return the costs as they are now; None as long as there is no place to speak of.

        With terrain classes the cells are theirs: those that were crossed have what was found
        there, the others what is expected of their class. Without, they are the window's.
        """
        costs = self._found()
        self.changed = False
        if costs is None:
            return None
        self._let_out(costs)
        cells = spread(costs.cells, self.spread / costs.resolution)
        if self.settings.unknown == "prior" and self.prior is not None:
            before = self.settings.rules.cost(self.prior.value, self.prior.standard_deviation)
            # Beside what was crossed one side's wheels are on ground that nothing tells of.
            told = cells != UNKNOWN
            if self.class_grid is not None:
                told |= self.class_grid.cells >= 0
            told &= costs.cells == UNKNOWN
            cells[told] = np.maximum(cells[told], min(before, _PASSABLE))
        grid = Grid(costs.frame, costs.resolution, costs.origin, cells)
        self._leave_way_home(grid)
        return grid

    def _follow(self, pose: Pose, *, stuck: bool) -> None:
        """Note the cells from the last place of base_link to this one."""
        side, last = self.settings.resolution, self._pose or pose
        gone = math.dist(pose[:2], last[:2])
        steps = max(math.ceil(2.0 * gone / side), 1)
        parts = [(k + 1) / steps for k in range(steps)] if gone <= LONGEST_STEP else [1.0]
        for part in parts:
            x, y = (a + part * (b - a) for a, b in zip(last[:2], pose[:2], strict=True))
            cell = math.floor(y / side), math.floor(x / side)
            self._track[cell] = self._track.get(cell, True) and not stuck

    def _leave_way_home(self, grid: Grid) -> None:
        """Where base_link itself has been it can be again: its own track is no obstacle, only dear."""
        free = [cell for cell, was_free in self._track.items() if was_free]
        if grid.frame != self.frame or not free:
            return
        row, column = np.array(free).T
        middle = (np.stack([row, column]) + 0.5) * self.settings.resolution
        at = np.floor((middle - np.array(grid.origin)[::-1, None]) / grid.resolution).astype(int)
        at = at[:, ((at >= 0) & (at < np.array(grid.cells.shape)[:, None])).all(axis=0)]
        grid.cells[tuple(at)] = np.minimum(grid.cells[tuple(at)], _PASSABLE)

    def _found(self) -> Grid | None:
        """What was found, newest on top, and what is expected of terrain classes."""
        ground = self._ground.grid(self.frame)
        if self.class_grid is not None:
            costs = self.classes.costs(self.class_grid)
        elif ground is not None and self.remembered is not None:
            blank = np.full_like(ground.cells, UNKNOWN)
            costs = Grid(ground.frame, ground.resolution, ground.origin, blank)
        else:
            return ground
        old = self.remembered
        if old is not None and costs.frame == old.frame:
            lay_over(costs, old)
        elif old is not None and costs.frame == self.frame and old.frame in self._frames:
            lay_over(costs, old, self._frames[old.frame].inverse())
        if ground is not None and costs.frame == self.frame:
            lay_over(costs, ground)
        return costs

    def _let_out(self, costs: Grid) -> None:
        """Leave no cell that cannot be crossed around a vehicle that stands on one, until it has left.

        A planner finds no way for a vehicle inside an obstacle. So far around it as costs are spread.
        """
        if self._pose is None or costs.frame != self.frame:
            self._held = None
            return
        far = self.outline.radius + max(self.spread, self.outline.half_width) + costs.resolution
        lethal = np.flatnonzero(costs.cells == HIGHEST)
        rows, columns = np.divmod(lethal, costs.cells.shape[1])
        x: NDArray[np.float64] = costs.origin[0] + costs.resolution * (columns + 0.5)
        y: NDArray[np.float64] = costs.origin[1] + costs.resolution * (rows + 0.5)
        gap = self.outline.gap(self._pose, x, y)
        touched = far if self._held is not None else 0.7 * costs.resolution
        inside = bool((gap <= touched).any())
        self._held = self._pose if inside else None
        if inside:
            costs.cells.flat[lethal[gap <= far]] = _PASSABLE

    def _enter(self, frame: str) -> None:
        """Note the frame; another one than before is another ground."""
        if frame != self.frame:
            if self.frame:
                remembered = self.remembered
                self.clear()
                self.remembered = remembered
            self.frame = frame

    @property
    def in_other_frame(self) -> bool:
        """Whether the classes' grid is in another frame than positions."""
        classes = self.class_grid
        return classes is not None and bool(self.frame) and classes.frame != self.frame

    @property
    def problem(self) -> str:
        """Why something that was given cannot be used, in words; empty where all can."""
        found = []
        if self.class_grid is not None and self.in_other_frame:
            found.append(
                f"terrain_classes is in frame {self.class_grid.frame}, positions are in"
                f" {self.frame}: it is not known on which class a wheel is, so the classes have no"
                " cost. Feed odometry of that frame, or publish the classes in it"
            )
        old = self.remembered
        if old is not None and self.frame and old.frame not in (self.frame, *self._frames):
            found.append(
                f"the saved cost map is in frame {old.frame}, positions are in {self.frame}: it is laid"
                " down once tf says where the one is in the other"
            )
        return "; ".join([*found, *self.classes.contradictions()])
