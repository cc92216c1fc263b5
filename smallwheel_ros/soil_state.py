"""The soil as the state of a filter: ln pressure, logit of n/3, m, and a spot for each wheel."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator_settings import EstimatorSettings, SoilPrior
from smallwheel_ros.iterated_update import Belief, Linearised, exponent_slope, logit_of
from smallwheel_ros.soil_filter import SoilFilter

Array = NDArray[np.float64]

Corrected = Literal["accepted", "gate", "out_of_range"]

_PRESSURE, _LOGIT, _M = 0, 1, 2  # places in the state
_LAW = 3  # as many components are the soil's law
# Beyond these the model means nothing.
_PRESSURE_LIMIT, _LOGIT_LIMIT, _M_LIMIT = 40.0, 6.0, 3.0
_TELLS_NOTHING = 1e-4  # variance of the prediction over the measurement's


class SoilState:
    """What is believed of the soil and of the spots that the wheels stand on."""

    def __init__(self, prior: SoilPrior, settings: EstimatorSettings) -> None:
        self._mean = (prior.log_reference_pressure, logit_of(prior.n), prior.m)
        self._spot = settings.soil_scatter**2, settings.scatter_length
        deviations = (
            prior.log_reference_pressure_std,
            prior.n_std / exponent_slope(prior.n),
            prior.m_std,
        )
        noise = settings.process_noise
        # Over a short travel s the drift is a random walk with variance 2 std^2 s / length.
        length = 2.0 * (deviations[0] / noise) ** 2 if noise > 0 else math.inf
        self._filter = SoilFilter(np.diag(np.square(deviations)), length)
        self.reset = self._filter.reset
        self.reopen = self._filter.reopen
        self.travel = self._filter.travel

    def add_spot(self) -> int:
        """Give a wheel a spot of its own."""
        return self._filter.add(*self._spot)

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
        ss = ll + diameter_log * (2.0 * lm + diameter_log * mm)
        sq = lq + diameter_log * qm
        if spot is None:
            ss += self._spot[0]
        else:
            of_spot = p[spot]
            s += x[spot]
            ss += 2.0 * (of_spot[_PRESSURE] + diameter_log * of_spot[_M]) + of_spot[spot]
            sq += of_spot[_LOGIT]
        return Belief(s, self._mean[_LOGIT] + x[_LOGIT], ss, sq, qq)

    def correct(
        self,
        line: Linearised,
        belief: Belief,
        measured: float,
        diameter_log: float,
        spot: int,
        gate: float,
    ) -> Corrected:
        """Update by a measurement at a spot if it fits, and say what was done.

        Raises ArithmeticError, with nothing changed, where rounding would spoil the covariance.
        """
        if line.chi_square > gate:
            return "gate"
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
