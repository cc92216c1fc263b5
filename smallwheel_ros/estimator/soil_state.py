"""The soil as the state of a filter: ln z_ref, q of n, m (see `coordinates`), a spot per wheel."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.bounded_exponent import (
    coordinate_of,
    exponent_slope,
)
from smallwheel_ros.estimator.coordinates import Direct, OfReference
from smallwheel_ros.estimator.iterated_update import Belief, Four, Line, Point, line_at, linearise
from smallwheel_ros.estimator.law_covariance import LawCovariance, Row
from smallwheel_ros.estimator.law_estimate import LawEstimate, law_estimate
from smallwheel_ros.estimator.opening import Opening
from smallwheel_ros.estimator.saved_state import SoilRecord
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.sinkage_observation import Observation, Reading
from smallwheel_ros.estimator.soil_filter import SoilFilter

Array = NDArray[np.float64]

Reason = Literal["accepted", "gate", "out_of_range"]

_FIRST, _EXPONENT, _M = 0, 1, 2  # places in the state
_LAW = 3  # as many components are the soil's law
# Beyond these the model means nothing.
_FIRST_LIMITS, _M_LIMIT = (-16.0, 3.0), 3.0  # sinkage of the reference wheel: 0.1 um to 20 m
_EXPONENT_LIMITS = (-0.12, 3.12)  # n from 0.004 to 2.996
_TELLS_NOTHING = 1e-4  # variance of the prediction over the measurement's
_PASSES = 8
_SETTLED = 0.02  # of ln z_ref, n and m from pass to pass


class Taken(NamedTuple):
    """What became of a measurement: expected (m) and variance (m^2) before it, with its noise."""

    reason: Reason
    expected: float
    variance: float
    noise: float
    chi_square: float


class SoilState:
    """What is believed of the soil and of the spots that the wheels stand on."""

    def __init__(self, prior: SoilPrior, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._prior_mean = np.array([prior.log_reference_pressure, coordinate_of(prior.n), prior.m])
        deviations = (
            prior.log_reference_pressure_std,
            prior.n_std / exponent_slope(coordinate_of(prior.n)),
            prior.m_std,
        )
        self._prior = np.diag(np.square(deviations))
        self._prior_law = LawCovariance.of(self._prior)
        self._reference = settings.reference_sinkage, settings.reference_diameter
        noise = settings.process_noise
        # Over a short travel s the drift is a random walk with variance 2 std^2 s / length.
        length = 2.0 * (deviations[0] / noise) ** 2 if noise > 0 else math.inf
        self._filter = SoilFilter(self._prior, length)
        self._law: LawEstimate | None = None
        self._law_of: Array | None = None  # the covariance that it was made from
        self.reset()

    def reset(self) -> None:
        """Go back to the prior, without spots."""
        self._filter.forget(self._prior)
        self.reopen(1.0)

    def reopen(self, factor: float) -> None:
        """Go back to the prior, its covariance widened by a factor; wheels keep their places."""
        self._widened = factor
        self._filter.renew(factor * self._prior)
        self._mean = self._prior_mean
        self._coordinates: Direct | OfReference = Direct()
        self._opening = Opening(self._settings.scatter_length)

    def add_spot(self) -> int:
        """Give a wheel a spot of its own."""
        return self._filter.add(self._settings.soil_scatter**2, self._settings.scatter_length)

    def travel(self, distance: float) -> None:
        """Let soil and spots drift over a distance (m)."""
        self._filter.travel(distance)
        self._opening.travelled += distance

    @property
    def law(self) -> LawEstimate:
        """What is believed of the law, at the settings' reference."""
        # Each change of the state brings a new covariance.
        covariance = self._filter.state[1]
        if self._law is None or covariance is not self._law_of:
            self._law, self._law_of = self._law_now(), covariance
        return self._law

    def _law_now(self) -> LawEstimate:
        deviation, covariance, _ = self._filter.state
        soil: Row = tuple((self._mean + deviation[:_LAW]).tolist())
        law = LawCovariance.of(covariance[:_LAW, :_LAW])
        if not isinstance(self._coordinates, Direct):
            # With n open the soils that fit lie on a slightly bent line: second order, for a
            # Gaussian n.
            bent = 0.5 * (self._coordinates.bend(soil) * law.nn) ** 2
            soil, row = self._coordinates.to_direct(soil)
            law = law.seen_as(row, 1.0).with_more(bent)
        return law_estimate(soil, law, self._prior_law, self._reference)

    def record(self) -> SoilRecord | None:
        """What to save; None before the first measurement."""
        if isinstance(self._coordinates, Direct):
            return None
        return SoilRecord(
            self._coordinates.wheel,
            self._mean.copy(),
            self._filter.deviation[:_LAW].copy(),
            self._filter.covariance[:_LAW, :_LAW].copy(),
            self._filter.stationary[:_LAW, :_LAW].copy(),
        )

    def resume(self, record: SoilRecord) -> None:
        """Go on from what was saved; wheels stand on spots that nobody knows."""
        self._coordinates = OfReference(*record.reference)
        self._mean = record.mean
        self._filter.resume(record.covariance, record.deviation, record.prior)
        self._opening.end()

    def belief(self, spot: int | None) -> Belief:
        """What a measurement at a spot depends on; None: at one that no wheel has been at."""
        deviation, covariance, _ = self._filter.state
        x, p = deviation.tolist(), covariance.tolist()
        if spot is None:
            spot = len(x)
            x.append(0.0)
            for row in p:
                row.append(0.0)
            p.append([0.0] * spot + [self._settings.soil_scatter**2])
        first, q, m = self._mean.tolist()
        mean = first + x[0], q + x[1], m + x[2], x[spot]
        return Belief(mean, (p[0], p[1], p[2], p[spot]), spot)

    def predict(
        self, observe: Observation, load_noise: float, spot: int | None
    ) -> tuple[Point, float]:
        """Sinkage (m) of a wheel, and its variance (m^2)."""
        belief = self.belief(spot)
        reading = Reading(observe, 0.0, 0.0, load_noise)
        point = self._coordinates.point(reading, belief.mean, belief)
        line = line_at(point, belief.mean, belief, 0.0)
        return point, line.spread + line.noise

    def relative_spread(self, reading: Reading, spot: int) -> float:
        """Standard deviation of what is expected of a reading, over it."""
        belief = self.belief(spot)
        point = self._coordinates.point(reading, belief.mean, belief)
        spread = line_at(point, belief.mean, belief, reading.measured).spread
        return math.sqrt(spread) / max(abs(point.value), 1e-9)

    def take(self, reading: Reading, spot: int, gate: float) -> Taken:
        """Update by a measurement at a spot if it fits (chi-square within the gate).

        Raises ArithmeticError or ValueError, with nothing changed, where the numbers cannot be
        computed with.
        """
        point, first, line, x = self._linearise(reading, self.belief(spot))
        variance = first.spread + first.noise
        if not math.isfinite(point.value + variance + line.chi_square):
            raise ArithmeticError("its uncertainty has no bounds")
        reason: Reason = "gate"
        if line.chi_square <= gate:
            if isinstance(self._coordinates, Direct):
                reason = self._begin(reading, spot, np.array(x[:_LAW]))
            else:
                reason = self._correct(line, reading, spot)
        if reason == "accepted" and self._opening.going_on:
            self._keep(reading, spot, point.value)
        return Taken(reason, point.value, variance, first.noise, line.chi_square)

    def _linearise(self, reading: Reading, belief: Belief) -> tuple[Point, Line, Line, Four]:
        see, mean = self._coordinates.point, belief.mean
        point = see(reading, mean, belief)
        first = line_at(point, mean, belief, reading.measured)
        line, x = linearise(
            lambda x: see(reading, x, belief), point, first, belief, reading.measured
        )
        return point, first, line, x

    def _begin(self, reading: Reading, spot: int, soil: Array) -> Reason:
        """Go over to the sinkage of the reading's wheel, near a soil (ln pressure, q, m); use it."""
        before = self._mean, self._filter.state, self._coordinates
        reason: Reason = "gate"
        try:
            self._coordinates = OfReference(*reading.observe.wheel)
            self._linearise_prior(self._coordinates, soil)
            line = self._linearise(reading, self.belief(spot))[2]
            reason = self._correct(line, reading, spot)
        finally:
            if reason != "accepted":
                self._mean, self._filter.state, self._coordinates = before
        return reason

    def _linearise_prior(self, coordinates: OfReference, soil: Array) -> None:
        there, jacobian = coordinates.from_direct(soil)
        mean = there + jacobian @ (self._prior_mean - soil)
        low, high = _FIRST_LIMITS
        if not low < float(mean[_FIRST]) < high:  # drift would lead back to there
            raise ArithmeticError("the soil that this would mean is outside of the model's range")
        self._mean = mean
        self._filter.renew(self._widened * jacobian @ self._prior @ jacobian.T)

    def _correct(self, line: Line, reading: Reading, spot: int) -> Reason:
        if line.spread < _TELLS_NOTHING * line.noise:
            return "accepted"  # the ten thousandth look at one spot: nothing left to learn there
        before = self._filter.state
        row = [0.0] * len(before[0])
        row[_FIRST], row[_EXPONENT], row[_M], row[spot] = line.row
        if not self._filter.update(reading.measured - line.expected, row, line.noise):
            raise ArithmeticError("the update would leave the covariance unsound")
        first, q, m = (self._mean + self._filter.deviation[:_LAW]).tolist()
        (low, high), (least, most) = _FIRST_LIMITS, _EXPONENT_LIMITS
        if not (low < first < high and least < q < most and -_M_LIMIT < m < _M_LIMIT):
            self._filter.state = before
            return "out_of_range"
        return "accepted"

    def _keep(self, reading: Reading, spot: int, here: float) -> None:
        opening = self._opening
        last = opening.at(spot, reading.channel)
        there = None
        if last is not None:
            belief = self.belief(spot)
            there = self._coordinates.point(last.reading, belief.mean, belief).value
            here = self._coordinates.point(reading, belief.mean, belief).value
        if opening.add(reading, spot, here, there):
            self._run_again()
        variance = float(self._filter.covariance[_EXPONENT, _EXPONENT])
        slope = exponent_slope(float(self._mean[_EXPONENT] + self._filter.deviation[_EXPONENT]))
        opening.judge(math.sqrt(variance) * slope)

    def _run_again(self) -> None:
        """Run over the opening's records, linearised at the newest soil, until that settles."""
        coordinates = self._coordinates
        if isinstance(coordinates, Direct):
            return
        before = self._mean, self._filter.state
        try:
            soil = self._mean + self._filter.deviation[:_LAW]
            for number in range(_PASSES):
                if not self._pass(coordinates, soil):
                    break
                change = self._mean + self._filter.deviation[:_LAW] - soil
                if float(np.abs(change).max()) < _SETTLED:
                    return
                soil = soil + (change if number < 2 else 0.6 * change)
        except (ArithmeticError, ValueError):
            pass  # no sinkage at a soil on the way: as good as not settled
        self._mean, self._filter.state = before

    def _pass(self, coordinates: OfReference, soil: Array) -> bool:
        """Filter the records, linearised at one soil (3,); False where it leads out of range."""
        first, q, m = soil.tolist()
        self._linearise_prior(coordinates, np.array(coordinates.to_direct((first, q, m))[0]))
        travelled = 0.0
        for record in self._opening.records:
            if record.travelled > travelled:
                self._filter.travel(record.travelled - travelled)
                travelled = record.travelled
            x = first, q, m, float(self._filter.deviation[record.spot])
            belief = self.belief(record.spot)
            point = coordinates.point(record.reading, x, belief)
            line = line_at(point, x, belief, record.reading.measured)
            if self._correct(line, record.reading, record.spot) != "accepted":
                return False
        if self._opening.travelled > travelled:
            self._filter.travel(self._opening.travelled - travelled)
        return True
