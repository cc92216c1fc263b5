"""The contact integral of a rigid wheel: how load and sinkage belong together, exactly.

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
number of terms gives it to rounding: no quadrature is needed. Bekker's and the paper's closed form
(eq. 7, 10) replaces I by its expansion in n at epsilon = 0, (3 - n)/3.

Every function broadcasts its arguments like NumPy does; units are SI.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import beta, digamma

Array = NDArray[np.float64]

AXLE_RATIO = 0.5  # epsilon at which the wheel is sunk to its axle
_BLOCK = 4096  # rows worked on at a time: the few temporaries then stay in the processor's cache
_TERMS = 56  # 0.5**56 is below rounding
_NEWTON_STEPS = 40


def _series_coefficients(terms: int) -> Array:
    """a_j of (1 - 2 sigma)/sqrt(1 - sigma), j = 0 .. terms - 1."""
    j = np.arange(1, terms)
    central = np.concatenate(([1.0], np.cumprod((2 * j - 1) / (2 * j))))
    coefficients = central.copy()
    coefficients[1:] -= 2 * central[:-1]
    return coefficients


_A = _series_coefficients(_TERMS)


class ShapeIntegral(NamedTuple):
    """I(n, epsilon) and its logarithmic slopes, each of the broadcast shape."""

    value: Array
    slope_ratio: Array  # d ln I / d ln epsilon
    slope_exponent: Array  # d ln I / d n


class ContactSinkage(NamedTuple):
    """Sinkage of a wheel, and where the model no longer holds.

    sinkage: m. Where `sunk_to_axle`, the load is more than the wheel can carry sunk to its axle;
    the sinkage there is a continuation by the power n + 1/2, of use to a fit that passes through
    such a point but not a prediction.
    slope_load, slope_exponent: d ln z / d ln(W / K) and d ln z / d n at constant K and W.
    """

    sinkage: Array
    sunk_to_axle: NDArray[np.bool_]
    slope_load: Array
    slope_exponent: Array


def _terms_for(ratio: float) -> int:
    """How many terms of the series reach rounding error at this sinkage over diameter."""
    if ratio <= 1e-12:
        return 3
    return int(min(_TERMS, np.ceil(-37.0 / np.log(min(ratio, AXLE_RATIO))) + 3))


def _series(exponent: Array, ratio: Array, start: Array) -> tuple[Array, Array, Array]:
    """Sums of t_j, j t_j and t_j h_j, with t_j = a_j B(j + 1/2, n + 1) epsilon^j / 2.

    h_j = sum of 1/(n + i + 1/2), i = 1 .. j, is what the derivative by n of the beta function adds.
    """
    product = start
    value, by_ratio = start.copy(), np.zeros_like(start)
    by_exponent, harmonic = np.zeros_like(start), np.zeros_like(start)
    terms = _terms_for(float(ratio.max(initial=0.0)))
    for j in range(1, terms):
        inverse = 1.0 / (exponent + (j + 0.5))
        harmonic = harmonic + inverse
        product = product * ratio * inverse * (j - 0.5)
        term = product * _A[j]
        value += term
        by_ratio += j * term
        by_exponent += term * harmonic
    return value, by_ratio, by_exponent


def shape_integral(exponent: ArrayLike, ratio: ArrayLike) -> ShapeIntegral:
    """I(n, z/D) of the contact integral, with d ln I / d ln(z/D) and d ln I / dn.

    exponent: n > 0. ratio: z/D, 0 .. 0.5 (not checked: the callers clip).
    """
    n, epsilon = np.broadcast_arrays(
        np.asarray(exponent, dtype=float), np.asarray(ratio, dtype=float)
    )
    start = 0.5 * beta(0.5, n + 1.0)
    value, by_ratio, by_exponent = _series(n, epsilon, np.array(start))
    at_zero = digamma(n + 1.0) - digamma(n + 1.5)
    return ShapeIntegral(value, by_ratio / value, at_zero - by_exponent / value)


def contact_load(
    sinkage: ArrayLike,
    diameter: ArrayLike,
    width: ArrayLike,
    modulus: ArrayLike,
    exponent: ArrayLike,
) -> Array:
    """Normal load (N) that a rolling wheel carries at this sinkage, by the contact integral.

    sinkage: m, 0 .. diameter/2. modulus: K = k D^m, Pa/m^n. exponent: n.
    """
    z, d, n = (np.asarray(a, dtype=float) for a in (sinkage, diameter, exponent))
    shape = shape_integral(n, z / d).value
    return np.asarray(np.asarray(width) * np.asarray(modulus) * np.sqrt(d) * z ** (n + 0.5) * shape)


def _solve_block(
    target: Array, diameter: Array, exponent: Array
) -> tuple[Array, Array, Array, Array]:
    """Ln z with (n + 1/2) ln z + ln I(n, z/D) = target, by Newton's method in ln z.

    ln I falls, faster and faster, with ln z: the left side is concave and rising. Started from the
    left of the root (I at zero sinkage is its largest value), Newton's steps approach the root
    from the left and never pass it, so no bracket is needed.
    """
    start: Array = np.asarray(0.5 * beta(0.5, exponent + 1.0))
    at_zero = digamma(exponent + 1.0) - digamma(exponent + 1.5)
    half = exponent + 0.5
    log_axle = np.log(AXLE_RATIO * diameter)
    # Load that the wheel carries sunk to its axle, in the same logarithm as the target.
    full = _series(exponent, np.full_like(diameter, AXLE_RATIO), start)[0]
    excess = target - (half * log_axle + np.log(full))
    sunk = excess > 0.0
    log_z = np.minimum((target - np.log(start)) / half, log_axle)
    for _ in range(_NEWTON_STEPS):
        value, by_ratio, by_exponent = _series(exponent, np.exp(log_z) / diameter, start)
        slope = half + by_ratio / value
        step = (target - half * log_z - np.log(value)) / slope
        log_z = np.minimum(log_z + step, log_axle)
        # Newton doubles the digits: a step of 1e-8 leaves an error of about 1e-16.
        if np.all((np.abs(step) < 1e-8) | sunk):
            break
    slope_exponent = -(log_z + at_zero - by_exponent / value) / slope
    log_z = np.where(sunk, log_axle + excess / half, log_z)
    return log_z, sunk, 1.0 / slope, slope_exponent


def contact_sinkage(
    load: ArrayLike, diameter: ArrayLike, width: ArrayLike, modulus: ArrayLike, exponent: ArrayLike
) -> ContactSinkage:
    """Sinkage (m) of a rolling wheel under a normal load, by the contact integral.

    load: W > 0, N. diameter, width: m. modulus: K = k D^m, Pa/m^n. exponent: n > 0. Arguments
    broadcast; they are not checked here (`model.predict` and the readers do).
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
            target[rows], flat_d[rows], flat_n[rows]
        )
    return ContactSinkage(
        np.exp(log_z).reshape(shape),
        sunk.reshape(shape),
        slope_load.reshape(shape),
        slope_exponent.reshape(shape),
    )
