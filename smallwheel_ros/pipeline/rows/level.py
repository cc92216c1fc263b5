# SPDX-License-Identifier: Apache-2.0
"""Zero error of the imu's tilt, by mounting or drift, learnt from turns and returns.

State: slopes e and n of the ground along x and y of the odometry's frame, and the imu's zeros p and
r ahead and across. On a vehicle with heading a the imu shows

    ahead = e cos a + n sin a + p,    across = n cos a - e sin a + r     (tangents, as g sin over g)

The slope stays with the ground, a zero with the imu: a straight drive cannot separate them, a
quarter of a turn on the spot does. Prediction: slopes are an Ornstein-Uhlenbeck process along the
path, 0.15 over 40 m; zeros one in time, 1.5 degrees over 3 minutes, since orientations are filtered
gyroscopes. A measurement is the mean of the newest 20 rows after 0.2 m or 0.2 rad, with 0.5 degrees
of its own: bumps.
"""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import KalmanFilter

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.tables import Array, Integers, Readings

_SLOPE, _LENGTH = 0.15, 40.0  # tangent, m: hills
_ZERO, _ZERO_TIME = math.radians(1.5), 180.0  # tangent, s
_ROW, _WAY, _TURN, _NEWEST = math.radians(0.5), 0.2, 0.2, 20  # tangent, m, rad, rows
_SPREAD = np.array([_SLOPE, _SLOPE, _ZERO, _ZERO])
_AHEAD = 512  # rows looked through at once


class Level:
    """Learns the zero error of the slope force g sin(slope) that the imu shows.

    Parameters
    ----------
    gravity
        Acceleration of gravity, m/s^2.
    """

    def __init__(self, gravity: float = GRAVITY) -> None:
        self._gravity = gravity
        self.kalman = KalmanFilter(dim_x=4, dim_z=2)
        self.kalman.x, self.kalman.P = np.zeros(4), np.diag(np.square(_SPREAD))
        self.kalman.R = _ROW**2 * np.eye(2)
        self._rows = np.zeros(
            (0, 5)
        )  # the newest: s, m, heading, ahead, across; from the last one taken on
        self._origin: int | None = None
        self._stamps, self._zeros = [NEVER], [(0.0, gravity * _ZERO)]

    def take(self, rows: Readings) -> None:
        """Learn from rows in the order of stamps; those of unknown slope or heading are skipped."""
        if rows.slope.size and self._origin is None:
            self._origin = int(rows.stamp[0])
        known = np.isfinite(rows.slope) & np.isfinite(rows.across) & np.isfinite(rows.heading)
        if not known.any():
            return
        seconds = (rows.stamp - (self._origin or 0)) / SECOND
        slopes = rows.slope / self._gravity, rows.across / self._gravity
        columns = seconds, rows.distance, rows.heading, *slopes
        held = len(self._rows)
        table = np.vstack([self._rows, np.column_stack(columns)[known]])
        stamps = np.concatenate([np.zeros(held, dtype=np.int64), rows.stamp[known]])
        taken, i = 0, max(held, 1)
        while i < len(table):
            part = table[i : i + _AHEAD]
            turned = np.abs(
                np.remainder(part[:, 2] - table[taken, 2] + math.pi, math.tau) - math.pi
            )
            far = (part[:, 1] - table[taken, 1] >= _WAY) | (turned >= _TURN)
            if not far.any():
                i += len(part)
                continue
            i += int(np.argmax(far))
            since = table[taken]
            self._use(table[i], since, table[max(taken, i - _NEWEST) + 1 : i + 1, 3:].mean(axis=0))
            self._stamps.append(int(stamps[i]))
            zero = float(self.kalman.x[2]), math.sqrt(max(float(self.kalman.P[2, 2]), 0.0))
            self._zeros.append((self._gravity * zero[0], self._gravity * zero[1]))
            taken, i = i, i + 1
        rest = np.arange(max(taken + 1, len(table) - _NEWEST), len(table))
        self._rows = table[np.concatenate([[taken], rest])]

    def _use(self, row: Array, since: Array, shown: Array) -> None:
        kalman = self.kalman
        metres, seconds = row[1] - since[1], max(row[0] - since[0], 0.0)
        keep = np.exp([-metres / _LENGTH] * 2 + [-seconds / _ZERO_TIME] * 2)
        kalman.F, kalman.Q = np.diag(keep), np.diag((1.0 - keep**2) * np.square(_SPREAD))
        kalman.predict()
        cosine, sine = math.cos(row[2]), math.sin(row[2])
        kalman.update(shown, H=np.array([[cosine, sine, 1.0, 0.0], [-sine, cosine, 0.0, 1.0]]))

    def at(self, stamps: Integers) -> Array:
        """Zero error of the slope force ahead and its standard deviation, m/s^2, at stamps (ns); (stamps, 2).

        Each depends only on the rows up to its stamp.
        """
        place = np.searchsorted(np.array(self._stamps), stamps, side="right") - 1
        return np.array(self._zeros)[place].reshape(-1, 2)

    def forget(self, before: int) -> None:
        """Drop what `at` needs only for stamps before this one (ns)."""
        drop = max(int(np.searchsorted(np.array(self._stamps), before, side="right")) - 1, 0)
        del self._stamps[:drop], self._zeros[:drop]
