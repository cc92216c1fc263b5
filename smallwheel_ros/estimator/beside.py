"""Sinkage of one wheel in the soil in which another one's is known, in plain floats.

With I(z) the contact integral (see `physics.contact`), K = k D^m and both wheels in one soil,

    ln W - ln(b sqrt(D)) = ln K + (n + 1/2) ln z + ln(I(z/D) / I(0)) + ln I(0)

holds for each of them. In the difference ln K and I(0) cancel, so the only thing to be computed is
the polynomial I/I(0): a third of the work of going through k, for the filter's hundreds of
measurements a second.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

from smallwheel_ros.estimator.point_sinkage import SHAPES, Shape, terms

_NEWTON_STEPS = 20
_STRAIGHT = 0.3
_SMALL_STEP = 1e-3  # of ln z: what is left is 1e-8
_GRID = 1000  # of n: the polynomial's coefficients are straight lines between, to 1e-8


class Wheel(NamedTuple):
    """A rolling wheel under a load: ln of W / (b sqrt(D)), and ln of D (m)."""

    log_loading: float
    log_diameter: float


# ln of the sinkage (m), with its slopes by ln of the reference's sinkage, by n (that held), and by ln
# of the load; by ln K it is the opposite.
Beside = tuple[float, float, float, float]


def wheel_of(load: float, diameter: float, width: float) -> Wheel:
    """Describe a wheel; N, m, m."""
    return Wheel(math.log(load / (width * math.sqrt(diameter))), math.log(diameter))


@lru_cache(maxsize=256)
def _terms(shape: Shape, place: int) -> tuple[tuple[float, float], ...]:
    """Coefficients of I/I(0) at a place of the grid, each with what n takes off; highest first."""
    return terms(shape, place / _GRID)


def sinkage_beside(
    wheel: Wheel, reference: Wheel, log_reference: float, exponent: float, log_factor: float
) -> Beside | None:
    """Sinkage of a wheel where a reference wheel's is exp(`log_reference`) (m).

    exponent: n, 0 to 3. log_factor: ln of the wheel's K over the reference's. None where one of the
    two is near the axle or deeper, or they differ widely: that is for `point_sinkage`. Raises
    ValueError or ArithmeticError (by math) for numbers that are not finite.
    """
    half = exponent + 0.5
    more = wheel.log_loading - reference.log_loading - log_factor
    log_ratio = log_reference - reference.log_diameter
    more_ratio = more + half * (reference.log_diameter - wheel.log_diameter)
    expected = 1.2 * math.exp(log_ratio + max(more_ratio / half, 0.0))
    for shape in SHAPES:
        if expected <= shape.limit:
            break
    else:
        return None
    place = round(exponent * _GRID)
    coefficients, away = _terms(shape, place), exponent - place / _GRID
    ratio = math.exp(log_ratio)
    # This loop stands here twice: two calls more are a fiftieth of the filter's whole update.
    value = slope = taken_off = 0.0
    for c, off in coefficients:
        slope = slope * ratio + value
        value = value * ratio + c
        taken_off = taken_off * ratio + off
    # It leaves out the power 0: I/I(0) = 1 + ratio * value.
    slope = (slope * ratio + value) * ratio
    value = 1.0 + (value - away * taken_off) * ratio
    by_reference = half + slope / value
    off_reference = taken_off * ratio / value
    target = half * log_ratio + math.log(value) + more_ratio
    # The slope grows about as fast as what it is over n + 1/2: that gives the second order.
    step = more_ratio / by_reference
    second = 0.5 * step * (1.0 - half / by_reference)
    if not -_STRAIGHT < second < _STRAIGHT:
        return None
    log_ratio += step * (1.0 - second)
    for _ in range(_NEWTON_STEPS):
        ratio = math.exp(log_ratio)
        if not ratio < shape.limit:
            return None
        value = slope = taken_off = 0.0
        for c, off in coefficients:
            slope = slope * ratio + value
            value = value * ratio + c
            taken_off = taken_off * ratio + off
        slope = (slope * ratio + value) * ratio
        value = 1.0 + (value - away * taken_off) * ratio
        slope = half + slope / value
        step = (target - half * log_ratio - math.log(value)) / slope
        if -_SMALL_STEP < step < _SMALL_STEP:
            log_ratio += step * (1.0 - 0.5 * step * (1.0 - half / slope))
            slope += (slope - half) * step
            break
        log_ratio += step
    taken_off *= ratio / value
    log_z = log_ratio + wheel.log_diameter
    return (
        log_z,
        by_reference / slope,
        (log_reference - off_reference - log_z + taken_off) / slope,
        1.0 / slope,
    )
