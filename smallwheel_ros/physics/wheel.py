# SPDX-License-Identifier: Apache-2.0
"""A wheel, and the strength of the soil under it; values with their uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.conditions import ROLLING

Array = NDArray[np.float64]

GRAVITY = 9.80665  # m/s^2, standard


class Quantity(NamedTuple):
    """A value and its standard deviation, in the same unit."""

    value: float
    standard_deviation: float


@dataclass(frozen=True)
class Wheel:
    """One wheel of a vehicle or a rig.

    Attributes
    ----------
    name
        Name of the wheel.
    diameter, width
        Diameter and width of the wheel, m.
    contact
        'rolling', or 'pressed' for a wheel that is pushed straight down and so meets the soil on both
        sides of its lowest point.
    longitudinal_position, lateral_position
        Position of the wheel in the vehicle's base frame, m, positive forward and to the left.
    """

    name: str
    diameter: float
    width: float
    contact: str = ROLLING
    lateral_position: float = 0.0
    longitudinal_position: float = 0.0


# What a wheel does with the strength of soil (`stresses`), with deviations among rigs. eta is 1 in Wong and
# Reece 1967 and 1.2 to 1.9 on rigs; mu of sand on metal is 0.5 to 0.9 (Potyondy 1961), 0.70 to 0.84 on rigs;
# the peak moves by 0.2 to 0.4 of the arc in Wong and Reece's wheels and hardly in the pulls of rigs.
ROLLING_SHARE, RIM_FRICTION = Quantity(1.3, 0.4), Quantity(0.8, 0.12)
PRESSURE_PEAK = Quantity(0.1, 0.2)
_CORRELATED = ("cohesion", "friction_angle", "shear_displacement", "rolling_share", "rim_friction")


@dataclass(frozen=True)
class Strength:
    """Shear strength of a soil and its contact with a rim: the parameters of `stresses`, with uncertainty.

    Attributes
    ----------
    cohesion, friction_angle
        Cohesion c, Pa, and angle of internal friction phi, rad (Mohr and Coulomb).
    shear_displacement
        Shear deformation modulus K, m (Janosi and Hanamoto).
    rolling_share, rim_friction, pressure_peak
        eta, mu and c2 of `stresses`, 1; `Soil` describes them.
    correlation
        Correlation of (c, phi, ln K, eta, mu), shape (5, 5); None: they are uncorrelated.
    """

    cohesion: Quantity
    friction_angle: Quantity
    shear_displacement: Quantity
    rolling_share: Quantity = ROLLING_SHARE
    rim_friction: Quantity = RIM_FRICTION
    pressure_peak: Quantity = PRESSURE_PEAK
    correlation: Array | None = None

    def wider(self, **by: float) -> Strength:
        """Return a copy with larger standard deviations, which include further independent errors.

        Variances add up; correlations shrink accordingly.

        Parameters
        ----------
        **by
            Standard deviation of the further error of each number, by the number's name, in its unit.
        """
        numbers: dict[str, Any] = {}
        share = np.ones(5)  # of the deviations that correlations are of
        for name, more in by.items():
            value, before = getattr(self, name)
            numbers[name] = Quantity(value, math.hypot(before, more))
            if name in _CORRELATED and numbers[name].standard_deviation > 0.0:
                share[_CORRELATED.index(name)] = before / numbers[name].standard_deviation
        if self.correlation is not None:
            correlation = self.correlation * np.outer(share, share)
            np.fill_diagonal(correlation, 1.0)
            numbers["correlation"] = correlation
        return replace(self, **numbers)
