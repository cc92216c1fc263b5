# SPDX-License-Identifier: Apache-2.0
"""From results of the estimate to the cost of the ground under the vehicle.

How often wheels have rolled over it is what `PassCounter` counts.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.estimator.soil_estimator import SoilEstimator
from smallwheel_ros.estimator.traction import GRAVITY, TractionEstimator
from smallwheel_ros.onboard.mobility import Mobility
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.onboard.stuck_warning import STALE, mean_margin
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

# Pa on diameter times width of a wheel: 3.3, 4.2 and 4.9 kPa of a rover of 30 kg, a Warthog and a Husky. From
# 2 to 8 kPa the margin before driving of these three moves by 0.005 at most, of a deviation of 0.13.
_USUAL_PRESSURE = 4e3
# Slip with which nothing is gained any more: the wheel turns five times as far as it gets.
_SPINS = 0.8


def vehicle_margin(newest: Iterable[Result]) -> Quantity | None:
    """Margin of a whole vehicle: drawbar pull of all wheels over load of all wheels.

    None where no wheel has a margin.
    """
    wheels = [
        (result.reading.load.value, result.forces.margin)
        for result in newest
        if result.forces is not None
        and result.forces.margin is not None
        and result.reading.load is not None
    ]
    return mean_margin(wheels) if wheels else None


def margin_before_driving(settings: OnboardSettings) -> Quantity | None:
    """Margin of the whole vehicle on any ground, as it is believed before the first message.

    All rolling wheels at their nominal load: as configured where loads are not measured, else an equal share
    of the weight, or 4 kPa on diameter times width where the mass is not known either. None without a
    rolling wheel, and where nothing can be predicted of them.
    """
    rolling = [wheel for wheel in settings.wheels if wheel.contact == ROLLING]
    share = settings.mass * GRAVITY / len(settings.wheels)
    nominal = [
        settings.static_loads.get(wheel.name)
        or Quantity(share or _USUAL_PRESSURE * wheel.diameter * wheel.width, 0.0)
        for wheel in rolling
    ]
    estimator = SoilEstimator(settings.prior, settings.estimator, settings.effects, settings.wheels)
    traction = TractionEstimator(settings.strength, settings.wheels, settings.mass)
    readings = [
        (Reading(wheel, 0, load, None, None, None, 0.0, 0.0), load)
        for wheel, load in zip(rolling, nominal, strict=True)
    ]
    try:
        margins = Mobility(settings, estimator, traction).margins(readings)
    except (SmallwheelError, ArithmeticError, ValueError):
        return None
    known = [
        (load.value, margin)
        for load, margin in zip(nominal, margins, strict=True)
        if margin is not None
    ]
    return mean_margin(known) if known else None


class Spinning:
    """Whether wheels spin on the spot: mean speed against mean rim speed over a second."""

    def __init__(self) -> None:
        self._seen: dict[str, deque[tuple[int, float, float]]] = {}

    def add(self, reading: Reading) -> bool:
        """Take a reading of a wheel; return whether it spins, as does most of the vehicle."""
        seen = self._seen.setdefault(reading.wheel.name, deque())
        if reading.speed is None or reading.rim_speed is None or reading.stands:
            seen.clear()
            return False
        if seen and not 0 <= reading.stamp - seen[-1][0] <= SECOND:
            seen.clear()
        seen.append((reading.stamp, reading.speed, reading.rim_speed))
        while len(seen) > 1 and reading.stamp - seen[1][0] >= SECOND:
            seen.popleft()
        spinning = [self._spins(wheel, reading.stamp) for wheel in self._seen]
        return self._spins(reading.wheel.name, reading.stamp) and 2 * sum(spinning) > len(spinning)

    def _spins(self, wheel: str, now: int) -> bool:
        seen = self._seen[wheel]
        if not seen or now - seen[-1][0] > SECOND or seen[-1][0] - seen[0][0] < SECOND:
            return False
        speed, rim = sum(each[1] for each in seen), sum(each[2] for each in seen)
        return abs(speed) < (1.0 - _SPINS) * abs(rim)


class GroundMapper:
    """Lays results down where their wheels were: what the vehicle can do on such ground.

    It is the vehicle's margin that counts, not the single wheel's: a wheel that cannot even move
    itself is dragged along by the others. At a border those that are on the other soil do not count.
    """

    def __init__(self, cost_map: CostMap) -> None:
        self.map = cost_map
        self.clear()

    def clear(self) -> None:
        """Forget the ground."""
        self.map.clear()
        self._newest: dict[str, Result] = {}
        self._spinning = Spinning()

    def add(self, result: Result, frame: str) -> None:
        """Take a result; frame is that of the odometry, empty where it is not known.

        Every margin counts, with its deviation: before the soil has been measured, and where its sinkage
        never is, that is what balance and torque tell, or the prior. Nothing is known where the measured
        sinkage did not fit. A wheel that is sunk to its axle in soil that was measured, digs itself in or
        spins on the spot is stuck there.
        """
        reading = result.reading
        self._newest[result.wheel] = result
        spins = self._spinning.add(reading)
        since = reading.stamp - STALE
        margin = vehicle_margin(
            other
            for name, other in self._newest.items()
            if other.reading.stamp >= since and name not in result.elsewhere
        )
        if reading.vehicle is None or reading.heading is None or not frame:
            return
        sunk = result.status is Status.SUNK_TO_AXLE and result.soil.accepted > 0
        stuck = result.digging_in or spins or sunk
        if result.status is Status.REJECTED:
            margin = None
        pose = Pose(*reading.vehicle, reading.heading)
        slope = result.slope if self.map.settings.slope == "measured" else 0.0
        self.map.add(reading.wheel, frame, pose, reading.distance, margin, stuck=stuck, slope=slope)


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
    """Takes readings in the order of their stamps, and gives pass numbers.

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

    def number(self, reading: Reading) -> int | None:
        """Return the pass number of the wheel at a reading; None: not known."""
        wheel, place, travel = reading.wheel.name, reading.place, reading.distance
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
        if travel - self._begin <= self._followed(wheel, reading.speed or 0.0) + self._side:
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
