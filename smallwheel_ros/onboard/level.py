# SPDX-License-Identifier: Apache-2.0
"""The zero of the imu: how far off level it is mounted, or has wandered, as turns and ways back show it.

State: slopes of the ground east and north in the frame of the odometry, e and n, and the zeros of what is
shown ahead and across, p and r. A vehicle that looks along the heading a is shown

    ahead = e cos a + n sin a + p,    across = n cos a - e sin a + r     (tangents, as g sin over g)

The ground follows the vehicle, a zero stays with the imu: on the straight nobody can tell one from the other,
and a quarter of a turn on one spot tells both. Prediction: slopes are an Ornstein-Uhlenbeck process along the
path, 0.15 over 40 m; zeros one in time, 1.5 degrees over 3 minutes, since orientations are filtered
gyroscopes. A row is taken after 0.2 m or 0.2 rad, with 0.5 degrees of its own: bumps.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.strength_filter import LEVEL_STD
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]

_SLOPE, _LENGTH = 0.15, 40.0  # tangent, m: hills
_ZERO, _TIME = LEVEL_STD / GRAVITY, 180.0  # tangent, s
_ROW = math.radians(0.5)
_WAY, _TURN = 0.2, 0.2  # m, rad
_NEWEST = 16  # instants over which a slope is a mean
_SURE, _WORTH = 3.0, math.radians(1.5)  # deviations and size of a zero that is said


class Level:
    """Of a vehicle; feed it every instant in the order of time. zero: of the slope force ahead, m/s^2."""

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

    def add(self, instant: Instant) -> bool:
        """Take an instant; return whether the zero is known better now, or less well."""
        force, heading = instant.slope_force, instant.heading
        if force is None or instant.across_force is None:
            self._newest.clear()
            return False
        way = 1.0 if instant.forward else -1.0
        self._newest.append((way * force / GRAVITY, instant.across_force / GRAVITY))
        self._shown.append(self._newest[-1])
        if heading is None:
            self._shown.clear()
            return False
        time = instant.stamp / SECOND
        if self._last is None:
            self._last = time, instant.distance, heading
        since, begin, looked = self._last
        turned = abs(math.remainder(heading - looked, math.tau))
        if instant.distance - begin < _WAY and turned < _TURN:
            del self._shown[:-20]  # who stands shows the same
            return False
        self._predict(instant.distance - begin, time - since)
        cosine, sine = math.cos(heading), math.sin(heading)
        ahead, across = np.mean(self._shown, axis=0).tolist()
        self._update(np.array([cosine, sine, 1.0, 0.0]), ahead)
        self._update(np.array([-sine, cosine, 0.0, 1.0]), across)
        self._last, self._shown = (time, instant.distance, heading), []
        return True

    def _predict(self, metres: float, seconds: float) -> None:
        keep = np.array(
            [math.exp(-metres / _LENGTH)] * 2 + [math.exp(-max(seconds, 0.0) / _TIME)] * 2
        )
        self._x = keep * self._x
        told = np.square([_SLOPE, _SLOPE, _ZERO, _ZERO])
        self._P = self._P * np.outer(keep, keep) + np.diag((1.0 - keep**2) * told)

    def _update(self, row: Array, shown: float) -> None:
        gain = self._P @ row / (float(row @ self._P @ row) + _ROW**2)
        self._x = self._x + gain * (shown - float(row @ self._x))
        self._P = self._P - np.outer(gain, row @ self._P)
