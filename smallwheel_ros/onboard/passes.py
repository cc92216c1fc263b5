# SPDX-License-Identifier: Apache-2.0
"""How often wheels have rolled over a place before: the pass number of a measurement.

A wheel that runs in the track of one ahead of it meets soil that this one has pressed, and so does any
wheel where the vehicle crosses its own earlier path. Both are seen in the places of the wheels in the
frame of the odometry:

    pass number = 1 + crossings of this place so far by a wheel that rolls, its own among them

A track whose middle is no further away than half the wheel's width is the same track; one that is no
further than a whole width is met in part, and nobody knows what that does: the number is unknown then.
It is unknown, too, without the wheels' places (no odometry, no orientation, no positions of the wheels
in the parameters), and at the beginning until a wheel has left the ground that the vehicle stood on.

Places are as good as the odometry: once it has drifted by half a wheel's width, ground that is crossed
again counts as fresh.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel

# Some hundreds of metres, over which few odometries keep to half a wheel's width.
_MOST_POINTS = 40_000
_LONGEST_STEP = 1.0  # m between two places of a wheel; over more the odometry began anew


class _Point(NamedTuple):
    """A place where a wheel has been, and the travel (m) of the vehicle then."""

    x: float
    y: float
    wheel: str
    travel: float


class PassCounter:
    """Takes instants in the order of their stamps, and gives pass numbers."""

    def __init__(self, wheels: Sequence[Wheel]) -> None:
        rolling = [wheel for wheel in wheels if wheel.contact == ROLLING]
        positions = {(w.longitudinal_position, w.lateral_position) for w in rolling}
        self._widths = {wheel.name: wheel.width for wheel in rolling}
        if len(positions) < len(rolling):
            self._widths = {}  # nobody has said where the wheels are
        self._ahead = {wheel.name: wheel.longitudinal_position for wheel in rolling}
        self._side = max(self._widths.values(), default=1.0)  # of a cell
        self._forget()

    def _forget(self) -> None:
        self._cells: dict[tuple[int, int], list[_Point]] = {}
        self._order: deque[tuple[int, int]] = deque()  # cells of the points, the oldest first
        self._last: dict[str, tuple[_Point, int | None]] = {}  # with the number there
        self._begin: float | None = None
        self._travel = 0.0

    def number(self, instant: Instant) -> int | None:
        """Return the pass number of the wheel at an instant; None: not known."""
        wheel, place, travel = instant.wheel.name, instant.place, instant.distance
        width = self._widths.get(wheel)
        if place is None or width is None:
            return None
        last = self._last.get(wheel)
        moved = math.inf if last is None else math.dist(place, last[0][:2])
        if travel < self._travel - 1e-9 or (last is not None and moved > _LONGEST_STEP):
            self._forget()
            last = None
        self._travel = travel
        if self._begin is None:
            self._begin = travel
        if last is not None and moved < width / 4:
            return last[1]
        point = _Point(*place, wheel, travel)
        number = self._crossings(point, width)
        if travel - self._begin <= self._followed(wheel, instant.speed or 0.0) + self._side:
            number = None
        self._last[wheel] = (point, number)
        self._add(point)
        return number

    def _followed(self, wheel: str, speed: float) -> float:
        """How far (m) a wheel follows behind the vehicle's first one in the direction of travel."""
        places, own = self._ahead.values(), self._ahead[wheel]
        return max(places) - own if speed >= 0 else own - min(places)

    def _cell(self, point: _Point) -> tuple[int, int]:
        return math.floor(point.x / self._side), math.floor(point.y / self._side)

    def _add(self, point: _Point) -> None:
        cell = self._cell(point)
        self._cells.setdefault(cell, []).append(point)
        self._order.append(cell)
        if len(self._order) > _MOST_POINTS:
            oldest = self._order.popleft()
            del self._cells[oldest][0]

    def _crossings(self, point: _Point, width: float) -> int | None:
        """Return 1 + the crossings of a place before; None where one is met only in part."""
        column, row = self._cell(point)
        near = [
            earlier
            for i in (column - 1, column, column + 1)
            for j in (row - 1, row, row + 1)
            for earlier in self._cells.get((i, j), ())
            if math.dist(point[:2], earlier[:2]) < width
        ]
        number = 1
        for wheel in {earlier.wheel for earlier in near}:
            mine = sorted((e for e in near if e.wheel == wheel), key=lambda e: e.travel)
            for crossing in _crossings_of(mine, 2 * width):
                if wheel == point.wheel and point.travel - crossing[-1].travel <= 2 * width:
                    continue  # this very one
                if min(math.dist(point[:2], e[:2]) for e in crossing) > width / 2:
                    return None
                number += 1
        return number


def _crossings_of(points: Sequence[_Point], apart: float) -> list[list[_Point]]:
    """Split the points of one wheel, by travel, where it was away for so long (m)."""
    found: list[list[_Point]] = []
    for point in points:
        if found and point.travel - found[-1][-1].travel <= apart:
            found[-1].append(point)
        else:
            found.append([point])
    return found
