"""From a measurement to what the filter reads, and from what it made of that to an answer."""

from __future__ import annotations

import math
from collections.abc import Sequence

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.drawbar_observation import force_observation
from smallwheel_ros.estimator.load_level import Level
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.estimator.sinkage_observation import (
    Reading,
    observation,
    resistance_observation,
)
from smallwheel_ros.estimator.soil_state import Taken
from smallwheel_ros.estimator.strength import Pull

_LEAST_VARIANCE = (1e-5) ** 2  # m^2: no sinkage is measured better; keeps the covariance sound


def sinkage_reading(
    effects: Sequence[Effect],
    given: SinkageMeasurement,
    load: tuple[float, float],
    sinkage_std: float,
) -> Reading:
    """Read the sinkage. load: N without its noise, and the variance of its logarithm.

    sinkage_std: m, where the measurement does not know its variance. Raises as `Observation`.
    """
    noise = given.variance
    if not (math.isfinite(noise) and noise > 0):
        noise = sinkage_std**2
    carried, load_noise = load
    observe = observation(
        effects,
        carried,
        given.diameter,
        given.width,
        given.contact,
        given.slip,
        given.speed,
    )
    return Reading(observe, given.sinkage, max(noise, _LEAST_VARIANCE), load_noise)


def resistance_reading(
    effects: Sequence[Effect], given: SinkageMeasurement, load: tuple[float, float]
) -> Reading:
    """Read the resistance, which is there and has no problem (see below)."""
    carried, load_noise = load
    observe = resistance_observation(
        effects, carried, given.diameter, given.width, given.slip, given.speed
    )
    measured = math.nan if given.resistance is None else given.resistance
    return Reading(observe, measured, given.resistance_variance, load_noise, "resistance")


def resistance_problem(given: SinkageMeasurement) -> tuple[str, str] | None:
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


def pull_reading(
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


def pull_problem(given: SinkageMeasurement) -> tuple[str, str] | None:
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


def result_of(
    wheel: str,
    reason: str,
    reading: Reading,
    taken: Taken,
    resistance: UpdateResult | None = None,
    drawbar_pull: UpdateResult | None = None,
) -> UpdateResult:
    """Answer for a reading that was used, or did not fit."""
    fits = reason in ("accepted", "soil_changed")
    return UpdateResult(
        Outcome.ACCEPTED if fits else Outcome.OUTLIER,
        reason,
        "" if fits else _misfit(wheel, reason, reading, taken),
        taken.expected,
        taken.variance - reading.noise,
        reading.measured - taken.expected,
        taken.variance,
        taken.chi_square,
        resistance,
        drawbar_pull,
    )


def _misfit(wheel: str, reason: str, reading: Reading, taken: Taken) -> str:
    scale, unit = (1e3, "mm") if reading.channel == "sinkage" else (1.0, "N")
    what = reading.channel.replace("_", " ")
    words = (
        f"wheel '{wheel}': {what} {scale * reading.measured:.2f} {unit} measured, "
        f"{scale * taken.expected:.2f} {unit} expected, standard deviation of the difference "
        f"{scale * math.sqrt(taken.variance):.2f} {unit}"
    )
    if reason == "out_of_range":
        words += "; the soil that this would mean is outside of the model's range"
    return words


def no_sinkage(given: SinkageMeasurement, error: Exception) -> str:
    """Say that the model has no number for a measurement."""
    return (
        f"wheel '{given.wheel}': the model has no sinkage for load {given.load:g} N, diameter "
        f"{given.diameter:g} m, width {given.width:g} m ({error}); check their units"
    )
