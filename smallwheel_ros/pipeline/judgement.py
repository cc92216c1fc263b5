# SPDX-License-Identifier: Apache-2.0
"""What is not to be believed, what is to be warned of, the margin of any ground: checks and warnings at work.

    blanked   rows without what checks doubt: of a doubted stream nothing is known
    judged    instants of 0.1 s: hazard and its levels, which wheels spin on the spot; each second the margin

A doubt holds from the stamp at which it could be judged (`checks`), and what holds at a row is that of its
stamp, so that neither depends on where blocks are cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings

from .align import Align
from .checks import Checks, Finding
from .margin import AnyGround, Ground, Margins
from .stream import NEVER, Stream
from .tables import SECOND, Array, Columns, Flags, Integers, Readings
from .warnings import Instants, Warned, Warnings, level_at

# Columns of `Readings` that a stream makes; odometry and velocity make those of every wheel.
_OF_WHEEL = {
    "load": ("load", "load_std"),
    "sinkage": ("sinkage", "sinkage_std"),
    "wheel_speed": ("rim_speed", "rim_std", "slip", "slip_std"),
    "torque": ("torque",),
    "drawbar_pull": ("pull",),
}
_OF_SPEED = ("vehicle_speed", "speed", "speed_std", "slip", "slip_std", "gained")
_OF_VEHICLE = {
    ODOMETRY: ("x", "y", "heading"),
    VELOCITY: _OF_SPEED,
    IMU: ("slope", "across", "vertical", "yaw_rate"),
}
_SPINS = (
    0.8  # slip with which nothing is gained any more: a wheel turns five times as far as it gets
)
_HIDDEN = 0.3  # slip that an odometry of the wheels may hide: what the twist takes slip for, too
_ASKED_STALE = 2 * SECOND  # ns: a margin is of a whole second, and known some tenths later


@dataclass(frozen=True)
class Judged(Columns):
    """What holds at rows: level of the warning, whether a wheel spins on the spot, margin of any ground.

    asked: pull over load that goes on being asked for; risk: that such ground does not give it. NaN: unknown.
    """

    level: Integers
    spins: Flags
    margin: Array
    margin_std: Array
    asked: Array
    risk: Array


class Judgement:
    """Checks, warnings and the margin of any ground of one vehicle.

    warned: of the newest turn; None: no tenth of a second was over.
    """

    def __init__(self, settings: OnboardSettings, align: Align) -> None:
        self.settings = settings
        self.checks = Checks(settings, align.ground)
        self.warnings = Warnings(settings.wheels, IMU in settings.streams)
        self.ground = AnyGround(self.warnings.side)
        self.warned: Warned | None = None
        self._speed_is = (
            VELOCITY
            if VELOCITY in settings.streams
            else ODOMETRY
            if settings.velocity != "none"
            else ""
        )
        self._instants: Instants | None = None  # of the last second, for spinning
        self._spinning: tuple[Integers, Flags] = np.empty(0, dtype=np.int64), np.empty((0, 0), bool)
        self._levels: tuple[Integers, Integers] = np.array([NEVER]), np.zeros(1, dtype=np.int64)
        self._margins: Margins | None = None
        self._slip = np.nan
        self._wheels_since: int | None = (
            None  # ns, since when the odometry is known to be of the wheels
        )

    # --- Doubts

    def check(
        self, rows: Readings, align: Align, *, last: bool
    ) -> tuple[Readings, tuple[Finding, ...]]:
        """Look at the raw rows behind the last watermark: rows as far as they are believed, and findings.

        Each finding is reported once.
        """
        found = self.checks.take(align.raw(), align.done)
        if last:
            found += self.checks.flush()
        return self._blanked(self._unsure(rows, align)), tuple(found)

    def _unsure(self, rows: Readings, align: Align) -> Readings:
        """Rows whose slip may be that of an odometry made of the wheels: it says as little as none at all."""
        may_be = align.ground.trust(rows.stamp).may_be
        if not may_be.any():
            return rows
        spread = np.maximum(rows.slip_std, np.where(may_be, _HIDDEN, 0.0))
        return replace(rows, slip_std=spread)

    def _blanked(self, rows: Readings) -> Readings:
        """Rows of which nothing is known by streams that were doubted at their stamps."""
        history = self.checks.history
        if not len(rows) or (len(history) == 1 and not history[0][1]):
            return rows
        changed: dict[str, Any] = {}

        def blank(columns: tuple[str, ...], where: Flags) -> None:
            for name in columns:
                before = changed.get(name, getattr(rows, name))
                changed[name] = np.where(where, np.nan, before)

        ends = np.array([stamp for stamp, _ in history[1:]] + [-NEVER])
        holds = np.searchsorted(ends, rows.stamp, side="left")
        numbers = {wheel.name: i for i, wheel in enumerate(self.settings.wheels)}
        for i, (_, doubted) in enumerate(history):
            for stream in doubted:
                wheel, _, kind = stream.rpartition("/")
                if wheel:
                    blank(_OF_WHEEL[kind], (holds == i) & (rows.wheel == numbers[wheel]))
                else:
                    blank(_OF_VEHICLE[stream], holds == i)
                    if stream == self._speed_is:
                        blank(_OF_SPEED, holds == i)
        self.checks.forget_history(int(rows.stamp[-1]))
        return replace(rows, **changed) if changed else rows

    # --- Warning and margin

    def judge(self, rows: Readings, align: Align) -> Judged:
        """Go on with rows; what holds at each of them. `warned` has what is new."""
        rows = self._by_ground(rows, align)
        felt = align.ground.felt.between(align.since, align.done)
        speeds = align.streams.all.get(self._speed_is)
        stamps = (
            speeds.between(align.since, align.done)[0]
            if isinstance(speeds, Stream)
            else felt[0][:0]
        )
        imu = felt if felt[0].size and IMU not in self.checks.doubted else None
        made = self.warnings.take(rows, stamps, imu, align.done)
        self.warned = None
        if made is not None:
            instants, self.warned = made
            self._slip = float(self.warned.slip[-1])
            self._levels = _carried(self._levels, self.warned.stamp, self.warned.level)
            self._spin(instants)
            margins = self.ground.take(instants)
            if margins is not None:
                # A second is over with the first instant behind it: from there on its margin holds.
                behind = np.searchsorted(instants.stamp, margins.stamp, side="right")
                margins = self._unlearnt(replace(margins, stamp=instants.stamp[behind]))
                old = self._margins
                self._margins = margins if old is None else Margins.joined([old, margins])
        found = self._at(rows)
        self._levels = self._levels[0][-1:], self._levels[1][-1:]
        self._spinning = self._spinning[0][-1:], self._spinning[1][-1:]
        if self._margins is not None:
            self._margins = self._margins.take(slice(-1, None))
        return found

    def _by_ground(self, rows: Readings, align: Align) -> Readings:
        """Rows without speeds that are of the wheels: these show no slip, and teach nothing of the ground."""
        of_wheels = align.ground.trust(rows.stamp).of_wheels
        if not of_wheels.any():
            return rows
        if self._wheels_since is None:
            self._wheels_since = int(rows.stamp[np.argmax(of_wheels)])
        return replace(
            rows,
            speed=np.where(of_wheels, np.nan, rows.speed),
            vehicle_speed=np.where(of_wheels, np.nan, rows.vehicle_speed),
        )

    def _unlearnt(self, margins: Margins) -> Margins:
        """The margin of ground that nothing is known of, once it has turned out that the wheels taught it."""
        if self._wheels_since is None:
            return margins
        wrong = margins.stamp > self._wheels_since
        mean, deviation = Ground().moments()
        return replace(
            margins,
            margin=np.where(wrong, mean, margins.margin),
            margin_std=np.where(wrong, deviation, margins.margin_std),
            risk=np.where(wrong, np.nan, margins.risk),
        )

    @property
    def slip(self) -> float:
        """Of the middle wheel, where there is a level."""
        return self._slip

    @property
    def level(self) -> int:
        """Of the warning, now."""
        return int(self._levels[1][-1])

    def _spin(self, instants: Instants) -> None:
        """Whether wheels spin on the spot, with most of the vehicle: mean speeds of a second."""
        whole = instants if self._instants is None else Instants.joined([self._instants, instants])
        first = len(whole) - len(instants)
        spins = np.zeros((len(instants), whole.rim.shape[1]), dtype=bool)
        for k in range(len(instants)):
            end = first + k + 1
            begin = int(np.searchsorted(whole.stamp, whole.stamp[end - 1] - SECOND, side="right"))
            if end - begin >= 10:
                rim, ground = whole.rim[begin:end], whole.ground[begin:end]
                spins[k] = np.abs(ground.mean(axis=0)) < (1.0 - _SPINS) * np.abs(rim.mean(axis=0))
        spins &= 2 * spins.sum(axis=1, keepdims=True) > spins.shape[1]
        before, flags = self._spinning
        flags = flags if flags.shape[1] else np.zeros((0, spins.shape[1]), dtype=bool)
        self._spinning = np.concatenate([before, instants.stamp]), np.vstack([flags, spins])
        self._instants = whole.take(slice(-10, None))

    def _at(self, rows: Readings) -> Judged:
        count = len(rows)
        level = level_at(*self._levels, rows.stamp)
        spins = np.zeros(count, dtype=bool)
        stamps, flags = self._spinning
        if stamps.size:
            order = np.full(len(self.settings.wheels), -1)
            order[self.warnings.rolling] = np.arange(self.warnings.rolling.size)
            place = np.searchsorted(stamps, rows.stamp, side="right") - 1
            fresh = (place >= 0) & (order[rows.wheel] >= 0)
            spins[fresh] = flags[place[fresh], order[rows.wheel[fresh]]]
        margin, margin_std, asked, risk = np.full((4, count), np.nan)
        margins = self._margins
        if margins is None:
            margin[:], margin_std[:] = self.ground.ground.moments()
        else:
            place = np.searchsorted(margins.stamp, rows.stamp, side="right") - 1
            at = np.maximum(place, 0)
            fresh = (place >= 0) & (rows.stamp - margins.stamp[at] <= _ASKED_STALE)
            margin, margin_std = margins.margin[at], margins.margin_std[at]
            asked[fresh], risk[fresh] = margins.asked[at[fresh]], margins.risk[at[fresh]]
        return Judged(level, spins, margin, margin_std, asked, risk)


def _carried(
    before: tuple[Integers, Integers], stamps: Integers, values: Integers
) -> tuple[Integers, Integers]:
    return np.concatenate([before[0], stamps]), np.concatenate([before[1], values])
