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
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf  # type: ignore[attr-defined]  # not in every stub

Array = NDArray[np.float64]

_CHECKED_EVERY = 20  # updates
_EXACT = 1e-6  # variance of a measurement over that of the innovation


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
        self._kalman.x[: self._law] = deviation
        self._kalman.P[: self._law, : self._law] = covariance

    def _start(self, x: Array, covariance: Array) -> None:
        # The linear filter: where to linearise has been found before (see `iterated_update`).
        self._kalman = KalmanFilter(dim_x=len(x), dim_z=1)
        self._kalman.inv = _inverse
        self._kalman.x, self._kalman.P = x, covariance
        self._updates = 0
        self._noise = np.zeros((1, 1))  # written to for each measurement

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """Deviation, covariance (symmetric to rounding) and prior; may be set to what it was."""
        return self._kalman.x, self._kalman.P, self._stationary

    @state.setter
    def state(self, state: tuple[Array, Array, Array]) -> None:
        self._kalman.x, self._kalman.P, self._stationary = state

    @property
    def stationary(self) -> Array:
        """Covariance that drift ends at, the prior's; shape (size, size)."""
        return self._stationary

    @property
    def deviation(self) -> Array:
        """Deviation from the prior mean, shape (size,); not to be written to."""
        x: Array = self._kalman.x
        return x

    @property
    def covariance(self) -> Array:
        """Covariance of the deviation, shape (size, size)."""
        return _symmetric(self._kalman.P)

    def add(self, variance: float, length: float) -> int:
        """Add a component of zero mean that nothing has measured yet; gives its index."""
        size = len(self._stationary)
        grown = [np.zeros((size + 1, size + 1)) for _ in range(2)]
        for old, new in zip((self._stationary, self._kalman.P), grown, strict=True):
            new[:size, :size] = old
            new[size, size] = variance
        self._stationary = grown[0]
        self._rates = np.append(self._rates, 1.0 / length)
        self._start(np.append(self._kalman.x, 0.0), grown[1])
        return size

    def travel(self, distance: float) -> None:
        """Let every component drift over a distance (m), >= 0.

        F is diagonal, so F P F' + Q is P0 + (P - P0) a a', element by element.
        """
        kept = np.exp(-distance * self._rates)
        kalman, prior = self._kalman, self._stationary
        kalman.x = kept * kalman.x
        kalman.P = prior + (kalman.P - prior) * np.multiply.outer(kept, kept)

    def update(self, innovation: float, row: list[float], variance: float) -> bool:
        """Update by one measurement: innovation = row @ (x - deviation) + noise.

        row: `size` numbers. False, with nothing changed, where the result would not be finite or
        its covariance not positive definite.
        """
        if not math.isfinite(innovation):
            return False
        kalman = self._kalman
        x, covariance = kalman.x, kalman.P
        jacobian = np.array([row])
        self._noise[0, 0] = variance
        try:
            # filterpy takes off what the row shows of the state: here the innovation is what counts.
            kalman.update(innovation + jacobian.dot(x).item(), self._noise, jacobian)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            kalman.x, kalman.P = x, covariance
            return False
        self._updates += 1
        due = self._updates % _CHECKED_EVERY == 0
        if due:
            # Rounding must not add up to an asymmetry over millions of updates.
            kalman.P = _symmetric(kalman.P)
        # filterpy's form of the update keeps the covariance sound to rounding, so only a measurement
        # that is far more exact than what was believed can spoil it, or one that is not finite.
        if (due or not variance > _EXACT * kalman.S.item()) and not _is_sound(kalman.P):
            kalman.x, kalman.P = x, covariance
            return False
        return True


def _is_sound(covariance: Array) -> bool:
    """Whether it is finite and positive definite."""
    factor, failed = dpotrf(covariance, 1, 0)  # of the lower triangle
    # What is not finite anywhere arrives at the last pivot.
    return not failed and bool(factor[-1, -1] > 0.0)


def _symmetric(matrix: Array) -> Array:
    """Take away the asymmetry that rounding leaves."""
    return np.asarray(0.5 * (matrix + matrix.T))


def _inverse(one: Array) -> Array:
    """Invert a matrix of one number: filterpy would call LAPACK for it."""
    return 1.0 / one
