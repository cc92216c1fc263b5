# SPDX-License-Identifier: Apache-2.0
"""The whole grammar at once: what each term would gain at the tangent of a fitted model.

About a fit, a term h with strength a at a place moves the predictions by a G h, where G is their
slope by that place's factor. So all terms of a place are one matrix product, and the same for
every permutation of the errors. What a term gains is measured by

    n/2 ln det S      S: covariance of the channels' whitened errors over points, (channels,) * 2

which has no scale of its own: how much runs scatter is judged anew with each term, so scatter
cannot hide a law, and none is needed to be known. Whitened is with V of the fitting problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from smallwheel_ros.fitting.fit import Fit, Fitter, stiffness
from smallwheel_ros.fitting.variance import Scatter

Array = NDArray[np.float64]

_LEFT = 0.02  # share of a term's effect that no soil parameter imitates, from which it is testable
_FLOOR = 0.05  # of the repeats' variance: no law is praised for errors under what repeats differ by
_UNTESTABLE = -1e6  # nats
_ABSENT = -12.0  # ln of the deviation of a component that is not there


def without_lack_of_fit(scatter: Scatter) -> Scatter:
    """The components without that of the law's lack of fit over settings: that is what is sought."""
    kept = [not name.startswith("fit:") for name in scatter.names]
    return replace(scatter, log_deviation=np.where(kept, scatter.log_deviation, _ABSENT))


class Yardstick:
    """Whitens values by V of a fit and sums up errors. count: n, points with all channels.

    V is without lack of fit over settings, which would take a law for scatter.
    """

    def __init__(self, fitter: Fitter, fit: Fit) -> None:
        points = fitter.points
        scatter = without_lack_of_fit(fit.scatter)
        kernels = fitter.variance.kernels(stiffness(fit.vector, fit.slopes), scatter.log_length)
        variance = fitter.variance.covariance(scatter, kernels)
        self._factor = np.linalg.cholesky(variance)
        self._channels = len(points.channels)
        self._row = np.unique(points.row, return_inverse=True)[1].reshape(-1)
        self._channel = points.channel
        self.count = len(points) / self._channels
        pure = np.zeros(self._channels)
        shares = fitter.repeats.variance / np.diag(variance)
        for c in range(self._channels):
            pure[c] = float(np.mean(shares[points.channel == c]))
        self._floor = _FLOOR * pure + 1e-9

    def white(self, values: Array) -> Array:
        """Values or columns of them, with V taken out; shape as given."""
        return np.asarray(solve_triangular(self._factor, values, lower=True, check_finite=False))

    def by_channel(self, columns: Array) -> list[Array]:
        """Whitened columns (values, columns) by channel and point, zero where nothing was measured."""
        points = int(self._row.max()) + 1
        found: list[Array] = []
        for c in range(self._channels):
            mine = self._channel == c
            table: Array = np.zeros((points, columns.shape[1]))
            table[self._row[mine]] = columns[mine]
            found.append(table)
        return found

    def nats(self, spread: Sequence[Sequence[Any]]) -> Array:
        """n/2 ln det S from sums of products by channel, each of any one shape."""
        s = [[np.asarray(spread[a][b]) / self.count + (self._floor[a] if a == b else 0.0)
              for b in range(self._channels)] for a in range(self._channels)]  # fmt: skip
        det = s[0][0] if self._channels == 1 else s[0][0] * s[1][1] - s[0][1] * s[1][0]
        return np.asarray(0.5 * self.count * np.log(np.maximum(det, 1e-300)))

    def score(self, error: Array) -> float:
        """n/2 ln det S of errors, shape (values,)."""
        parts = self.by_channel(self.white(error)[:, None])
        return float(self.nats([[np.sum(a * b) for b in parts] for a in parts]))


class Tangent:
    """Errors about a fit, with what its own parameters can take up projected off.

    errors: shape (values,) or (values, copies), whitened. slopes: shape (values, parameters).
    """

    def __init__(self, yardstick: Yardstick, white_errors: Array, slopes: Array) -> None:
        self._yardstick = yardstick
        self._basis = np.linalg.qr(yardstick.white(slopes))[0]
        self._errors = self._rest(white_errors.reshape(len(slopes), -1))
        self._parts = yardstick.by_channel(self._errors)
        self._sums = [[np.sum(a * b, axis=0) for b in self._parts] for a in self._parts]

    def _rest(self, columns: Array) -> Array:
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))

    @property
    def nats(self) -> Array:
        """n/2 ln det S without another term, shape (copies,)."""
        return self._yardstick.nats(self._sums)

    def gains(self, columns: Array) -> tuple[Array, Array]:
        """What each term gains, and its strength; shape (terms, copies).

        columns: what a unit of each moves the values by, shape (values, terms), not whitened.
        """
        white = self._yardstick.white(columns)
        rest = self._rest(white)
        left = np.sum(rest**2, axis=0)
        testable = left > _LEFT * np.sum(white**2, axis=0) + 1e-300
        strength = (rest.T @ self._errors) / np.where(testable, left, 1.0)[:, None]
        parts = self._yardstick.by_channel(rest)
        after = [
            [self._sums[a][b]
             - strength * (parts[a].T @ self._parts[b] + parts[b].T @ self._parts[a])
             + strength**2 * np.sum(parts[a] * parts[b], axis=0)[:, None]
             for b in range(len(parts))] for a in range(len(parts))
        ]  # fmt: skip
        gained = self.nats - self._yardstick.nats(after)
        gained[~testable] = _UNTESTABLE
        return gained, strength
