# SPDX-License-Identifier: Apache-2.0
"""The contact integral of a rigid wheel: the exact relation of load and sinkage.

A wheel of radius r = D/2 and width b, sunk by z0, carries on the soil in front of its lowest point

    W = b r * integral over 0..theta0 of p(z(theta)) cos(theta) d(theta),
    z(theta) = r (cos(theta) - cos(theta0)),  cos(theta0) = 1 - z0/r

(Bekker 1956; Wong 2008, chapter 2).

For a power law p = K z^n, with K = k D^m (Meirion-Griffith and Spenko, eq. 9), the substitution
s = z0 - z makes it an Euler integral, so it has a closed form (s/D = sigma, epsilon = z0/D):

    W = b K sqrt(D) z0^(n + 1/2) I(n, epsilon),
    I(n, epsilon) = 1/2 * sum over j of a_j B(j + 1/2, n + 1) epsilon^j,
    sum over j of a_j sigma^j = (1 - 2 sigma) / sqrt(1 - sigma)

The series converges for epsilon < 1, and a wheel is sunk to its axle at epsilon = 1/2, so a fixed
number of terms gives it to rounding: no quadrature is needed. A polynomial fitted to the last line
takes fewer terms still. Bekker's and the paper's closed form (eq. 7, 10) replaces I by its
expansion in n at epsilon = 0, (3 - n)/3.

Every function broadcasts its arguments like NumPy does; units are SI.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import beta, digamma

Array = NDArray[np.float64]

AXLE_RATIO = 0.5  # epsilon at which the wheel is sunk to its axle
_BLOCK = 2048  # rows worked on at a time: the few temporaries then stay in the processor's cache
_NEWTON_STEPS = 40
_LOG_AXLE = float(np.log(AXLE_RATIO))


class _Outline(NamedTuple):
    """(1 - 2 sigma)/sqrt(1 - sigma) as a polynomial in sigma, for sigma up to `limit`."""

    limit: float
    coefficients: Array


def _fit_outline(limit: float, degree: int) -> _Outline:
    fitted = np.polynomial.Chebyshev.interpolate(
        lambda sigma: (1.0 - 2.0 * sigma) / np.sqrt(1.0 - sigma), degree, domain=[0.0, limit]
    )
    power = fitted.convert(kind=np.polynomial.Polynomial).coef
    return _Outline(limit, np.asarray(power, dtype=np.float64))


# Fewer terms than the power series has, to the same rounding error: the nearest singularity, at
# sigma = 1, is far off where the wheel is sunk little.
_OUTLINES = (_fit_outline(0.05, 8), _fit_outline(0.15, 11), _fit_outline(AXLE_RATIO, 20))


class ShapeIntegral(NamedTuple):
    """The integral I(n, epsilon) of the module's docstring, and its derivatives, of the broadcast shape.

    Attributes
    ----------
    value
        I, dimensionless.
    slope_ratio, slope_exponent
        d ln I / d ln epsilon, with epsilon = z/D, and d ln I / dn.
    """

    value: Array
    slope_ratio: Array
    slope_exponent: Array


class ContactSinkage(NamedTuple):
    """Sinkage of a wheel, and its derivatives; arrays of the broadcast shape.

    Attributes
    ----------
    sinkage
        Sinkage z, m. Where `sunk_to_axle` holds, it is extrapolated from the axle as W ~ z^(n + 1/2): useful
        to a fit that passes through such a point, but not a prediction.
    sunk_to_axle
        Whether the load exceeds what the soil carries with the wheel sunk to its axle: the model
        no longer holds.
    slope_load
        d ln z / d ln(W / K), with the load W and the modulus K, to about 1e-8.
    slope_exponent
        d ln z / dn at constant W and K, to about 1e-8; NaN without `with_exponent` of `contact_sinkage`.
        Where `sunk_to_axle` holds, both slopes are those of the extrapolation.
    """

    sinkage: Array
    sunk_to_axle: NDArray[np.bool_]
    slope_load: Array
    slope_exponent: Array


def _outline_for(ratio: float) -> _Outline:
    """The polynomial with fewest terms that holds up to this sinkage over diameter."""
    return next((o for o in _OUTLINES if ratio <= o.limit), _OUTLINES[-1])


def _coefficients(exponent: Array, outline: _Outline) -> Array:
    """c_j(n) = a_j B(j + 1/2, n + 1) / 2, shape (terms, rows): I = sum of c_j epsilon^j."""
    j = np.arange(1.0, outline.coefficients.size)[:, None]
    found = np.empty((j.size + 1, exponent.size))
    found[0] = 0.5 * beta(0.5, exponent + 1.0)
    found[1:] = (j - 0.5) / (exponent + (j + 0.5))  # of each B over the one before
    for before, term in itertools.pairwise(found):
        term *= before
    found *= outline.coefficients[:, None]
    return found


def _value_and_slope(coefficients: Array, ratio: Array) -> tuple[Array, Array]:
    """I and dI/d epsilon, by Horner's rule."""
    value, slope = coefficients[-1].copy(), np.zeros_like(ratio)
    for coefficient in coefficients[-2::-1]:
        slope *= ratio
        slope += value
        value *= ratio
        value += coefficient
    return value, slope


def _slope_exponent(exponent: Array, coefficients: Array, ratio: Array, value: Array) -> Array:
    """d ln I / dn, from the derivative d ln B / dn of each term of the series."""
    harmonic, total, power = np.zeros_like(ratio), np.zeros_like(ratio), np.ones_like(ratio)
    for j in range(1, coefficients.shape[0]):
        harmonic += 1.0 / (exponent + (j + 0.5))
        power *= ratio
        total += coefficients[j] * power * harmonic
    return np.asarray(digamma(exponent + 1.0) - digamma(exponent + 1.5) - total / value)


def shape_integral(exponent: ArrayLike, ratio: ArrayLike) -> ShapeIntegral:
    """Compute I(n, z/D), the dimensionless factor of the contact integral, and its derivatives.

    Parameters
    ----------
    exponent
        Exponent n > 0.
    ratio
        Sinkage over diameter, z/D, 0 to 0.5, which is not checked. Both arguments broadcast.

    Returns
    -------
    ShapeIntegral
    """
    n, epsilon = np.broadcast_arrays(
        np.asarray(exponent, dtype=float), np.asarray(ratio, dtype=float)
    )
    shape = n.shape
    n, epsilon = n.reshape(-1), epsilon.reshape(-1)
    coefficients = _coefficients(n, _outline_for(float(epsilon.max(initial=0.0))))
    value, slope = _value_and_slope(coefficients, epsilon)
    by_exponent = _slope_exponent(n, coefficients, epsilon, value)
    return ShapeIntegral(
        value.reshape(shape), (epsilon * slope / value).reshape(shape), by_exponent.reshape(shape)
    )


def contact_load(
    sinkage: ArrayLike,
    diameter: ArrayLike,
    width: ArrayLike,
    modulus: ArrayLike,
    exponent: ArrayLike,
) -> Array:
    """Normal load (N) that a rolling wheel carries at a sinkage, by the contact integral.

    Parameters
    ----------
    sinkage
        Sinkage z, m, 0 to half of the diameter.
    diameter, width
        Diameter D and width b of the wheel, m.
    modulus
        K = k D^m, Pa/m^n.
    exponent
        Exponent n of sinkage.

    Returns
    -------
    array of the broadcast shape
    """
    z, d, n = (np.asarray(a, dtype=float) for a in (sinkage, diameter, exponent))
    shape = shape_integral(n, z / d).value
    return np.asarray(np.asarray(width) * np.asarray(modulus) * np.sqrt(d) * z ** (n + 0.5) * shape)


def _solve_block(
    target: Array, diameter: Array, exponent: Array, with_exponent: bool
) -> tuple[Array, NDArray[np.bool_], Array, Array | float]:
    """ln z with (n + 1/2) ln z + ln I(n, z/D) = target, by Newton's method in ln z.

    ln I falls, faster and faster, with ln z: the left side is concave and rising. Started from
    the left of the root (I at zero sinkage is its largest value), Newton's steps approach the root
    from the left and never pass it, so no bracket is needed; if a step is beyond the axle, so is the root.
    """
    half = exponent + 0.5
    log_d = np.log(diameter)
    # In ln(z/D): the load that the wheel carries at each ratio, in the target's logarithm.
    level = target - half * log_d
    first = 0.5 * beta(0.5, exponent + 1.0)
    start = np.minimum((level - np.log(first)) / half, _LOG_AXLE)
    # I falls with depth, at first by d ln I / d epsilon = -0.75/(n + 1.5): still left of the root.
    fall = np.log1p(-0.75 / (exponent + 1.5) * np.exp(start))
    start = np.minimum(start - fall / half, _LOG_AXLE)
    highest = np.exp(float(start.max(initial=-np.inf)))
    for outline in _OUTLINES:
        if highest > outline.limit:
            continue
        coefficients = _coefficients(exponent, outline)
        log_ratio = start.copy()
        for _ in range(_NEWTON_STEPS):
            ratio = np.exp(log_ratio)
            value, slope = _value_and_slope(coefficients, ratio)
            rise = half + ratio * slope / value
            step = (level - half * log_ratio - np.log(value)) / rise
            log_ratio = np.minimum(log_ratio + step, _LOG_AXLE)
            # Newton doubles the digits: a step of 1e-8 leaves an error of about 1e-16.
            if np.all((np.abs(step) < 1e-8) | (log_ratio == _LOG_AXLE)):
                break
        highest = float(np.exp(log_ratio.max(initial=-np.inf)))
        if highest <= outline.limit:
            break
    sunk = log_ratio == _LOG_AXLE
    if sunk.any():
        n = exponent[sunk]
        of_axle, _ = _value_and_slope(_coefficients(n, _OUTLINES[-1]), np.full(n.size, AXLE_RATIO))
        excess = level[sunk] - (half[sunk] * _LOG_AXLE + np.log(of_axle))
        log_ratio[sunk] += np.maximum(excess, 0.0) / half[sunk]
        # ln z = (target - ln I)/(n + 1/2) beyond the axle, with I at the axle.
        ratio[sunk], value[sunk] = AXLE_RATIO, of_axle
        sunk[sunk] = excess > 0.0
        rise = np.where(sunk, half, rise)
    log_z, slope_exponent = log_ratio + log_d, np.nan
    if with_exponent:
        by_exponent = _slope_exponent(exponent, coefficients, ratio, value)
        slope_exponent = -(log_z + by_exponent) / rise
    return log_z, sunk, 1.0 / rise, slope_exponent


def contact_sinkage(
    load: ArrayLike,
    diameter: ArrayLike,
    width: ArrayLike,
    modulus: ArrayLike,
    exponent: ArrayLike,
    *,
    with_exponent: bool = True,
) -> ContactSinkage:
    """Solve the contact integral for the sinkage of a rolling wheel under a normal load.

    Arguments broadcast, and are not checked.

    Parameters
    ----------
    load
        Normal load W, N, above 0.
    diameter, width
        Diameter D and width b of the wheel, m.
    modulus
        K = k D^m, Pa/m^n.
    exponent
        Exponent n > 0.
    with_exponent
        Whether to compute `slope_exponent`, which takes a third of the time.

    Returns
    -------
    ContactSinkage
    """
    w, d, b, modulus_array, n = np.broadcast_arrays(
        *(np.asarray(a, dtype=float) for a in (load, diameter, width, modulus, exponent))
    )
    shape = w.shape
    flat_d, flat_n = d.reshape(-1), n.reshape(-1)
    target = np.log(w / (b * modulus_array * np.sqrt(d))).reshape(-1)
    log_z, slope_load, slope_exponent = (np.empty(target.size) for _ in range(3))
    sunk = np.empty(target.size, dtype=bool)
    for first in range(0, target.size, _BLOCK):
        rows = slice(first, first + _BLOCK)
        log_z[rows], sunk[rows], slope_load[rows], slope_exponent[rows] = _solve_block(
            target[rows], flat_d[rows], flat_n[rows], with_exponent
        )
    return ContactSinkage(
        np.exp(log_z).reshape(shape),
        sunk.reshape(shape),
        slope_load.reshape(shape),
        slope_exponent.reshape(shape),
    )
