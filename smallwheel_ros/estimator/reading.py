# SPDX-License-Identifier: Apache-2.0
"""One wheel at one instant: what is measured of it, which every step from the sensors to the answer reads.

What the soil estimator does with it, and what it refuses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.settings import EstimatorError
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

SECOND = 1_000_000_000  # ns
_COVARIATES = ("load", "diameter", "width", "slip", "speed")


class Reading(NamedTuple):
    """What is known of one wheel at one instant; None where it is not.

    Each deviation is that of one reading. Those of sinkage and load are learnt by the soil estimator: what is
    told of them counts for little, 0 for nothing.

    Attributes
    ----------
    stamp
        ns, rising from reading to reading of one wheel.
    load, slip, sinkage, drawbar_pull
        N, 1, m, N; sinkage and drawbar pull as measured: noise around the truth, so sinkage is below 0 too on
        firm ground.
    speed, rim_speed
        Of the wheel's place over ground, and of its rim, m/s.
    speed_std, rim_std
        Standard deviations of the two, m/s.
    stands
        Whether the wheel stands, by both of them.
    heading
        rad, the way the vehicle looks in the frame of the odometry.
    pass_number
        1 and how often a wheel has rolled over this place before (see `PassCounter`); None: not known.
    onward
        Which way the vehicle goes as a whole: True forward.
    rim_held
        s, since which the rim has shown exactly this speed.
    speed_repeats
        Whether the messages of the speed over ground are one and the same while the vehicle moves:
        it is not known then.
    distance, path
        That the vehicle and this wheel have travelled so far, m, never falling; for the wheel turning on the
        spot counts.
    place, vehicle
        x and y (m) of the wheel and of the vehicle's middle in the frame of the odometry; the latter
        is known also where nobody knows which way the vehicle looks.
    load_is_static
        Nobody measures it.
    pitch
        rad, positive nose down.
    slope_force, gained_force
        m/s^2, of the vehicle the way it drives: g sin(slope), and dv/dt.
    across_force
        m/s^2, g sin(slope across), positive where the left side is higher.
    torque
        N m, at the wheel.
    forward
        Which way the wheel drives, see `drives_forward`.
    """

    wheel: Wheel
    stamp: int
    load: Quantity | None
    slip: Quantity | None
    sinkage: Quantity | None
    speed: float | None
    distance: float
    path: float
    place: tuple[float, float] | None = None
    load_is_static: bool = False
    vehicle: tuple[float, float] | None = None
    drawbar_pull: Quantity | None = None
    pitch: float = 0.0
    rim_speed: float | None = None
    slope_force: float | None = None
    torque: float | None = None
    forward: bool = True
    gained_force: float | None = None
    speed_std: float = 0.0
    rim_std: float = 0.0
    stands: bool = False
    across_force: float | None = None
    heading: float | None = None
    rim_held: float = 0.0
    speed_repeats: bool = False
    pass_number: int | None = None
    onward: bool = True

    @property
    def time(self) -> float:
        """Its stamp in s."""
        return self.stamp / SECOND

    @property
    def measured(self) -> tuple[float, float]:
        """Load (N) and sinkage (m) of a reading that has both."""
        assert self.load is not None, "`find_problem` says so"
        assert self.sinkage is not None, "`find_problem` says so"
        return self.load.value, self.sinkage.value

    def on_way(self, pass_number: int | None, onward: bool) -> Reading:
        """It with what the places and ways of all wheels tell."""
        return Reading._make((*self[:_OWN], pass_number, onward))


_OWN = Reading._fields.index("pass_number")  # so many fields are of the wheel and its sensors


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
        'sunk_to_axle', 'unknown_contact', 'covariate_missing', 'load_missing', 'sinkage_missing',
        'time_backwards', 'distance_backwards', 'too_many_wheels', 'numerical'.
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


_NUMBERS = (
    *("stamp", "sinkage", "load", "deviation of load", "diameter", "width", "distance", "path"),
    *("pitch", "slip", "speed"),
)


def find_problem(given: Reading, needs: tuple[str, ...]) -> tuple[str, str] | None:
    """Reason and message if load and sinkage of a wheel cannot be used whatever came before.

    needs: covariates ('slip', 'speed') that the model's effects read.
    """
    wheel, load, sinkage, slip = given.wheel, given.load, given.sinkage, given.slip
    name = f"wheel '{wheel.name}'"
    if load is None or sinkage is None:
        missing = "load" if load is None else "sinkage"
        return f"{missing}_missing", f"{name}: {missing} is not known"
    for covariate in needs:
        if getattr(given, covariate) is None:
            return "covariate_missing", f"{name}: an effect needs {covariate}, none was given"
    of_effects = (
        slip.value if "slip" in needs and slip is not None else 0.0,
        given.speed if "speed" in needs and given.speed is not None else 0.0,
    )
    numbers = (
        *(given.stamp, sinkage.value, load.value, load.standard_deviation),
        *(wheel.diameter, wheel.width, given.distance, given.path, given.pitch),
        *of_effects,
    )
    if not math.isfinite(sum(numbers)):
        for quantity, value in zip(_NUMBERS, numbers, strict=True):
            if not math.isfinite(value):
                return "not_finite", f"{name}: {quantity} is {value}, expected a finite number"
    if load.value <= 0:
        return "load_not_positive", f"{name}: load is {load.value:g} N, expected over 0"
    if wheel.diameter <= 0 or wheel.width <= 0:
        return "geometry_not_positive", (
            f"{name}: diameter {wheel.diameter:g} m and width {wheel.width:g} m, expected over 0"
        )
    if load.standard_deviation < 0:
        return "load_variance_negative", (
            f"{name}: the deviation of the load is {load.standard_deviation:g} N, expected 0 or more"
        )
    if abs(sinkage.value) > 0.5 * wheel.diameter:
        words = f"{name}: sinkage is {sinkage.value:g} m"
        if sinkage.value < 0.0:
            return "sinkage_negative", (
                f"{words}, below minus half of the diameter {wheel.diameter:g} m: the wrong sign, or the"
                " wrong unit"
            )
        return "sunk_to_axle", (
            f"{words}, over half of the diameter {wheel.diameter:g} m: sunk to the axle, or the wrong unit"
        )
    if wheel.contact not in (ROLLING, PRESSED):
        return "unknown_contact", (
            f"{name}: contact is '{wheel.contact}', expected '{ROLLING}' or '{PRESSED}'"
        )
    return None
