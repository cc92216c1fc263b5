# SPDX-License-Identifier: Apache-2.0
"""The whole grammar at once: the gain of each term at the tangent of a fitted model.

About a fit, a term h with strength a at a place moves the predictions by a G h, where G is their
derivative with respect to that place's factor. All terms of a place thus are one matrix product, and the same
for every permutation of the errors. The gain of a term is measured by

    n/2 ln det S      S: covariance of the channels' whitened errors over points, (channels, channels)

which has no scale of its own: the scatter of runs is estimated anew with each term, so that scatter
cannot hide a law, and need not be known. Errors are whitened by V of the fitting problem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.variance import Scatter

Array = NDArray[np.float64]

_LEFT = 0.02  # share of a term's effect that no soil parameter imitates, from which it is testable
_FLOOR = 0.05  # of the variance of repeats, added to S: errors far below that gain nothing
_UNTESTABLE = -1e6  # nats
_ABSENT = -12.0  # ln of the deviation of a component that is left out


def without_lack_of_fit(scatter: Scatter) -> Scatter:
    """The scatter without its components of lack of fit over settings, which is what the search looks for."""
    kept = [not name.startswith("fit:") for name in scatter.names]
    return replace(scatter, log_deviation=np.where(kept, scatter.log_deviation, _ABSENT))


class Yardstick:
    """Whitens values by the covariance V of a fit, and scores errors in nats.

    V leaves out the lack of fit over settings, which would treat a missing law as scatter.

    Parameters
    ----------
    fitter
        Fitter of the points.
    fit
        The fit with whose scatter V is computed.

    Attributes
    ----------
    count
        n, the number of values divided by the number of channels.
    rows
        Row of the conditions of each point, shape (points,).
    """

    def __init__(self, fitter: Fitter, fit: Fit) -> None:
        points = fitter.points
        scatter = without_lack_of_fit(fit.scatter)
        self._v = fitter.variance.covariance(scatter, fit.stiffness)
        self.rows, point = np.unique(points.row, return_inverse=True)
        self._place = points.channel, point.reshape(-1)
        self._shape = len(points.channels), self.rows.size
        self.count = len(points) / len(points.channels)
        shares = fitter.repeats.variance / np.diag(self._v.matrix)
        mean = np.bincount(points.channel, shares) / np.bincount(points.channel)
        self._floor = np.diag(_FLOOR * mean + 1e-9)

    def white(self, values: Array) -> Array:
        """Values, or columns of them, whitened by V; same shape."""
        return self._v.whiten(values)

    def by_channel(self, columns: Array) -> Array:
        """Columns, shape (values, columns), as (channels, points, columns); 0 where nothing was measured."""
        found = np.zeros((*self._shape, columns.shape[1]))
        found[self._place] = columns
        return found

    def at_each_point(self, slope: Array) -> Array:
        """The slope, shape (values,), as one column for each point, 0 in other rows: (values, points)."""
        found = np.zeros((slope.size, self.rows.size))
        found[np.arange(slope.size), self._place[1]] = slope
        return found

    def nats(self, products: Array) -> Array:
        """n/2 ln det S, shape (...), from n S, sums of products of errors, (..., channels, channels)."""
        determinant = np.linalg.det(products / self.count + self._floor)
        return np.asarray(0.5 * self.count * np.log(np.maximum(determinant, 1e-300)))

    def score(self, error: Array) -> float:
        """n/2 ln det S of errors that are not whitened yet, shape (values,)."""
        parts = self.by_channel(self.white(error)[:, None])[:, :, 0]
        return float(self.nats(parts @ parts.T))


class Tangent:
    """Errors of a fit that is linearised, without the part that the fit's own parameters can absorb.

    Parameters
    ----------
    yardstick
        Whitens and scores.
    white_errors
        Whitened errors, shape (values,); or several copies, as permutations, (values, copies).
    slopes
        Derivatives of the predictions with respect to the parameters, shape (values, parameters).
    """

    def __init__(self, yardstick: Yardstick, white_errors: Array, slopes: Array) -> None:
        self._yardstick, self._errors, self._slopes = yardstick, white_errors, slopes
        self._basis = np.linalg.qr(yardstick.white(slopes))[0]
        self._parts = yardstick.by_channel(self._rest(white_errors.reshape(len(slopes), -1)))
        self._products = np.einsum("apc,bpc->cab", self._parts, self._parts)

    def _rest(self, columns: Array) -> Array:
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))

    def beside(self, slope: Array) -> Tangent:
        """The tangent with one more parameter, whose slope has shape (values,)."""
        slopes = np.column_stack([self._slopes, slope])
        return Tangent(self._yardstick, self._errors, slopes)

    @property
    def nats(self) -> Array:
        """n/2 ln det S without another term, shape (copies,)."""
        return self._yardstick.nats(self._products)

    def gains(self, slope: Array, terms: Array) -> tuple[Array, Array]:
        """Compute for each term by how many nats it would lower the score, and with which strength.

        A term changes the prediction of each point by its value there, so one set of matrices over points
        serves all terms.

        Parameters
        ----------
        slope
            Derivative of the predictions with respect to the sum of the terms, shape (values,).
        terms
            Values of the terms, shape (points, terms).

        Returns
        -------
        gain, strength : ndarray
            Shape (terms, copies) each. The gain is -1e6 for a term that the fit's own parameters can imitate.
        """
        each = self._yardstick.white(self._yardstick.at_each_point(slope))
        moved = self._yardstick.by_channel(self._rest(each))
        # Products of what a term moves with itself and with the errors, last axes (channels, channels).
        own = np.array([[_squares(a.T @ b, terms) for b in moved] for a in moved])
        mixed = np.array([[terms.T @ (a.T @ e) for e in self._parts] for a in moved])
        own, mixed = own.T[:, None], np.moveaxis(mixed + mixed.swapaxes(0, 1), (0, 1), (2, 3))
        left = np.trace(own, axis1=2, axis2=3)
        testable = left > _LEFT * _squares(each.T @ each, terms)[:, None] + 1e-300
        strength = 0.5 * np.trace(mixed, axis1=2, axis2=3) / np.where(testable, left, 1.0)
        by = strength[:, :, None, None]
        gained = self.nats - self._yardstick.nats(self._products - by * mixed + by**2 * own)
        return np.where(testable, gained, _UNTESTABLE), strength


def _squares(matrix: Array, columns: Array) -> Array:
    """c' M c of each column c, shape (columns,)."""
    return np.asarray(np.sum(columns * (matrix @ columns), axis=0))
