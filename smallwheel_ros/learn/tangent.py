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

    V is without lack of fit over settings, which would take a law for scatter. rows: of the
    conditions, one for each point. pairs: of channels, whose sums of products make S.
    """

    def __init__(self, fitter: Fitter, fit: Fit) -> None:
        points = fitter.points
        scatter = without_lack_of_fit(fit.scatter)
        self._v = fitter.variance.covariance(scatter, stiffness(fit.vector, fit.slopes))
        self._channels = range(len(points.channels))
        self._channel = points.channel
        self.rows, point = np.unique(points.row, return_inverse=True)
        self._point = point.reshape(-1)
        self.pairs = [(a, b) for a in self._channels for b in self._channels if a <= b]
        self.count = len(points) / len(self._channels)
        shares = fitter.repeats.variance / self._v.variance()
        self._floor = [
            _FLOOR * float(np.mean(shares[points.channel == c])) + 1e-9 for c in self._channels
        ]

    def white(self, values: Array) -> Array:
        """Values or columns of them, with V taken out; shape as given."""
        return self._v.whiten(values)

    def by_channel(self, columns: Array) -> Array:
        """Whitened columns (values, columns) by channel and point, 0 where nothing was measured."""
        found = np.zeros((len(self._channels), self.rows.size, columns.shape[1]))
        found[self._channel, self._point] = columns
        return found

    def at_each_point(self, slope: Array) -> Array:
        """What a unit at one point alone moves the values by, shape (values, points)."""
        found = np.zeros((slope.size, self.rows.size))
        found[np.arange(slope.size), self._point] = slope
        return found

    def nats(self, spread: Sequence[Any]) -> Array:
        """n/2 ln det S from sums of products, one for each of `pairs`, of any one shape."""
        s = dict(zip(self.pairs, (np.asarray(one) / self.count for one in spread), strict=True))
        det = s[0, 0] + self._floor[0]
        if len(self._channels) == 2:
            det = det * (s[1, 1] + self._floor[1]) - s[0, 1] ** 2
        return np.asarray(0.5 * self.count * np.log(np.maximum(det, 1e-300)))

    def score(self, error: Array) -> float:
        """n/2 ln det S of errors, shape (values,)."""
        parts = self.by_channel(self.white(error)[:, None])
        return float(self.nats([np.sum(parts[a] * parts[b]) for a, b in self.pairs]))


class Tangent:
    """Errors about a fit, with what its own parameters can take up projected off.

    white_errors: shape (values,) or (values, copies), whitened. slopes: shape (values, parameters).
    """

    def __init__(self, yardstick: Yardstick, white_errors: Array, slopes: Array) -> None:
        self._yardstick, self._errors, self._slopes = yardstick, white_errors, slopes
        self._basis = np.linalg.qr(yardstick.white(slopes))[0]
        self._parts = yardstick.by_channel(self._rest(white_errors.reshape(len(slopes), -1)))
        self._spread = [np.sum(self._parts[a] * self._parts[b], axis=0) for a, b in yardstick.pairs]

    def _rest(self, columns: Array) -> Array:
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))

    def beside(self, slope: Array) -> Tangent:
        """The tangent with one parameter more, shape (values,)."""
        slopes = np.column_stack([self._slopes, slope])
        return Tangent(self._yardstick, self._errors, slopes)

    @property
    def nats(self) -> Array:
        """n/2 ln det S without another term, shape (copies,)."""
        return self._yardstick.nats(self._spread)

    def gains(self, slope: Array, terms: Array) -> tuple[Array, Array]:
        """What each term gains, and its strength; shape (terms, copies).

        slope: of the predictions by the sum of terms, shape (values,). terms: their values, shape
        (points, terms). A term moves all points, each by its value there, so what is needed of it are
        products with matrices over points, which are the same for all terms.
        """
        each = self._yardstick.white(self._yardstick.at_each_point(slope))
        moved = self._yardstick.by_channel(self._rest(each))
        ours, pairs = self._parts, self._yardstick.pairs

        def size(matrix: Array) -> Array:
            return np.asarray(np.sum(terms * (matrix @ terms), axis=0))

        own = [size(moved[a].T @ moved[b])[:, None] for a, b in pairs]
        mixed = [terms.T @ (moved[a].T @ ours[b] + moved[b].T @ ours[a]) for a, b in pairs]
        same = [i for i, (a, b) in enumerate(pairs) if a == b]
        left = sum((own[i] for i in same), np.zeros(1))
        testable = left > _LEFT * size(each.T @ each)[:, None] + 1e-300
        strength = 0.5 * sum(mixed[i] for i in same) / np.where(testable, left, 1.0)
        after = [
            before - strength * m + strength**2 * o
            for before, m, o in zip(self._spread, mixed, own, strict=True)
        ]
        gained = self.nats - self._yardstick.nats(after)
        return np.where(testable, gained, _UNTESTABLE), strength
