"""The soil as the state of a filter: ln pressure, n (bounded), m, and a spot for each wheel."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.bounded_exponent import coordinate_of, exponent_of, exponent_slope
from smallwheel_ros.estimator_settings import EstimatorSettings, SoilPrior
from smallwheel_ros.iterated_update import (
    Belief,
    Linearised,
    exponent_ratio,
    line_at,
    linearise,
)
from smallwheel_ros.opening import Opening, Record
from smallwheel_ros.sinkage_observation import Reading
from smallwheel_ros.soil_filter import SoilFilter

Array = NDArray[np.float64]

Reason = Literal["accepted", "gate", "out_of_range"]

_PRESSURE, _EXPONENT, _M = 0, 1, 2  # places in the state
_LAW = 3  # as many components are the soil's law
# Beyond these the model means nothing.
_PRESSURE_LIMIT, _M_LIMIT = 40.0, 3.0
_EXPONENT_LIMITS = (-0.12, 3.12)  # n from 0.004 to 2.996
_TELLS_NOTHING = 1e-4  # variance of the prediction over the measurement's
_PASSES = 8
_SETTLED = 0.02  # of ln pressure, n and m from pass to pass


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
        self._mean = (prior.log_reference_pressure, coordinate_of(prior.n), prior.m)
        deviations = (
            prior.log_reference_pressure_std,
            prior.n_std / exponent_slope(coordinate_of(prior.n)),
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
        self._opening = Opening(self._settings.scatter_length)

    def reopen(self, factor: float) -> None:
        """Go back to the prior, its covariance widened by a factor; wheels keep their places."""
        self._filter.reopen(factor)
        self._opening = Opening(self._settings.scatter_length)

    def add_spot(self) -> int:
        """Give a wheel a spot of its own."""
        return self._filter.add(self._settings.soil_scatter**2, self._settings.scatter_length)

    def travel(self, distance: float) -> None:
        """Let soil and spots drift over a distance (m)."""
        self._filter.travel(distance)
        self._opening.travel(distance)

    @property
    def law(self) -> tuple[Array, Array, Array]:
        """Mean (3,), covariance (3, 3) and prior covariance of ln pressure, q of n, and m."""
        return (
            np.add(self._mean, self._filter.deviation[:_LAW]),
            self._filter.covariance[:_LAW, :_LAW],
            self._filter.stationary[:_LAW, :_LAW],
        )

    def belief(self, diameter_log: float, spot: int | None) -> Belief:
        """Mean and covariance of (s, q) for a wheel at its spot, or at a fresh one."""
        x, p = self._filter.deviation.tolist(), self._filter.covariance.tolist()
        (ll, lq, lm), (qq, qm), mm = p[_PRESSURE][:_LAW], p[_EXPONENT][_EXPONENT:_LAW], p[_M][_M]
        s = self._mean[_PRESSURE] + x[_PRESSURE] + diameter_log * (self._mean[_M] + x[_M])
        q = self._mean[_EXPONENT] + x[_EXPONENT]
        law_s = ll + diameter_log * (2.0 * lm + diameter_log * mm)
        law_q = lq + diameter_log * qm
        if spot is None:
            ss = law_s + self._settings.soil_scatter**2
            return Belief(s, q, ss, law_q, qq, s, law_s, law_q)
        of_spot = p[spot]
        law_spot = of_spot[_PRESSURE] + diameter_log * of_spot[_M]
        ss = law_s + 2.0 * law_spot + of_spot[spot]
        sq = law_q + of_spot[_EXPONENT]
        return Belief(s + x[spot], q, ss, sq, qq, s, law_s + law_spot, law_q)

    def take(self, reading: Reading, spot: int, gate: float) -> Taken:
        """Update by a reading at a spot if it fits (chi-square within the gate).

        Raises ArithmeticError or ValueError, with nothing changed, where the numbers cannot be
        computed with.
        """
        opening = self._opening
        belief = self.belief(reading.observe.diameter_log, spot)
        observed = reading.observe(belief.law, exponent_of(belief.q))
        reading, factor = reading.at_steady_load(observed)
        held = None if opening.anchor is None else self._ratio(reading, opening.anchor)
        ratio = exponent_ratio(observed, belief.q) if held is None else held
        first = line_at(observed, belief.law, belief.q, belief, reading, ratio)
        line = linearise(first, belief, reading, held)
        expected = first.expected * factor
        variance = belief.spread(first.by_s, first.by_q) + first.noise
        if not math.isfinite(expected + variance + line.chi_square):
            raise ArithmeticError("its uncertainty has no bounds")
        reason: Reason = "gate"
        if line.chi_square <= gate:
            reason = self._correct(line, belief, reading, spot)
        if reason == "accepted" and opening.going_on:
            due = opening.add(reading, observed.sinkage, belief.law, belief.q, spot)
            if opening.anchor is None:
                opening.hold(self._filter.deviation[:_LAW])
            elif due or line is not first:
                self._run_again(opening)
            opening.judge(math.sqrt(float(self._filter.covariance[_EXPONENT, _EXPONENT])))
        return Taken(reason, expected, variance, line.chi_square)

    def _place(self, soil: Array, diameter_log: float) -> tuple[float, float]:
        """(s, q) of a soil, given as deviation (3,), under a wheel."""
        pressure, exponent, m = np.add(self._mean, soil).tolist()
        return pressure + diameter_log * m, exponent

    def _ratio(self, reading: Reading, soil: Array) -> float:
        s, q = self._place(soil, reading.observe.diameter_log)
        return exponent_ratio(reading.observe(s, exponent_of(q)), q)

    def _correct(self, line: Linearised, belief: Belief, reading: Reading, spot: int) -> Reason:
        if belief.spread(line.by_s, line.by_q) < _TELLS_NOTHING * line.noise:
            return "accepted"  # the ten thousandth look at one spot: nothing left to learn there
        row = [0.0] * len(self._filter.deviation)
        row[_PRESSURE] = row[spot] = line.by_s
        row[_EXPONENT], row[_M] = line.by_q, line.by_s * reading.observe.diameter_log
        before = self._filter.state
        if not self._filter.update(reading.measured, line.expected, row, line.noise):
            raise ArithmeticError("the update would leave the covariance unsound")
        pressure, exponent, m = self._filter.deviation[:_LAW].tolist()
        if (
            abs(self._mean[_PRESSURE] + pressure) > _PRESSURE_LIMIT
            or not _EXPONENT_LIMITS[0] < self._mean[_EXPONENT] + exponent < _EXPONENT_LIMITS[1]
            or abs(self._mean[_M] + m) > _M_LIMIT
        ):
            self._filter.state = before
            return "out_of_range"
        return "accepted"

    def _run_again(self, opening: Opening) -> None:
        """Run over the opening's records, linearised at one soil, until they lead back to it."""
        before = self._filter.state
        if not self._settle(opening):
            self._filter.state = before
        if opening.full:
            after = self._filter.state
            half = opening.records[: len(opening.records) // 2]
            self._filter.rewind()
            if self._pass(half, after[0][:_LAW], opening.hold(after[0][:_LAW])):
                self._filter.mark()
                opening.drop(len(half))
            else:
                opening.end()
            self._filter.state = after

    def _settle(self, opening: Opening) -> bool:
        anchor, soil = opening.anchor, self._filter.deviation[:_LAW]
        for number in range(_PASSES):
            self._filter.rewind()
            if not self._pass(opening.records, soil, opening.hold(soil)):
                break
            change = self._filter.deviation[:_LAW] - soil
            if float(np.abs(change).max()) < _SETTLED:
                return True
            soil = soil + (change if number < 2 else 0.6 * change)
        opening.anchor = anchor
        return False

    def _pass(self, records: list[Record], soil: Array, anchor: Array) -> bool:
        """Filter the records, linearised at one soil (3,); False where that cannot be done."""
        for record in records:
            if record.travelled > 0.0:
                self._filter.travel(record.travelled)
            reading = record.reading
            belief = self.belief(reading.observe.diameter_log, record.spot)
            s, q = self._place(soil, reading.observe.diameter_log)
            try:
                ratio = self._ratio(reading, anchor)
                line = line_at(reading.observe(s, exponent_of(q)), s, q, belief, reading, ratio)
                if self._correct(line, belief, reading, record.spot) != "accepted":
                    return False
            except (ArithmeticError, ValueError):
                return False
        return True
