"""The load that a wheel is taken to carry where sinkage is linearised."""

from __future__ import annotations

import math

_BAND = 3.0  # standard deviations of one reading; two in a row outside are no chance
_FAR = 6.0  # nor is one so far away
_LONGEST = 50  # readings


class SteadyLoad:
    """Running mean of ln load over the readings since the load last changed by more than noise.

    How strongly sinkage depends on n goes with ln load. If that slope followed the noise of the
    load cell, a constant load would look like a varied one: n would seem determined, and come out
    wrong (regression dilution).
    """

    def __init__(self) -> None:
        self._mean = 0.0
        self._readings = 0
        self._outside: float | None = None

    def follow(self, load: float, deviation: float) -> float:
        """Take a reading (N) with the standard deviation of its logarithm; give the mean (N)."""
        log = math.log(load)
        off = log - self._mean
        before, self._outside = self._outside, None
        if self._readings == 0 or abs(off) > _FAR * deviation:
            self._mean, self._readings = log, 1
        elif abs(off) <= _BAND * deviation:
            self._readings = min(self._readings + 1, _LONGEST)
            self._mean += off / self._readings
        elif before is not None and (before > self._mean) == (off > 0):
            self._mean, self._readings = 0.5 * (before + log), 2
        else:
            self._outside = log
        return math.exp(self._mean)
