# SPDX-License-Identifier: Apache-2.0
"""The vehicle as a whole, ten times a second: level of the warning, slip, margin, slope, energy.

    take    tenths of a second in which any message came, the warnings, rows and estimates of wheels
            -> VehicleEstimates

An estimate depends on rows before its instant and not on where blocks are cut. There is one whenever any
message came, even if only the imu's: a subscriber then learns that slip is unknown, instead of receiving
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import SLOWEST_RIM, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.pipeline.rows.slip import slip_of
from smallwheel_ros.pipeline.rows.steering import along_course
from smallwheel_ros.pipeline.soil.local_law import Version
from smallwheel_ros.pipeline.tables import (
    Array,
    Columns,
    Estimates,
    Flags,
    Integers,
    Readings,
    none_of,
)
from smallwheel_ros.pipeline.versions import Versions
from smallwheel_ros.pipeline.warning.hazard import HELD, PERIOD, SLIP_S, Instants, Warned
from smallwheel_ros.pipeline.warning.judgement import Judged
from smallwheel_ros.pipeline.warning.margin import information, is_prior
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel

from .answer import STALE
from .status import Condition, MarginSource
from .wheel import SUNK

_PAUSE = 10 * SECOND  # ns: longest time without messages that is filled with estimates
_STEEPEST = 0.87  # sine of 60 degrees, on which no vehicle drives


@dataclass(frozen=True)
class VehicleEstimates(Columns):
    """Estimates of the vehicle at the end of each tenth of a second; NaN if unknown.

    Attributes
    ----------
    stamp
        End of the tenth, ns.
    level
        Level of the warning: a number of VehicleMobility.msg (`WarningLevel`).
    slip_warned
        Median slip of the rolling wheels, in the direction in which their rims turn, on which the warning
        rests, 1; NaN where it rests on none.
    speed, speed_std
        Speed over ground along `course`, and its standard deviation, m/s.
    course
        Direction of travel relative to the heading, rad, positive to the left.
    slip, slip_std
        Median slip of the rolling wheels over half a second, and its standard deviation, 1.
    slip_left, slip_left_std, slip_right, slip_right_std
        The same of the left wheels and of the right ones, 1; of all wheels where a side has none.
    margin, margin_std
        Drawbar pull of all wheels over their load at the reference slip, and its standard deviation, 1.
    margin_source
        What the margin rests on: a number of VehicleMobility.msg (`status.MarginSource`).
    information
        Share of the information about the margin that this drive has given, 0 to 1 (`margin.information`).
    slope_ahead, slope_across
        Slope of the ground, means over 2 s, rad; positive nose up and left side up.
    demand
        Pull over load that the vehicle continues to need, 1.
    risk
        Probability of getting stuck within the next metre, 0 to 1.
    energy
        Energy per metre of travel of all wheels, J/m; NaN where that of one wheel is unknown.
    soil
        Largest number of the soils under the wheels; soils are numbered in the order in which they are found.
    at_border
        Whether some wheels are still on the soil before the last border.
    """

    stamp: Integers
    level: Integers
    slip_warned: Array
    speed: Array
    speed_std: Array
    course: Array
    slip: Array
    slip_std: Array
    slip_left: Array
    slip_left_std: Array
    slip_right: Array
    slip_right_std: Array
    margin: Array
    margin_std: Array
    margin_source: Integers
    information: Array
    slope_ahead: Array
    slope_across: Array
    demand: Array
    risk: Array
    energy: Array
    soil: Integers
    at_border: Flags


class VehicleState:
    """State of the vehicle, carried from block to block.

    Parameters
    ----------
    settings
        The pipeline's settings.
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self._wheels = none_of(
            Estimates
        )  # of the last seconds, since an instant may be before the newest row
        self._numbers = np.empty(0, dtype=np.int64)  # of the soils of these rows
        self._instants: Instants | None = None  # of the last half second
        self._last = _nothing(sum(wheel.contact == ROLLING for wheel in settings.wheels))
        self._told = NEVER  # stamp of the newest estimate
        # Stamps of the newest rows; gravity's components ahead and across (m/s^2), and pull over load needed.
        self._felt: tuple[Integers, Array] = np.empty(0, dtype=np.int64), np.empty((3, 0))

    def take(
        self, heard: Integers, instants: Instants | None, warned: Warned | None, stuck: Flags,
        rows: Readings, judged: Judged, estimates: Estimates, soils: Versions[Version],
    ) -> VehicleEstimates:  # fmt: skip
        """Estimate the vehicle at the end of each tenth of a second in a block.

        Parameters
        ----------
        heard
            Ends of the block's tenths of a second in which any message came, rising, shape (tenths,), ns.
        instants
            Speeds and slope at the new instants of the warning; None if there are none.
        warned
            State of the warning at each instant; None if there are none.
        stuck
            Whether the rims turn and the vehicle does not move, at each instant, shape (instants,).
        rows
            Readings of all wheels in the block.
        judged
            Warning and margin of any ground at each row.
        estimates
            Estimates of the rows that were due.
        soils
            Versions of the soil's law, those in `estimates` included.

        Returns
        -------
        VehicleEstimates
            One row for each tenth since the last call; empty without any message. Tenths without a message
            are included, unless no message came for over 10 s.
        """
        every = Estimates.joined([self._wheels, estimates])
        own = [soils[version].number for version in estimates.soil_version.tolist()]
        numbers = np.concatenate([self._numbers, np.array(own, dtype=np.int64)])
        stamps = np.concatenate([self._felt[0], rows.stamp])
        # From along and across the course to ahead and to the left of the vehicle.
        turned = rows.course != 0.0  # straight ahead the slope is known even if that across is not
        ahead, across = along_course(-rows.course, rows.slope, rows.across)
        ahead = np.where(turned, ahead, rows.slope)
        across = np.where(turned, across, rows.across)
        felt = np.hstack([self._felt[1], np.stack([ahead, across, judged.asked])])
        if instants is not None and warned is not None:
            before = self._last
            self._last = (
                Instants.joined([before[0], instants]),
                Warned.joined([before[1], warned]),
                np.concatenate([before[2], stuck]),
            )
            heard = np.union1d(heard, instants.stamp)
        found = none_of(VehicleEstimates)
        if heard.size:
            found = self._at(*self._every_tenth(heard), every, numbers, stamps, felt)
        recent = every.stamp > every.stamp.max(initial=0) - 2 * STALE
        self._wheels, self._numbers = every.take(recent), numbers[recent]
        recent = stamps > stamps.max(initial=0) - 2 * STALE
        self._felt = stamps[recent], felt[:, recent]
        return found

    def _every_tenth(self, heard: Integers) -> tuple[Instants, Warned, Flags]:
        """Return the newest instant, warning and stuck at each tenth up to the last of `heard`.

        Each is held for `HELD` seconds; after that it is unknown.
        """
        since = heard - np.concatenate([[self._told], heard[:-1]])
        times = np.where(since > _PAUSE, 1, since // PERIOD)
        left = np.repeat(np.cumsum(times), times) - np.arange(times.sum()) - 1
        stamp = np.repeat(heard, times) - PERIOD * left
        self._told = int(stamp[-1])
        instants, warned, stuck = self._last
        index = np.searchsorted(instants.stamp, stamp, side="right") - 1
        newest = slice(-1, None)
        self._last = instants.take(newest), warned.take(newest), stuck[newest]
        instants, warned, stuck = instants.take(index), warned.take(index), stuck[index]
        old = instants.stamp < stamp - round(HELD * SECOND)
        unknown = {
            name: np.where(old if column.ndim == 1 else old[:, None], np.nan, column)
            for name, column in vars(instants).items()
            if name not in ("stamp", "course")
        }
        level = np.where(old, 0, warned.level)
        return (
            replace(instants, stamp=stamp, **unknown),
            replace(warned, stamp=stamp, level=level, slip=np.where(old, np.nan, warned.slip)),
            stuck & ~old,
        )

    def _at(
        self, instants: Instants, warned: Warned, stuck: Flags, every: Estimates, numbers: Integers,
        stamps: Integers, felt: Array,
    ) -> VehicleEstimates:  # fmt: skip
        known = np.isfinite(instants.rim) & np.isfinite(instants.ground)
        shown = 2 * known.sum(axis=1) > known.shape[1]
        level = np.where(
            shown | (warned.level > 0), WarningLevel.OK + warned.level, WarningLevel.UNKNOWN
        )
        level = np.where(stuck, WarningLevel.STUCK, level)
        spread = _median(instants.ground_std)
        usual = np.where(np.isfinite(spread), spread, self.settings.noise.speed)
        moving = np.isfinite(instants.speed)
        slips = self._slips(instants)
        wheels = _Newest(every, numbers, instants.stamp, len(self.settings.wheels))
        margin, margin_std = wheels.margin
        known = information(margin_std, self.settings.reference_slip)
        of_drive = ~is_prior(margin_std, self.settings.reference_slip)
        source = np.where(of_drive, MarginSource.MEASURED, MarginSource.ANY_GROUND)
        of_soil = wheels.by_soil & (of_drive | self.settings.strength_measured)
        ahead, across, asked = _felt(stamps, felt, instants.stamp, self.settings.gravity)
        return VehicleEstimates(
            stamp=instants.stamp, level=level, slip_warned=warned.slip, speed=instants.speed,
            speed_std=np.where(moving, usual, np.nan), course=instants.course,
            slip=slips[0], slip_std=slips[1], slip_left=slips[2], slip_left_std=slips[3],
            slip_right=slips[4], slip_right_std=slips[5],
            margin=margin, margin_std=margin_std,
            margin_source=np.where(of_soil, MarginSource.SOIL, source), information=known,
            slope_ahead=ahead, slope_across=across, demand=asked, risk=wheels.risk,
            energy=wheels.energy, soil=wheels.soil, at_border=wheels.at_border,
        )  # fmt: skip

    def _slips(self, instants: Instants) -> Array:
        """Median slip and its deviation: of all rolling wheels, left ones, right ones; (6, instants)."""
        rolling = [w for w in self.settings.wheels if w.contact == "rolling"]
        side = np.array([wheel.lateral_position for wheel in rolling])
        sides = [side > 0.0, side < 0.0]
        sides = [one if one.any() else np.ones(side.size, dtype=bool) for one in sides]
        old = self._instants
        whole = instants if old is None else Instants.joined([old, instants])
        count, first = len(instants), len(whole) - len(instants)
        begins = np.searchsorted(
            whole.stamp, instants.stamp - round(SLIP_S * SECOND), side="right"
        ).tolist()
        parts = [slice(begin, first + k + 1) for k, begin in enumerate(begins)]
        rim, ground, ground_std = (
            np.array([column[part].mean(axis=0) for part in parts]).reshape(count, side.size)
            for column in (whole.rim, whole.ground, np.nan_to_num(whole.ground_std))
        )
        known = np.isfinite(rim) & np.isfinite(ground)
        known &= 2 * known.sum(axis=1, keepdims=True) > side.size
        slip, spread = _slip(rim, ground, ground_std)
        found = np.full((6, count), np.nan)
        for j, of in enumerate([np.ones(side.size, dtype=bool), *sides]):
            for i, column in enumerate((slip, spread)):
                found[2 * j + i] = _median(np.where(known & of, column, np.nan))
        self._instants = whole.take(slice(-5, None))
        return found


def _nothing(wheels: int) -> tuple[Instants, Warned, Flags]:
    """An instant before all others, at which nothing is known; `wheels`: number of rolling wheels."""
    never, no = np.array([NEVER]), np.zeros(1, dtype=np.int64)
    of_wheels, one = np.full((1, wheels), np.nan), np.full(1, np.nan)
    return (
        Instants(never, of_wheels, of_wheels, of_wheels, one, one, one, np.zeros(1), np.zeros(1)),
        Warned(never, one, one, no, no),
        np.zeros(1, dtype=bool),
    )


def _slip(rim: Array, ground: Array, spread: Array) -> tuple[Array, Array]:
    """Slip of wheels, driven or braked, and its deviation; NaN where a wheel stands.

    rim, ground: speeds, m/s. spread: deviation of the speed over ground, m/s.
    """
    exact = np.zeros_like(rim)
    slip, _, _ = slip_of(ground, exact, rim, exact, SLOWEST_RIM)
    larger = np.maximum(np.abs(rim), np.abs(ground))
    return slip, np.where(np.isfinite(slip), spread / np.maximum(larger, SLOWEST_RIM), np.nan)


def _median(table: Array) -> Array:
    """Median of each row's numbers, NaN where there is none."""
    rows, columns = table.shape
    if not columns:
        return np.full(rows, np.nan)
    ordered = np.sort(table, axis=1)  # NaN last; `np.nanmedian` takes ten times as long for so few
    count = columns - np.isnan(table).sum(axis=1)
    index = np.arange(rows)
    low, high = ordered[index, np.maximum(count - 1, 0) // 2], ordered[index, count // 2]
    return np.where(np.isfinite(table).any(axis=1), 0.5 * (low + high), np.nan)


def _felt(stamps: Integers, felt: Array, instants: Integers, gravity: float) -> Array:
    """Slopes (rad), means over 2 s, ahead (nose up) and across (left side up), and demand; (3, instants).

    NaN where unknown. felt: gravity ahead and across (m/s^2), and demand, at stamps, (3, stamps).
    """
    found = np.full((3, instants.size), np.nan)
    end = np.searchsorted(stamps, instants, side="left")
    begin = np.searchsorted(stamps, instants - STALE, side="left")
    known = np.isfinite(felt)
    sums = [
        np.concatenate([[0.0], np.cumsum(np.where(k, f, 0.0))])
        for k, f in zip(known, felt, strict=True)
    ]
    counts = [np.concatenate([[0], np.cumsum(k)]) for k in known]
    for j in (0, 1):
        number = counts[j][end] - counts[j][begin]
        total = (sums[j][end] - sums[j][begin]) / np.maximum(number, 1) / gravity
        sine = np.clip(total, -_STEEPEST, _STEEPEST)
        found[j] = np.where(number > 0, np.arcsin(sine), np.nan)
    fresh = end > begin
    found[2, fresh] = felt[2, end[fresh] - 1]
    return found


class _Newest:
    """Numbers of the vehicle from the newest row of each wheel before each instant, at most 2 s older.

    numbers: number of the soil of each row of `every`. wheels: number of wheels.
    """

    def __init__(
        self, every: Estimates, numbers: Integers, instants: Integers, wheels: int
    ) -> None:
        place = np.full((wheels, instants.size), -1)
        for wheel in range(wheels):
            own = np.flatnonzero(every.wheel == wheel)
            if own.size:
                before = np.searchsorted(every.stamp[own], instants, side="left") - 1
                old = (before < 0) | (every.stamp[own[np.maximum(before, 0)]] < instants - STALE)
                place[wheel] = np.where(old, -1, own[np.maximum(before, 0)])
        self._place, self._every = np.maximum(place, 0), every
        self._fresh = place >= 0
        if not len(every):
            self._fresh = np.zeros_like(self._fresh)
        of = self._of(numbers, 0)
        self.soil = of.max(axis=0, initial=0)
        self.at_border: Flags = np.asarray(self._of(every.elsewhere, False).any(axis=0))
        by = self._of(every.margin_by_soil, False)
        sunk = self._of(every.conditions, 0) & int(Condition.SUNK_TO_AXLE)
        self._sunk = by & (sunk > 0)
        known = np.isfinite(self._of(every.margin, np.nan)) | self._sunk
        self.by_soil = known.any(axis=0) & (by | ~known).all(axis=0)
        energy = self._of(every.energy, np.nan)
        self.energy = energy.sum(axis=0)  # NaN where one is
        risk = self._of(every.risk, np.nan)
        stamp = np.where(np.isfinite(risk), self._of(every.stamp, 0), -1)
        self.risk = np.take_along_axis(risk, stamp.argmax(axis=0)[None], axis=0)[0]

    def _of(self, column: NDArray[Any], otherwise: float) -> NDArray[Any]:
        """A column's values of each wheel at each instant, (wheels, instants); `otherwise` without a row."""
        if not column.size:
            return np.full(self._fresh.shape, otherwise)
        return np.where(self._fresh, column[self._place], otherwise)

    @property
    def margin(self) -> tuple[Array, Array]:
        """Pull of all wheels over their load, and its deviation, (instants,); NaN without any margin.

        A wheel that is sunk to its axle counts as `SUNK`; others without a margin are left out. Where the
        load of one is unknown, all have the same weight. All wheels stand on one estimated soil, so their
        errors are taken to be fully correlated.
        """
        every = self._every
        margin, spread = self._of(every.margin, np.nan), self._of(every.margin_std, np.nan)
        margin, spread = np.where(self._sunk, SUNK, margin), np.where(self._sunk, 0.0, spread)
        known = np.isfinite(margin)
        load = self._of(every.load, np.nan)
        weighed = (np.isfinite(load) | ~known).all(axis=0)
        load = np.where(known, np.where(weighed, load, 1.0), 0.0)
        total = np.where(known.any(axis=0), load.sum(axis=0), np.nan)
        return (
            (load * np.where(known, margin, 0.0)).sum(axis=0) / total,
            (load * np.where(known, spread, 0.0)).sum(axis=0) / total,
        )


def vehicle_margin(newest: Estimates) -> Quantity | None:
    """Compute the margin of a vehicle: pull of all wheels over their load at the reference slip, 1.

    A wheel that is sunk to its axle by a measured law counts as `SUNK`. Wheels are weighted by load, or
    equally where a load is unknown.

    Parameters
    ----------
    newest
        Newest row of each wheel; rows over 2 s older than the newest of all are left out.

    Returns
    -------
    Quantity or None
        Value and standard deviation, 1; None where no wheel has a margin or is so sunk.
    """
    if not len(newest):
        return None
    now = np.array([newest.stamp.max() + 1])
    numbers = np.zeros(len(newest), dtype=np.int64)
    margin, spread = _Newest(newest, numbers, now, int(newest.wheel.max()) + 1).margin
    return Quantity(float(margin[0]), float(spread[0])) if np.isfinite(margin[0]) else None
