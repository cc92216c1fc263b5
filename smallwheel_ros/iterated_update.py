"""Where to linearise one measurement of sinkage: at the most likely soil, not at the predicted one.

Sinkage goes as exp(-s/(n + 1/2)): under a wide prior a Kalman update linearised at the prediction
overshoots and then believes itself. Gauss-Newton steps find the most likely soil given prediction
and measurement first (the iterated extended Kalman filter; Bell and Cathey 1993). One scalar
measurement moves the soil in two directions only, so this is done in plain floats.

Only the soil's law is searched for, the spot stays at zero: a slope that follows what is peculiar
to one measurement takes its noise for information on n.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from smallwheel_ros.bounded_exponent import exponent_of, exponent_slope
from smallwheel_ros.sinkage_observation import Observed, Reading

_ITERATIONS = 15
_TOLERANCE = 0.05  # of the noise's standard deviation, for what linearising may be off
_LONGEST_STEP = 1.0  # of s and of q


class Belief(NamedTuple):
    """Mean and covariance of (s, q): s as in `sinkage_observation`, q as in `bounded_exponent`.

    law: mean of the soil's share of s, without the spot's. law_s, law_q: its covariance with s, q.
    """

    s: float
    q: float
    ss: float
    sq: float
    qq: float
    law: float
    law_s: float
    law_q: float

    def spread(self, by_s: float, by_q: float) -> float:
        """Variance of a linear function of s and q."""
        return by_s * by_s * self.ss + 2.0 * by_s * by_q * self.sq + by_q * by_q * self.qq


class Linearised(NamedTuple):
    """The measurement as a straight line: expected + by_s (s - mean) + by_q (q - mean) + noise.

    sinkage: m, where it was linearised. expected: m, at the belief's mean.
    """

    sinkage: float
    expected: float
    by_s: float
    by_q: float
    noise: float  # variance
    chi_square: float  # innovation squared over its variance


def exponent_ratio(observed: Observed, q: float) -> float:
    """Slope by q over slope by s: the direction in which a reading tells nothing."""
    return observed.by_exponent * exponent_slope(q) / observed.by_pressure


def line_at(
    observed: Observed, s: float, q: float, belief: Belief, reading: Reading, ratio: float
) -> Linearised:
    """Linearise a reading at (s, q), where `observed` is. ratio: see `exponent_ratio`."""
    by_s = observed.by_pressure
    by_q = by_s * ratio
    expected = observed.sinkage + by_s * (belief.s - s) + by_q * (belief.q - q)
    # Load and pressure enter as their ratio, so the slope by ln load is minus the one by s.
    noise = reading.noise + by_s * by_s * reading.load_noise
    chi_square = (reading.measured - expected) ** 2 / (belief.spread(by_s, by_q) + noise)
    return Linearised(observed.sinkage, expected, by_s, by_q, noise, chi_square)


def linearise(
    first: Linearised, belief: Belief, reading: Reading, ratio: float | None
) -> Linearised:
    """Linearise a reading at the most likely soil, or leave it as it is where that is near enough.

    first: at the mean of the law. ratio: to be kept to, or None. Raises ArithmeticError or
    ValueError where sinkage cannot be computed.
    """
    s, q = belief.law, belief.q
    line = first
    share, last = 1.0, math.inf
    for _ in range(_ITERATIONS):
        gain = (reading.measured - line.expected) / (
            belief.spread(line.by_s, line.by_q) + line.noise
        )
        aim_s, aim_q = gain * line.by_s, gain * line.by_q
        step_s = belief.law + belief.law_s * aim_s + belief.law_q * aim_q - s
        step_q = belief.q + belief.sq * aim_s + belief.qq * aim_q - q
        # Sinkage is nearly exponential in s and q: what a straight line misses over this step.
        change = abs(line.by_s * step_s) + abs(line.by_q * step_q)
        bend = 0.5 * change * change / max(abs(line.sinkage), 1e-6)
        if bend < _TOLERANCE * math.sqrt(line.noise):
            break
        if change > 0.7 * last:
            share *= 0.5  # it swings around the solution
        last = change
        part = share * min(1.0, _LONGEST_STEP / max(abs(step_s), abs(step_q)))
        s, q = s + part * step_s, q + part * step_q
        observed = reading.observe(s, exponent_of(q))
        kept = exponent_ratio(observed, q) if ratio is None else ratio
        line = line_at(observed, s, q, belief, reading, kept)
    return line
