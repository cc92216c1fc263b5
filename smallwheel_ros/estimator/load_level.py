"""The load that a wheel carries (and its slip), told apart from the noise of the sensor.

How strongly sinkage depends on n goes with ln load. Where that slope follows the noise of the load
cell, a constant load looks like a varied one: n seems determined, and comes out wrong (regression
dilution). The remedy is regression calibration (Carroll and others 2006, Measurement Error in
Nonlinear Models, chapter 4): in place of the measured load stands the best guess of the true one,

    mean + r (measured - mean),  r = variance of the true load / variance of the measured one

over the newest readings. A load that varies by much more than its noise passes as it is (r near 1),
a constant one is its mean. The same goes for slip and thrust.
"""

from __future__ import annotations

import math

_MEMORY = 500  # readings
_JUMP = 3.0  # standard deviations of one reading: beyond, what is off is load rather than noise
_CLEAR = 3.0  # chance variation of the variance, in its standard deviations


class Level:
    """Mean and variance of what is behind the newest readings of one sensor."""

    def __init__(self) -> None:
        self._readings = 0
        self._mean = 0.0
        self._variance = 0.0
        self._noise = 0.0
        self._chance = 0.0  # of the variance, over that of the noise

    def told_apart(self, reading: float, variance: float) -> tuple[float, float]:
        """Take a reading and the variance of its noise, over 0.

        Gives the best guess of what it is without the noise, and the variance of that.
        """
        count = self._readings
        if count < _MEMORY:
            self._readings = count = count + 1
            self._chance = _CLEAR * math.sqrt(2.0 / count)
        share = 1.0 / count
        off = reading - self._mean
        self._mean += share * off
        self._variance += share * ((1.0 - share) * off * off - self._variance)
        self._noise += share * (variance - self._noise)
        off *= 1.0 - share  # the new mean
        true = self._variance - self._noise
        reliability = true / (true + variance) if true > self._chance * self._noise else 0.0
        square = off * off
        if square > _JUMP**2 * variance:
            # A wheel that has just been loaded: the memory does not know of it yet.
            reliability = max(reliability, 1.0 - _JUMP**2 * variance / square)
        rest = 1.0 - reliability
        left = (max(true, 0.0) + share * self._noise) * rest * rest
        return self._mean + reliability * off, reliability * reliability * variance + left


class LoadLevel(Level):
    """The level of ln load of one wheel."""

    def follow(self, load: float, variance: float) -> tuple[float, float]:
        """Take a reading (N) and the variance of its logarithm.

        Gives the best guess of the true load (N), and the variance of the logarithm of that.
        """
        if variance <= 0.0:
            return load, 0.0
        log, left = self.told_apart(math.log(load), variance)
        return math.exp(log), left
