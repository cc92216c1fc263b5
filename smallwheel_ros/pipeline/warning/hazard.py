# SPDX-License-Identifier: Apache-2.0
"""Warning before a vehicle gets stuck: slip, increased by the pull that the ground fails to give.

    hazard = slip + 2 (max(sin slope, 0)/2 + max(-dv/dt, 0)/g) - one deviation by the scatter of the speed

Slip shows the share of the grip that is in use: the median over the wheels of means over half a second,
extrapolated to the end of that time where slip grows. Loss of speed is pull that is already missing.
Only half of the pull that a slope demands counts, since slip answers to a slope within a second. All are
taken along the direction in which the rims turn.

There are two levels: over 0.4 the vehicle may get stuck, over 0.5 it gets stuck. Either begins where slip
grows, speed is lost, or slip alone is over that limit: a vehicle that climbs at a steady slip below it gets
on, and slip that grows slowly is warned of. A level ends when the hazard is 0.1 below it. The first
level also begins where slip is over 0.3 by two deviations, under the same conditions: ground that
gives way at once takes away no speed beforehand (docs/without_soil_sensors.md).

A start is not judged, since a late odometry shows slip there. It ends where slip is below 0.3, or
after 3 s: a vehicle that starts in ground that does not carry it may never slip less. One that has
never rolled yet, and surely slides back on wheels that drive ahead, is warned of after 1 s; with an
imu, once that has felt which way the vehicle goes, within 2 s of driving (`checks/lateness.py`).

No warning is given where there may be no slip at all: it has to exceed 0 by three standard deviations, those
stated for the ground speed (large for one that is late, scattered, or hardly known).

Rows of the wheels need not share stamps: each wheel's newest row in a tenth of a second is used, so
that the result depends neither on where blocks are cut nor on the order in which sensors report.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import SLOWEST_RIM
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import GRAVITY, Wheel
from smallwheel_ros.pipeline.tables import Array, Columns, Integers, Readings, unknown

PERIOD = SECOND // 10  # ns, an instant; all constants were found at 10 Hz
HELD = 0.5  # s, for which a wheel's row stays in use
SLIP_S, TREND_S, READINGS = 0.5, 1.0, 5  # s: of a mean, of a line; readings of the speed in a mean
SLIP_PER_PULL = 2.0  # d slip / d (pull / weight) of soft ground: slip 0.4 for a pull of 0.2
# Of a slope. By the law of slip alone it counts nothing once slip has answered; of 17 immobilisations in snow
# the whole slope brought a little more in time (12.3 for 11.6), and on climbs half of all false warnings.
OF_SLOPE = 0.5
# Of the hazard, and of slip alone: by the 17 in snow, on even ground.
FIRST, SECOND_LEVEL = 0.4, 0.5
HOLDS = 0.1  # a level ends when the hazard is this much below it: else noise of slip makes several of one
SLIPS, SURELY = 0.3, 2.0  # slip that is of the first level by itself, by so many deviations
# Deviations by which slip has to be over 0. They are what 0.8 of the errors keep to, and those of odometries
# have heavy tails: by two, 7 warnings on 190 m of wet grass were false, by 2.5 three.
MAY_BE_NONE = 3.0
# 1/s of slip, over `GROWTH_S`, and of the rims' speed: less is a steady climb. In snow slip grew from 0.2 to
# 0.3 in 2.1 s and to 0.4 in 1.2 s more; with 0.06 a tenth of the warnings in time is lost in own worlds.
GROWS, LOSES, GROWTH_S = 0.05, 0.10, 2.0
DRIVES = 0.20  # m/s: slower rims stand, or spin on the spot
DEVIATIONS = 1.0  # of the hazard, that are taken off
# Slip under which a start is over; s, after which it is: rims run up within two.
ROLLED, START_S = 0.30, 3.0
# s, after which a start is over where the vehicle surely goes against its rims: odometries come late by half
# a second, and half a second is averaged.
BACK_S = 1.0
BRAKES = 0.30  # of g: wheels that pull cannot brake so
GAINS = 0.10  # m/s^2: what gains speed so fast is not getting stuck
REPEAT, APART = 5.0, 2.0  # s: between messages of one warning; gap after which a new one begins
# Least risk at each level. In snow 17 of 25 warnings of the first level came before a vehicle got stuck, and
# 17 of 19 of the second.
RISKS = (0.0, 0.5, 0.9)
_KEEP = 10 * SECOND  # ns of instants: a trend of a speed that comes once a second


@dataclass(frozen=True)
class Instants(Columns):
    """Motion of the vehicle ten times a second; NaN if unknown.

    Attributes
    ----------
    stamp
        End of the tenth, ns.
    rim, ground, ground_std
        Rim speeds of the rolling wheels, their speeds over ground, and standard deviations of the latter,
        (rows, rolling wheels), m/s. On a vehicle that steers, the speeds' components along its course.
    speed
        Speed of the vehicle, along its course, m/s.
    rise
        Sine of the slope along the course, nose up.
    felt
        Specific force along the course, m/s^2: g sin(slope) + dv/dt by the accelerometer, or by odometry.
    course
        Direction of travel to the left of the vehicle's heading, rad; 0 on a vehicle that does not steer.
    apart
        Largest angle between a wheel's heading or motion and the course, rad.
    """

    stamp: Integers
    rim: Array
    ground: Array
    ground_std: Array
    speed: Array
    rise: Array
    felt: Array
    course: Array
    apart: Array

    @property
    def time(self) -> Array:
        """Stamp, s."""
        return self.stamp / SECOND


@dataclass(frozen=True)
class Warned(Columns):
    """State of the warning at each instant.

    Attributes
    ----------
    stamp
        As in `Instants`, ns.
    hazard, slip
        Hazard as defined in this module, and slip of the middle wheel, 1; NaN where they are not judged.
    level
        0: none; 1: may get stuck; 2: gets stuck (the rolling wheels dig in).
    told
        The level at instants at which its warning is to be issued: when it begins, and every 5 s as long as
        it holds; else 0.
    """

    stamp: Integers
    hazard: Array
    slip: Array
    level: Integers
    told: Integers


@dataclass(frozen=True)
class _Hazard:
    """Hazard at one instant; NaN where it is not judged.

    Attributes
    ----------
    value
        The hazard, 1.
    slip, surely
        Slip of the middle wheel, and the same less two deviations, 1.
    grows
        Whether slip grows, or speed is lost.
    """

    value: float = np.nan
    slip: float = np.nan
    surely: float = np.nan
    grows: bool = False


class Warnings:
    """Computes the warning over a drive.

    Parameters
    ----------
    wheels
        All wheels; those that roll are used.
    with_imu
        Whether the vehicle has an imu, which then gives the specific force, and the slope if it has an
        orientation.
    gravity
        Acceleration of gravity, m/s^2.

    Attributes
    ----------
    rolling
        Numbers of the wheels that roll.
    side
        Distances of these wheels to the left of the base frame, m.
    done
        Instants of the newest block, and those of the 10 s before them; None before the first.
    """

    def __init__(
        self, wheels: tuple[Wheel, ...], with_imu: bool = False, gravity: float = GRAVITY
    ) -> None:
        self._gravity = gravity
        self.with_imu = with_imu
        self.rolling = np.flatnonzero([wheel.contact == ROLLING for wheel in wheels])
        self.side = np.array([wheel.lateral_position for wheel in wheels])[self.rolling]
        self._open: Readings | None = None
        self._imu: tuple[Integers, Array] = np.empty(0, dtype=np.int64), np.empty((0, 9))
        self._speeds: Integers = np.empty(0, dtype=np.int64)
        # Of each wheel: time, rim, ground and its deviation, angle off the course.
        self._newest = np.full((self.rolling.size, 5), np.nan)
        self.done: Instants | None = None
        self._slips: Array = np.empty(0)  # of each of these, whether judged or not
        self._rolled, self._level, self._began = False, 0, np.inf  # s, since when the rims run
        self._driven = np.inf  # s, likewise, whether the speed is known or not
        self._has_rolled = False  # whether any start so far was over by slip
        self._last, self._said = np.full(2, -np.inf), np.full(2, -np.inf)

    def take(
        self,
        rows: Readings | None,
        speeds: Integers,
        imu: tuple[Integers, Array] | None,
        until: int,
    ) -> tuple[Instants, Warned] | None:
        """Judge all tenths of a second that have ended.

        Parameters
        ----------
        rows
            New readings, in order of stamps; None if there are none.
        speeds
            Stamps of the new messages of the ground speed, shape (messages,), ns; they show its period.
        imu
            Stamps (ns) and rows of the new messages of the imu, columns as in `BelievedRows.felt`; None if
            there are none.
        until
            Stamp up to which all rows have arrived, ns.

        Returns
        -------
        (Instants, Warned) or None
            The new instants, in tenths of a second in which there were readings, and the warning at each;
            None if there are none.
        """
        if rows is not None:
            self._open = rows if self._open is None else Readings.joined([self._open, rows])
        self._speeds = np.concatenate([self._speeds, speeds])
        if imu is not None:
            old = self._imu
            self._imu = np.concatenate([old[0], imu[0]]), np.concatenate([old[1], imu[1]])
        end = until // PERIOD * PERIOD
        found = None
        if self._open is not None and len(self._open) and self._open.stamp[0] < end:
            over = self._open.stamp < end
            made = self._instants(self._open.take(over))
            self._open = self._open.take(~over)
            before = 0
            if self.done is not None:
                kept = self.done.stamp > self.done.stamp[-1] - _KEEP
                self._slips, before = self._slips[kept], int(kept.sum())
                self.done = Instants.joined([self.done.take(kept), made])
            else:
                self.done = made
            found = made, self._judged(before)
        self._speeds = self._speeds[self._speeds > end - _KEEP]
        recent = self._imu[0] >= end
        self._imu = self._imu[0][recent], self._imu[1][recent]
        return found

    def _instants(self, rows: Readings) -> Instants:
        """Combine the rows of tenths that have ended to one instant each."""
        bins = rows.stamp // PERIOD
        kept = np.unique(bins)
        wheels = self.rolling.size
        rim, ground, ground_std = np.full((3, kept.size, wheels), np.nan)
        speed, slope, felt = np.full((3, kept.size), np.nan)
        course, apart = np.zeros((2, kept.size))
        # A wheel whose angle is not known has no slip, and counts as along the course.
        apart_of, aside, course_of = (
            np.nan_to_num(each) for each in (rows.apart, rows.slip_angle, rows.course)
        )
        share = np.cos(apart_of)
        for k, one in enumerate(kept.tolist()):
            mine = np.flatnonzero(bins == one)
            now = (one + 1) * PERIOD / SECOND
            for j, number in enumerate(self.rolling.tolist()):
                own = mine[rows.wheel[mine] == number]
                if own.size:
                    last = own[-1]
                    self._newest[j] = (
                        rows.stamp[last] / SECOND,
                        share[last] * rows.rim_speed[last],
                        share[last] * rows.speed[last],
                        rows.speed_std[last],
                        max(abs(apart_of[last]), abs(aside[last])),
                    )
            fresh = now - self._newest[:, 0] <= HELD
            rim[k, fresh], ground[k, fresh], ground_std[k, fresh] = self._newest[fresh, 1:4].T
            apart[k] = self._newest[fresh, 4].max(initial=0.0)
            last = mine[-1]
            course[k] = course_of[last]
            speed[k], slope[k] = rows.vehicle_speed[last], rows.slope[last]
            felt[k] = rows.pushed[last]
        rise = slope / self._gravity
        if self.with_imu:
            felt, rise = self._felt(kept, course)
        return Instants(
            (kept + 1) * PERIOD, rim, ground, ground_std, speed, rise, felt, course, apart
        )

    def _felt(self, kept: Integers, course: Array) -> tuple[Array, Array]:
        """Mean specific force (m/s^2) and mean sine of the slope, both along the course, in each tenth.

        kept: numbers of the tenths. course: rad, shape (tenths,).
        """
        ahead, up = np.full((2, kept.size), np.nan)
        if not self._imu[0].size:
            return ahead, up
        bins = self._imu[0] // PERIOD
        for k, one in enumerate(kept.tolist()):
            first, last = np.searchsorted(bins, [one, one + 1])
            if last > first:
                ahead[k], up[k] = self._imu[1][first:last, [1, 4]].mean(axis=0)
                if course[k]:
                    left = self._imu[1][first:last, [2, 5]].mean(axis=0)
                    cosine, sine = np.cos(course[k]), np.sin(course[k])
                    ahead[k], up[k] = cosine * np.array([ahead[k], up[k]]) + sine * left
        return ahead, up

    def _judged(self, first: int) -> Warned:
        done = self.done
        assert done is not None
        count = len(done) - first
        hazard, slip = np.full((2, count), np.nan)
        level, told = np.zeros((2, count), dtype=np.int64)
        self._slips = np.concatenate([self._slips, unknown(count)])
        for i in range(first, len(done)):
            k = i - first
            one = self._hazard(done, i)
            hazard[k], slip[k] = one.value, one.slip
            level[k] = self._level = _level_of(one, self._level)
            told[k] = self._told(float(done.stamp[i] / SECOND), int(level[k]))
        return Warned(done.stamp[first:], hazard, slip, level, told)

    def _told(self, now: float, level: int) -> int:
        """Level whose warning is to be issued now: where it begins, and every `REPEAT` s; else 0. now: s."""
        told = 0
        for one in (0, 1):
            if level > one:
                if now - self._last[one] > APART or now - self._said[one] >= REPEAT:
                    self._said[one], told = now, one + 1
                self._last[one] = now
        return told

    def _hazard(self, done: Instants, i: int) -> _Hazard:
        """Hazard at the instant with index i; it also updates whether a start is over."""
        time = done.time[: i + 1] - done.time[i]
        rate = self._rate(int(done.stamp[i]))
        slip_s, trend_s = max(SLIP_S, READINGS / rate), max(TREND_S, 2 * READINGS / rate)
        growth_s = max(GROWTH_S, trend_s)
        a, b, c = np.searchsorted(time, [1e-6 - each for each in (slip_s, trend_s, growth_s)])
        rim, ground, spread = (
            each[a : i + 1].mean(axis=0) for each in (done.rim, done.ground, done.ground_std)
        )
        turning = rim[np.isfinite(rim)]
        drives = turning.size > 0 and abs(float(np.mean(turning))) > DRIVES
        self._driven = min(self._driven, float(done.time[i])) if drives else np.inf
        known = np.isfinite(rim) & np.isfinite(ground)
        if not known.sum() * 2 > known.size:
            self._rolled, self._began = False, np.inf
            return _Hazard()
        rim, ground, spread = rim[known], ground[known], np.nan_to_num(spread[known])
        along = -1.0 if np.mean(rim) < 0.0 else 1.0
        rim, ground = rim * along, ground * along
        rolls = np.mean(rim)
        slip, unsure = _slip(rim, ground), np.median(spread / np.maximum(rim, SLOWEST_RIM))
        self._slips[i] = slip
        growth, _ = _line(time[c:], self._slips[c : i + 1], growth_s)
        gain, scatter = _line(time[b:], done.speed[b : i + 1], trend_s)
        gain = gain * along
        rises = done.rise[b : i + 1]
        rises = rises[np.isfinite(rises)]
        rise = np.mean(rises) * along if rises.size else 0.0
        missing = OF_SLOPE * max(rise, 0.0) + max(-gain, 0.0) / self._gravity
        of_slip = scatter / max(rolls, DRIVES) / np.sqrt(rate * slip_s)
        of_loss = (
            SLIP_PER_PULL * scatter / self._gravity * np.sqrt(12.0 / (rate * trend_s)) / trend_s
        )
        deviation = float(np.hypot(of_slip, of_loss))
        less = DEVIATIONS * (deviation if np.isfinite(deviation) else 0.0)
        runs = bool(rolls > DRIVES and rim.min() > -0.05)
        self._began = min(self._began, float(done.time[i])) if runs else np.inf
        # A vehicle that goes against its rims slips by more than 1; this, not the limit 1, is compared with
        # the deviations.
        back = float(np.median(-ground / np.maximum(rim, SLOWEST_RIM)))
        shown = slip if self._has_rolled else max(slip, 1.0 + back)
        surely_slips = shown > MAY_BE_NONE * unsure
        driven = done.time[i] - self._driven
        self._has_rolled |= bool(runs and slip < ROLLED)
        slides = not self._has_rolled and driven >= BACK_S - 1e-6 and back > 0.0 and surely_slips
        started = slip < ROLLED or done.time[i] - self._began >= START_S - 1e-6 or slides
        self._rolled = bool(runs and (self._rolled or started))
        judged = self._rolled and -BRAKES * self._gravity < gain < GAINS
        if not (judged and surely_slips):
            return _Hazard()
        grows = growth > GROWS or gain < -LOSES * max(rolls, DRIVES)
        now = slip + max(growth, 0.0) * 0.5 * slip_s  # the mean is that of half of its span ago
        value = float(now + SLIP_PER_PULL * missing - less)
        return _Hazard(value, slip, slip - SURELY * deviation, bool(grows))

    def _rate(self, stamp: int) -> float:
        """Mean rate (1/s) of messages of the ground speed in the 5 s before a stamp (ns); 10 for under 3."""
        first, last = np.searchsorted(self._speeds, [stamp - 5 * SECOND, stamp])
        if last - first < 3:
            return 10.0
        spanned = (self._speeds[last - 1] - self._speeds[first]) / SECOND
        return float(np.clip((last - first - 1) / max(spanned, 1e-3), 1.0, 1000.0))


def _level_of(one: _Hazard, before: int) -> int:
    """Level at an instant: one that begins, or the last instant's (`before`) as far as it still holds."""
    value = one.value
    begins = 0
    if value > SECOND_LEVEL and (one.grows or one.slip > SECOND_LEVEL):
        begins = 2
    elif (value > FIRST and (one.grows or one.slip > FIRST)) or (one.grows and one.surely > SLIPS):
        begins = 1
    goes_on = int(value > FIRST - HOLDS) + int(value > SECOND_LEVEL - HOLDS)
    return max(begins, min(before, goes_on))


def _slip(rim: Array, ground: Array) -> float:
    """Median slip over the wheels, -1 to 1. rim (positive), ground: their speeds, m/s, (wheels,)."""
    middle = float(np.median(1.0 - ground / np.maximum(rim, SLOWEST_RIM)))
    return min(max(middle, -1.0), 1.0)


def _line(time: Array, values: Array, seconds: float) -> tuple[float, float]:
    """Slope of a fitted line (unit of the values per s), and the standard deviation about it.

    0 and NaN for less than half of the span `seconds`, or under 4 values.
    """
    good = np.isfinite(values)
    time, values = time[good], values[good]
    if len(time) < 4 or not time[-1] - time[0] > 0.5 * seconds:
        return 0.0, np.nan
    t, v = time - np.mean(time), values - np.mean(values)
    slope = float(t @ v / (t @ t))
    return slope, float(np.sqrt(np.sum((v - slope * t) ** 2) / (len(t) - 2)))


def level_at(instants: Integers, levels: Integers, stamps: Integers) -> Integers:
    """Look up the level of the warning at stamps: that of the newest instant at or before each.

    Parameters
    ----------
    instants
        Stamps of the instants, rising, shape (instants,), ns.
    levels
        Level at each instant, 0, 1 or 2, shape (instants,).
    stamps
        Shape (rows,), ns.

    Returns
    -------
    ndarray
        Shape (rows,): 0, 1 or 2; 0 before the first instant.
    """
    place = np.searchsorted(instants, stamps, side="right") - 1
    return np.where(place >= 0, levels[np.maximum(place, 0)], 0)


def risk_of(risk: Array, level: Integers) -> Array:
    """Combine the risk of getting stuck by the margin with the level of the warning.

    Parameters
    ----------
    risk
        Probability of getting stuck by the margin alone, shape (rows,), 0 to 1; NaN where not known.
    level
        Level of the warning, 0, 1 or 2, shape (rows,).

    Returns
    -------
    ndarray
        Shape (rows,): the risk, at least 0.5 at level 1 and 0.9 at level 2; NaN only where it is not known
        and the level is 0.
    """
    return np.asarray(np.where(level > 0, np.fmax(risk, np.array(RISKS)[level]), risk))
