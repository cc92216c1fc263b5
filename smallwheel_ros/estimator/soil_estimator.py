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
from smallwheel_ros.estimator.identifiability import Identifiable, SoilEstimate
from smallwheel_ros.estimator.measured_forces import MeasuredForces
from smallwheel_ros.estimator.missing_effect import (
    EffectScore,
    MissingEffect,
    MissingEffectWatch,
)
from smallwheel_ros.estimator.outcomes import (
    no_sinkage,
    result_of,
    sinkage_reading,
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
from smallwheel_ros.estimator.sinkage_observation import Reading, observation
from smallwheel_ros.estimator.soils import Soils, WheelTrack
from smallwheel_ros.estimator.strength import StrengthState
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
        self._forces = MeasuredForces(prior, self.settings, self.effects, self._gate)
        self.reset()

    def reset(self) -> None:
        """Forget every measurement and count: the prior again."""
        self._soils = Soils(self.prior, self.settings, self._gate)
        self._wheels: dict[str, WheelTrack] = {}
        self._watch.reset()
        self._distance = 0.0
        self._forces.reset()
        self.accepted = self.outliers = 0
        self.refused: dict[str, int] = {}

    @property
    def soil_changes(self) -> int:
        """How often a run of surprises was taken for another soil."""
        return self._soils.changes

    @property
    def resistance_outliers(self) -> int:
        """Measured resistances that did not fit."""
        return self._forces.resistance_outliers

    @property
    def drawbar_pull_outliers(self) -> int:
        """Measured drawbar pulls that did not fit."""
        return self._forces.drawbar_pull_outliers

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
        given, wheel = measurement, self._wheels.get(measurement.wheel)
        rolls = measurement.slip is not None
        if not rolls and wheel is not None:
            given = _in_its_rut(measurement, wheel)
        problem = find_problem(given, self._needs) or self._out_of_order(given, wheel)
        if problem is not None:
            return self._refuse(*problem)
        if wheel is None:
            wheel = self._arrive(given)
        if given.distance > self._distance:
            self._distance = given.distance
        try:
            result = self._use(given, wheel, rolls)
        except (ArithmeticError, ValueError) as error:
            return self._refuse("numerical", no_sinkage(given, error))
        if rolls:
            wheel.slip, wheel.slip_at = measurement.slip, given.distance
        return result

    def _out_of_order(
        self, given: SinkageMeasurement, wheel: WheelTrack | None
    ) -> tuple[str, str] | None:
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

    def _use(self, given: SinkageMeasurement, wheel: WheelTrack, rolls: bool) -> UpdateResult:
        wheel.load = wheel.level.follow(given.load, given.load_variance / (given.load * given.load))
        reading = sinkage_reading(self.effects, given, wheel.load, self.settings.sinkage_std)
        taken, reason = self._soils.take(reading, wheel, self._wheels.values(), self._distance)
        # Only now: what could not be used does not stand in the way of an earlier one that can.
        wheel.time, wheel.distance = given.time, given.distance
        if given.contact == ROLLING:
            self._look_for_missing_effects(given, wheel, reading)
        resistance = pull = None
        if reason in ("accepted", "soil_changed"):
            self.accepted += 1
            if given.resistance is not None and given.contact == ROLLING:
                resistance = self._counted(self._forces.use_resistance(given, wheel))
            if given.drawbar_pull is not None and given.contact == ROLLING:
                # The slip of a wheel's rut says nothing of what it pulls with while it stands.
                pulling = given if rolls else replace(given, slip=None)
                pull = self._counted(self._forces.use_pull(pulling, wheel))
            wheel.soil.variety = wheel.soil.variety.with_wheel(
                given.diameter, wheel.load[0] / given.width
            )
        else:
            self.outliers += 1
        return result_of(given.wheel, reason, reading, taken, resistance, pull)

    def _refuse(self, reason: str, message: str) -> UpdateResult:
        return self._counted(UpdateResult(Outcome.REFUSED, reason, message))

    def _counted(self, result: UpdateResult) -> UpdateResult:
        if result.outcome is Outcome.REFUSED:
            self.refused[result.reason] = self.refused.get(result.reason, 0) + 1
        return result

    def _look_for_missing_effects(
        self, given: SinkageMeasurement, wheel: WheelTrack, reading: Reading
    ) -> None:
        if self._watch.add(given, wheel.load[0], reading.noise):
            now = self._soils.current.state.law
            self._watch.test(self.prior.soil, (now.k, now.n, now.m), given.distance)

    def _arrive(self, given: SinkageMeasurement) -> WheelTrack:
        """Give a wheel that was never measured its place; the first one says where way begins."""
        if not self._wheels:
            self._distance = given.distance
            self._soils.start(given.distance)
        wheel = WheelTrack(self._soils.add_spot(), self._soils.current)
        self._wheels[given.wheel] = wheel
        return wheel

    def elsewhere(self, wheel: str) -> tuple[str, ...]:
        """Name the wheels that are on another soil than this one: just before or after a border."""
        known = self._wheels.get(wheel)
        if known is None:
            return ()
        return tuple(n for n, other in self._wheels.items() if other.soil is not known.soil)

    def on_newest_soil(self, wheel: str) -> bool:
        """Whether a wheel is on the soil that a wheel came to last, or was never measured."""
        known = self._wheels.get(wheel)
        return known is None or known.soil is self._soils.current

    def estimate(self, wheel: str | None = None) -> SoilEstimate:
        """Return the soil as it is believed now: the one that a wheel came to last.

        wheel: return the soil that this wheel is on, where it has been measured.
        """
        known = self._wheels.get(wheel) if wheel is not None else None
        soil = self._soils.current if known is None else known.soil
        strength, law = soil.strength, soil.state.law
        return SoilEstimate(
            *law,
            self.settings.reference_sinkage,
            self.settings.reference_diameter,
            soil.variety,
            self.accepted,
            self.outliers,
            dict(self.refused),
            self.soil_changes,
            self._distance,
            self._watch.alarm,
            None if strength is None else strength.estimate(law.n),
        )

    def save(self, path: str | Path) -> None:
        """Save the newest soil, whole or not at all. Raises EstimatorError where it cannot be."""
        current = self._soils.current
        now = self.estimate()
        summary = (
            f"ln pressure {now.log_reference_pressure:.4f}, n {now.n:.4f}, m {now.m:.4f} after "
            f"{self.accepted} measurements"
        )
        strength = None if current.strength is None else current.strength.record()
        state = SavedState(current.state.record(), current.variety, self.accepted, strength)
        write_state(Path(path), state, self.prior, self.effects, summary)

    def restore(self, path: str | Path) -> None:
        """Begin anew from a saved soil instead of the prior.

        Raises EstimatorError, and changes nothing, for a file that is missing, not whole, or saved
        under another prior or other effects.
        """
        state = read_state(Path(path), self.prior, self.effects)
        strength = None
        if state.strength is not None:
            strength = StrengthState.restored(path, state.strength, self.prior, self.settings)
        self.reset()
        if state.soil is not None:
            self._soils.resume(state.soil, state.variety)
            self._soils.current.strength = strength
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
            raise EstimatorError(no_sinkage(given, error)) from None
        return prediction


def _in_its_rut(given: SinkageMeasurement, wheel: WheelTrack) -> SinkageMeasurement:
    """A wheel that stands is as deep as it dug itself when it last rolled: so is its slip."""
    if wheel.slip is None or given.distance - wheel.slip_at > _STANDS:
        return given
    return replace(given, slip=wheel.slip)
