# SPDX-License-Identifier: Apache-2.0
"""What is known of a number before the data, and the numbers in which a fit takes a soil.

ln p_ref is ln of the pressure at 10 mm of sinkage under a wheel of 0.2 m: k itself is the pressure at
one metre, an extrapolation whose error is tied to n and m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln
from scipy.stats import t as student

from smallwheel_ros.fitting.constants import STUDENT
from smallwheel_ros.physics.soil import Soil, k_from_reference

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """What is known of one number before the data.

    heavy: Student's t with `STUDENT` degrees of freedom, truncated at the bounds; else Gaussian.
    """

    centre: float
    deviation: float
    low: float
    high: float
    heavy: bool = False

    @cached_property
    def _log_norm(self) -> float:
        if not self.heavy:
            return float(np.log(self.deviation) + 0.5 * np.log(2.0 * np.pi))
        low, high = ((b - self.centre) / self.deviation for b in (self.low, self.high))
        inside = max(float(student.cdf(high, STUDENT) - student.cdf(low, STUDENT)), 1e-9)
        constant = gammaln((STUDENT + 1) / 2) - gammaln(STUDENT / 2)
        return float(
            np.log(inside) + np.log(self.deviation) + 0.5 * np.log(STUDENT * np.pi) - constant
        )

    def log_density(self, value: float) -> float:
        """Logarithm of the prior's density."""
        u = (value - self.centre) / self.deviation
        if self.heavy:
            return float(-(STUDENT + 1) / 2 * np.log1p(u * u / STUDENT)) - self._log_norm
        return -0.5 * u * u - self._log_norm

    def precision(self, value: float) -> float:
        """Weight of the Gaussian that touches the prior there (for Student's t: its majoriser)."""
        if not self.heavy:
            return self.deviation**-2
        u = (value - self.centre) / self.deviation
        return (STUDENT + 1) / (STUDENT + u * u) / self.deviation**2


# Middle of what the soils of the library and of Wong (2008) show: n 0.1 to 1.6, |m| up to 0.5.
SOIL_PARAMETERS = {
    "log_reference_pressure": ("ln Pa", Prior(10.5, 3.0, 2.0, 20.0)),
    "n": ("1", Prior(0.9, 0.4, 0.05, 2.9)),
    "m": ("1", Prior(0.0, 0.6, -3.0, 3.0)),
}
# Dry sand under small wheels: phi 28 to 40 deg, c 0 to 1 kPa (Wong 2008; 21 to 31 deg and 200 to 2300 Pa in
# the pulls of nine rigs), K 5 to 25 mm.
STRENGTH_PARAMETERS = {
    "friction_angle": ("rad", Prior(0.576, 0.08, 0.1, 1.0)),
    "log_shear_displacement": ("ln m", Prior(float(np.log(0.012)), 0.6, -6.2, -2.8)),
    "cohesion": ("Pa", Prior(500.0, 500.0, 0.0, 20e3)),
}
# What a wheel does with that strength (`stresses`): eta is 1 in Wong and Reece 1967 and 1.2 to 1.9 on rigs;
# mu of sand on metal is 0.5 to 0.9 (Potyondy 1961), 0.70 to 0.84 on rigs; the peak moves by 0.2 to 0.4 of the
# arc in Wong and Reece's wheels and hardly in the pulls of rigs.
WHEEL_PARAMETERS = {
    "rolling_share": ("1", Prior(1.3, 0.4, 0.0, 4.0)),
    "rim_friction": ("1", Prior(0.8, 0.12, 0.2, 1.5)),
    "pressure_peak": ("1", Prior(0.1, 0.2, 0.0, 0.8)),
}
# Where nobody measured it.
USUAL_STRENGTH = {
    name: prior.centre for name, (_, prior) in (STRENGTH_PARAMETERS | WHEEL_PARAMETERS).items()
}


def soil_numbers(soil: Soil) -> dict[str, float]:
    """The soil in the numbers that a fit works with."""
    return {
        "log_reference_pressure": soil.log_reference_pressure,
        "n": soil.n,
        "m": soil.m,
        "friction_angle": soil.friction_angle,
        "log_shear_displacement": float(np.log(soil.shear_displacement)),
        "cohesion": soil.cohesion,
        "rolling_share": soil.rolling_share,
        "rim_friction": soil.rim_friction,
        "pressure_peak": soil.pressure_peak,
    }


def soil_from(soil: Soil, values: Mapping[str, float], name: str = "") -> Soil:
    """The soil with these of its numbers replaced, under another name where one is given."""
    v = soil_numbers(soil) | dict(values)
    return Soil(
        name or soil.name,
        float(k_from_reference(v["log_reference_pressure"], v["n"], v["m"])),
        v["n"],
        v["m"],
        v["cohesion"],
        v["friction_angle"],
        float(np.exp(v["log_shear_displacement"])),
        soil.source,
        v["rolling_share"],
        v["rim_friction"],
        v["pressure_peak"],
    )


@dataclass(frozen=True)
class SoilPrior:
    """A soil known from elsewhere: its mean, and the covariance of (ln p_ref, n, m), shape (3, 3)."""

    soil: Soil
    covariance: Array
