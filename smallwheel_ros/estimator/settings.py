# SPDX-License-Identifier: Apache-2.0
"""What the soil estimator is told before the first measurement: the prior and its settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.parameter import Parameter, out_of_range
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil
from smallwheel_ros.physics.wheel import Quantity, Strength

Array = NDArray[np.float64]

_COVARIATES = (
    "load",
    "diameter",
    "width",
    "contact",
    "slip",
    "speed",
)  # of every wheel, or told by streams
REMEMBERED = 4  # soils that were met, to which the vehicle may come back


class EstimatorError(SmallwheelError):
    """A prior or a setting outside its domain."""


def _require(what: str, name: str, value: float, good: bool, expected: str) -> None:
    if not (math.isfinite(value) and good):
        raise EstimatorError(f"{what}: {name} is {value!r}, expected {expected}")


def covariates_of(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Columns beside the load that effects read: a row without them has no sinkage in the model.

    Raises EstimatorError for an effect that reads what no stream tells.
    """
    read = {name: effect.id for effect in effects for name in effect.needs}
    for name, effect in read.items():
        if name not in _COVARIATES:
            raise EstimatorError(
                f"effect '{effect}' needs '{name}', which the robot is not given. There is:"
                f" {', '.join(_COVARIATES)}"
            )
    return tuple(name for name in ("slip", "speed") if name in read)


def usual_strength(soil: Soil) -> Strength:
    """Strength of a soil of this kind, not of this very soil.

    Deviations: cohesion 500 Pa and 30 %, friction angle 0.1 rad, shear displacement 40 %. Dry sands
    and loams in the published tables have 0 to 1.7 kPa and 27 to 34 degrees; Wong 2008 gives 10 to
    25 mm for sand.
    """
    return Strength(
        Quantity(soil.cohesion, math.hypot(500.0, 0.3 * soil.cohesion)),
        Quantity(soil.friction_angle, 0.1),
        Quantity(soil.shear_displacement, 0.4 * soil.shear_displacement),
    )


@dataclass(frozen=True)
class SoilPrior:
    """What is known of the soil before any measurement.

    Attributes
    ----------
    soil
        Lends its name.
    log_reference_pressure, log_reference_pressure_std
        ln of the pressure (Pa) at `soil.REFERENCE_SINKAGE` under `soil.REFERENCE_DIAMETER`.
    n, n_std
        Exponent of sinkage, in (0, 3); 1.
    m, m_std
        Exponent of the wheel's diameter, in -3 .. 3; 1.

    Raises EstimatorError where a number is outside its domain.
    """

    soil: Soil
    log_reference_pressure: float
    n: float
    m: float
    log_reference_pressure_std: float
    n_std: float
    m_std: float

    def __post_init__(self) -> None:
        """Check every number."""
        what = f"prior from soil '{self.soil.name}'"
        pressure = self.log_reference_pressure
        _require(what, "log_reference_pressure", pressure, abs(pressure) < 30, "-30 to 30")
        # Nearer to the ends the exponent's logit leaves what the filter holds for possible.
        _require(what, "n", self.n, 0.03 < self.n < 2.97, "a number from 0.03 to 2.97")
        _require(what, "m", self.m, abs(self.m) < 3, "a number between -3 and 3")
        for name in ("log_reference_pressure_std", "n_std", "m_std"):
            value = getattr(self, name)
            _require(what, name, value, 0 < value <= 3, "a number over 0, 3 at most")

    @cached_property
    def law(self) -> tuple[Array, Array]:
        """Ln pressure (Pa) at the soil's reference, n and m, and their covariance, (3,) and (3, 3)."""
        deviations = [self.log_reference_pressure_std, self.n_std, self.m_std]
        mean = np.array([self.log_reference_pressure, self.n, self.m])
        return mean, np.diag(np.square(deviations))

    def log_modulus(self, diameter: float) -> float:
        """Ln of K = k D^m (Pa/m^n) under a wheel of this diameter (m)."""
        across = math.log(diameter / REFERENCE_DIAMETER)
        return self.log_reference_pressure - self.n * math.log(REFERENCE_SINKAGE) + self.m * across

    @classmethod
    def from_soil(
        cls,
        soil: Soil,
        log_reference_pressure_std: float = 0.7,
        n_std: float | None = None,
        m_std: float = 0.4,
    ) -> SoilPrior:
        """Take the vehicle to be on a soil of this kind, not on this very soil.

        The defaults are the spread within one kind in the published tables: the three dry sands of
        `soil.SOILS` differ by 0.9 in ln pressure (one standard deviation; a factor of 2 is 0.7) and
        by 0.2 in n, all soils by 0.4 in n; the three published m (0.39, 0, -0.49) by 0.4. n_std is
        0.3 or, near the ends of n's range, half the way to the nearer end.
        """
        if n_std is None:
            n_std = min(0.3, 0.5 * soil.n, 0.5 * (3.0 - soil.n))
        return cls(
            soil,
            soil.log_reference_pressure,
            soil.n,
            soil.m,
            log_reference_pressure_std,
            n_std,
            m_std,
        )


@dataclass(frozen=True)
class EstimatorSettings:
    """How the estimator judges measurements, how it forgets, and what its sensors are good for.

    Parameters of the node, but for what is the same on every vehicle: slip_sinkage_std, of the slip
    sinkage s in z (1 + s slip), and pitch_std, m/rad, error of the shown sinkage with pitch. sinkage_std:
    m, noise of one reading until it is learnt, the parameter noise.sinkage. loads_measured: whether each
    wheel's load is; else ground that is not plane loads wheels by what nobody knows.

    Raises EstimatorError where a number is outside its range.
    """

    reference_sinkage: float = Parameter(REFERENCE_SINKAGE, "m", 1e-4, 1.0).means(
        "Sinkage at which ~/soil gives the reference pressure."
    )
    reference_diameter: float = Parameter(REFERENCE_DIAMETER, "m", 1e-3, 10.0).means(
        "Wheel diameter for which ~/soil gives reference pressure and effective modulus."
    )
    # None while standing; 0: one soil throughout.
    # The drift ends at the prior: that is what is known of soil never measured.
    process_noise: float = Parameter(0.02, "1/sqrt(m)", 0.0, 10.0).means(
        "How fast the soil may change: growth of the standard deviation of ln pressure per square"
        " root of travel."
    )
    soil_scatter: float = Parameter(0.06, "1", 1e-3, 3.0).means(  # 6 % from run to run is usual
        "Standard deviation of ln k from place to place of one soil, until it is learnt."
    )
    scatter_length: float = Parameter(0.2, "m", 1e-4, 1e3).means(  # correlation exp(-path/length)
        "Path after which a wheel stands on other soil: the readings on one stretch of this length"
        " become one measurement. For a pressed wheel, new depth."
    )
    # What enters the estimate is decided stretch by stretch.
    gate_probability: float = Parameter(0.999, "1", 0.5, 0.999999).means(
        "Share of good readings that pass for good ones; the others are counted as outliers."
    )
    # Common to all sensors; each by itself a quarter of that.
    sinkage_zero_std: float = Parameter(0.002, "m", 0.0, 1.0, "sinkage_zero_std").means(
        "What the zero of the sinkage sensors is good for. It limits how well n and the pressure can"
        " be known: set the zeros on firm ground, or with the wheels lifted, and say so here."
    )
    pass_std: float = Parameter(0.3, "1", 0.0, 1.0, "pass_std").means(
        "Standard deviation of ln sinkage per doubling of the wheels that have passed, for wheels"
        " whose track overlaps with that of a wheel ahead (lateral_position). 0: ruts change nothing."
    )
    # Each cell by itself half of that.
    load_scale_std: float = Parameter(0.1, "1", 0.0, 1.0, "load_scale_std").means(
        "Standard deviation of the scale of the load cells, all together."
    )
    load_zero_std: float = Parameter(0.03, "1", 0.0, 1.0, "load_zero_std").means(
        "Standard deviation of the zero of the load cells, as a share of a wheel's usual load."
    )
    delay_std: float = Parameter(0.1, "s", 0.0, 1.0, "delay_std").means(
        "Standard deviation of the time by which sinkage is shown behind the load."
    )
    sinkage_std: float = 0.001
    slip_sinkage_std: float = 1.0
    pitch_std: float = 0.01
    loads_measured: bool = True

    def __post_init__(self) -> None:
        """Check every number."""
        wrong = out_of_range(self)
        if wrong:
            raise EstimatorError(f"estimator settings: {wrong}")
        what = "estimator settings"
        _require(
            what, "sinkage_std", self.sinkage_std, 1e-5 <= self.sinkage_std <= 1, "1e-5 to 1 m"
        )
        for name in ("slip_sinkage_std", "pitch_std"):
            value = getattr(self, name)
            _require(what, name, value, 0 <= value <= 10, "0 to 10")
