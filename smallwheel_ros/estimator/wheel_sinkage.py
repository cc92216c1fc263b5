# SPDX-License-Identifier: Apache-2.0
"""Sinkage of one wheel in plain floats, with its derivatives by the law and the load.

The filter asks for it thousands of times a second, one wheel at a time. It is the contact integral of
`physics.contact`, which works on arrays: for one row NumPy's cost per call is sixty times the arithmetic's.
Here the factor (1 - 2 sigma)/sqrt(1 - sigma) of the integral is a polynomial fitted on the range of sinkage
over diameter that is needed: fewer terms than its series.

Without effects a sinkage is one solution; with effects that leave pressure a power of depth, that solution
between what they make of load, wheel and soil and what they make of the sinkage; with any others
`model.predict` itself and its differences, a hundred times slower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model.nearby import STEP as _STEP
from smallwheel_ros.model.nearby import neighbours, slopes
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import PRESSED, Conditions
from smallwheel_ros.physics.contact import AXLE_RATIO
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER

Array = NDArray[np.float64]
Slopes = tuple[float, float, float, float]

_NEWTON_STEPS = 40
# What comes of a soil in which a wheel has no sinkage, an effect that fails, or a filter that does.
NO_SINKAGE = (ArithmeticError, ValueError, np.linalg.LinAlgError, SmallwheelError)
_LOG_HALF_ROOT_PI = 0.5 * math.log(math.pi) - math.log(2.0)


class Law(NamedTuple):
    """The soil's law: ln of K = k D^m (Pa/m^n) under a wheel of `REFERENCE_DIAMETER`, n and m."""

    log_modulus: float
    n: float
    m: float

    @property
    def k(self) -> float:
        """Pa/m^(n+m)."""
        return math.exp(self.log_modulus - self.m * math.log(REFERENCE_DIAMETER))


class WheelSinkage(NamedTuple):
    """What the instrument would show (m), and its slopes by the three of `Law` and by ln load."""

    value: float
    slopes: Slopes
    sunk_to_axle: bool


class PointSinkage(NamedTuple):
    """ln of the sinkage (m), and its slopes by ln(W/K) and, at constant W and K, by n.

    Where sunk to the axle, the sinkage is a continuation by the power n + 1/2.
    """

    log_sinkage: float
    slope_load: float
    slope_exponent: float
    sunk_to_axle: bool


@dataclass(frozen=True, eq=False)
class Shape:
    """A polynomial that is the contact's shape factor for sinkage over diameter up to `limit`."""

    limit: float
    coefficients: tuple[tuple[float, float], ...]  # j - 1/2 and the one of power j, j = 1, 2, ..


def _fit_shape(limit: float, degree: int) -> Shape:
    fitted = np.polynomial.Chebyshev.interpolate(
        lambda s: (1.0 - 2.0 * s) / np.sqrt(1.0 - s), degree, domain=[0.0, limit]
    )
    power = fitted.convert(kind=np.polynomial.Polynomial).coef
    return Shape(limit, tuple((j + 0.5, float(a)) for j, a in enumerate(power[1:])))


# The degrees reach 2e-12: the nearest singularity is at sigma = 1.
SHAPES = tuple(_fit_shape(*s) for s in ((0.04, 5), (0.08, 6), (0.16, 8), (AXLE_RATIO, 14)))


@lru_cache(maxsize=64)
def _at_zero(exponent: float) -> tuple[float, float]:
    """ln of I at zero sinkage, and its slope by n."""
    log_start = _LOG_HALF_ROOT_PI + math.lgamma(exponent + 1.0) - math.lgamma(exponent + 1.5)
    return log_start, float(digamma(exponent + 1.0)) - float(digamma(exponent + 1.5))


def terms(shape: Shape, exponent: float) -> tuple[tuple[float, float], ...]:
    """Coefficients of I over I at zero sinkage, as a polynomial in the ratio; the highest first.

    Second: each times its share in what n takes off.
    """
    found = []
    product, harmonic, denominator = 1.0, 0.0, exponent + 0.5
    for beta_index, a in shape.coefficients:
        denominator += 1.0
        product *= beta_index / denominator
        harmonic += 1.0 / denominator
        found.append((product * a, product * a * harmonic))
    return tuple(reversed(found))


_terms = lru_cache(maxsize=64)(terms)


def static_sinkage(
    law: Law, load: float, diameter: float, width: float, contact: str
) -> WheelSinkage:
    """Sinkage of a wheel that rolls or is pressed under a load (N), without any effects."""
    # A pressed wheel meets the soil on both sides of its lowest point: each carries half.
    carried = 0.5 * load if contact == PRESSED else load
    across = math.log(diameter / REFERENCE_DIAMETER)
    found = point_sinkage(carried, diameter, width, law.log_modulus + law.m * across, law.n)
    z = math.exp(found.log_sinkage)
    by_load, by_n = z * found.slope_load, z * found.slope_exponent
    return WheelSinkage(z, (-by_load, by_n, -by_load * across, by_load), found.sunk_to_axle)


def point_sinkage(
    load: float, diameter: float, width: float, log_modulus: float, exponent: float
) -> PointSinkage:
    """Sinkage of a rolling wheel under a normal load, by the contact integral.

    load: N, > 0. diameter, width: m. log_modulus: ln of K = k D^m in Pa/m^n. exponent: n, 0 to 3.
    Raises ValueError or ArithmeticError (by math) for numbers outside these.
    """
    half = exponent + 0.5
    log_start, at_zero = _at_zero(exponent)
    target = math.log(load / (width * math.sqrt(diameter))) - log_modulus - log_start
    log_axle = math.log(AXLE_RATIO * diameter)
    # I at zero sinkage, its largest value, gives a start left of the root
    ratio = math.exp(min(target / half, log_axle)) / diameter
    log_z = min((target + 0.75 / (exponent + 1.5) * ratio) / half, log_axle)
    expected = 1.2 * math.exp(log_z) / diameter
    for shape in SHAPES:
        if expected > shape.limit and shape is not SHAPES[-1]:
            continue
        log_z, slope, by_exponent, excess = _solve(shape, exponent, target, diameter, log_z)
        if excess > 0.0 and shape is not SHAPES[-1]:
            continue
        break
    slope_exponent = -(log_z + at_zero - by_exponent) / slope
    if excess > 0.0:
        log_z += excess / half
    return PointSinkage(log_z, 1.0 / slope, slope_exponent, excess > 0.0)


def _solve(
    shape: Shape, exponent: float, target: float, diameter: float, log_z: float
) -> tuple[float, float, float, float]:
    """Newton's method for (n + 1/2) ln z + ln(I / I(z = 0)) = target, within the shape's range.

    Gives ln z, the left side's slope by ln z, what I's polynomial takes off d ln I/dn, and the part
    of the target that is left where the range ends before it.
    """
    half = exponent + 0.5
    polynomial = _terms(shape, exponent)
    log_limit = math.log(shape.limit * diameter)
    log_z = min(log_z, log_limit)
    excess = 0.0
    for _ in range(_NEWTON_STEPS):
        ratio = math.exp(log_z) / diameter
        value, slope = 0.0, 0.0
        for c, _ in polynomial:
            slope = slope * ratio + value
            value = value * ratio + c
        # the loop leaves out the power 0: I/I0 = 1 + ratio * value
        slope = (slope * ratio + value) * ratio
        value = 1.0 + value * ratio
        slope = half + slope / value
        miss = target - half * log_z - math.log(value)
        step = miss / slope
        if log_z + step > log_limit:
            if log_z == log_limit:
                excess = miss
                break
            log_z = log_limit
            continue
        log_z += step
        # Newton squares the error: it is at rounding now, that of the slopes below 1e-6.
        if -1e-7 < step < 1e-7:
            break
    by_exponent = 0.0
    for _, off in polynomial:
        by_exponent = by_exponent * ratio + off
    return log_z, slope, by_exponent * ratio / value, excess


class PointPressure(NamedTuple):
    """ln of K = k D^m (Pa/m^n) that a sinkage shows, and its slopes by ln sinkage and by n."""

    log_modulus: float
    slope_sinkage: float
    slope_exponent: float


@lru_cache(maxsize=64)  # all wheels ask for that of one soil
def point_pressure(
    load: float, diameter: float, width: float, log_sinkage: float, exponent: float
) -> PointPressure:
    """Modulus of the soil in which a rolling wheel sinks so far: the inverse of `point_sinkage`.

    load: N, > 0. diameter, width: m. log_sinkage: ln of m. exponent: n, 0 to 3. Beyond the axle
    the same continuation. Raises ValueError or ArithmeticError for numbers outside these.
    """
    half = exponent + 0.5
    ratio = math.exp(log_sinkage) / diameter
    beyond = ratio > AXLE_RATIO
    ratio = min(ratio, AXLE_RATIO)
    if not ratio <= AXLE_RATIO:
        raise ValueError("sinkage is not a number")
    for shape in SHAPES:
        if ratio <= shape.limit:
            break
    value, slope, by_exponent = 0.0, 0.0, 0.0
    for c, off in terms(shape, exponent):
        slope = slope * ratio + value
        value = value * ratio + c
        by_exponent = by_exponent * ratio + off
    slope = (slope * ratio + value) * ratio
    value = 1.0 + value * ratio
    log_start, at_zero = _at_zero(exponent)
    log_load = math.log(load / (width * math.sqrt(diameter)))
    return PointPressure(
        log_load - log_start - half * log_sinkage - math.log(value),
        -half - (0.0 if beyond else slope / value),
        -log_sinkage - at_zero + by_exponent * ratio / value,
    )


class LoadedWheel(NamedTuple):
    """A wheel under a load: N, m; slip 1 and speed m/s, None where not known."""

    load: float
    diameter: float
    width: float
    contact: str
    slip: float | None = None
    speed: float | None = None

    def conditions(self, loads: Array) -> Conditions:
        """It under each of these loads (N), one row each; slip and speed as far as they are known."""
        given = {"slip": self.slip, "speed": self.speed}
        known = {name: value for name, value in given.items() if value is not None}
        return Conditions(
            loads,
            np.full(loads.size, self.diameter),
            np.full(loads.size, self.width),
            np.broadcast_to(np.array(self.contact), loads.shape),
            None,
            {name: np.full(loads.size, value) for name, value in known.items()},
        )


def wheel_sinkage(law: Law, wheel: LoadedWheel, effects: Sequence[Effect] = ()) -> WheelSinkage:
    """Sinkage of a wheel in a soil.

    Raises one of `NO_SINKAGE` where the model has none.
    """
    if not effects:
        return static_sinkage(law, *wheel[:4])
    # The wheel under a little less and a little more load; then as it is, a little less and more deep.
    loads = wheel.load * np.exp(_STEP * np.array([-1.0, 0.0, 1.0, 0.0, 0.0]))
    stages = Stages(effects, wheel.conditions(loads))
    if stages.layered:
        alone = wheel.conditions(np.array([wheel.load]))
        found = neighbours(np.array([law]), alone, effects)
        by_modulus, by_n, by_m, by_load = slopes(found.sinkage)[:, 0].tolist()
        by_law = by_modulus, by_n, by_m, by_load
        return WheelSinkage(float(found.sinkage[0]), by_law, bool(found.immobilised[0]))
    statics = []
    for load, diameter, modulus, n in np.transpose(stages.loaded(law.k, law.n, law.m))[:3].tolist():
        log_modulus = math.log(modulus) - law.m * math.log(diameter / REFERENCE_DIAMETER)
        acted_on = Law(log_modulus, n, law.m)
        statics.append(static_sinkage(acted_on, load, diameter, wheel.width, wheel.contact))
    static = statics[1]
    around = static.value * (1.0 - _STEP), static.value * (1.0 + _STEP)
    z = np.array([*(one.value for one in statics), *around])
    dug = stages.change_rolling("sinkage", z)
    less, shown, more, before, after = stages.change("measured_sinkage", dug).tolist()
    slope = (after - before) / (2.0 * _STEP * static.value)
    by_modulus, by_n, by_m, _ = static.slopes
    by_law = by_modulus * slope, by_n * slope, by_m * slope, (more - less) / (2.0 * _STEP)
    return WheelSinkage(shown, by_law, static.sunk_to_axle or shown > 0.5 * diameter)
