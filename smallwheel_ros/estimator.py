"""Online estimate of the soil from measured sinkage: ROS-free, one for node and replay.

estimator = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")))
result = estimator.update(SinkageMeasurement(time=0.1, wheel="front_left", sinkage=0.011, ...))
estimate = estimator.estimate()
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from smallwheel_ros.conditions import ROLLING
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.identifiability import SoilEstimate
from smallwheel_ros.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil


class EstimatorError(SmallwheelError):
    """A prior or a setting outside its domain."""


@dataclass(frozen=True)
class SoilPrior:
    """What is known of the soil before any measurement.

    log_reference_pressure is at `soil.REFERENCE_SINKAGE` and `soil.REFERENCE_DIAMETER`. `soil` lends
    the name and the strength (cohesion, friction angle, shear displacement), which are not estimated.
    """

    soil: Soil
    log_reference_pressure: float
    n: float
    m: float
    log_reference_pressure_std: float
    n_std: float
    m_std: float

    @classmethod
    def from_soil(
        cls,
        soil: Soil,
        log_reference_pressure_std: float = 0.7,
        n_std: float | None = None,
        m_std: float = 0.4,
    ) -> SoilPrior:
        """Take a soil of that kind, not that very soil."""
        raise NotImplementedError


@dataclass(frozen=True)
class EstimatorSettings:
    """How the estimator judges measurements and forgets.

    Attributes
    ----------
    reference_sinkage, reference_diameter
        m; where `SoilEstimate` reports the pressure (and the modulus by default).
    process_noise
        Growth of the standard deviation of ln pressure per square root of a metre travelled, 1/sqrt(m);
        n and m drift in proportion to their prior deviations. None while standing.
    soil_scatter
        Standard deviation of ln k from spot to spot of one soil.
    scatter_length
        Travel (m) over which the soil under one wheel becomes another spot.
    sinkage_std
        m; used where a measurement's variance is not known.
    gate_probability
        Share of good measurements that the outlier gate lets pass.
    surprises_to_reopen
        This many outliers at different spots, none fitting between them, are another soil.
    """

    reference_sinkage: float = REFERENCE_SINKAGE
    reference_diameter: float = REFERENCE_DIAMETER
    process_noise: float = 0.02
    soil_scatter: float = 0.06
    scatter_length: float = 0.2
    sinkage_std: float = 0.001
    gate_probability: float = 0.999
    surprises_to_reopen: int = 3


@dataclass(frozen=True)
class SinkageMeasurement:
    """Measured sinkage of one wheel at one instant, with the load that it carried; SI units.

    time: s, rising from measurement to measurement of one wheel. distance: m that the vehicle has
    travelled so far. variance: m^2; 0 or less, or not finite: not known. load_variance: N^2, 0: exact.
    slip, speed: only needed by effects that read them. contact: 'rolling' or 'pressed'.
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


class Outcome(Enum):
    """What became of a measurement."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    REFUSED = "refused"


@dataclass(frozen=True)
class UpdateResult:
    """What the estimator did with one measurement.

    Attributes
    ----------
    outcome
        ACCEPTED: the estimate was updated. OUTLIER: it did not fit. REFUSED: it could not be used.
    reason
        Short key to count by: 'accepted', 'soil_changed' (accepted after reopening), 'gate',
        'not_finite', 'load_not_positive', 'geometry_not_positive', 'sinkage_negative', 'sunk_to_axle',
        'unknown_contact', 'covariate_missing', 'time_backwards', 'distance_backwards',
        'too_many_wheels', 'numerical'.
    message
        The same for people, with the numbers.
    predicted_sinkage, predicted_variance
        m, m^2; before the measurement, at this wheel's spot; without the measurement's own noise.
    innovation, innovation_variance
        m, m^2; measured less predicted, and its variance with the measurement's noise.
    normalised_innovation_squared
        Chi-square of one degree of freedom where the model is right. All five are None where refused.
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


class SoilEstimator:
    """Refines the soil from measured sinkage, for any number of wheels on one soil."""

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings | None = None,
        effects: Sequence[Effect] = (),
    ) -> None:
        self.prior = prior
        self.settings = settings or EstimatorSettings()
        self.effects = tuple(effects)

    def update(self, measurement: SinkageMeasurement) -> UpdateResult:
        """Use one measurement; never raises for what is in it."""
        raise NotImplementedError

    def estimate(self) -> SoilEstimate:
        """Return the soil as it is believed now."""
        raise NotImplementedError

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

        Raises EstimatorError for a load, diameter or width that is not positive, ConditionsError or
        ModelError where the model lacks something.
        """
        raise NotImplementedError

    def reset(self) -> None:
        """Forget every measurement and count: the prior again."""
        raise NotImplementedError
