# SPDX-License-Identifier: Apache-2.0
"""The warning before a vehicle gets stuck, by slip as odometry and wheel speeds alone show it.

A straight line through the slip of the middle wheel over 1.5 s, or half a metre of the rims where that is
longer, weighted by the deviations of the readings, gives the slip now, its trend, and by both the slip when a
driver who is warned now has stopped: 3 s or half a metre on, whichever is later.
It is warned where, surely,

    slip is over 0.3: from there on the net traction of small wheels hardly rises;
    slip is over 0.2 and rises, and will be over the reference slip by then;

or slip is over 0.2 and the risk over 0.8 (see `stuck_warning`). Surely: by 1.5 deviations of the line, which
leave one reading in fifteen; errors of an odometry are alike over 0.3 s (`path_steps`). Steps of the path, by
which it goes where sinkage is measured, take long where wheels slip. Who gains speed slips because of that,
and who turns on the spot gets nowhere: neither is warned.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.wheel import Quantity

_WINDOW, _SHORTEST = 1.5, 0.6  # s
_ALIKE = 0.3  # s
_SURELY = 1.5  # deviations
_ORDINARY, _HIGH, _LIKELY = 0.2, 0.3, 0.8  # slip, slip, risk: as in `stuck_warning`
_STOPS, _WAY, _LONGEST = 3.0, 0.5, 10.0  # s, m, s
_GAINS = 0.1  # m/s^2


class SlipWarning:
    """Of a vehicle; feed it every instant in the order of time. wheels: that roll."""

    def __init__(self, wheels: int, reference_slip: float) -> None:
        self._wheels, self._reference = wheels, reference_slip
        self._now: list[Instant] = []  # of one stamp
        # s; slip of the middle wheel; m/s, mean of the rims.
        self._readings: deque[tuple[float, Quantity, float]] = deque()
        self.warning = ""

    def add(self, instant: Instant, risk: float | None) -> str:
        """Take an instant; return the warning in words, empty where there is none."""
        if self._now and instant.stamp != self._now[0].stamp:
            self._take()
            self.warning = self._words(risk)
            self._now = []
        self._now.append(instant)
        return self.warning

    def _take(self) -> None:
        """Keep the middle of the wheels' slips.

        Begin anew where the vehicle stands, turns back or turns on the spot.
        """
        slips = sorted((one.slip for one in self._now if one.slip is not None), key=_value)
        ways = {one.forward for one in self._now if one.slip is not None}
        if 2 * len(slips) <= self._wheels or len(ways) > 1:
            self._readings.clear()
            return
        rims = [one.rim_speed for one in self._now if one.rim_speed is not None]
        rim = sum(rims) / len(rims)
        newest = self._readings[-1] if self._readings else None
        time = self._now[0].stamp / SECOND
        if newest is not None and (newest[2] * rim < 0.0 or time - newest[0] > _SHORTEST):
            self._readings.clear()
        self._readings.append((time, slips[(len(slips) - 1) // 2], rim))
        window = min(max(_WINDOW, _WAY / max(abs(rim), 1e-3)), _LONGEST)
        while time - self._readings[0][0] > window:
            self._readings.popleft()

    def _words(self, risk: float | None) -> str:
        first, last = (self._readings[0], self._readings[-1]) if self._readings else (None, None)
        if first is None or last is None or last[0] - first[0] < _SHORTEST:
            return ""
        seconds = last[0] - first[0]
        if (abs(last[2]) - abs(first[2])) / seconds > _GAINS:
            return ""
        times = np.array([reading[0] - last[0] for reading in self._readings])
        slips = np.array([reading[1].value for reading in self._readings])
        weights = [1.0 / max(reading[1].standard_deviation, 1e-3) for reading in self._readings]
        line, spread = np.polyfit(times, slips, 1, w=weights, cov="unscaled")
        alike = max(_ALIKE * (len(times) - 1) / seconds, 1.0)
        trend, now = line.tolist()
        travel = max((1.0 - now) * abs(last[2]), 1e-3)
        until = min(max(_STOPS, _WAY / travel), _LONGEST)
        later = now + trend * until
        unsure, unsure_later = (
            _SURELY * math.sqrt(alike * float(row @ spread @ row))
            for row in (np.array([0.0, 1.0]), np.array([until, 1.0]))
        )
        words = f"the wheels slip by {now:.2f}"
        if now > _ORDINARY and trend > 0.0 and later - unsure_later > self._reference:
            left = max((self._reference - now) / trend, 0.0)
            when = f"in {left:.0f} s" if left >= 0.5 else "at any moment"
            return f"{words} and more and more: the vehicle may get stuck {when}"
        if now - unsure > _HIGH:
            return f"{words}: the vehicle may get stuck"
        if now > _ORDINARY and risk is not None and risk > _LIKELY:
            return (
                f"{words}, and the ground asks for more than they pull: the vehicle may get stuck"
            )
        return ""


def _value(slip: Quantity) -> float:
    return slip.value
