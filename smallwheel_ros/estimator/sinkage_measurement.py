"""What goes into the soil estimator one by one, what comes out, and what is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from smallwheel_ros.physics.conditions import PRESSED, ROLLING

NUMBERS = ("time", "sinkage", "load", "load_variance", "diameter", "width", "distance")


@dataclass(frozen=True)
class SinkageMeasurement:
    """Measured sinkage of one wheel at one instant, with the load that it carried; SI units.

    Attributes
    ----------
    time
        s, rising from measurement to measurement of one wheel.
    wheel
        Name of the wheel.
    sinkage, variance
        m, positive down; m^2, 0 or less or not finite: not known.
    load, load_variance
        N; N^2, 0 is exact.
    diameter, width
        m.
    distance
        m that the vehicle has travelled so far, never falling.
    slip, speed
        1, m/s; needed only by effects that read them.
    contact
        'rolling' or 'pressed'.
    resistance, resistance_variance
        N, N^2; resistance to motion measured at the same time, where it is (a free-rolling wheel
        pulled through a force sensor, say). Not used for a pressed wheel.
    drawbar_pull, drawbar_pull_variance
        N, N^2; what the wheel pulls the vehicle with, measured at the same time, where it is. Needs
        slip. Not used for a pressed wheel.
    slip_variance
        1; 0 is exact. Used with drawbar pull.
    """

    time: float
    wheel: str
    sinkage: float
    variance: float
    load: float
    load_variance: float
    diameter: float
    width: float
    distance: float
    slip: float | None = None
    speed: float | None = None
    contact: str = ROLLING
    resistance: float | None = None
    resistance_variance: float = 0.0
    drawbar_pull: float | None = None
    drawbar_pull_variance: float = 0.0
    slip_variance: float = 0.0


class Outcome(Enum):
    """What became of a measurement."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    REFUSED = "refused"


class UpdateResult(NamedTuple):
    """What the estimator did with one measurement.

    Attributes
    ----------
    outcome
        ACCEPTED: the estimate was updated. OUTLIER: it did not fit. REFUSED: it could not be used.
    reason
        Short key to count by. Accepted: 'accepted', 'soil_changed' (after a run of surprises).
        Outlier: 'gate', 'out_of_range'. Refused: 'not_finite', 'load_not_positive',
        'geometry_not_positive', 'load_variance_negative', 'sinkage_negative', 'sunk_to_axle',
        'unknown_contact', 'covariate_missing', 'time_backwards', 'distance_backwards',
        'too_many_wheels', 'numerical'.
    message
        The same for people, with the numbers; empty where accepted.
    predicted_sinkage, predicted_variance
        m, m^2; before the measurement, at this wheel's spot, with the uncertainty of soil, spot and
        load, without the sinkage measurement's own.
    innovation, innovation_variance
        m, m^2; measured less predicted, and its variance with the measurement's noise.
    normalised_innovation_squared
        Chi-square of one degree of freedom where the model is right: innovation squared over its
        variance where sinkage is a straight line over the soil's uncertainty; under a wide prior,
        taken at the most likely soil instead (see `iterated_update`).

    resistance
        The same for the resistance in the measurement, in N and N^2; None without one. Refused:
        'resistance_not_finite', 'resistance_variance_not_positive', 'resistance_numerical'.

    drawbar_pull
        The same for the drawbar pull. Refused: 'drawbar_pull_not_finite',
        'drawbar_pull_variance_not_positive', 'drawbar_pull_without_slip',
        'drawbar_pull_slip_variance', 'drawbar_pull_numerical'.

    The numbers are None where the measurement was refused.
    """

    outcome: Outcome
    reason: str
    message: str
    predicted_sinkage: float | None = None
    predicted_variance: float | None = None
    innovation: float | None = None
    innovation_variance: float | None = None
    normalised_innovation_squared: float | None = None
    resistance: UpdateResult | None = None
    drawbar_pull: UpdateResult | None = None


@dataclass(frozen=True)
class SinkagePrediction:
    """Sinkage (m) that the estimated soil gives a wheel, with its standard deviation.

    Where `sunk_to_axle`, the number is a continuation and not a prediction.
    """

    sinkage: float
    standard_deviation: float
    sunk_to_axle: bool


def find_problem(given: SinkageMeasurement, needs: tuple[str, ...]) -> tuple[str, str] | None:
    """Reason and message if a measurement cannot be used whatever came before it.

    needs: covariates ('slip', 'speed') that the model's effects read.
    """
    if (
        0.0 <= given.sinkage <= 0.5 * given.diameter < math.inf
        and 0.0 < given.load < math.inf
        and 0.0 < given.width < math.inf
        and 0.0 <= given.load_variance < math.inf
        and given.diameter > 0.0
        and abs(given.time) + abs(given.distance) < math.inf
        and given.contact in (ROLLING, PRESSED)
        and not needs
    ):
        return None  # what nearly every measurement is, told cheaply
    name = f"wheel '{given.wheel}'"
    for covariate in needs:
        if getattr(given, covariate) is None:
            return "covariate_missing", f"{name}: an effect needs {covariate}, none was given"
    for field in (*NUMBERS, *needs):
        value = getattr(given, field)
        if not math.isfinite(value):
            return "not_finite", f"{name}: {field} is {value}, expected a finite number"
    if given.load <= 0:
        return "load_not_positive", f"{name}: load is {given.load:g} N, expected over 0"
    if given.diameter <= 0 or given.width <= 0:
        return "geometry_not_positive", (
            f"{name}: diameter {given.diameter:g} m and width {given.width:g} m, expected over 0"
        )
    if given.load_variance < 0:
        return "load_variance_negative", (
            f"{name}: load_variance is {given.load_variance:g} N^2, expected 0 or more"
        )
    if given.sinkage < 0:
        return "sinkage_negative", (
            f"{name}: sinkage is {given.sinkage:g} m, expected 0 or more: a wheel in the air, or "
            f"the instrument's zero is wrong"
        )
    if given.sinkage > 0.5 * given.diameter:
        return "sunk_to_axle", (
            f"{name}: sinkage is {given.sinkage:g} m, over half of the diameter "
            f"{given.diameter:g} m: sunk to the axle, or the wrong unit"
        )
    if given.contact not in (ROLLING, PRESSED):
        return "unknown_contact", (
            f"{name}: contact is '{given.contact}', expected '{ROLLING}' or '{PRESSED}'"
        )
    return None
