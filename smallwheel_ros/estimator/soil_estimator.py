"""Online estimate of the soil from measured sinkage: ROS-free, one for node and replay.

estimator = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
result = estimator.update(SinkageMeasurement(time=0.1, wheel="front_left", sinkage=0.011, ...))
estimate = estimator.estimate()

State: ln of the sinkage of a reference wheel, n, m (see `coordinates`), and for each wheel the
deviation of ln k at the spot where it stands. The spot's deviation is what repeated
measurements at one place have in common: they sharpen the spot, not the soil, and no measurement
has to be skipped. It fades over `scatter_length` of travel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scipy.special import chdtri

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import (
    Counts,
    Identifiable,
    SoilEstimate,
    soil_estimate,
)
from smallwheel_ros.estimator.missing_effect import (
    EffectScore,
    MissingEffect,
    MissingEffectWatch,
)
from smallwheel_ros.estimator.saved_state import SavedState, read_state, write_state
from smallwheel_ros.estimator.settings import EstimatorError, EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.sinkage_measurement import (
    Outcome,
    SinkageMeasurement,
    SinkagePrediction,
    UpdateResult,
    find_problem,
)
from smallwheel_ros.estimator.sinkage_observation import (
    Reading,
    observation,
    resistance_observation,
)
from smallwheel_ros.estimator.soil_state import Taken
from smallwheel_ros.estimator.soils import Soils, WheelTrack
from smallwheel_ros.physics.conditions import ROLLING

__all__ = [
    "EffectScore",
    "EstimatorError",
    "EstimatorSettings",
    "Identifiable",
    "MissingEffect",
    "Outcome",
    "SinkageMeasurement",
    "SinkagePrediction",
    "SoilEstimate",
    "SoilEstimator",
    "SoilPrior",
    "UpdateResult",
]

_COVARIATES = ("load", "diameter", "width", "slip", "speed")
_MOST_WHEELS = 64
_STANDS = 0.02  # m: a wheel that has moved less stands in the rut that it made
_LEAST_VARIANCE = (1e-5) ** 2  # m^2: no sinkage is measured better; keeps the covariance sound


class SoilEstimator:
    """Refines the soil from measured sinkage, for any number of wheels on one soil.

    effects: act on every prediction, with the parameters that they have. Raises EstimatorError for
    an effect whose covariate a SinkageMeasurement does not carry.
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings | None = None,
        effects: Sequence[Effect] = (),
    ) -> None:
        self.prior = prior
        self.settings = settings or EstimatorSettings()
        self.effects = tuple(effects)
        needs = {name: effect for effect in self.effects for name in effect.needs}
        for name, effect in needs.items():
            if name not in _COVARIATES:
                raise EstimatorError(
                    f"effect '{effect.id}' needs '{name}', which the estimator is not given. There "
                    f"is: {', '.join(_COVARIATES)}"
                )
        self._needs = tuple(name for name in ("slip", "speed") if name in needs)
        self._gate = float(chdtri(1, 1.0 - self.settings.gate_probability))
        self._watch = MissingEffectWatch(self.effects, self.settings.scatter_length)
        self.reset()

    def reset(self) -> None:
        """Forget every measurement and count: the prior again."""
        self._soils = Soils(self.prior, self.settings, self._gate)
        self._wheels: dict[str, WheelTrack] = {}
        self._watch.reset()
        self._distance = 0.0
        self.accepted = self.outliers = self.resistance_outliers = 0
        self.refused: dict[str, int] = {}

    @property
    def soil_changes(self) -> int:
        """How often a run of surprises was taken for another soil."""
        return self._soils.changes

    @property
    def missing_effect(self) -> MissingEffect | None:
        """The alarm that the model misses an effect, None while there is none."""
        return self._watch.alarm

    @property
    def effect_scores(self) -> tuple[EffectScore, ...]:
        """The newest test for each effect that the model has not, the best first."""
        return self._watch.scores

    def update(self, measurement: SinkageMeasurement) -> UpdateResult:
        """Use one measurement; never raises for what is in it (see `UpdateResult.reason`)."""
        if measurement.slip is None:
            measurement = self._in_its_rut(measurement)
        problem = find_problem(measurement, self._needs) or self._out_of_order(measurement)
        if problem is None:
            try:
                return self._use(measurement)
            except (ArithmeticError, ValueError) as error:
                problem = "numerical", _no_sinkage(measurement, error)
        reason, message = problem
        self.refused[reason] = self.refused.get(reason, 0) + 1
        return UpdateResult(Outcome.REFUSED, reason, message)

    def _in_its_rut(self, given: SinkageMeasurement) -> SinkageMeasurement:
        """A wheel that stands is as deep as it dug itself when it last rolled: so is its slip."""
        wheel = self._wheels.get(given.wheel)
        if wheel is None or wheel.slip is None or given.distance - wheel.slip_at > _STANDS:
            return given
        return replace(given, slip=wheel.slip)

    def _out_of_order(self, given: SinkageMeasurement) -> tuple[str, str] | None:
        wheel = self._wheels.get(given.wheel)
        if wheel is None:
            if len(self._wheels) < _MOST_WHEELS:
                return None
            return "too_many_wheels", (
                f"wheel '{given.wheel}': there are {_MOST_WHEELS} other wheels already"
            )
        if given.time <= wheel.time:
            return "time_backwards", (
                f"wheel '{given.wheel}': time {given.time:.6f} s is not after the last one, "
                f"{wheel.time:.6f} s"
            )
        if given.distance < wheel.distance:
            return "distance_backwards", (
                f"wheel '{given.wheel}': distance {given.distance:g} m is less than the last one, "
                f"{wheel.distance:g} m"
            )
        return None

    def _use(self, given: SinkageMeasurement) -> UpdateResult:
        known = self._wheels.get(given.wheel)
        before = None if known is None else (known.time, known.distance)
        wheel = self._arrive(given)
        try:
            reading = self._reading(given, wheel)
            taken, reason = self._soils.take(reading, wheel, self._wheels.values(), self._distance)
        except (ArithmeticError, ValueError):
            # What could not be used does not stand in the way of an earlier one that can.
            if before is not None:
                wheel.time, wheel.distance = before
            else:
                wheel.time = wheel.distance = -math.inf
            raise
        if given.contact == ROLLING:
            self._look_for_missing_effects(given, wheel, reading)
        resistance = None
        if reason in ("accepted", "soil_changed"):
            outcome, message = Outcome.ACCEPTED, ""
            self.accepted += 1
            if given.resistance is not None and given.contact == ROLLING:
                resistance = self._use_resistance(given, wheel, given.resistance, reading)
            wheel.soil.variety = wheel.soil.variety.with_wheel(
                given.diameter, wheel.carried / given.width
            )
        else:
            outcome = Outcome.OUTLIER
            self.outliers += 1
            message = _misfit(given.wheel, reading, taken, reason)
        return _result(outcome, reason, message, reading, taken, resistance)

    def _use_resistance(
        self, given: SinkageMeasurement, wheel: WheelTrack, measured: float, sinkage: Reading
    ) -> UpdateResult:
        """Update by the resistance of a wheel whose sinkage fits.

        One that does not fit is left out, and is no sign of another soil: the wheel's sinkage fits,
        so it is the resistance that the model has not got right.
        """
        name = f"wheel '{given.wheel}'"
        problem = None
        if not math.isfinite(measured):
            problem = "resistance_not_finite", f"{name}: resistance is {measured}"
        elif not 0.0 < given.resistance_variance < math.inf:
            problem = (
                "resistance_variance_not_positive",
                (
                    f"{name}: resistance_variance is {given.resistance_variance:g} N^2, expected over 0"
                ),
            )
        if problem is None:
            observe = resistance_observation(
                self.effects, wheel.carried, given.diameter, given.width, given.slip, given.speed
            )
            noise, load_noise = given.resistance_variance, sinkage.load_noise
            reading = Reading(observe, measured, noise, load_noise, "resistance")
            try:
                taken = wheel.soil.state.take(reading, wheel.spot, self._gate)
            except (ArithmeticError, ValueError) as error:
                problem = "resistance_numerical", f"{name}: the model has no resistance ({error})"
            else:
                fits = taken.reason == "accepted"
                self.resistance_outliers += not fits
                outcome = Outcome.ACCEPTED if fits else Outcome.OUTLIER
                words = "" if fits else _misfit(given.wheel, reading, taken, taken.reason)
                return _result(outcome, taken.reason, words, reading, taken)
        reason, message = problem
        self.refused[reason] = self.refused.get(reason, 0) + 1
        return UpdateResult(Outcome.REFUSED, reason, message)

    def _reading(self, given: SinkageMeasurement, wheel: WheelTrack) -> Reading:
        noise = given.variance
        if not (math.isfinite(noise) and noise > 0):
            noise = self.settings.sinkage_std**2
        wheel.carried, load_noise = wheel.load.follow(
            given.load, given.load_variance / given.load**2
        )
        observe = observation(
            self.effects,
            wheel.carried,
            given.diameter,
            given.width,
            given.contact,
            given.slip,
            given.speed,
        )
        return Reading(observe, given.sinkage, max(noise, _LEAST_VARIANCE), load_noise)

    def _look_for_missing_effects(
        self, given: SinkageMeasurement, wheel: WheelTrack, reading: Reading
    ) -> None:
        settings = wheel.carried, given.diameter, given.width
        due = self._watch.add(
            given.wheel,
            given.distance,
            given.sinkage,
            reading.noise,
            settings,
            given.slip,
            given.speed,
        )
        if due:
            now = self.estimate()
            law = replace(self.prior.soil, k=now.k, n=now.n, m=now.m)
            self._watch.test(law, given.distance)

    def _arrive(self, given: SinkageMeasurement) -> WheelTrack:
        """Bring filter and wheel to where the measurement was made."""
        if not self._wheels:
            self._distance = given.distance
            self._soils.start(given.distance)
        self._distance = max(self._distance, given.distance)
        wheel = self._wheels.get(given.wheel)
        if wheel is None:
            spot = self._soils.add_spot()
            wheel = WheelTrack(spot, given.time, given.distance, self._soils.current)
            self._wheels[given.wheel] = wheel
        wheel.time, wheel.distance = given.time, given.distance
        if given.slip is not None and wheel.slip != given.slip:
            wheel.slip, wheel.slip_at = given.slip, given.distance
        return wheel

    def estimate(self) -> SoilEstimate:
        """Return the soil as it is believed now."""
        return soil_estimate(
            *self._soils.current.state.law,
            (self.settings.reference_sinkage, self.settings.reference_diameter),
            self._soils.current.variety,
            Counts(
                self.accepted, self.outliers, dict(self.refused), self.soil_changes, self._distance
            ),
            self._watch.alarm,
        )

    def save(self, path: str | Path) -> None:
        """Save the newest soil, whole or not at all. Raises EstimatorError where it cannot be."""
        current = self._soils.current
        now = self.estimate()
        summary = (
            f"ln pressure {now.log_reference_pressure:.4f}, n {now.n:.4f}, m {now.m:.4f} after "
            f"{self.accepted} measurements"
        )
        state = SavedState(current.state.record(), current.variety, self.accepted)
        write_state(Path(path), state, self.prior, self.effects, summary)

    def restore(self, path: str | Path) -> None:
        """Begin anew from a saved soil instead of the prior.

        Raises EstimatorError, and changes nothing, for a file that is missing, not whole, or saved
        under another prior or other effects.
        """
        state = read_state(Path(path), self.prior, self.effects)
        self.reset()
        if state.soil is not None:
            self._soils.resume(state.soil, state.variety)
            self.accepted = state.accepted

    def predict(
        self,
        load: float,
        diameter: float,
        width: float,
        *,
        slip: float | None = None,
        speed: float | None = None,
        contact: str = ROLLING,
        load_variance: float = 0.0,
        wheel: str | None = None,
    ) -> SinkagePrediction:
        """Predict the sinkage of a wheel; at the spot of `wheel` where that one has been measured.

        Raises EstimatorError for a load, diameter or width that is not a number over 0, a slip or
        speed that an effect needs and that is not given, and where the model has no sinkage.
        """
        given = SinkageMeasurement(
            0.0,
            wheel or "",
            0.0,
            0.0,
            load,
            load_variance,
            diameter,
            width,
            0.0,
            slip,
            speed,
            contact,
        )
        problem = find_problem(given, self._needs)
        if problem is not None:
            raise EstimatorError(problem[1])
        known = self._wheels.get(wheel) if wheel is not None else None
        try:
            observe = observation(self.effects, load, diameter, width, contact, slip, speed)
            spot = None if known is None else known.spot
            soil = self._soils.current if known is None else known.soil
            point, variance = soil.state.predict(observe, load_variance / load**2, spot)
            prediction = SinkagePrediction(
                point.value, math.sqrt(max(variance, 0.0)), point.sunk_to_axle
            )
        except (ArithmeticError, ValueError) as error:
            raise EstimatorError(_no_sinkage(given, error)) from None
        return prediction


def _misfit(wheel: str, reading: Reading, taken: Taken, reason: str) -> str:
    scale, unit = (1e3, "mm") if reading.channel == "sinkage" else (1.0, "N")
    words = (
        f"wheel '{wheel}': {reading.channel} {scale * reading.measured:.2f} {unit} measured, "
        f"{scale * taken.expected:.2f} {unit} expected, standard deviation of the difference "
        f"{scale * math.sqrt(taken.variance):.2f} {unit}"
    )
    if reason == "out_of_range":
        words += "; the soil that this would mean is outside of the model's range"
    return words


def _result(
    outcome: Outcome,
    reason: str,
    message: str,
    reading: Reading,
    taken: Taken,
    resistance: UpdateResult | None = None,
) -> UpdateResult:
    return UpdateResult(
        outcome,
        reason,
        message,
        taken.expected,
        taken.variance - reading.noise,
        reading.measured - taken.expected,
        taken.variance,
        taken.chi_square,
        resistance,
    )


def _no_sinkage(given: SinkageMeasurement, error: Exception) -> str:
    return (
        f"wheel '{given.wheel}': the model has no sinkage for load {given.load:g} N, diameter "
        f"{given.diameter:g} m, width {given.width:g} m ({error}); check their units"
    )
