"""Where to linearise one measurement: at the most likely soil, not at the predicted one.

Sinkage is an exponential of the state: under a wide prior a Kalman update linearised at the
prediction overshoots and then believes itself. Gauss-Newton steps find the most likely soil given
prediction and measurement first (the iterated extended Kalman filter; Bell and Cathey 1993). One
measurement depends on four numbers only (ln z_ref or ln pressure, q, m, the wheel's spot), so this
is done in plain floats.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

_ITERATIONS = 15
_TOLERANCE = 0.05  # of the noise's standard deviation, for what linearising may be off
_LONGEST_STEP = 1.0  # of ln sinkage or pressure, q and m


class Belief(NamedTuple):
    """Mean and covariance of what one wheel's measurement depends on: 4 numbers, 4 x 4."""

    mean: tuple[float, float, float, float]
    covariance: tuple[tuple[float, float, float, float], ...]


class Point(NamedTuple):
    """A measurement's value at some soil, its slopes there, and the variance of its noise.

    sunk_to_axle: the value is a continuation.
    """

    value: float
    row: tuple[float, float, float, float]
    noise: float
    sunk_to_axle: bool


class Line(NamedTuple):
    """A measurement as a straight line: expected + row @ (x - mean) + noise.

    by: covariance @ row. spread: variance of row @ x. chi_square: innovation squared over its
    variance.
    """

    expected: float
    row: tuple[float, float, float, float]
    noise: float
    by: tuple[float, float, float, float]
    spread: float
    chi_square: float


def line_at(
    point: Point, x: tuple[float, float, float, float], belief: Belief, measured: float
) -> Line:
    """Put a straight line through a point at x."""
    a, b, c, d = point.row
    mean = belief.mean
    expected = (
        point.value
        + a * (mean[0] - x[0])
        + b * (mean[1] - x[1])
        + c * (mean[2] - x[2])
        + d * (mean[3] - x[3])
    )
    one, two, three, four = belief.covariance
    first = one[0] * a + one[1] * b + one[2] * c + one[3] * d
    second = two[0] * a + two[1] * b + two[2] * c + two[3] * d
    third = three[0] * a + three[1] * b + three[2] * c + three[3] * d
    fourth = four[0] * a + four[1] * b + four[2] * c + four[3] * d
    spread = a * first + b * second + c * third + d * fourth
    chi_square = (measured - expected) ** 2 / (spread + point.noise)
    return Line(
        expected, point.row, point.noise, (first, second, third, fourth), spread, chi_square
    )


def linearise(
    at: Callable[[tuple[float, float, float, float]], Point],
    first: Point,
    line: Line,
    belief: Belief,
    measured: float,
) -> tuple[Line, tuple[float, float, float, float]]:
    """Linearise at the most likely soil; give the line and that soil.

    first, line: `at` the belief's mean, and `line_at` there. Raises ArithmeticError or ValueError
    where the measurement's value cannot be computed.
    """
    mean, x, value = belief.mean, belief.mean, first.value
    share, last = 1.0, math.inf
    for _ in range(_ITERATIONS):
        gain = (measured - line.expected) / (line.spread + line.noise)
        by, row = line.by, line.row
        step = (
            mean[0] + gain * by[0] - x[0],
            mean[1] + gain * by[1] - x[1],
            mean[2] + gain * by[2] - x[2],
            mean[3] + gain * by[3] - x[3],
        )
        # Sinkage is nearly exponential in the state: what a straight line misses over this step.
        change = (
            abs(row[0] * step[0])
            + abs(row[1] * step[1])
            + abs(row[2] * step[2])
            + abs(row[3] * step[3])
        )
        bend = 0.5 * change * change / max(abs(value), 1e-6)
        if bend < _TOLERANCE * math.sqrt(line.noise):
            break
        if change > 0.7 * last:
            share *= 0.5  # it swings around the solution
        last = change
        part = share * min(1.0, _LONGEST_STEP / max(map(abs, step)))
        x = (
            x[0] + part * step[0],
            x[1] + part * step[1],
            x[2] + part * step[2],
            x[3] + part * step[3],
        )
        point = at(x)
        value = point.value
        line = line_at(point, x, belief, measured)
    return line, x
