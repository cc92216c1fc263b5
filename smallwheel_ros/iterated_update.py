"""Where to linearise one measurement of sinkage: at the most likely soil, not at the predicted one.

Sinkage goes as exp(-s/(n + 1/2)): under a wide prior a Kalman update linearised at the prediction
overshoots and then believes itself. Gauss-Newton steps find the most likely (s, n) given prediction
and measurement first (the iterated extended Kalman filter; Bell and Cathey 1993). One scalar
measurement moves the soil in two directions only, so this is done in plain floats.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from smallwheel_ros.sinkage_observation import Observation, Observed

_ITERATIONS = 20
_HALVINGS = 6
_TOLERANCE = 0.05  # of the noise's standard deviation, for what linearising may be off
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
    """Mean and covariance of (s, q): s as in `sinkage_observation`, q the logit of n."""

    s: float
    q: float
    ss: float
    sq: float
    qq: float

    def spread(self, by_s: float, by_q: float) -> float:
        """Variance of a linear function of s and q."""
        return by_s * by_s * self.ss + 2.0 * by_s * by_q * self.sq + by_q * by_q * self.qq


class Linearised(NamedTuple):
    """The measurement as a straight line: expected + by_s (s - mean) + by_q (q - mean) + noise.

    chi_square is the least of (soil off the belief)^2 + (measurement off the soil)^2, each over its
    variance: innovation squared over its variance where sinkage is a straight line.
    """

    expected: float
    by_s: float
    by_q: float
    noise: float  # variance
    chi_square: float


def linearise_at_prediction(
    observed: Observed, belief: Belief, measured: float, noise: float, load_noise: float
) -> Linearised:
    """Linearise where the belief is. noise: m^2; load_noise: variance of ln load."""
    by_s, by_q = observed.by_pressure, observed.by_exponent * exponent_slope(exponent_of(belief.q))
    # Load and pressure enter as their ratio, so the slope by ln load is minus the one by s.
    noise = noise + by_s * by_s * load_noise
    spread = belief.spread(by_s, by_q) + noise
    chi_square = (measured - observed.sinkage) ** 2 / spread
    return Linearised(observed.sinkage, by_s, by_q, noise, chi_square)


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

    observed, line: `observe` at the belief's mean, and `linearise_at_prediction` from it.
    Raises ArithmeticError or ValueError where sinkage cannot be computed.
    """
    s, q = belief.s, belief.q
    dual_s = dual_q = 0.0  # offset from the mean = covariance times (dual_s, dual_q)
    cost = (measured - observed.sinkage) ** 2 / line.noise
    for _ in range(_ITERATIONS):
        gain = (measured - line.expected) / (belief.spread(line.by_s, line.by_q) + line.noise)
        aim_s, aim_q = gain * line.by_s, gain * line.by_q
        to_s = belief.s + belief.ss * aim_s + belief.sq * aim_q
        to_q = belief.q + belief.sq * aim_s + belief.qq * aim_q
        # Sinkage is nearly exponential in s and q: what a straight line misses over this step.
        change = abs(line.by_s * (to_s - s)) + abs(line.by_q * (to_q - q))
        bend = 0.5 * change * change / max(abs(observed.sinkage), 1e-6)
        if bend < _TOLERANCE * math.sqrt(line.noise):
            break
        share = 1.0
        for _ in range(_HALVINGS):
            new_dual_s = dual_s + share * (aim_s - dual_s)
            new_dual_q = dual_q + share * (aim_q - dual_q)
            offset_s = belief.ss * new_dual_s + belief.sq * new_dual_q
            offset_q = belief.sq * new_dual_s + belief.qq * new_dual_q
            s, q = belief.s + offset_s, belief.q + offset_q
            exponent = exponent_of(q)
            observed = observe(s, exponent)
            by_s = observed.by_pressure
            by_q = observed.by_exponent * exponent_slope(exponent)
            total = noise + by_s * by_s * load_noise
            new_cost = (measured - observed.sinkage) ** 2 / total
            new_cost += new_dual_s * offset_s + new_dual_q * offset_q
            if new_cost < cost:
                break
            share *= 0.5
        dual_s, dual_q, cost = new_dual_s, new_dual_q, new_cost
        expected = observed.sinkage - by_s * offset_s - by_q * offset_q
        spread = belief.spread(by_s, by_q) + total
        line = Linearised(expected, by_s, by_q, total, (measured - expected) ** 2 / spread)
    return line
