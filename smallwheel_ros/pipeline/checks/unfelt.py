# SPDX-License-Identifier: Apache-2.0
"""Changes of the ground speed that the accelerometer does not feel.

An observer carries the speed on by the imu alone and is corrected by the ground speed, within some seconds:

    dv/dt = a - g sin(slope) - z + 3 e/T,    dz/dt = w - 3 e/T^2,    dw/dt = -e/T^3

a is the specific force ahead, z what the accelerometer shows on the level at rest, w how it drifts: a pitch
rate that is off adds up to a slope. All three poles are at 1/T. e = (speed over ground) - v is what has not
been felt of the speed's changes. Wheels that dig in brake a vehicle, which is felt; a ground speed that
changes where nothing is felt is in error, or its stamps are.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.pipeline.intake.layout import MAXIMUM_GAP
from smallwheel_ros.pipeline.tables import Array, Flags, Integers

from .lateness import MOVES
from .sums import RunningDeviation

_WITHIN = 3.0  # s, T: in less vibration hides a change, in more the zero drifts and slopes add up
# ns, after which a twentieth of what was off at first is left.
_SETTLES = round(3 * _WITHIN * SECOND)
_LONGEST = 2.0  # s between two speeds: some odometries send one a second
# Of a change in the last second, at least, that a doubted speed leaves unfelt.
_UNFELT = 0.5
# Deviations of e, which are what 0.8 of its sizes keep to; heavy tails, as in the warning.
_SURELY = 3.0
# rad s: directions of up are off by half a degree on bumps, and changes over a second are compared.
_LEAST = math.radians(0.5) * 1.0
_COUNT = 3  # readings that `_LEAST` counts for before any


class InertialSpeed:
    """Speed ahead by integration of the imu alone, from 0, with its drift: the integral of a - g sin(slope).

    Without an orientation the slope is integrated from the pitch rate.
    """

    def __init__(self, gravity: float) -> None:
        self._gravity = gravity
        self._stamp: int | None = None
        self._sums = np.zeros(2)  # nose-up angle by the pitch rate (rad), speed (m/s)
        self._pitches = False  # whether a pitch rate has ever been anything but 0

    def take(self, stamps: Integers, felt: Array) -> Array:
        """Integrate the speed up to each row of the imu.

        Parameters
        ----------
        stamps
            Shape (rows,), ns, rising.
        felt
            Rows of the imu in axes with z up, shape (rows, 8): the first columns of `BelievedRows.felt`.

        Returns
        -------
        ndarray
            Shape (rows,), m/s; NaN where neither an orientation nor a pitch rate shows the slope.
        """
        before = np.concatenate([stamps[:1] if self._stamp is None else [self._stamp], stamps[:-1]])
        seconds = (stamps - before) / SECOND
        seconds = np.where(seconds > MAXIMUM_GAP, 0.0, seconds)
        ahead, up, pitch_rate = np.nan_to_num(felt[:, 1]), felt[:, 4], np.nan_to_num(felt[:, 7])
        turns = np.concatenate([self._sums[:1], -pitch_rate * seconds])
        nose_up = np.cumsum(turns)[1:]
        pitches = np.logical_or.accumulate(np.append(self._pitches, pitch_rate != 0.0))[1:]
        slope = np.where(np.isnan(up), nose_up, up)
        gains = np.concatenate([self._sums[1:], (ahead - self._gravity * slope) * seconds])
        speed = np.cumsum(gains)[1:]
        self._stamp, self._pitches = int(stamps[-1]), bool(pitches[-1])
        self._sums = np.array([nose_up[-1], speed[-1]])
        return np.where(np.isnan(up) & ~pitches, np.nan, speed)


class Unfelt:
    """Detects changes of the ground speed that the imu does not feel."""

    def __init__(self, gravity: float) -> None:
        self._least = gravity * _LEAST
        self._deviation = RunningDeviation(_COUNT)
        self._stamp, self._speed, self._inertial, self._settled = 0, math.nan, math.nan, 0
        self._zero = self._drift = 0.0

    def take(self, stamps: Integers, speed: Array, earlier: Array, inertial: Array) -> Flags:
        """Tell at which messages of the ground speed the imu did not feel its last change.

        Parameters
        ----------
        stamps
            Stamps at which the speeds hold, shape (rows,), ns.
        speed, earlier
            Speed over ground at these stamps and a second before, shape (rows,), m/s; NaN: unknown.
        inertial
            Speed by the imu alone (`InertialSpeed`), at these stamps less the delay of the ground speed,
            shape (rows,), m/s; NaN: unknown.

        Returns
        -------
        ndarray
            Shape (rows,), bool: True where the change over the last second was not felt.
        """
        off: Array = np.empty(stamps.size)
        rows = zip(stamps.tolist(), speed.tolist(), inertial.tolist(), strict=True)
        for i, row in enumerate(rows):
            off[i] = self._missed(*row)
        changed = speed - earlier
        with np.errstate(invalid="ignore"):
            moves = np.isfinite(off) & (np.maximum(np.abs(speed), np.abs(earlier)) > MOVES)
            least = np.full(stamps.size, self._least)
            spread = self._deviation.take(moves, np.abs(off), least)
            unfelt = np.abs(changed - off) < _UNFELT * np.abs(changed)
            return np.asarray(unfelt & (np.abs(off) > _SURELY * np.maximum(spread, least)))

    def _missed(self, stamp: int, speed: float, inertial: float) -> float:
        """Innovation e (m/s) of the observer at a message; NaN until the observer has settled.

        stamp: ns. speed, inertial: as in `take`, m/s.
        """
        seconds = (stamp - self._stamp) / SECOND
        felt = inertial - self._inertial
        self._stamp, self._inertial = stamp, inertial
        if not (0.0 < seconds <= _LONGEST and math.isfinite(felt + self._speed)):
            self._speed, self._settled = speed, stamp + _SETTLES
            return math.nan
        self._speed += felt - (self._zero + 0.5 * self._drift * seconds) * seconds
        self._zero += self._drift * seconds
        off = speed - self._speed
        if math.isfinite(off):
            # Gains of a fading memory of second degree (Morrison 1969): critically damped at any period.
            kept = math.exp(-seconds / _WITHIN)
            lost = 1.0 - kept
            self._speed += (1.0 - kept**3) * off
            self._zero -= 1.5 * (1.0 - kept**2) * lost / seconds * off
            self._drift -= lost**3 / seconds**2 * off
        return off if stamp >= self._settled else math.nan
