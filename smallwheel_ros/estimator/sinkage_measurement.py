# SPDX-License-Identifier: Apache-2.0
"""What goes into the soil estimator one by one, what comes out, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import NamedTuple

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.settings import EstimatorError
from smallwheel_ros.physics.conditions import PRESSED, ROLLING

_COVARIATES = ("load", "diameter", "width", "slip", "speed")
NUMBERS = (
    "time",
    "sinkage",
    "load",
    "load_variance",
    "diameter",
    "width",
    "distance",
    "own_path",
    "pitch",
)


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
        m, positive down, noise around the truth and so below 0 too on firm ground; m^2, what the
        sensor says of its noise, 0 or less or not finite: not known. The noise is learnt.
    load, load_variance
        N; N^2, 0 is exact.
    diameter, width
        m.
    distance
        m that the vehicle has travelled so far, never falling.
    path
        m that this wheel has travelled so far, turning on the spot included; None: as the vehicle.
    pitch
        rad, of the vehicle, positive nose down (REP 103).
    slip, speed
        1, m/s; needed only by effects that read them.
    contact
        'rolling' or 'pressed'.
    forward
        Which way the vehicle drives: which wheels come first.
    pass_number
        1 and how often a wheel has rolled over this place before; None: by the places of the wheels.
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
    path: float | None = None
    pitch: float = 0.0
    forward: bool = True
    pass_number: int | None = None

    @cached_property
    def own_path(self) -> float:
        """Path of the wheel (m)."""
        return self.distance if self.path is None else self.path


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
        Short key to count by. Accepted: 'accepted', 'soil_changed' (another soil was found).
        Outlier: 'gate'. Refused: 'not_finite', 'load_not_positive', 'geometry_not_positive',
        'load_variance_negative', 'sinkage_negative' (by more than half of the diameter),
        'sunk_to_axle', 'unknown_contact', 'covariate_missing', 'time_backwards',
        'distance_backwards', 'too_many_wheels', 'numerical'.
    message
        The same for people, with the numbers; empty where accepted.
    predicted_sinkage, predicted_variance
        m, m^2; of the wheel's true sinkage, before the measurement, with the uncertainty of the law,
        of the place and of the load.
    innovation, innovation_variance
        m, m^2; measured less what the sensor was expected to show, and its variance.
    normalised_innovation_squared
        Innovation squared over its variance: chi-square of one degree of freedom where the model is
        right.

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


@dataclass(frozen=True)
class SinkagePrediction:
    """Sinkage (m) that the estimated soil gives a wheel, with its standard deviation.

    Where `sunk_to_axle`, the number is a continuation and not a prediction.
    """

    sinkage: float
    standard_deviation: float
    sunk_to_axle: bool


def covariates_of(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Covariates that effects read. Raises EstimatorError for one that no measurement carries."""
    needs = {name: effect for effect in effects for name in effect.needs}
    for name, effect in needs.items():
        if name not in _COVARIATES:
            raise EstimatorError(
                f"effect '{effect.id}' needs '{name}', which the estimator is not given. There "
                f"is: {', '.join(_COVARIATES)}"
            )
    return tuple(name for name in ("slip", "speed") if name in needs)


def find_problem(given: SinkageMeasurement, needs: tuple[str, ...]) -> tuple[str, str] | None:
    """Reason and message if a measurement cannot be used whatever came before it.

    needs: covariates ('slip', 'speed') that the model's effects read.
    """
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
    if given.sinkage < -0.5 * given.diameter:
        return "sinkage_negative", (
            f"{name}: sinkage is {given.sinkage:g} m, below minus half of the diameter "
            f"{given.diameter:g} m: the wrong sign, or the wrong unit"
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
