# SPDX-License-Identifier: Apache-2.0
"""The ground that a vehicle has crossed: a window of cells that goes along with it.

At each axle it covers a strip over its whole width. Of the wheels that pass a cell in one crossing the
worst counts, of several crossings the newest. Where it was stuck stays so until a wheel itself has
rolled over the cell: what is between wheels tells nothing against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError, Grid
from smallwheel_ros.costmap.vehicle import Line

Places = NDArray[np.int32]  # rows and columns on the frame's lattice, shape (2, places)

_MOST_CELLS = 4_000_000
_LONGEST_STEP = 2.0  # m between two places of a wheel; over more nobody knows the way


def side_of(size: float, resolution: float) -> int:
    """Cells along a window's side. Raises CostMapError where there can be no such window."""
    if not (math.isfinite(size) and math.isfinite(resolution) and 0 < resolution <= size):
        raise CostMapError(
            f"size is {size!r} m and resolution {resolution!r} m, expected 0 < resolution <= size"
        )
    side = math.ceil(size / resolution)
    if side**2 > _MOST_CELLS:
        raise CostMapError(
            f"{size:g} m at {resolution:g} m are {side**2} cells, expected at most"
            f" {_MOST_CELLS}: a smaller size or a larger resolution"
        )
    return side


@dataclass
class _Strip:
    """The ground under an axle from a wheel's last place to this one; cost: the newest there."""

    across: tuple[Line, Line]
    whole: Places
    own: Places
    travel: float
    cost: int
    stuck: bool


class CrossedGround:
    """Costs of crossed cells, on one lattice of the frame whatever the window's place.

    Parameters
    ----------
    size, resolution
        Side of the window and of a cell, m.
    length
        m of travel over which a cell is in one crossing: the vehicle's length.
    """

    def __init__(self, size: float, resolution: float, length: float = 0.0) -> None:
        self.resolution, self._length = resolution, length + resolution
        self._side = side_of(size, resolution)
        self._corner: tuple[int, int] | None = None  # row and column on the lattice
        self.clear()

    @property
    def placed(self) -> bool:
        """Whether the window has a place yet."""
        return self._corner is not None

    def clear(self) -> None:
        """Forget every cell; the window stays where it is."""
        self._cells: Cells = np.full((self._side, self._side), UNKNOWN, dtype=np.int8)
        self._travel = np.full(self._cells.shape, -np.inf, dtype=np.float32)  # when it was crossed
        self._strips: dict[str, _Strip] = {}
        self._left: list[tuple[Places, Cells]] = []  # by the window behind it, oldest first

    def follow(self, x: float, y: float) -> bool:
        """Let the window hold this place (m); return whether it was moved."""
        at, side = (math.floor(y / self.resolution), math.floor(x / self.resolution)), self._side
        old, rim = self._corner, side // 4
        if old is not None and all(rim <= a - b < side - rim for a, b in zip(at, old, strict=True)):
            return False
        if old is not None:
            for strip in self._strips.values():
                self._lay(strip)
        self._corner = new = at[0] - side // 2, at[1] - side // 2
        if old is not None:
            cells, travel = self._cells, self._travel
            self._keep(cells, old, new)
            self._cells = np.full((side, side), UNKNOWN, dtype=np.int8)
            self._travel = np.full((side, side), -np.inf, dtype=np.float32)
            shift = new[0] - old[0], new[1] - old[1]
            to, since = (
                tuple(slice(max(s * by, 0), max(side + min(s * by, 0), 0)) for by in shift)
                for s in (-1, 1)
            )
            self._cells[to], self._travel[to] = cells[since], travel[since]
        return True

    def _keep(self, cells: Cells, old: tuple[int, int], new: tuple[int, int]) -> None:
        """Note known cells of the old window that are outside of the new one; the oldest go."""
        found = np.argwhere(cells != UNKNOWN).T
        places = (found + np.array(old)[:, None]).astype(np.int32)
        gone = ~self._inside(places, new)
        self._left.append((places[:, gone], cells[found[0, gone], found[1, gone]]))
        while sum(costs.size for _, costs in self._left) > _MOST_CELLS:
            self._left.pop(0)

    def cross(
        self, wheel: str, across: tuple[Line, Line], travel: float, cost: int, *, stuck: bool
    ) -> bool:
        """Take the cost of where a wheel is now; return whether any cell has changed.

        across: the vehicle's width at the wheel's axle, and the wheel's own. travel: of the vehicle, m.
        As long as the wheel is there its newest cost counts, but where it was stuck it was stuck.
        """
        (left, right), _ = across
        moved = self.follow(0.5 * (left[0] + right[0]), 0.5 * (left[1] + right[1]))
        last = self._strips.get(wheel)
        start = across
        if last is not None:
            gone = max(math.dist(a, b) for a, b in zip(across[0], last.across[0], strict=True))
            if gone < 0.5 * self.resolution:
                before = last.cost
                last.stuck |= stuck
                last.cost = HIGHEST if last.stuck else cost
                return moved or last.cost != before
            self.skip(wheel)
            start = last.across if gone <= _LONGEST_STEP else across
        whole, own = (self._swept(a, b) for a, b in zip(start, across, strict=True))
        cost = HIGHEST if stuck else cost
        self._strips[wheel] = _Strip(across, whole, own, travel, cost, stuck)
        return moved or bool((self._cells[self._indices(whole)] != cost).any())

    def skip(self, wheel: str) -> None:
        """Note that from here on nothing is known of a wheel's way."""
        last = self._strips.pop(wheel, None)
        if last is not None:
            self._lay(last)

    def grid(self, frame: str) -> Grid:
        """Return the window as a grid of that frame; its cells are a copy.

        Raises CostMapError before `follow` or `cross` have given it a place.
        """
        if self._corner is None:
            raise CostMapError("the window has no place yet: no odometry has come")
        # What is under the wheels may still change: it is laid down for this copy only.
        touched = [self._indices(strip.whole) for strip in self._strips.values()]
        before = [(at, self._cells[at], self._travel[at]) for at in touched]
        for strip in self._strips.values():
            self._lay(strip)
        cells = self._cells.copy()
        for at, costs, travel in before:
            self._cells[at], self._travel[at] = costs, travel
        row, column = self._corner
        origin = (column * self.resolution, row * self.resolution)
        return Grid(frame, self.resolution, origin, cells)

    def whole(self, frame: str) -> Grid | None:
        """Return all that was crossed, also what the window has left behind; None where nothing is."""
        if self._corner is None:
            return None
        now = self.grid(frame).cells
        found = np.argwhere(now != UNKNOWN).T
        parts = [*self._left, (found + np.array(self._corner)[:, None], now[tuple(found)])]
        places = np.concatenate([part for part, _ in parts], axis=1)
        if places.size == 0:
            return None
        low, high = places.min(axis=1), places.max(axis=1)
        cells: Cells = np.full(tuple(high - low + 1), UNKNOWN, dtype=np.int8)
        for part, costs in parts:
            cells[tuple(part - low[:, None])] = costs
        origin = (float(low[1]) * self.resolution, float(low[0]) * self.resolution)
        return Grid(frame, self.resolution, origin, cells)

    def _lay(self, strip: _Strip) -> None:
        """Write a strip: over its width but for where it was stuck before, under the wheel there too."""
        for places, rolled in ((strip.whole, False), (strip.own, True)):
            at = self._indices(places)
            old, same = self._cells[at], strip.travel - self._travel[at] < self._length
            stays = ~same & (old == HIGHEST) & (not rolled)
            new = np.where(same, np.maximum(old, strip.cost), strip.cost)
            self._cells[at] = np.where(stays, old, new)
            self._travel[at] = np.where(stays, self._travel[at], strip.travel)

    def _inside(self, places: NDArray[np.integer], corner: tuple[int, int]) -> NDArray[np.bool_]:
        at = places - np.array(corner)[:, None]
        return np.asarray(((at >= 0) & (at < self._side)).all(axis=0))

    def _indices(self, places: Places) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        """Rows and columns in the window; those outside of it are left out."""
        assert self._corner is not None
        rows, columns = places[:, self._inside(places, self._corner)]
        return rows - self._corner[0], columns - self._corner[1]

    def _swept(self, start: Line, end: Line) -> Places:
        """The cells that a line sweeps from one place to another: two points to a cell each way."""
        first, last = np.array(start), np.array(end)  # (ends, x and y)
        length = float(np.max(np.hypot(*(last - first).T)))
        width = math.dist(*end)
        s = np.linspace(0.0, 1.0, 1 + math.ceil(2.0 * length / self.resolution))[:, None, None]
        u = np.linspace(0.0, 1.0, 1 + math.ceil(2.0 * width / self.resolution))[None, :, None]
        left = first[0] + s * (last[0] - first[0])
        right = first[1] + s * (last[1] - first[1])
        places = np.floor((left + u * (right - left)) / self.resolution).astype(np.int32)
        return np.ascontiguousarray(places.reshape(-1, 2)[:, ::-1].T)
