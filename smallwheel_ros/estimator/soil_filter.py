"""The Kalman filter below the soil estimator: the only module that imports filterpy.

State: the deviation of each component from its prior mean. Every component drifts with the distance
travelled as a stationary random process (Ornstein-Uhlenbeck) whose spread is the prior's,

    x(d + s) = a x(d) + noise,  a = exp(-s / length),  Q = (1 - a a') P0

so uncertainty grows like a random walk at first and ends at the prior: it is bounded for ever, in
directions that nothing measures too. Its traps (x must be one-dimensional, `mahalanobis` is 0 in
1.4.5, a NaN poisons it, LinAlgError leaves it) are dealt with here.
"""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf  # type: ignore[attr-defined]  # not in every stub

Array = NDArray[np.float64]


class SoilFilter:
    """A Kalman filter over components that drift with distance, one scalar measurement at a time.

    covariance: the prior's, shape (size, size), for components that drift over one `length` (m;
    inf: never). Further components are added one by one.
    """

    def __init__(self, covariance: Array, length: float) -> None:
        self._law = len(covariance)
        self._rate = 1.0 / length
        self._rates: Array = np.empty(0)
        self.forget(covariance)

    def forget(self, covariance: Array) -> None:
        """Begin anew, without added components, from this prior (as in the constructor)."""
        self._stationary: Array = np.array(covariance, dtype=float)
        self._rates = np.full(self._law, self._rate)
        self.renew(covariance)

    def renew(self, covariance: Array) -> None:
        """Forget all measurements; the prior of all but the added components becomes this one."""
        self._stationary = self._stationary.copy()
        self._stationary[: self._law, : self._law] = covariance
        self._start(np.zeros(len(self._stationary)), self._stationary.copy())

    def resume(self, covariance: Array, deviation: Array, stationary: Array) -> None:
        """Go on from a saved state of all but the added components."""
        self.renew(stationary)
        self._ekf.x[: self._law] = deviation
        self._ekf.P[: self._law, : self._law] = covariance

    def _start(self, x: Array, covariance: Array) -> None:
        self._ekf = ExtendedKalmanFilter(dim_x=len(x), dim_z=1)
        self._ekf.x, self._ekf.P = x, covariance
        # Written to for each measurement: filterpy keeps none of them beyond the call.
        self._measured, self._expected, self._noise = np.zeros(1), np.zeros(1), np.zeros((1, 1))

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """Deviation, covariance and prior covariance; may be set to what it was."""
        return self.deviation, self.covariance, self._stationary

    @state.setter
    def state(self, state: tuple[Array, Array, Array]) -> None:
        self._ekf.x, self._ekf.P, self._stationary = state

    @property
    def stationary(self) -> Array:
        """Covariance that drift ends at, the prior's; shape (size, size)."""
        return self._stationary

    @property
    def deviation(self) -> Array:
        """Deviation from the prior mean, shape (size,); not to be written to."""
        return np.asarray(self._ekf.x)

    @property
    def covariance(self) -> Array:
        """Covariance of the deviation, shape (size, size); not to be written to."""
        return np.asarray(self._ekf.P)

    def add(self, variance: float, length: float) -> int:
        """Add a component of zero mean that nothing has measured yet; gives its index."""
        size = len(self._stationary)
        grown = [np.zeros((size + 1, size + 1)) for _ in range(2)]
        for old, new in zip((self._stationary, self._ekf.P), grown, strict=True):
            new[:size, :size] = old
            new[size, size] = variance
        self._stationary = grown[0]
        self._rates = np.append(self._rates, 1.0 / length)
        self._start(np.append(self._ekf.x, 0.0), grown[1])
        return size

    def travel(self, distance: float) -> None:
        """Let every component drift over a distance (m), >= 0.

        F is diagonal, so F P F' + Q is P0 + (P - P0) a a', element by element.
        """
        kept = np.exp(-distance * self._rates)
        ekf, prior = self._ekf, self._stationary
        ekf.x = kept * ekf.x
        ekf.P = prior + (ekf.P - prior) * np.multiply.outer(kept, kept)

    def update(self, measured: float, expected: float, row: list[float], variance: float) -> bool:
        """Update by one measurement, linearised: expected + row @ (x - deviation) + noise.

        row: `size` numbers. False, with nothing changed, where the result would not be finite or
        its covariance not positive definite.
        """
        ekf = self._ekf
        before = self.state
        jacobian, value = np.array([row]), self._expected
        self._measured[0], value[0], self._noise[0, 0] = measured, expected, variance
        try:
            ekf.update(self._measured, lambda _: jacobian, lambda _: value, R=self._noise)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            self.state = before
            return False
        # Rounding must not add up to an asymmetry over millions of updates.
        covariance = ekf.P + ekf.P.T
        covariance *= 0.5
        ekf.P = covariance
        factor, failed = dpotrf(covariance, lower=1, clean=0)
        # What is not finite anywhere in the covariance arrives at the last pivot.
        if failed or not factor[-1, -1] > 0.0 or not math.isfinite(ekf.x.sum()):
            self.state = before
            return False
        return True
