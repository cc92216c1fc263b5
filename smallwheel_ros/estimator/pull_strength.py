"""Drawbar pull that is measured with the sinkage sharpens the soil's strength, not its law."""

from __future__ import annotations

import math
from collections.abc import Sequence

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.drawbar_observation import force_observation
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.estimator.soils import Soils
from smallwheel_ros.estimator.strength import Pull, StrengthState


class PullStrength:
    """Updates the strength of the soil that a wheel came to last by drawbar pulls on it.

    gate: chi-square up to which a pull fits. outliers: how many did not.
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
        self.outliers = 0

    def use(
        self,
        given: SinkageMeasurement,
        load: tuple[float, float],
        soil: SoilEstimate,
        soils: Soils,
    ) -> UpdateResult:
        """Use a pull of a rolling wheel. load: N without its noise, variance of its logarithm."""
        problem = _problem(given)
        if problem is not None:
            return UpdateResult(Outcome.REFUSED, *problem)
        assert given.drawbar_pull is not None
        assert given.slip is not None
        if soils.strength is None:
            soils.strength = StrengthState(self._prior, self._settings)
        try:
            forces = force_observation(
                self._effects, load[0], given.diameter, given.width, given.slip, given.speed
            )
            pull = Pull(
                forces,
                given.drawbar_pull,
                given.drawbar_pull_variance,
                given.slip,
                given.slip_variance,
                load[1],
                given.sinkage,
            )
            taken = soils.strength.take(pull, given.wheel, soil, given.distance, self._gate)
        except (ArithmeticError, ValueError) as error:
            words = f"wheel '{given.wheel}': the model has no drawbar pull ({error})"
            return UpdateResult(Outcome.REFUSED, "drawbar_pull_numerical", words)
        self.outliers += taken.reason != "accepted"
        outcome = Outcome.ACCEPTED if taken.reason == "accepted" else Outcome.OUTLIER
        miss = given.drawbar_pull - taken.expected
        message = ""
        if outcome is Outcome.OUTLIER:
            message = (
                f"wheel '{given.wheel}': drawbar pull {given.drawbar_pull:.1f} N, expected "
                f"{taken.expected:.1f} +- {math.sqrt(taken.variance):.1f} N"
            )
        return UpdateResult(
            outcome,
            taken.reason,
            message,
            taken.expected,
            taken.variance - given.drawbar_pull_variance,
            miss,
            taken.variance,
            taken.chi_square,
        )


def _problem(given: SinkageMeasurement) -> tuple[str, str] | None:
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
