# SPDX-License-Identifier: Apache-2.0
"""The uncertainty of fitted parameters.

Notation as in `fit`: y measured values, f their predictions, J = df/dtheta, c and P centre and precision of
the prior. A fit that weighs values by G converges where G' (y - f) = P (theta - c). If the errors of the
values have the covariance V, that of theta is (the sandwich of Huber 1967, with a prior)

    C = H^-1 (G' V G + P) H^-T,     H = G' J + P

which is (J' V^-1 J + P)^-1 for G = V^-1 J.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from smallwheel_ros.fitting.constants import DETERMINED
from smallwheel_ros.fitting.fit import Array, Fit, Fitter, inverse
from smallwheel_ros.fitting.variance import Scatter

_NODE = np.sqrt(3.0)  # of the rule over ln phi, in deviations
_NO_LESS = 1.05  # of a deviation: as well known, for any use


def sandwich(slopes: Array, weights: Array, variance: Array, precision: Array) -> Array:
    """Compute the sandwich covariance of the parameters (C in the module's docstring; Huber 1967).

    Parameters
    ----------
    slopes
        J, derivatives of the predictions with respect to the parameters, shape (values, parameters).
    weights
        G, weight of each value for each parameter, shape (values, parameters).
    variance
        V, covariance of the values' errors, shape (values, values).
    precision
        P, precision of the prior, shape (parameters, parameters).

    Returns
    -------
    ndarray
        Shape (parameters, parameters). Where a standard deviation would exceed P_jj^(-1/2) it is reduced to
        that, with the correlations kept: data never make a parameter less certain.
    """
    h = weights.T @ slopes + precision
    size = np.sqrt(np.diag(h))
    back = np.linalg.inv(h / np.outer(size, size)) / np.outer(size, size)
    found = back @ (weights.T @ variance @ weights + precision) @ back.T
    # Nothing is less known after the data than before, whatever the weights were.
    least = np.minimum(1.0, np.diag(precision) ** -0.5 / np.sqrt(np.diag(found)))
    return np.asarray(found * np.outer(least, least))


def over_scatter(
    fitter: Fitter, fit: Fit, scatter: Scatter, of: Callable[[Scatter], Array]
) -> Array:
    """Average a function of the variance components over the uncertainty of their standard deviations phi.

    ln phi ~ N(estimate, S), with S from `Fitter.scatter_covariance`. The mean is taken by second
    differences at the columns of sqrt(3) times a root of S (the unscented rule of Julier and Uhlmann 1997
    with kappa = 3 - q for q components, exact to the third order). A component on which the function does
    not depend changes nothing.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.
    scatter
        Estimated variance components: `Fitter.true_scatter`.
    of
        Function of the variance components that returns an array, always of the same shape.

    Returns
    -------
    ndarray
        Mean of the function, in its shape and unit.
    """
    total = middle = of(scatter)
    for column in _NODE * np.linalg.cholesky(fitter.scatter_covariance(fit, scatter)).T:
        ends = (
            of(replace(scatter, log_deviation=scatter.log_deviation + sign * column))
            for sign in (1.0, -1.0)
        )
        total = total + (sum(ends) - 2.0 * middle) / (2.0 * _NODE**2)
    return total


def posterior_covariance(fitter: Fitter, fit: Fit, scatter: Scatter) -> Array:
    """Compute the covariance of the parameters, including the uncertainty of the variance components.

    With few runs the variance components are poorly known, which makes the standard deviations larger.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.
    scatter
        Estimated variance components: `Fitter.true_scatter`.

    Returns
    -------
    ndarray
        Shape (parameters, parameters), in the products of their units; rows and columns of parameters at a
        bound are 0.
    """
    free = np.flatnonzero(~fit.at_bound)
    slopes, precision = fit.slopes[:, free], fit.vector.precision(fit.theta)[np.ix_(free, free)]
    weights = fitter.weights(fit)[:, free] if fitter.working else None

    def under(there: Scatter) -> Array:
        true = fitter.true_variance.covariance(there, fit.stiffness)
        if weights is None:
            return inverse(slopes.T @ true.solve(slopes) + precision)
        return sandwich(slopes, weights, true.matrix, precision)

    full = np.zeros((fit.theta.size, fit.theta.size))
    full[np.ix_(free, free)] = over_scatter(fitter, fit, scatter, under)
    return full


def pull_may_bend(fitter: Fitter, fit: Fit) -> bool:
    """Return whether a fit may use pull and torque to determine the exponent n of each soil.

    It may if sinkage and resistance alone leave n of every soil undetermined, and if its standard deviation
    with pull and torque, which includes the error of their law, is at most 5 % larger than without. This is
    so under a single load, for example. Otherwise the error of their law would distort an n that is better
    known without them.

    Parameters
    ----------
    fitter
        A fitter that fits pull and torque to the strength alone (`Fitter.apart`).
    fit
        A converged fit by `fitter`.
    """
    exponents = [j for j, p in enumerate(fit.vector.of_soils) if p.field == "n"]
    variance = fitter.true_variance.covariance(fitter.true_scatter(fit), fit.stiffness).matrix
    precision = fit.vector.precision(fit.theta)
    apart, together = (
        np.sqrt(np.diag(sandwich(fit.slopes, one.weights(fit), variance, precision))[exponents])
        for one in (fitter, replace(fitter, apart=False))
    )
    before = np.diag(precision)[exponents] ** -0.5
    is_open = apart > DETERMINED * before
    return bool(np.all(is_open & (together <= _NO_LESS * apart)))
