"""The soil as the state of a filter: ln pressure, logit of n/3, m, and a spot for each wheel."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.iterated_update import (
    Belief,
    Linearised,
    exponent_of,
    exponent_slope,
    line_at,
    linearise,
    logit_of,
)
from smallwheel_ros.estimator.opening import Opening
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.sinkage_observation import Observation
from smallwheel_ros.estimator.soil_filter import SoilFilter

Array = NDArray[np.float64]

Reason = Literal["accepted", "gate", "out_of_range"]

_PRESSURE, _LOGIT, _M = 0, 1, 2  # places in the state
_LAW = 3  # as many components are the soil's law
# Beyond these the model means nothing.
_PRESSURE_LIMIT, _LOGIT_LIMIT, _M_LIMIT = 40.0, 6.0, 3.0
_TELLS_NOTHING = 1e-4  # variance of the prediction over the measurement's
_PASSES = 8
_SETTLED = 0.02  # of ln pressure, logit and m from pass to pass


class Taken(NamedTuple):
    """What became of a measurement: expected (m) and variance (m^2) before it, with its noise."""

    reason: Reason
    expected: float
    variance: float
    chi_square: float


class SoilState:
    """What is believed of the soil and of the spots that the wheels stand on."""

    def __init__(self, prior: SoilPrior, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._mean = (prior.log_reference_pressure, logit_of(prior.n), prior.m)
        deviations = (
            prior.log_reference_pressure_std,
            prior.n_std / exponent_slope(prior.n),
            prior.m_std,
        )
        noise = settings.process_noise
        # Over a short travel s the drift is a random walk with variance 2 std^2 s / length.
        length = 2.0 * (deviations[0] / noise) ** 2 if noise > 0 else math.inf
        self._filter = SoilFilter(np.diag(np.square(deviations)), length)
        self.reset()

    def reset(self) -> None:
        """Go back to the prior, without spots."""
        self._filter.reset()
        self._widened = 1.0
        self._opening = Opening(self._settings.scatter_length)

    def reopen(self, factor: float) -> None:
        """Go back to the prior, its covariance widened by a factor; wheels keep their places."""
        self._filter.reopen(factor)
        self._widened = factor
        self._opening = Opening(self._settings.scatter_length)

    def add_spot(self) -> int:
        """Give a wheel a spot of its own."""
        return self._filter.add(self._settings.soil_scatter**2, self._settings.scatter_length)

    def travel(self, distance: float) -> None:
        """Let soil and spots drift over a distance (m)."""
        self._filter.travel(distance)
        self._opening.travelled += distance

    @property
    def law(self) -> tuple[Array, Array, Array]:
        """Mean (3,), covariance (3, 3) and prior covariance of ln pressure, logit of n/3, and m."""
        return (
            np.add(self._mean, self._filter.deviation[:_LAW]),
            self._filter.covariance[:_LAW, :_LAW],
            self._filter.stationary[:_LAW, :_LAW],
        )

    def belief(self, diameter_log: float, spot: int | None) -> Belief:
        """Mean and covariance of (s, q) for a wheel at its spot, or at a fresh one."""
        x, p = self._filter.deviation.tolist(), self._filter.covariance.tolist()
        (ll, lq, lm), (qq, qm), mm = p[_PRESSURE][:_LAW], p[_LOGIT][_LOGIT:_LAW], p[_M][_M]
        s = self._mean[_PRESSURE] + x[_PRESSURE] + diameter_log * (self._mean[_M] + x[_M])
        q = self._mean[_LOGIT] + x[_LOGIT]
        law_s = ll + diameter_log * (2.0 * lm + diameter_log * mm)
        law_q = lq + diameter_log * qm
        if spot is None:
            ss = law_s + self._settings.soil_scatter**2
            return Belief(s, q, ss, law_q, qq, law_s, law_q)
        of_spot = p[spot]
        law_spot = of_spot[_PRESSURE] + diameter_log * of_spot[_M]
        ss = law_s + 2.0 * law_spot + of_spot[spot]
        return Belief(s + x[spot], q, ss, law_q + of_spot[_LOGIT], qq, law_s + law_spot, law_q)

    def take(
        self,
        observe: Observation,
        measured: float,
        noise: float,
        load_noise: float,
        spot: int,
        gate: float,
    ) -> Taken:
        """Update by a measurement at a spot if it fits (chi-square within the gate).

        measured: m. noise: m^2. load_noise: variance of ln load. Raises ArithmeticError or
        ValueError, with nothing changed, where the numbers cannot be computed with.
        """
        belief = self.belief(observe.diameter_log, spot)
        observed = observe(belief.s, exponent_of(belief.q))
        first = line_at(observed, belief.s, belief.q, belief, measured, noise, load_noise)
        line = linearise(observe, observed, first, belief, measured, noise, load_noise)
        variance = belief.spread(first.by_s, first.by_q) + first.noise
        if not math.isfinite(observed.sinkage + variance + line.chi_square):
            raise ArithmeticError("its uncertainty has no bounds")
        reason: Reason = "gate"
        if line.chi_square <= gate:
            reason = self._correct(line, belief, measured, observe.diameter_log, spot)
        if reason == "accepted" and self._opening.going_on:
            due = self._opening.add(observe, observed, belief, measured, noise, load_noise, spot)
            if due:
                self._run_again()
            self._opening.judge(math.sqrt(float(self._filter.covariance[_LOGIT, _LOGIT])))
        return Taken(reason, observed.sinkage, variance, line.chi_square)

    def _correct(
        self, line: Linearised, belief: Belief, measured: float, diameter_log: float, spot: int
    ) -> Reason:
        if belief.spread(line.by_s, line.by_q) < _TELLS_NOTHING * line.noise:
            return "accepted"  # the ten thousandth look at one spot: nothing left to learn there
        row = [0.0] * len(self._filter.deviation)
        row[_PRESSURE] = row[spot] = line.by_s
        row[_LOGIT], row[_M] = line.by_q, line.by_s * diameter_log
        before = self._filter.state
        if not self._filter.update(measured, line.expected, row, line.noise):
            raise ArithmeticError("the update would leave the covariance unsound")
        pressure, logit, m = self._filter.deviation[:_LAW].tolist()
        if (
            abs(self._mean[_PRESSURE] + pressure) > _PRESSURE_LIMIT
            or abs(self._mean[_LOGIT] + logit) > _LOGIT_LIMIT
            or abs(self._mean[_M] + m) > _M_LIMIT
        ):
            self._filter.state = before
            return "out_of_range"
        return "accepted"

    def _run_again(self) -> None:
        """Run over the opening's records, linearised at the newest soil, until that settles."""
        before = self._filter.state
        try:
            soil = self._filter.deviation[:_LAW]
            for number in range(_PASSES):
                if not self._pass(soil):
                    break
                change = self._filter.deviation[:_LAW] - soil
                if float(np.abs(change).max()) < _SETTLED:
                    return
                soil = soil + (change if number < 2 else 0.6 * change)
        except (ArithmeticError, ValueError):
            pass  # no sinkage at a soil on the way: as good as not settled
        self._filter.state = before

    def _pass(self, soil: Array) -> bool:
        """Filter the records, linearised at one soil (3,); False where it leads out of range."""
        pressure, logit, m = np.add(self._mean, soil).tolist()
        self._filter.reopen(self._widened)
        travelled = 0.0
        for record in self._opening.records:
            if record.travelled > travelled:
                self._filter.travel(record.travelled - travelled)
                travelled = record.travelled
            diameter_log = record.observe.diameter_log
            belief = self.belief(diameter_log, record.spot)
            s = pressure + diameter_log * m + float(self._filter.deviation[record.spot])
            observed = record.observe(s, exponent_of(logit))
            line = line_at(
                observed, s, logit, belief, record.measured, record.noise, record.load_noise
            )
            if (
                self._correct(line, belief, record.measured, diameter_log, record.spot)
                != "accepted"
            ):
                return False
        if self._opening.travelled > travelled:
            self._filter.travel(self._opening.travelled - travelled)
        return True
