# SPDX-License-Identifier: Apache-2.0
"""The ground that a vehicle covers and has crossed: a window of cells that moves along with it.

At each axle the vehicle covers a strip over its whole width. If several wheels pass a cell in one
crossing, the highest cost counts; of several crossings, the newest.

Marks are costs on top of these: `HIGHEST` where the vehicle was stuck, less where a warning held. Once
the axle is a vehicle's length further on, the vehicle has got through, and the marks under this axle are
removed over the whole width. Otherwise they stay until a wheel itself has rolled over the cell, since
ground between the wheels has not been tested.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Cells, CostMapError, Grid, Pose
from smallwheel_ros.physics.wheel import Wheel

Line = tuple[tuple[float, float], tuple[float, float]]  # two places, m
Places = NDArray[np.int32]  # rows and columns on the frame's lattice, shape (2, places)
Indices = NDArray[np.intp]  # of places in the window's cells, row by row

_MOST_CELLS = 4_000_000
_MOST_OPEN = 1000  # strips with marks that are kept for a wheel, should it go to and fro
LONGEST_STEP = 2.0  # m between two places of a wheel; beyond, the path between them is not known


class Outline:
    """The rectangle that the wheels stand on, between the outer axles and the wheels' outer edges.

    Parameters
    ----------
    wheels
        All wheels of the vehicle, with their positions in base_link.

    Attributes
    ----------
    front, rear, left, right
        Positions of its sides in base_link, m; positive forward and to the left.
    radius
        Largest radius of a wheel, m, by which wheels protrude from it at the front and at the rear.
    half_width
        Distance from base_link to the outermost side, left or right, m.
    around
        Distance from base_link to the outermost corner, m: the distance that a planner that only knows
        base_link has to keep, since wheels swing out in a turn.
    length
        Length of the vehicle over its wheels, m.
    """

    def __init__(self, wheels: Sequence[Wheel]) -> None:
        ahead = [wheel.longitudinal_position for wheel in wheels]
        edges = [w.lateral_position + s * w.width for w in wheels for s in (-0.5, 0.5)]
        self.front, self.rear = max(ahead), min(ahead)
        self.left, self.right = max(edges), min(edges)
        self.radius = 0.5 * max(wheel.diameter for wheel in wheels)
        self.half_width = max(self.left, -self.right)
        self.around = math.hypot(max(self.front, -self.rear), self.half_width)
        self.length = self.front - self.rear + 2.0 * self.radius

    def across(self, pose: Pose, wheel: Wheel, course: float = 0.0) -> tuple[Line, Line]:
        """Compute the lines across the path that a wheel's axle covers: the vehicle's width, and the wheel's.

        Parameters
        ----------
        pose
            Pose of base_link.
        wheel
            The wheel.
        course
            Direction of travel to the left of the heading, rad. The lines are perpendicular to it.

        Returns
        -------
        whole, own : Line
            Left and right end of each line in the frame of the pose, m: over the width of the outline as
            seen in the direction of travel, and over the wheel's width.
        """
        cosine, sine = math.cos(course), math.sin(course)

        def aside(ahead: float, left: float) -> float:
            """Distance (m) of a place of the vehicle to the left of base_link's course."""
            return cosine * left - sine * ahead

        ahead, middle = wheel.longitudinal_position, wheel.lateral_position
        along = cosine * ahead + sine * middle
        to_x, to_y = math.cos(pose.heading + course), math.sin(pose.heading + course)
        x, y = pose.x + to_x * along, pose.y + to_y * along

        def line(left: float, right: float) -> Line:
            return (x - to_y * left, y + to_x * left), (x - to_y * right, y + to_x * right)

        corners = [
            aside(end, side) for end in (self.front, self.rear) for side in (self.left, self.right)
        ]
        own = aside(ahead, middle)
        whole = line(max(corners), min(corners))
        return whole, line(own + 0.5 * wheel.width, own - 0.5 * wheel.width)

    def gap(
        self, pose: Pose, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Compute the distance of places from the vehicle's outline.

        Parameters
        ----------
        pose
            Pose of base_link.
        x, y
            Places, m, any shape.

        Returns
        -------
        ndarray
            m, same shape; 0 within the outline.
        """
        ahead, left = pose.inverse().place(x, y)
        beyond = ahead - np.clip(ahead, self.rear, self.front)
        beside = left - np.clip(left, self.right, self.left)
        return np.hypot(beyond, beside)


def side_of(size: float, resolution: float) -> int:
    """Compute the number of cells along a window's side, rounded up.

    Parameters
    ----------
    size, resolution
        Side of the window, and of a cell, m.

    Raises
    ------
    CostMapError
        If a cell is larger than the window or not larger than 0, or the window has over 4 million cells.
    """
    if not 0 < resolution <= size < math.inf:
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
    """The ground under an axle from a wheel's last place to its present one."""

    across: tuple[Line, Line]
    places: tuple[Places, Places]  # under the whole width, and under the wheel
    at: list[Indices]  # of the places that are in the window
    travel: float
    cost: int  # the newest there
    mark: int  # the highest there
    ahead: tuple[float, float]  # unit vector of the axle's direction of travel, x and y

    @property
    def middle(self) -> tuple[float, float]:
        """Position x, y of the axle's middle, m."""
        (ax, ay), (bx, by) = self.across[0]
        return 0.5 * (ax + bx), 0.5 * (ay + by)


class CrossedGround:
    """Costs of crossed cells in a square window that follows the vehicle, and of crossed cells outside it.

    Corners of cells are at whole multiples of the resolution, wherever the window is.

    Parameters
    ----------
    size, resolution
        Side of the window and of a cell, m.
    length
        Length of the vehicle, m: wheels that pass a cell within this distance of travel belong to one
        crossing.

    Raises
    ------
    CostMapError
        If such a window is impossible (`side_of`).
    """

    def __init__(self, size: float, resolution: float, length: float = 0.0) -> None:
        self.resolution, self._length = resolution, length + resolution
        self._side = side_of(size, resolution)
        self._corner: tuple[int, int] | None = None  # row and column on the lattice
        self.clear()

    def clear(self) -> None:
        """Forget every cell; the window stays where it is."""
        self._empty()
        self._strips: dict[str, _Strip] = {}
        self._open: dict[str, list[_Strip]] = {}  # with marks, until the axle has got through
        self._left: list[tuple[Places, Cells]] = []  # cells that the window has left, oldest first

    def _empty(self) -> None:
        self._cells: Cells = np.full(self._side**2, UNKNOWN, dtype=np.int8)  # row by row
        self._marks: Cells = np.full(self._side**2, UNKNOWN, dtype=np.int8)
        self._travel = np.full(self._cells.shape, -np.inf, dtype=np.float32)  # when it was crossed

    def follow(self, x: float, y: float) -> bool:
        """Centre the window on a place if that is closer to the window's edge than a quarter of its side.

        Parameters
        ----------
        x, y
            The place, m.

        Returns
        -------
        bool
            Whether the window was moved.
        """
        at, side = (math.floor(y / self.resolution), math.floor(x / self.resolution)), self._side
        old, rim = self._corner, side // 4
        if old is not None and all(rim <= a - b < side - rim for a, b in zip(at, old, strict=True)):
            return False
        for strip in self._strips.values():
            self._lay(strip)
        known, places = self._known(np.maximum(self._cells, self._marks))
        costs, marks, travel = (each[known] for each in (self._cells, self._marks, self._travel))
        self._empty()
        self._corner = at[0] - side // 2, at[1] - side // 2
        still, inside = self._in_window(places)
        self._cells[still], self._travel[still] = costs[inside], travel[inside]
        self._marks[still] = marks[inside]
        self._left.append((places[:, ~inside], np.maximum(costs, marks)[~inside]))
        while sum(costs.size for _, costs in self._left) > _MOST_CELLS:
            self._left.pop(0)
        for strip in self._strips.values():
            strip.at = self._under(strip.places)
        return True

    def cross(
        self, wheel: str, across: tuple[Line, Line], travel: float, cost: int, mark: int = UNKNOWN
    ) -> bool:
        """Record the cost of the ground that a wheel's axle has crossed since the last call for that wheel.

        The window must have been placed by `follow`. As long as the wheel has moved by less than half a cell,
        a new call replaces the cost of the last one, and the higher of their marks counts. If it has moved by
        more than `LONGEST_STEP` (2 m), or `skip` was called, only the present place is recorded.

        Parameters
        ----------
        wheel
            Name of the wheel.
        across
            Present lines of the axle, as `Outline.across` returns them: the first over the vehicle's width,
            the second over the wheel's.
        travel
            Distance that the vehicle has travelled since its start, m; it tells crossings of a cell apart.
        cost
            Cost of the ground, 0 to 100; -1 if unknown: known costs of the cells then stay.
        mark
            Cost that later crossings do not lower until the vehicle has got through (see the module's
            docstring), such as 100 where it is stuck; -1 for none.

        Returns
        -------
        bool
            Whether a cell may have changed.
        """
        last = self._strips.get(wheel)
        start, ahead = across, _ahead(*across[0])
        if last is not None:
            gone = max(math.dist(a, b) for a, b in zip(across[0], last.across[0], strict=True))
            if gone < 0.5 * self.resolution:
                before = last.cost, last.mark
                last.cost, last.mark = cost, max(last.mark, mark)
                return (last.cost, last.mark) != before
            self.skip(wheel)
            if gone <= LONGEST_STEP:
                start, ahead = last.across, _way(last, across[0])
        whole, own = zip(start, across, strict=True)
        places = _swept(*whole, self.resolution), _swept(*own, self.resolution)
        at = self._under(places)
        self._strips[wheel] = strip = _Strip(across, places, at, travel, cost, mark, ahead)
        taken = self._take_back(wheel, strip.middle)
        return taken or bool((self._cells[at[0]] != cost).any() or mark != UNKNOWN)

    def _take_back(self, wheel: str, now: tuple[float, float]) -> bool:
        """Remove marks that an axle has passed by over a vehicle's length; return whether there were any."""
        still = []
        for strip in self._open.get(wheel, ()):
            (x, y), (c, s) = strip.middle, strip.ahead
            if c * (now[0] - x) + s * (now[1] - y) > self._length:
                at, _ = self._in_window(strip.places[0])
                self._marks[at[self._travel[at] - strip.travel < self._length]] = UNKNOWN
            else:
                still.append(strip)
        taken = len(still) < len(self._open.get(wheel, ()))
        self._open[wheel] = still[-_MOST_OPEN:]
        return taken

    def skip(self, wheel: str) -> None:
        """Record that a wheel's path from its last place on is unknown: the next strip begins anew."""
        last = self._strips.pop(wheel, None)
        if last is not None:
            self._lay(last)
            if last.mark != UNKNOWN:
                self._open.setdefault(wheel, []).append(last)

    def stuck_places(self) -> list[tuple[float, float]]:
        """Middles (m) of the cells where an axle got stuck and has not got through since, each once."""
        strips = [*self._strips.values(), *(one for each in self._open.values() for one in each)]
        cells = {
            tuple(math.floor(value / self.resolution) for value in strip.middle)
            for strip in strips
            if strip.mark == HIGHEST
        }
        return [((x + 0.5) * self.resolution, (y + 0.5) * self.resolution) for x, y in cells]

    def grid(self, frame: str) -> Grid | None:
        """Return the costs of the window as a grid in that frame, with marks; its cells are a copy.

        None before `follow` has placed the window, and if the frame's name is empty.
        """
        if self._corner is None or not frame:
            return None
        # Strips under the wheels may still change: they are written for this copy only, then taken back.
        under = np.concatenate(
            [np.empty(0, np.intp), *(at for one in self._strips.values() for at in one.at)]
        )
        layers: list[NDArray[Any]] = [self._cells, self._marks, self._travel]
        before = [layer[under] for layer in layers]
        for strip in self._strips.values():
            self._lay(strip)
        cells = np.maximum(self._cells, self._marks)
        for layer, values in zip(layers, before, strict=True):
            layer[under] = values
        row, column = self._corner
        origin = (column * self.resolution, row * self.resolution)
        return Grid(frame, self.resolution, origin, cells.reshape(self._side, self._side))

    def whole(self, frame: str) -> Grid | None:
        """Return all crossed ground, inside and outside the window, in that frame; None if there is none."""
        window = self.grid(frame)
        if window is None:
            return None
        known, under = self._known(window.cells)
        parts = [*self._left, (under, window.cells.ravel()[known])]
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
        """Write a strip into the window.

        Over the vehicle's width cells marked as stuck are left alone; under the wheel they are overwritten.
        """
        cells, marks, travel = self._cells, self._marks, self._travel
        for at, rolled in zip(strip.at, (False, True), strict=True):
            same = strip.travel - travel[at] < self._length
            if not rolled:
                taken = same | (marks[at] != HIGHEST)
                at, same = at[taken], same[taken]
            if strip.cost != UNKNOWN:
                cells[at] = np.where(same, np.maximum(cells[at], strip.cost), strip.cost)
            marks[at] = np.where(same, np.maximum(marks[at], strip.mark), strip.mark)
            travel[at] = strip.travel

    def _known(self, cells: Cells) -> tuple[Indices, Places]:
        """Indices of the known cells of the window, and their places on the lattice."""
        known = np.flatnonzero(cells != UNKNOWN)
        corner = (0, 0) if self._corner is None else self._corner
        places = np.stack(np.divmod(known, self._side)) + np.array(corner)[:, None]
        return known, places.astype(np.int32)

    def _in_window(self, places: Places) -> tuple[Indices, NDArray[np.bool_]]:
        """Indices in the window of the places that are inside it, and a mask of these places."""
        assert self._corner is not None
        from_corner = places - np.array(self._corner)[:, None]
        inside = ((from_corner >= 0) & (from_corner < self._side)).all(axis=0)
        return (from_corner[0] * self._side + from_corner[1])[inside], inside

    def _under(self, places: tuple[Places, Places]) -> list[Indices]:
        at, inside = self._in_window(np.concatenate(places, axis=1))
        first = int(np.count_nonzero(inside[: places[0].shape[1]]))
        return [at[:first], at[first:]]


def _ahead(left: tuple[float, float], right: tuple[float, float]) -> tuple[float, float]:
    """Unit vector (x, y) of the heading of a vehicle whose axle reaches from one place to the other."""
    x, y = left[1] - right[1], right[0] - left[0]
    size = math.hypot(x, y) or 1.0
    return x / size, y / size


def _way(last: _Strip, axle: Line) -> tuple[float, float]:
    """Unit vector (x, y) of an axle's motion since its last place; the last one if it has hardly moved."""
    (ax, ay), (bx, by) = axle
    x, y = 0.5 * (ax + bx) - last.middle[0], 0.5 * (ay + by) - last.middle[1]
    size = math.hypot(x, y)
    return (x / size, y / size) if size > 1e-3 else last.ahead


@functools.lru_cache(maxsize=16)
def _swept(start: Line, end: Line, resolution: float) -> Places:
    """The cells that a line sweeps from one place to another, from two points per cell each way.

    The last results are cached: all wheels of an axle need those of the vehicle's width.
    """
    length = max(math.dist(start[0], end[0]), math.dist(start[1], end[1]))
    first = np.array(start)  # (ends, x and y)
    along = _shares(math.ceil(2.0 * length / resolution))[:, None, None]
    lines = first + along * (np.array(end) - first)
    left, right = lines[:, :1], lines[:, 1:]
    aside = _shares(math.ceil(2.0 * math.dist(*end) / resolution))[:, None]
    places = np.floor((left + aside * (right - left)) / resolution).astype(np.int32)
    return np.ascontiguousarray(places.reshape(-1, 2)[:, ::-1].T)


@functools.lru_cache(maxsize=1000)
def _shares(steps: int) -> NDArray[np.float64]:
    """Numbers from 0 to 1 in equal steps, shape (1 + steps,)."""
    return np.linspace(0.0, 1.0, 1 + steps, dtype=np.float64)
