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


Four = tuple[float, float, float, float]


class Belief(NamedTuple):
    """Mean and covariance of what one wheel's measurement depends on: 4 numbers.

    rows: of the covariance, 4; columns 0, 1, 2 and `spot` of each are those of the four numbers.
    """

    mean: Four
    rows: tuple[list[float], list[float], list[float], list[float]]
    spot: int


class Point(NamedTuple):
    """A measurement's value at some soil, its slopes there, and the variance of its noise.

    sunk_to_axle: the value is a continuation.
    """

    value: float
    row: Four
    noise: float
    sunk_to_axle: bool


class Line(NamedTuple):
    """A measurement as a straight line: expected + row @ (x - mean) + noise.

    by: covariance @ row. spread: variance of row @ x. reach: the sum of its parts' sizes.
    chi_square: innovation squared over its variance.
    """

    expected: float
    row: Four
    noise: float
    by: Four
    spread: float
    reach: float
    chi_square: float


def line_at(point: Point, x: Four, belief: Belief, measured: float) -> Line:
    """Put a straight line through a point at x."""
    value, row, noise, _ = point
    a, b, c, d = row
    mean, (one, two, three, four), spot = belief
    if x is not mean:
        value += a * (mean[0] - x[0]) + b * (mean[1] - x[1])
        value += c * (mean[2] - x[2]) + d * (mean[3] - x[3])
    first = one[0] * a + one[1] * b + one[2] * c + one[spot] * d
    second = two[0] * a + two[1] * b + two[2] * c + two[spot] * d
    third = three[0] * a + three[1] * b + three[2] * c + three[spot] * d
    fourth = four[0] * a + four[1] * b + four[2] * c + four[spot] * d
    by = first, second, third, fourth
    first, second, third, fourth = a * first, b * second, c * third, d * fourth
    spread = first + second + third + fourth
    reach = abs(first) + abs(second) + abs(third) + abs(fourth)
    miss = measured - value
    return Line(value, row, noise, by, spread, reach, miss * miss / (spread + noise))


def linearise(
    at: Callable[[Four], Point],
    first: Point,
    line: Line,
    belief: Belief,
    measured: float,
) -> tuple[Line, Four]:
    """Linearise at the most likely soil; give the line and that soil.

    first, line: `at` the belief's mean, and `line_at` there. Raises ArithmeticError or ValueError
    where the measurement's value cannot be computed.
    """
    mean, x, value = belief.mean, belief.mean, first.value
    expected, _, noise, _, spread, reach, _ = line
    gain = (measured - expected) / (spread + noise)
    if _straight(gain * reach, value, noise):
        return line, x
    share, last = 1.0, math.inf
    for _ in range(_ITERATIONS):
        by, row = line.by, line.row
        step = (
            mean[0] + gain * by[0] - x[0],
            mean[1] + gain * by[1] - x[1],
            mean[2] + gain * by[2] - x[2],
            mean[3] + gain * by[3] - x[3],
        )
        change = (
            abs(row[0] * step[0])
            + abs(row[1] * step[1])
            + abs(row[2] * step[2])
            + abs(row[3] * step[3])
        )
        if _straight(change, value, line.noise):
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
        gain = (measured - line.expected) / (line.spread + line.noise)
    return line, x


def _straight(change: float, value: float, noise: float) -> bool:
    """Whether a value is a straight line over a change of it, to less than the noise.

    Sinkage is nearly exponential in the state.
    """
    return 0.5 * change * change < _TOLERANCE * max(abs(value), 1e-6) * math.sqrt(noise)
