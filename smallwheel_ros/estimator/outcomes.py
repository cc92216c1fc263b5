"""From a measurement to what the filter reads, and from what it made of that to an answer."""

from __future__ import annotations

import math
from collections.abc import Sequence

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.estimator.sinkage_observation import (
    Reading,
    observation,
)
from smallwheel_ros.estimator.soil_state import Taken

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
