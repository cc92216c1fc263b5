# SPDX-License-Identifier: Apache-2.0
"""Loads against what else is known of them: the vehicle's mass, its tilt, and each wheel's sinkage.

A load has two sources. All loads together are mass times gravity, whatever the cells say; a slope, or
gaining speed, moves load to the wheels behind; and a wheel sinks deeper under more load, its own. Rows are
means over half a second and 0.2 m (2 s of a vehicle that stands):

    sum       r = sum of W / (m g cos tilt): over 10 % off is said, with the unit that would do it
    place     sum of W x / sum of W = x_c - h t,   sum of W y / sum of W = y_c - h q,   h > 0
    sinkage   changes of ln z_w = s_w changes of ln W_w,   s_w > 0

t, q: tangents of the tilt backward and to the right, gained speed included; x, y: places of the wheels; h:
height of the centre of gravity, and x_c, y_c its place. The moments hold on any ground, whatever it does to
single loads. Each interchange of two wheels, of front and rear, of left and right changes which load belongs
to which place and sinkage. It is said where it makes residuals so much smaller that its odds are e^6 to 1,
of likelihoods that count half of the rows, since neighbours are alike.

The zero of the imu is what `Level` finds.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.estimator.soil_filter import CONTRADICTION
from smallwheel_ros.estimator.strength_filter import LEVEL_STD
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.problems import unit_of
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

Array = NDArray[np.float64]

_MASS_STD = 0.02  # of ln mass: what a scale shows, water, dust
_TIME, _WAY, _STANDING = 0.5, 0.2, 2.0  # s, m, s
_READINGS = 3  # of each wheel in a row
_WEIGHED = 6  # rows
_ROWS = 120
_COMPARED = 8  # rows before wheels are told apart
_ODDS = 6.0  # ln
_EXACT = 0.005  # of the wheel base: what places and tilts are good for
_LEAST_SINKAGE = 1e-3  # m: the logarithm of less is noise

_FOLLOWS = "the sinkage of each follows the load of the other: check load_topic and sinkage_topic"
_LEANS = (
    "when the vehicle leans or gains speed, load goes to the wrong wheels, and their sinkage with it: check"
    " load_topic"
)
_LEANS_ALONE = (
    "when the vehicle leans or gains speed, load goes to the wrong wheels: check their longitudinal_position"
    " and lateral_position"
)


@dataclass
class _Row:
    """What is collected for a row, by wheel: readings, and sums of load, sinkage, and of how many."""

    begin: int
    way: float
    loads: dict[str, list[float]] = field(default_factory=dict)
    sinkages: dict[str, list[float]] = field(default_factory=dict)
    tilts: list[tuple[float, float]] = field(default_factory=list)


class LoadWatch:
    """Of a vehicle; feed it every reading in the order of time.

    mass: kg, 0: not known. weighing: mean loads (N) by wheel and the weight (N) that they should add up
    to, as soon as there is one.
    """

    def __init__(self, wheels: Sequence[Wheel], mass: float) -> None:
        self._wheels = tuple(wheels)
        self._mass = mass if all(wheel.contact == ROLLING for wheel in wheels) else 0.0
        self._row: _Row | None = None
        self._sums: deque[float] = deque(maxlen=_ROWS)  # ln of the loads' sum over the weight
        self._means: deque[dict[str, float]] = deque(maxlen=_WEIGHED)
        self._table: deque[tuple[Array, Array, float, float]] = deque(maxlen=_ROWS)
        self._judged: tuple[int, str] = 0, ""  # rows, and what they said
        self._rows = 0
        self.weighing: tuple[Mapping[str, float], Quantity] | None = None

    def add(self, reading: Reading) -> bool:
        """Take a reading; return whether there is a weighing now for the first time."""
        if reading.load is None or len(self._wheels) < 2:
            return False
        row = self._row
        if row is None:
            row = self._row = _Row(reading.stamp, reading.distance)
        name = reading.wheel.name
        row.loads.setdefault(name, []).append(reading.load.value)
        if reading.sinkage is not None:
            row.sinkages.setdefault(name, []).append(reading.sinkage.value)
        if reading.slope_force is not None:
            way = 1.0 if reading.forward else -1.0
            gained = reading.gained_force or 0.0
            behind = way * (reading.slope_force + gained) / GRAVITY
            row.tilts.append((behind, (reading.across_force or 0.0) / GRAVITY))
        seconds, metres = (reading.stamp - row.begin) / SECOND, reading.distance - row.way
        if seconds < _TIME or (metres < _WAY and seconds < _STANDING):
            return False
        if len(row.loads) < len(self._wheels) or min(map(len, row.loads.values())) < _READINGS:
            if seconds > 2.0 * _STANDING:
                self._row = None
            return False
        self._row = None
        return self._close(row, metres >= _WAY)

    def _close(self, row: _Row, moved: bool) -> bool:
        means = {name: float(np.mean(values)) for name, values in row.loads.items()}
        behind, right = np.mean(row.tilts, axis=0).tolist() if row.tilts else (math.nan, math.nan)
        if self._mass > 0.0:
            tilt = min(math.hypot(behind, right), 0.7) if row.tilts else 0.0
            weight = self._mass * GRAVITY * math.sqrt(1.0 - tilt * tilt)
            self._sums.append(math.log(sum(means.values()) / weight))
            self._means.append(means)
        if moved:
            self._rows += 1
            order = [wheel.name for wheel in self._wheels]
            sunk = [np.mean(row.sinkages.get(name, math.nan)) for name in order]
            loads = np.log([means[name] for name in order])
            self._table.append((loads, np.array(sunk), behind, right))
        if self.weighing is not None or len(self._sums) < _WEIGHED:
            return False
        found = {name: float(np.mean([m[name] for m in self._means])) for name in means}
        off, spread = float(np.mean(self._sums)), float(np.std(self._sums)) / math.sqrt(_WEIGHED)
        weight = sum(found.values()) / math.exp(off)
        deviation = math.hypot(_MASS_STD, spread)
        if abs(off) > CONTRADICTION and not unit_of(math.exp(off), "load"):
            deviation = abs(off)  # the cells or the mass: nobody knows which
        self.weighing = found, Quantity(weight, weight * deviation)
        return True

    @property
    def missing(self) -> float:
        """Share of the weight that the listed wheels do not carry, where it is more than errors are."""
        off = self._off()
        return max(1.0 - math.exp(off), 0.0) if abs(off) > CONTRADICTION else 0.0

    def _off(self) -> float:
        """Ln of the loads' sum over the weight lately, 0 where that is not known well."""
        lately = list(self._sums)[-2 * _WEIGHED :]
        if len(lately) < _WEIGHED // 2:
            return 0.0
        mean, spread = float(np.mean(lately)), float(np.std(lately))
        return mean if abs(mean) > 3.0 * spread / math.sqrt(len(lately)) else 0.0

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        found = []
        off = self._off()
        if abs(off) > CONTRADICTION:
            found.append(self._of_sum(math.exp(off)))
        return (*found, self.interchanged) if self.interchanged else tuple(found)

    @property
    def interchanged(self) -> str:
        """Say which loads look interchanged; empty where none do."""
        if self._judged[0] != self._rows:
            self._judged = self._rows, self._judge()
        return self._judged[1]

    def _of_sum(self, ratio: float) -> str:
        words = (
            f"the loads of all wheels add up to {ratio:.3g} times vehicle.mass and gravity"
            f" ({self._mass * GRAVITY:.4g} N)"
        )
        unit = unit_of(ratio, "load")
        if unit:
            return (
                f"{words}: loads in {unit[1]}? Check the drivers, load.per_effort and vehicle.mass"
            )
        if ratio < 1.0:
            return (
                f"{words}: check the load cells and vehicle.mass, or whether a wheel that is not listed"
                " carries the rest"
            )
        return (
            f"{words}: check the load cells, and whether the vehicle carries more than vehicle.mass"
        )

    # -- whose load is it

    def _judge(self) -> str:
        count = len(self._wheels)
        if len(self._table) < _COMPARED:
            return ""
        loads, sunk, behind, right = map(np.array, zip(*self._table, strict=True))
        by_place = _by_place(self._wheels, np.exp(loads), behind, right)
        by_sinkage = _by_sinkage(loads, sunk)
        plain = tuple(range(count))
        before = by_place(plain), by_sinkage(plain)
        best, words = _ODDS, ""
        for order, names in _interchanges(self._wheels):
            places, follows = by_place(order) - before[0], by_sinkage(order) - before[1]
            if places + follows > best:
                why = _FOLLOWS if follows > places else _LEANS
                best, words = (
                    places + follows,
                    f"loads of {names} look interchanged (swapped): {why}",
                )
            elif places > best:
                best = places
                words = f"places of {names} look interchanged (swapped): {_LEANS_ALONE}"
        return words


def _interchanges(wheels: Sequence[Wheel]) -> list[tuple[tuple[int, ...], str]]:
    """Which wheel's place each load would be of, and in words."""
    count = len(wheels)
    found = []
    for i, j in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        found.append((tuple(order), f"'{wheels[i].name}' and '{wheels[j].name}'"))
    places = [(w.longitudinal_position, w.lateral_position) for w in wheels]
    for name, (along, across) in (("front and rear", (-1, 1)), ("left and right", (1, -1))):
        middle = np.mean(places, axis=0)
        mirrored = [
            (along * (x - middle[0]) + middle[0], across * (y - middle[1]) + middle[1])
            for x, y in places
        ]
        order = [int(np.argmin([math.dist(place, at) for place in places])) for at in mirrored]
        if sorted(order) == list(range(count)) and order != list(range(count)):
            found.append((tuple(order), f"{name}"))
    return found


def _by_place(
    wheels: Sequence[Wheel], loads: Array, behind: Array, right: Array
) -> Callable[[Sequence[int]], float]:
    """Ln likelihood of an order of the wheels by the moments of their loads."""
    known = np.isfinite(behind)
    shares = loads[known] / loads[known].sum(axis=1, keepdims=True)
    rows = shares.shape[0]
    axes = []
    for name, tilt in (("longitudinal_position", behind), ("lateral_position", right)):
        place = np.array([getattr(wheel, name) for wheel in wheels])
        leans = tilt[known] - tilt[known].mean() if rows else tilt[known]
        if np.ptp(place) > 0.0 and float(np.sum(leans**2)) > 0.0:
            axes.append((place, leans))

    def likelihood(order: Sequence[int]) -> float:
        found = 0.0
        if rows < _COMPARED:
            return found
        for place, leans in axes:
            moments = shares @ place[list(order)]
            moments = moments - moments.mean()
            along = min(float(leans @ moments), 0.0)
            left = float(moments @ moments) - along**2 / float(leans @ leans)
            found -= 0.25 * rows * math.log(left / rows + (_EXACT * np.ptp(place)) ** 2)
        return found

    return likelihood


def _by_sinkage(loads: Array, sunk: Array) -> Callable[[Sequence[int]], float]:
    """Ln likelihood of an order of the loads by whose sinkage follows which."""
    good = np.flatnonzero(np.min(sunk, axis=1) > _LEAST_SINKAGE)
    by_load, by_depth = np.diff(loads[good], axis=0), np.diff(np.log(sunk[good]), axis=0)
    rows, count = by_load.shape
    left = np.ones((count, count))
    if rows >= _COMPARED:
        squares = np.sum(by_load**2, axis=0) + 1e-9
        along = np.maximum(by_depth.T @ by_load, 0.0)  # (sinkages, loads)
        whole = np.sum(by_depth**2, axis=0)[:, None]
        left = np.maximum(whole - along**2 / squares, 1e-3 * whole) + 1e-12
    unlikely = np.log(left)

    def likelihood(order: Sequence[int]) -> float:
        # Differences share each row with their neighbours.
        return -0.25 * rows * float(unlikely[order, range(count)].sum())

    return likelihood


_SLOPE, _LENGTH = 0.15, 40.0  # tangent, m: hills
_ZERO, _ZERO_TIME = LEVEL_STD / GRAVITY, 180.0  # tangent, s
_ROW = math.radians(0.5)
_ROW_WAY, _ROW_TURN = 0.2, 0.2  # m, rad
_NEWEST = 16  # readings over which a slope is a mean
_SURE, _WORTH = 3.0, math.radians(1.5)  # deviations and size of a zero that is said


class Level:
    """How far off level the imu is mounted, or has wandered, by turns and ways back.

    State: slopes of the ground east and north in the frame of the odometry, e and n, and the zeros of what is
    shown ahead and across, p and r. A vehicle that looks along the heading a is shown

        ahead = e cos a + n sin a + p,    across = n cos a - e sin a + r     (tangents, as g sin over g)

    The ground follows the vehicle, a zero stays with the imu: on the straight nobody can tell one from the
    other, and a quarter of a turn on one spot tells both. Prediction: slopes are an Ornstein-Uhlenbeck
    process along the path, 0.15 over 40 m; zeros one in time, 1.5 degrees over 3 minutes, since orientations
    are filtered gyroscopes. A row is taken after 0.2 m or 0.2 rad, with 0.5 degrees of its own: bumps.

    Of a vehicle; feed it every reading in the order of time. zero: of the slope force ahead, m/s^2.
    """

    def __init__(self) -> None:
        self._x: Array = np.zeros(4)
        self._P: Array = np.diag(np.square([_SLOPE, _SLOPE, _ZERO, _ZERO]))
        self._last: tuple[float, float, float] | None = None  # time, distance, heading
        self._shown: list[tuple[float, float]] = []
        self._newest: deque[tuple[float, float]] = deque(maxlen=_NEWEST)

    @property
    def slope(self) -> float:
        """Tangent of the steepest slope here, without the zero of the imu; 0 before any is measured."""
        if not self._newest:
            return 0.0
        ahead, across = (
            sum(values) / len(self._newest) for values in zip(*self._newest, strict=True)
        )
        sine = min(math.hypot(ahead - float(self._x[2]), across - float(self._x[3])), 0.99)
        return sine / math.sqrt(1.0 - sine * sine)

    @property
    def zero(self) -> Quantity:
        """What the slope force is shown too large by, forward positive, m/s^2."""
        return Quantity(
            GRAVITY * float(self._x[2]), GRAVITY * math.sqrt(max(float(self._P[2, 2]), 0.0))
        )

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        found = []
        for i, names in ((2, ("nose up", "nose down")), (3, ("left side up", "right side up"))):
            off, deviation = float(self._x[i]), math.sqrt(float(self._P[i, i]))
            if abs(off) > max(_WORTH, _SURE * deviation):
                found.append(
                    f"the imu shows {math.degrees(abs(off)):.1f} +- {math.degrees(deviation):.1f} degrees too"
                    f" much slope, {names[off < 0.0]}, whichever way the vehicle looks: level it, or check"
                    " how it is mounted (imu_topic, or the orientation of odom)"
                )
        return tuple(found)

    def add(self, reading: Reading) -> bool:
        """Take a reading; return whether the zero is known better now, or less well."""
        force, heading = reading.slope_force, reading.heading
        if force is None or reading.across_force is None:
            self._newest.clear()
            return False
        way = 1.0 if reading.forward else -1.0
        self._newest.append((way * force / GRAVITY, reading.across_force / GRAVITY))
        self._shown.append(self._newest[-1])
        if heading is None:
            self._shown.clear()
            return False
        time = reading.stamp / SECOND
        if self._last is None:
            self._last = time, reading.distance, heading
        since, begin, looked = self._last
        turned = abs(math.remainder(heading - looked, math.tau))
        if reading.distance - begin < _ROW_WAY and turned < _ROW_TURN:
            del self._shown[:-20]  # who stands shows the same
            return False
        self._predict(reading.distance - begin, time - since)
        cosine, sine = math.cos(heading), math.sin(heading)
        ahead, across = np.mean(self._shown, axis=0).tolist()
        self._update(np.array([cosine, sine, 1.0, 0.0]), ahead)
        self._update(np.array([-sine, cosine, 0.0, 1.0]), across)
        self._last, self._shown = (time, reading.distance, heading), []
        return True

    def _predict(self, metres: float, seconds: float) -> None:
        keep = np.array(
            [math.exp(-metres / _LENGTH)] * 2 + [math.exp(-max(seconds, 0.0) / _ZERO_TIME)] * 2
        )
        self._x = keep * self._x
        told = np.square([_SLOPE, _SLOPE, _ZERO, _ZERO])
        self._P = self._P * np.outer(keep, keep) + np.diag((1.0 - keep**2) * told)

    def _update(self, row: Array, shown: float) -> None:
        gain = self._P @ row / (float(row @ self._P @ row) + _ROW**2)
        self._x = self._x + gain * (shown - float(row @ self._x))
        self._P = self._P - np.outer(gain, row @ self._P)
