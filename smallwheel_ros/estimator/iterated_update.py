"""Where to linearise one measurement of sinkage: at the most likely soil, not at the predicted one.

Sinkage goes as exp(-s/(n + 1/2)): under a wide prior a Kalman update linearised at the prediction
overshoots and then believes itself. Gauss-Newton steps find the most likely soil given prediction
and measurement first (the iterated extended Kalman filter; Bell and Cathey 1993). One scalar
measurement moves the soil in two directions only, so this is done in plain floats.

The spot and the instrument's noise stay where they were predicted: a slope that follows the noise
of its own measurement has the noise in it, and pulls n down (errors in variables).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from smallwheel_ros.estimator.sinkage_observation import Observation, Observed

_ITERATIONS = 15
_TOLERANCE = 0.05  # of the noise's standard deviation, for what linearising may be off
_LONGEST_STEP = 1.0  # of s and of q
_EXPONENT_LIMIT = 3.0


def exponent_of(logit: float) -> float:
    """Give n = 3 / (1 + exp(-q)): inside (0, 3) whatever q."""
    return _EXPONENT_LIMIT / (1.0 + math.exp(-logit))


def logit_of(exponent: float) -> float:
    """Invert `exponent_of`."""
    return math.log(exponent / (_EXPONENT_LIMIT - exponent))


def exponent_slope(exponent: float) -> float:
    """Give dn/dq at n."""
    return exponent * (1.0 - exponent / _EXPONENT_LIMIT)


class Belief(NamedTuple):
    """Mean and covariance of (s, q): s as in `sinkage_observation`, q the logit of n.

    law_s, law_q: covariance with s and with q of the soil's share of s, without the spot's.
    """

    s: float
    q: float
    ss: float
    sq: float
    qq: float
    law_s: float
    law_q: float

    def spread(self, by_s: float, by_q: float) -> float:
        """Variance of a linear function of s and q."""
        return by_s * by_s * self.ss + 2.0 * by_s * by_q * self.sq + by_q * by_q * self.qq


class Linearised(NamedTuple):
    """The measurement as a straight line: expected + by_s (s - mean) + by_q (q - mean) + noise."""

    expected: float
    by_s: float
    by_q: float
    noise: float  # variance
    chi_square: float  # innovation squared over its variance


def line_at(
    observed: Observed,
    s: float,
    q: float,
    belief: Belief,
    measured: float,
    noise: float,
    load_noise: float,
) -> Linearised:
    """Linearise at (s, q), where `observed` is. noise: m^2; load_noise: variance of ln load."""
    by_s, by_q = observed.by_pressure, observed.by_exponent * exponent_slope(exponent_of(q))
    expected = observed.sinkage + by_s * (belief.s - s) + by_q * (belief.q - q)
    # Load and pressure enter as their ratio, so the slope by ln load is minus the one by s.
    noise += by_s * by_s * load_noise
    chi_square = (measured - expected) ** 2 / (belief.spread(by_s, by_q) + noise)
    return Linearised(expected, by_s, by_q, noise, chi_square)


def linearise(
    observe: Observation,
    observed: Observed,
    line: Linearised,
    belief: Belief,
    measured: float,
    noise: float,
    load_noise: float,
) -> Linearised:
    """Linearise at the most likely soil.

    observed, line: `observe` at the belief's mean, and `line_at` there. Raises ArithmeticError or
    ValueError where sinkage cannot be computed.
    """
    s, q = belief.s, belief.q
    share, last = 1.0, math.inf
    for _ in range(_ITERATIONS):
        gain = (measured - line.expected) / (belief.spread(line.by_s, line.by_q) + line.noise)
        aim_s, aim_q = gain * line.by_s, gain * line.by_q
        step_s = belief.s + belief.law_s * aim_s + belief.law_q * aim_q - s
        step_q = belief.q + belief.sq * aim_s + belief.qq * aim_q - q
        # Sinkage is nearly exponential in s and q: what a straight line misses over this step.
        change = abs(line.by_s * step_s) + abs(line.by_q * step_q)
        bend = 0.5 * change * change / max(abs(observed.sinkage), 1e-6)
        if bend < _TOLERANCE * math.sqrt(line.noise):
            break
        if change > 0.7 * last:
            share *= 0.5  # it swings around the solution
        last = change
        part = share * min(1.0, _LONGEST_STEP / max(abs(step_s), abs(step_q)))
        s, q = s + part * step_s, q + part * step_q
        observed = observe(s, exponent_of(q))
        line = line_at(observed, s, q, belief, measured, noise, load_noise)
    return line
