# SPDX-License-Identifier: Apache-2.0
"""The start of the soil's estimate: prior, sensors and ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.instruments import SINKAGE_ZERO_STD
from smallwheel_ros.physics.sinkage import CONTACT_RULES, ContactRule, Geometry
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil

Array = NDArray[np.float64]

SINKAGE_STD = 0.001  # m, of one reading of sinkage: a laser or a linear gauge on loose soil
# Columns that effects may read: known of every wheel, or measured.
_COVARIATES = ("load", "diameter", "width", "contact", "slip", "speed")


class EstimatorError(SmallwheelError):
    """A prior or a setting of the estimate outside its domain."""


def _require(what: str, name: str, value: float, good: bool, expected: str) -> None:
    if not (math.isfinite(value) and good):
        raise EstimatorError(f"{what}: {name} is {value!r}, expected {expected}")


def covariates_of(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return which of `slip` and `speed` the effects read; a row without these has no predicted sinkage.

    Raises EstimatorError for an effect that reads a column that the robot does not provide.
    """
    read = {name: effect.id for effect in effects for name in effect.needs}
    for name, effect in read.items():
        if name not in _COVARIATES:
            raise EstimatorError(
                f"effect '{effect}' needs '{name}', which the robot is not given. It is given"
                f" {', '.join(_COVARIATES)}"
            )
    return tuple(name for name in ("slip", "speed") if name in read)


@dataclass(frozen=True)
class SoilPrior:
    """Prior of the law p = k z^n D^m: means, and standard deviations, which are above 0 and at most 3.

    Attributes
    ----------
    soil
        The soil that the means come from; its name is used.
    log_reference_pressure, log_reference_pressure_std
        ln of the pressure (Pa) at 10 mm of sinkage under a wheel of 0.2 m, -30 to 30.
    n, n_std
        Exponent of sinkage, 0.03 to 2.97, 1.
    m, m_std
        Exponent of the wheel's diameter, -3 to 3, 1.
    geometry
        How sinkage follows from load: by the contact integral, or in closed form by eq. 10 of
        Meirion-Griffith and Spenko 2011.

    Raises
    ------
    EstimatorError
        If a number is outside its range.
    """

    soil: Soil
    log_reference_pressure: float
    n: float
    m: float
    log_reference_pressure_std: float
    n_std: float
    m_std: float
    geometry: Geometry = "contact_integral"

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
        """Mean, shape (3,), and covariance, (3, 3), of ln reference pressure (Pa), n and m."""
        deviations = [self.log_reference_pressure_std, self.n_std, self.m_std]
        mean = np.array([self.log_reference_pressure, self.n, self.m])
        return mean, np.diag(np.square(deviations))

    @property
    def contact(self) -> ContactRule:
        """The rule by which the sinkage of a wheel follows from its load."""
        return CONTACT_RULES[self.geometry]

    def log_modulus(self, diameter: float) -> float:
        """Ln of the effective modulus K = k D^m (Pa/m^n) under a wheel of this diameter (m)."""
        across = math.log(diameter / REFERENCE_DIAMETER)
        return self.log_reference_pressure - self.n * math.log(REFERENCE_SINKAGE) + self.m * across

    @classmethod
    def from_soil(cls, soil: Soil, geometry: Geometry = "contact_integral") -> SoilPrior:
        """Make the prior of a vehicle on some soil of this kind, not on this very soil.

        The deviations are the spread within one kind in the published tables: the three dry sands of
        `soil.SOILS` differ by 0.9 in ln pressure (one standard deviation; a factor of 2 is 0.7) and
        by 0.2 in n, all soils by 0.4 in n; the three published m (0.39, 0, -0.49) by 0.4. That of n is
        0.3 or, near the ends of n's range, half the way to the nearer end.

        Parameters
        ----------
        soil
            A soil of that kind; its k, n and m are the means.
        geometry
            How sinkage follows from load, as in the class.

        Returns
        -------
        SoilPrior
            The prior.
        """
        n_std = min(0.3, 0.5 * soil.n, 0.5 * (3.0 - soil.n))
        return cls(soil, soil.log_reference_pressure, soil.n, soil.m, 0.7, n_std, 0.4, geometry)


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of the soil's estimate about sensors and ground.

    Attributes
    ----------
    sinkage_std
        Noise of one reading of sinkage until it is learnt, m.
    sinkage_zero_std
        Standard deviation of the zero error that all sinkage sensors share, m.
    soil_scatter
        Standard deviation of ln k from place to place of one soil until it is learnt, 1; 0.06 from run to
        run is usual.
    loads_measured
        Whether each wheel's load is measured; otherwise uneven ground changes the loads by unknown amounts.

    Raises
    ------
    EstimatorError
        If a number is outside its range.
    """

    sinkage_std: float = SINKAGE_STD
    sinkage_zero_std: float = SINKAGE_ZERO_STD
    soil_scatter: float = 0.06
    loads_measured: bool = True

    def __post_init__(self) -> None:
        """Check every number."""
        for name, low, high in (
            ("sinkage_std", 1e-5, 1.0),
            ("sinkage_zero_std", 0.0, 1.0),
            ("soil_scatter", 1e-3, 3.0),
        ):
            value = getattr(self, name)
            good = low <= value <= high
            _require("estimator settings", name, value, good, f"{low:g} to {high:g}")
