# SPDX-License-Identifier: Apache-2.0
"""Changes of the ground speed that the accelerometer does not feel.

An observer carries the speed on by the imu alone and is corrected by the ground speed, within some seconds:

    dv/dt = a - g sin(slope) - z + 2 e/T,    dz/dt = -e/T^2,    e = (speed over ground) - v

a is the specific force ahead, z what the accelerometer shows on the level at rest (both poles at 1/T). e is
what has not been felt of the speed's changes. Wheels that dig in brake a vehicle, which is felt; a ground
speed that changes where nothing is felt is in error, or its stamps are.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.pipeline.tables import Array, Flags, Integers

from .lateness import MOVES
from .sums import RunningDeviation

_WITHIN = 3.0  # s, T: in less vibration hides a change, in more the zero drifts and slopes add up
_LONGEST = 1.0  # s between two rows over which what is felt is added up
# Of a change in the last second, at least, that a doubted speed leaves unfelt.
_UNFELT = 0.5
# Deviations of e, which are what 0.8 of its sizes keep to; heavy tails, as in the warning.
_SURELY = 3.0
# s: directions of up are off by half a degree on bumps, and what is compared is the change of a second.
_LEAST = math.radians(0.5) * 1.0
_COUNT = 3  # readings that `_LEAST` counts for before any


class InertialSpeed:
    """Speed ahead by the imu alone, from 0, with all of its drift: the integral of a - g sin(slope)."""

    def __init__(self, gravity: float) -> None:
        self._gravity = gravity
        self._stamp: int | None = None
        self._sums = np.zeros(2)  # nose-up angle by the pitch rate (rad), speed (m/s)
        self._pitches = False  # whether a pitch rate has ever been anything but 0

    def take(self, stamps: Integers, felt: Array) -> Array:
        """Speed at each row of the imu.

        Parameters
        ----------
        stamps
            Shape (rows,), ns, rising.
        felt
            Rows of the imu, z up, shape (rows, 8).

        Returns
        -------
        ndarray
            Shape (rows,), m/s; NaN where neither an orientation nor a pitch rate tells how gravity turns.
        """
        before = np.concatenate([stamps[:1] if self._stamp is None else [self._stamp], stamps[:-1]])
        seconds = (stamps - before) / SECOND
        seconds = np.where(seconds > _LONGEST, 0.0, seconds)
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
    """Whether the last change of the ground speed is one that the imu did not feel."""

    def __init__(self, gravity: float) -> None:
        self._least = gravity * _LEAST
        self._deviation = RunningDeviation(_COUNT)
        self._stamp, self._speed, self._zero, self._inertial = 0, math.nan, 0.0, math.nan

    def take(self, stamps: Integers, speed: Array, earlier: Array, inertial: Array) -> Flags:
        """Judge messages in their order.

        Parameters
        ----------
        stamps
            Shape (rows,), ns, at which the speeds hold.
        speed, earlier
            Speed over ground now and a second before, shape (rows,), m/s; NaN: unknown.
        inertial
            By `InertialSpeed`, as long ago as the ground speed comes late, shape (rows,), m/s.

        Returns
        -------
        ndarray
            Shape (rows,), bool.
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
        """By how much (m/s) the speed is off what the imu makes of those before; NaN: unknown."""
        seconds = (stamp - self._stamp) / SECOND
        felt = inertial - self._inertial
        self._stamp, self._inertial = stamp, inertial
        if not (0.0 <= seconds <= _LONGEST and math.isfinite(felt + self._speed)):
            self._speed = speed
            return math.nan
        self._speed += felt - self._zero * seconds
        off = speed - self._speed
        if math.isfinite(off):
            self._speed += min(2.0 * seconds / _WITHIN, 1.0) * off
            self._zero -= seconds / _WITHIN**2 * off
        return off
