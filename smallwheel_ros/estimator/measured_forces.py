"""Forces that are measured with the sinkage: resistance sharpens the law, drawbar pull the strength.

A force is only used where the wheel's sinkage fits. One that does not fit is left out, and is no sign
of another soil: the sinkage fits, so it is the force that the model has not got right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.drawbar_observation import force_observation
from smallwheel_ros.estimator.load_level import Level
from smallwheel_ros.estimator.outcomes import result_of
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.estimator.sinkage_observation import Reading, resistance_observation
from smallwheel_ros.estimator.soils import WheelTrack
from smallwheel_ros.estimator.strength import Pull, StrengthState


class MeasuredForces:
    """Updates the soil under a wheel by its resistance and its drawbar pull.

    gate: chi-square up to which one fits. Counts of those that did not: `resistance_outliers`,
    `drawbar_pull_outliers`.
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings,
        effects: Sequence[Effect],
        gate: float,
    ) -> None:
        self._prior, self._settings = prior, settings
        self._effects, self._gate = tuple(effects), gate
        self.reset()

    def reset(self) -> None:
        """Begin to count anew."""
        self.resistance_outliers = self.drawbar_pull_outliers = 0

    def use_resistance(self, given: SinkageMeasurement, wheel: WheelTrack) -> UpdateResult:
        """Update the law by a measured resistance."""
        problem = _resistance_problem(given)
        if problem is not None:
            return UpdateResult(Outcome.REFUSED, *problem)
        try:
            reading = _resistance_reading(self._effects, given, wheel.load)
            taken = wheel.soil.state.take(reading, wheel.spot, self._gate)
        except (ArithmeticError, ValueError) as error:
            words = f"wheel '{given.wheel}': the model has no resistance ({error})"
            return UpdateResult(Outcome.REFUSED, "resistance_numerical", words)
        self.resistance_outliers += taken.reason != "accepted"
        return result_of(given.wheel, taken.reason, reading, taken)

    def use_pull(self, given: SinkageMeasurement, wheel: WheelTrack) -> UpdateResult:
        """Update the soil's strength by a measured drawbar pull."""
        problem = _pull_problem(given)
        if problem is not None:
            return UpdateResult(Outcome.REFUSED, *problem)
        soil = wheel.soil
        if soil.strength is None:
            soil.strength = StrengthState(self._prior, self._settings)
        try:
            pull = _pull_reading(self._effects, given, wheel.load, wheel.slip_level)
            taken, reading = soil.strength.take(
                pull, given.wheel, wheel.spot, soil.state, given.distance, self._gate
            )
        except (ArithmeticError, ValueError) as error:
            words = f"wheel '{given.wheel}': the model has no drawbar pull ({error})"
            return UpdateResult(Outcome.REFUSED, "drawbar_pull_numerical", words)
        self.drawbar_pull_outliers += taken.reason != "accepted"
        return result_of(given.wheel, taken.reason, reading, taken)


def _resistance_reading(
    effects: Sequence[Effect], given: SinkageMeasurement, load: tuple[float, float]
) -> Reading:
    """Read the resistance, which is there and has no problem (see below)."""
    carried, load_noise = load
    observe = resistance_observation(
        effects, carried, given.diameter, given.width, given.slip, given.speed
    )
    measured = math.nan if given.resistance is None else given.resistance
    return Reading(observe, measured, given.resistance_variance, load_noise, "resistance")


def _resistance_problem(given: SinkageMeasurement) -> tuple[str, str] | None:
    """Reason and message if the resistance cannot be used."""
    name = f"wheel '{given.wheel}'"
    if given.resistance is None or not math.isfinite(given.resistance):
        return "resistance_not_finite", f"{name}: resistance is {given.resistance}"
    if not 0.0 < given.resistance_variance < math.inf:
        return (
            "resistance_variance_not_positive",
            f"{name}: resistance_variance is {given.resistance_variance:g} N^2, expected over 0",
        )
    return None


def _pull_reading(
    effects: Sequence[Effect],
    given: SinkageMeasurement,
    load: tuple[float, float],
    slip_level: Level,
) -> Pull:
    """Read the drawbar pull, which is there and has no problem (see below)."""
    carried, load_noise = load
    assert given.drawbar_pull is not None
    assert given.slip is not None
    slip, slip_noise = given.slip, given.slip_variance
    if slip_noise > 0.0:
        slip, slip_noise = slip_level.told_apart(slip, slip_noise)
    forces = force_observation(effects, carried, given.diameter, given.width, slip, given.speed)
    return Pull(
        forces,
        given.drawbar_pull,
        given.drawbar_pull_variance,
        slip,
        slip_noise,
        load_noise,
        given.sinkage,
    )


def _pull_problem(given: SinkageMeasurement) -> tuple[str, str] | None:
    """Reason and message if the drawbar pull cannot be used."""
    name = f"wheel '{given.wheel}'"
    if given.drawbar_pull is None or not math.isfinite(given.drawbar_pull):
        return "drawbar_pull_not_finite", (
            f"{name}: drawbar_pull is {given.drawbar_pull}, expected a finite number"
        )
    if not 0.0 < given.drawbar_pull_variance < math.inf:
        return "drawbar_pull_variance_not_positive", (
            f"{name}: drawbar_pull_variance is {given.drawbar_pull_variance:g} N^2, expected over 0"
        )
    if given.slip is None or not abs(given.slip) <= 1.0:
        return "drawbar_pull_without_slip", (
            f"{name}: slip is {given.slip}, expected -1 to 1: without it a drawbar pull says nothing"
        )
    if not 0.0 <= given.slip_variance < math.inf:
        return "drawbar_pull_slip_variance", (
            f"{name}: slip_variance is {given.slip_variance:g}, expected 0 or more"
        )
    return None
