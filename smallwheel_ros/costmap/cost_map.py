# SPDX-License-Identifier: Apache-2.0
"""The cost map: the ground that was crossed, and terrain classes where a classifier gives them.

map = CostMap(CostSettings())
map.add("front_left", "odom", (3.1, 0.2), 0.1, Quantity(0.12, 0.02))
grid = map.grid()
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.costmap.crossed_ground import CrossedGround
from smallwheel_ros.costmap.grid import HIGHEST, CostMapError, Grid
from smallwheel_ros.costmap.terrain_classes import TerrainClasses
from smallwheel_ros.physics.wheel import Quantity

_NOTHING_HELD = Quantity(-1.0, 0.0)  # a wheel that its own load holds back


@dataclass(frozen=True)
class CostSettings:
    """What the cost map is to be.

    Attributes
    ----------
    resolution, size
        Side of a cell and of the window that follows the robot, m.
    period
        Shortest time between two publications, s.
    frame
        Name of the frame that positions are in; empty: the one that odometry says.
    slope
        "measured": cost is the risk on the slope that was measured at a place; "level": on level ground.
    rules
        How a margin becomes a cost.

    Raises CostMapError where a number is outside its domain.
    """

    resolution: float = 0.1
    size: float = 40.0
    period: float = 1.0
    frame: str = ""
    slope: str = "measured"
    rules: CostRules = field(default_factory=CostRules)

    def __post_init__(self) -> None:
        """Check what no other class checks."""
        CrossedGround(self.size, self.resolution)
        if not self.period > 0:
            raise CostMapError(f"period is {self.period!r} s, expected more than 0")


class CostMap:
    """Costs of ground, from wheels' margins as they come.

    changed: whether the grid differs from the one given last. problem: why terrain classes cannot
    be learnt, in words; empty where they can, or where there are none.
    """

    def __init__(self, settings: CostSettings) -> None:
        self.settings = settings
        self.changed = False
        self.problem = ""
        self._ground = CrossedGround(settings.size, settings.resolution)
        self.classes = TerrainClasses(settings.rules, settings.resolution)
        self._class_grid: Grid | None = None
        self._frame = settings.frame

    def clear(self) -> None:
        """Forget all that wheels have found; the classes' grid stays."""
        self._ground.clear()
        self.classes.clear()
        self.changed = self._ground.placed or self._class_grid is not None

    def follow(self, frame: str, x: float, y: float) -> None:
        """Let the window go along with the robot, which is at this place (m) of that frame."""
        self._enter(frame)
        self.changed |= self._ground.follow(x, y)

    def add(
        self,
        wheel: str,
        frame: str,
        place: tuple[float, float],
        width: float,
        margin: Quantity | None,
        *,
        stuck: bool = False,
        slope: float = 0.0,
    ) -> None:
        """Take what a wheel of some width (m) has found at its place (m).

        slope: of the ground there, a tangent; terrain classes are learnt without it.
        margin: None where nothing is known there. stuck: it cannot move on there, whatever the
        margin is: sunk to its axle, or digging itself in.
        """
        self._enter(frame)
        x, y = place
        if margin is None and not stuck:
            self._ground.skip(wheel)
            return
        if not (stuck or self._ground.moved(wheel, x, y)):
            return
        cost = HIGHEST
        if margin is not None and not stuck:
            cost = int(self.settings.rules.cost(margin.value - slope, margin.standard_deviation))
        self.changed |= self._ground.cross(wheel, x, y, width, cost)
        if stuck:
            # A place of its own, although the wheel has not moved since it last counted.
            self._learn(f"{wheel}, stuck", x, y, _NOTHING_HELD)
        elif margin is not None:
            self._learn(wheel, x, y, margin)

    def take_classes(self, grid: Grid) -> None:
        """Take a grid of terrain classes: whole numbers from 0 on, below 0 is not classified."""
        before = self._class_grid
        if (
            before is not None
            and before.geometry == grid.geometry
            and np.array_equal(before.cells, grid.cells)
        ):
            return
        self._class_grid = grid
        self._check_frames()
        self.changed = True

    @property
    def class_grid(self) -> Grid | None:
        """The newest grid of terrain classes."""
        return self._class_grid

    def grid(self) -> Grid | None:
        """Return the costs as they are now; None as long as there is no place to speak of.

        With terrain classes the cells are theirs: those that were crossed have what was found
        there, the others what is expected of their class. Without, they are the window's.
        """
        self.changed = False
        if self._class_grid is None:
            return self._ground.grid(self._frame) if self._frame and self._ground.placed else None
        costs = self.classes.costs(self._class_grid)
        if self._ground.placed and costs.frame == self._frame:
            _lay_over(costs, self._ground.grid(self._frame))
        return costs

    def _enter(self, frame: str) -> None:
        """Note the frame; another one than before is another ground."""
        frame = self.settings.frame or frame
        if frame != self._frame:
            if self._frame:
                self.clear()
            self._frame = frame
            self._check_frames()

    def _check_frames(self) -> None:
        self.problem = ""
        if self._class_grid is not None and self._frame and self._class_grid.frame != self._frame:
            self.problem = (
                f"terrain_classes is in frame {self._class_grid.frame}, positions are in"
                f" {self._frame}: nobody can tell on which class a wheel is, so the classes have no"
                " cost. Feed odometry of that frame, or set cost.frame if it is the same"
            )

    def _learn(self, wheel: str, x: float, y: float, margin: Quantity) -> None:
        classes = self._class_grid
        if classes is None or self.problem:
            return
        cell = classes.cell(x, y)
        if cell is not None:
            counted = self.classes.learn(wheel, x, y, int(classes.cells[cell]), margin)
            self.changed |= counted


def _lay_over(costs: Grid, ground: Grid) -> None:
    """Write the known cells of a window into a grid of the same frame: of several, the worst."""
    # The dearest last: of several that are written to one cell, the last one stays.
    known = np.flatnonzero(ground.cells >= 0)
    known = known[np.argsort(ground.cells.ravel()[known], kind="stable")]
    rows, columns = np.divmod(known, ground.cells.shape[1])
    scale = ground.resolution / costs.resolution
    # Where the window's cells are the coarser ones, each covers several: look at their parts.
    count = math.ceil(scale)
    parts = (np.arange(count) + 0.5) / count
    y = (ground.origin[1] - costs.origin[1]) / costs.resolution + scale * (rows[:, None] + parts)
    x = (ground.origin[0] - costs.origin[0]) / costs.resolution + scale * (columns[:, None] + parts)
    at_row = np.floor(y).astype(np.int64)[:, :, None] + np.zeros(parts.size, np.int64)
    at_column = np.floor(x).astype(np.int64)[:, None, :] + np.zeros((parts.size, 1), np.int64)
    cost = np.broadcast_to(ground.cells[rows, columns][:, None, None], at_row.shape)
    inside = (at_row >= 0) & (at_row < costs.cells.shape[0])
    inside &= (at_column >= 0) & (at_column < costs.cells.shape[1])
    costs.cells[at_row[inside], at_column[inside]] = cost[inside]
