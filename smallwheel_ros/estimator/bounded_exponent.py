"""A coordinate q for the exponent n that is n itself, but bent where n nears 0 or 3.

What a load and a sinkage say of the soil is nearly a straight line between ln pressure and n, and
often a thin one. A logarithm or a logit of n would bend it, and a filter's ellipse along the bend
is sure of what is wrong. So n = q to 1e-6 from 0.6 to 2.4, and nears 0 and 3 without reaching them.
"""

from __future__ import annotations

import math

_UPPER = 3.0
_MIDDLE = 0.5 * _UPPER
_BEND = 0.05  # n over which the ends bend


def exponent_of(q: float) -> float:
    """Give n, in (0, 3)."""
    return exponent_and_slope(q)[0]


def coordinate_of(exponent: float) -> float:
    """Give q for n in (0, 3)."""
    if exponent <= _MIDDLE:
        return exponent + _BEND * math.log(-math.expm1(-exponent / _BEND))
    return _UPPER - coordinate_of(_UPPER - exponent)


def exponent_slope(q: float) -> float:
    """Give dn/dq."""
    return exponent_and_slope(q)[1]


def exponent_and_slope(q: float) -> tuple[float, float]:
    """Give n, in (0, 3), and dn/dq."""
    if q < _MIDDLE:
        grown = math.exp(q / _BEND)
        return _BEND * math.log1p(grown), grown / (1.0 + grown)
    grown = math.exp((_UPPER - q) / _BEND)
    return _UPPER - _BEND * math.log1p(grown), grown / (1.0 + grown)
