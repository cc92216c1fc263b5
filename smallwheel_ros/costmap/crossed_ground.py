# SPDX-License-Identifier: Apache-2.0
"""The ground that the wheels have crossed: a window of cells that goes along with the robot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.costmap.grid import UNKNOWN, Cells, CostMapError, Grid

Indices = NDArray[np.int64]

_MOST_CELLS = 4_000_000
_LONGEST_STEP = 2.0  # m between two places of a wheel; over more nobody knows the way


class CrossedGround:
    """Costs of crossed cells; those that the window leaves behind are forgotten.

    Cells lie on one lattice of the frame, whatever the window's place.

    Parameters
    ----------
    size, resolution
        Side of the window and of a cell, m.
    """

    def __init__(self, size: float, resolution: float) -> None:
        if not (math.isfinite(size) and math.isfinite(resolution) and 0 < resolution <= size):
            raise CostMapError(
                f"size is {size!r} m and resolution {resolution!r} m, expected 0 < resolution <="
                " size"
            )
        self.resolution = resolution
        self._side = math.ceil(size / resolution)
        if self._side**2 > _MOST_CELLS:
            raise CostMapError(
                f"{size:g} m at {resolution:g} m are {self._side**2} cells, expected at most"
                f" {_MOST_CELLS}: a smaller size or a larger resolution"
            )
        self._cells: Cells = np.full((self._side, self._side), UNKNOWN, dtype=np.int8)
        self._corner: tuple[int, int] | None = None  # row and column on the lattice
        self._last: dict[str, tuple[float, float]] = {}

    @property
    def placed(self) -> bool:
        """Whether the window has a place yet."""
        return self._corner is not None

    def clear(self) -> None:
        """Forget every cell; the window stays where it is."""
        self._cells.fill(UNKNOWN)
        self._last.clear()

    def follow(self, x: float, y: float) -> bool:
        """Let the window hold this place (m); return whether it was moved."""
        row, column = self._lattice(y), self._lattice(x)
        if self._corner is None:
            self._corner = (row - self._side // 2, column - self._side // 2)
            return True
        rim = self._side // 4
        inside = (
            rim <= at - start < self._side - rim
            for at, start in zip((row, column), self._corner, strict=True)
        )
        if all(inside):
            return False
        corner = (row - self._side // 2, column - self._side // 2)
        self._cells = self._shifted(corner[0] - self._corner[0], corner[1] - self._corner[1])
        self._corner = corner
        return True

    def moved(self, wheel: str, x: float, y: float) -> bool:
        """Whether a wheel has moved by half a cell or more since its last crossing."""
        last = self._last.get(wheel)
        return last is None or math.hypot(x - last[0], y - last[1]) >= 0.5 * self.resolution

    def cross(self, wheel: str, x: float, y: float, width: float, cost: int) -> bool:
        """Give a cost to the cells between a wheel's last place and this one (m), as wide as it is.

        The newest crossing of a cell counts. Returns whether any cell has changed.
        """
        moved = self.follow(x, y)
        assert self._corner is not None
        start = self._last.get(wheel, (x, y))
        self._last[wheel] = (x, y)
        if math.hypot(x - start[0], y - start[1]) > _LONGEST_STEP:
            start = (x, y)
        rows, columns = self._swath(start, (x, y), width)
        before = self._cells[rows, columns]
        self._cells[rows, columns] = cost
        return moved or bool((before != cost).any())

    def skip(self, wheel: str) -> None:
        """Note that from here on nothing is known of a wheel's way."""
        self._last.pop(wheel, None)

    def grid(self, frame: str) -> Grid:
        """Return the window as a grid of that frame; its cells are a copy.

        Raises CostMapError before `follow` or `cross` have given it a place.
        """
        if self._corner is None:
            raise CostMapError("the window has no place yet: no odometry has come")
        row, column = self._corner
        origin = (column * self.resolution, row * self.resolution)
        return Grid(frame, self.resolution, origin, self._cells.copy())

    def _lattice(self, value: float) -> int:
        return math.floor(value / self.resolution)

    def _shifted(self, rows: int, columns: int) -> Cells:
        """The cells of a window that lies further along by so many rows and columns."""
        side = self._side
        cells: Cells = np.full((side, side), UNKNOWN, dtype=np.int8)
        if abs(rows) < side and abs(columns) < side:
            cells[_overlap(-rows, side), _overlap(-columns, side)] = self._cells[
                _overlap(rows, side), _overlap(columns, side)
            ]
        return cells

    def _swath(
        self, start: tuple[float, float], end: tuple[float, float], width: float
    ) -> tuple[Indices, Indices]:
        """Rows and columns of the cells under a strip, those outside of the window left out."""
        assert self._corner is not None
        (x0, y0), (x1, y1) = start, end
        length = math.hypot(x1 - x0, y1 - y0)
        across = ((y0 - y1) / length, (x1 - x0) / length) if length > 0 else (0.0, 1.0)
        # Two points to a cell, so that none is jumped over.
        along = np.linspace(0.0, 1.0, 1 + math.ceil(2.0 * length / self.resolution))
        aside = np.linspace(-0.5, 0.5, 1 + math.ceil(2.0 * width / self.resolution)) * width
        x = (x0 + along * (x1 - x0))[:, None] + aside * across[0]
        y = (y0 + along * (y1 - y0))[:, None] + aside * across[1]
        rows = np.floor(y / self.resolution).astype(np.int64).ravel() - self._corner[0]
        columns = np.floor(x / self.resolution).astype(np.int64).ravel() - self._corner[1]
        inside = (rows >= 0) & (rows < self._side) & (columns >= 0) & (columns < self._side)
        return rows[inside], columns[inside]


def _overlap(shift: int, side: int) -> slice:
    return slice(max(shift, 0), min(side + shift, side))
