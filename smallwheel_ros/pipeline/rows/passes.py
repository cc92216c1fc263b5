# SPDX-License-Identifier: Apache-2.0
"""Number of times that ground has been rolled over, from the vehicle's own tracks in the odometry's frame.

    number = 1 + earlier crossings of this place by wheels that roll, this wheel included

A track whose middle is within half the wheel's width is the same track; one within a whole width overlaps
partly, and the number is unknown. It is also unknown without positions, and at the beginning, until a wheel
has left the ground that the vehicle stood on. Once the odometry has drifted by half a width, ground that is
crossed again counts as fresh.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Aligned, Array, Flags

_MOST = 40_000  # points: some hundreds of metres, over which few odometries keep to half a wheel's width
_LONGEST = 1.0  # m between two places of a wheel; over more the odometry began anew
_BETWEEN = 0.25  # widths between two points of a track


class _Point(NamedTuple):
    """Position of a wheel (m, odometry's frame), its number, and the vehicle's travel until then (m)."""

    x: float
    y: float
    wheel: int
    travel: float


class Passes:
    """Counts the passes over each place, from the tracks of the vehicle's wheels so far."""

    def __init__(self, wheels: Sequence[Wheel]) -> None:
        self._wheels = wheels
        rolls = [wheel for wheel in wheels if wheel.contact == ROLLING]
        places = {(wheel.longitudinal_position, wheel.lateral_position) for wheel in rolls}
        self._told = (
            len(places) == len(rolls) > 0
        )  # else the parameters do not say where the wheels are
        self._side = max((wheel.width for wheel in rolls), default=1.0)
        self._ahead = [wheel.longitudinal_position for wheel in rolls]
        self._forget()

    def _forget(self) -> None:
        self._cells: dict[tuple[int, int], list[_Point]] = {}
        self._order: deque[tuple[int, int]] = deque()  # cells of the points, the oldest first
        self._last: dict[int, tuple[_Point, float]] = {}  # with the number there
        self._begin = math.nan

    def numbers(self, rows: Aligned, distance: Array, onward: Flags) -> Array:
        """Compute the pass number at each row, and add the rows to the tracks.

        Parameters
        ----------
        rows
            Aligned rows, in order of stamps.
        distance
            Distance that the vehicle has travelled, shape (rows,), m.
        onward
            Whether the vehicle goes forward, shape (rows,).

        Returns
        -------
        ndarray
            Shape (rows,): 1 on fresh ground, 2 at the second pass and so on; NaN where it is not known.
        """
        found = np.full_like(distance, np.nan)
        cosine, sine = np.cos(rows.heading), np.sin(rows.heading)
        along = np.array([wheel.longitudinal_position for wheel in self._wheels])[rows.wheel]
        aside = np.array([wheel.lateral_position for wheel in self._wheels])[rows.wheel]
        x, y = rows.x + cosine * along - sine * aside, rows.y + sine * along + cosine * aside
        rolls = np.array([wheel.contact == ROLLING for wheel in self._wheels])[rows.wheel]
        mine = np.flatnonzero(rolls & np.isfinite(x) & np.isfinite(y) & self._told)
        columns = (x, y, rows.wheel, distance, onward)
        found[mine] = [
            self._number(*row) for row in zip(*(c[mine].tolist() for c in columns), strict=True)
        ]
        return found

    def _number(self, x: float, y: float, number: int, travel: float, onward: bool) -> float:
        wheel, last = self._wheels[number], self._last.get(number)
        moved = math.inf if last is None else math.hypot(x - last[0].x, y - last[0].y)
        if last is not None and moved > _LONGEST:
            self._forget()
            last = None
        if math.isnan(self._begin):
            self._begin = travel
        if last is not None and moved < _BETWEEN * wheel.width:
            return last[1]
        point = _Point(x, y, number, travel)
        first = max(self._ahead) if onward else min(self._ahead)
        behind = abs(first - wheel.longitudinal_position)
        passes = self._crossings(point, wheel.width)
        if travel - self._begin <= behind + self._side:
            passes = math.nan
        self._last[number] = point, passes
        self._add(point)
        return passes

    def _cell(self, point: _Point) -> tuple[int, int]:
        return math.floor(point.x / self._side), math.floor(point.y / self._side)

    def _add(self, point: _Point) -> None:
        cell = self._cell(point)
        self._cells.setdefault(cell, []).append(point)
        self._order.append(cell)
        if len(self._order) > _MOST:
            oldest = self._order.popleft()
            del self._cells[oldest][0]
            if not self._cells[oldest]:
                del self._cells[oldest]

    def _crossings(self, point: _Point, width: float) -> float:
        """1 + the number of earlier crossings of a place; NaN where a track overlaps it only in part."""
        column, row = self._cell(point)
        near: dict[int, list[_Point]] = {}
        for i in (column - 1, column, column + 1):
            for j in (row - 1, row, row + 1):
                for earlier in self._cells.get((i, j), ()):
                    if math.hypot(point.x - earlier.x, point.y - earlier.y) < width:
                        near.setdefault(earlier.wheel, []).append(earlier)
        number = 1.0
        for wheel, mine in near.items():
            crossings: list[list[_Point]] = []
            for one in sorted(mine, key=lambda each: each.travel):
                if crossings and one.travel - crossings[-1][-1].travel <= 2.0 * width:
                    crossings[-1].append(one)
                else:
                    crossings.append([one])
            for crossing in crossings:
                if wheel == point.wheel and point.travel - crossing[-1].travel <= 2.0 * width:
                    continue  # this very one
                if min(math.dist(point[:2], one[:2]) for one in crossing) > width / 2.0:
                    return math.nan
                number += 1.0
        return number
