# SPDX-License-Identifier: Apache-2.0
"""What is expected of ground that no wheel has been on, from its terrain class and its slope.

For a class, it is the margin that wheels have met on it, or its prior. If the slope of a cell is known as
well, the slope is subtracted; where the class is unknown, the margin is the largest one that ground like the
present one gives at any slip.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from smallwheel_ros.costmap.cost import Array, CostSettings
from smallwheel_ros.costmap.elevation import Elevation
from smallwheel_ros.costmap.grid import UNKNOWN, Cells, Grid
from smallwheel_ros.costmap.terrain import PRIORS, REFERENCE_SLIP, TerrainClasses
from smallwheel_ros.physics.wheel import Quantity


class GroundAhead:
    """Predicted costs of the ground ahead; none of them is over 99.

    Parameters
    ----------
    settings
        Settings of the cost map.
    prior
        Largest pull over load (1) to expect of any ground before driving; None if unknown.
    names
        Names of the terrain classes, in the order of their numbers. Classes in `PRIORS` have a margin before
        any wheel is on them.
    reference_slip
        Slip at which margins are defined, 1.

    Attributes
    ----------
    classes
        Margins of the terrain classes.
    class_grid, elevation
        The newest grid of terrain classes, and the newest slopes; None before the first.
    most
        Largest pull over load (1) of ground like the present one; `prior` before the vehicle has driven.
    """

    def __init__(
        self,
        settings: CostSettings,
        prior: Quantity | None,
        names: Sequence[str] = (),
        reference_slip: float = REFERENCE_SLIP,
    ) -> None:
        self._settings, self._prior = settings, prior
        self._names = tuple(names)
        named = {
            number: PRIORS[name].met(reference_slip)
            for number, name in enumerate(names)
            if name in PRIORS
        }
        self.classes = TerrainClasses(settings.rules, settings.resolution, named)
        self.class_grid: Grid | None = None
        self.elevation: Elevation | None = None
        self.most = prior
        # The table by class number, and the costs computed from it: computed anew once the table or the grid
        # changes.
        self._level: tuple[Cells, Grid] | None = None
        self._sloping: tuple[Array, Grid] | None = None
        self._numbers: Cells | None = None  # class number of each cell of the elevation, as a byte

    def clear(self) -> None:
        """Forget margins that were measured; keep the grids of ground ahead."""
        self.classes.clear()
        self.most = self._prior

    def take_classes(self, grid: Grid) -> bool:
        """Take a grid of terrain classes (0 and above); return whether it differs from the last one."""
        before = self.class_grid
        if (
            before is not None
            and before.geometry == grid.geometry
            and np.array_equal(before.cells, grid.cells)
        ):
            return False
        self.class_grid = grid
        self._level = self._sloping = self._numbers = None
        return True

    def take_elevation(self, elevation: Elevation) -> None:
        """Take the slopes of ground ahead."""
        self.elevation = elevation
        self._sloping = self._numbers = None

    def class_at(self, frame: str, x: float, y: float) -> int:
        """Look up the terrain class of a place.

        Parameters
        ----------
        frame
            Name of the frame of the place.
        x, y
            The place, m.

        Returns
        -------
        int
            Number of the class; -1 outside of the grid, in a frame other than the grid's, and where the grid
            has none.
        """
        grid = self.class_grid
        cell = grid.cell(x, y) if grid is not None and grid.frame == frame else None
        return UNKNOWN if grid is None or cell is None else int(grid.cells[cell])

    def stuck_at(self, frame: str, places: Iterable[tuple[float, float]]) -> None:
        """Count places where the vehicle got stuck and has not got through since, for their terrain classes.

        They replace those of the last call. Without a grid of classes nothing is done.

        Parameters
        ----------
        frame
            Name of the frame of the places.
        places
            x and y of each place, m.
        """
        if self.class_grid is not None:
            self.classes.stuck_at(self.class_at(frame, x, y) for x, y in places)

    def by_class(self) -> Grid | None:
        """Costs of level ground by its terrain class, as a copy; None without a grid of classes."""
        if self.class_grid is None:
            return None
        table = self.classes.table(self._other)
        if self._level is None or not np.array_equal(self._level[0], table):
            self._level = table, self.classes.costs(self.class_grid, self._other)
        costs = self._level[1]
        return replace(costs, cells=costs.cells.copy())

    @property
    def _other(self) -> Quantity | None:
        """Largest pull over load of a class of which nothing is known; None: such a class has no cost."""
        return self._prior if self._settings.unknown == "prior" else None

    def by_slope(self) -> Grid | None:
        """Cost of cells with a known slope; None without an elevation map."""
        ahead = self.elevation
        if ahead is None:
            return None
        table = self._moments()
        if self._sloping is None or not np.array_equal(self._sloping[0], table, equal_nan=True):
            # In single precision: for whole per cents, in half the time.
            margin, variance = (one.astype(np.float32) for one in self._margins(ahead, table))
            slope, deviation = (one.astype(np.float32) for one in (ahead.slope, ahead.deviation))
            cells = self._settings.rules.expected(
                margin - slope, np.sqrt(variance + np.square(deviation))
            )
            self._sloping = table, Grid(ahead.frame, ahead.resolution, ahead.origin, cells)
        return self._sloping[1]

    def _moments(self) -> Array:
        """Mean and variance of the largest margin of each class, shape (2, 256), by the byte of its int8.

        Ground that is not classified (negative numbers) has the margin of ground like the present one.
        """
        table = np.full((2, 256), np.nan)
        table[:, :128] = np.array(_moments(self._other))[:, None]
        table[:, 128:] = np.array(_moments(self.most))[:, None]
        for terrain, most in self.classes.most().items():
            table[:, terrain] = _moments(most)
        return table

    def _margins(self, ahead: Elevation, table: Array) -> tuple[Array, Array]:
        """Largest margin of each cell of an elevation, and its variance, by the cell's class."""
        if self._numbers is None:
            self._numbers = self._classes_of(ahead).view(np.uint8)
        mean, variance = (one.take(self._numbers) for one in table.astype(np.float32))
        if not ahead.classes:
            return mean, variance
        # Probabilities of several classes: moments of their mixture; the rest of the probability is for the
        # cell's class in the grid of classes.
        total = np.maximum(sum(ahead.classes.values(), np.zeros(mean.shape)), 1.0)
        rest = np.ones(mean.shape)
        first, second = np.zeros((2, *mean.shape))
        for name, share in ahead.classes.items():
            value, spread = table[:, self._names.index(name)]
            part = share / total
            rest, first, second = (
                rest - part,
                first + part * value,
                second + part * (spread + value**2),
            )
        rest = np.maximum(rest, 0.0)
        first, second = first + rest * mean, second + rest * (variance + mean**2)
        return first, np.maximum(second - first**2, 0.0)

    def _classes_of(self, ahead: Elevation) -> Cells:
        """Class number of each cell of an elevation, int8."""
        grid = self.class_grid
        found: Cells = np.full(ahead.slope.shape, UNKNOWN, dtype=np.int8)
        if grid is None or grid.frame != ahead.frame:
            return found
        at, inside = [], []
        for axis in (0, 1):
            middles = ahead.origin[1 - axis] + ahead.resolution * (
                np.arange(found.shape[axis]) + 0.5
            )
            index = np.floor((middles - grid.origin[1 - axis]) / grid.resolution)
            index = index.astype(np.intp)
            inside.append((index >= 0) & (index < grid.cells.shape[axis]))
            at.append(index[inside[-1]])
        # The indices inside are consecutive.
        rows, columns = (
            slice(int(np.argmax(one)), int(np.argmax(one)) + int(one.sum())) for one in inside
        )
        found[rows, columns] = grid.cells.take(at[0], axis=0).take(at[1], axis=1)
        return found


def _moments(margin: Quantity | None) -> tuple[float, float]:
    """Mean and variance; NaN of None."""
    return (np.nan, np.nan) if margin is None else (margin.value, margin.standard_deviation**2)
