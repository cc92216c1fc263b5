"""Sinkage and motion resistance of one wheel on the soil as it is estimated, with their slopes.

Without effects the slopes are worked out by hand, in plain floats, since this runs for every
measurement; with effects they are differences of the model itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.point_sinkage import point_sinkage
from smallwheel_ros.estimator.traction_filter import RollingContact
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import PRESSED, ROLLING, Conditions
from smallwheel_ros.physics.point_thrust import point_contact_length, point_thrust
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4
Array = NDArray[np.float64]
_STEP = 1e-5  # of central differences: about the cube root of the rounding error
_NONE: Array = np.zeros(4)


class MobilityError(SmallwheelError):
    """A wheel, a load or a slip that mobility cannot be worked out for."""


@dataclass(frozen=True)
class WheelOnSoil:
    """Sinkage (m), compaction and other resistance (N) under a load (N), each with its slopes.

    Slopes are by ln reference pressure, n, m and ln load, shape (4,); covariance is that of these
    four. thrust_factor: of the effects on thrust, 1 without.
    """

    wheel: Wheel
    soil: SoilEstimate
    load: Quantity
    covariance: Array
    sinkage: float
    compaction: float
    other: float
    by_sinkage: Array
    by_compaction: Array
    by_other: Array
    thrust_factor: float = 1.0

    def variance(self, slopes: Array) -> float:
        """Of a quantity with these slopes, by law, the place's deviation of ln k, and load."""
        return max(float(slopes @ self.covariance @ slopes), 0.0)

    def quantity(self, value: float, slopes: Array) -> Quantity:
        """A value with its standard deviation."""
        return Quantity(value, math.sqrt(self.variance(slopes)))

    @cached_property
    def resistance(self) -> Quantity:
        """All motion resistance that the model gives, N."""
        return self.quantity(self.compaction + self.other, self.by_compaction + self.by_other)

    @cached_property
    def contact(self) -> RollingContact:
        """What the traction filter needs of it."""
        return RollingContact(
            self.load.value,
            self.sinkage,
            self.wheel.diameter,
            self.wheel.width,
            self.resistance,
            self.thrust_factor,
        )


def wheel_on_soil(
    wheel: Wheel,
    soil: SoilEstimate,
    load: Quantity,
    *,
    scatter: float = 0.0,
    slip: float | None = None,
    speed: float | None = None,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> WheelOnSoil | None:
    """Put a wheel under a load (N, over 0) on a soil; None where it sinks to its axle.

    scatter: standard deviation of ln k from place to place. slip, speed (m/s), strength: for the
    effects that read them.

    Raises
    ------
    MobilityError
        If load or slip is outside its domain, or the wheel's contact is not known here.
    ModelError
        If an effect lacks its covariate.
    """
    if not (math.isfinite(load.value) and load.value > 0):
        raise MobilityError(f"wheel {wheel.name}: load is {load.value!r} N, expected more than 0")
    if slip is not None and not abs(slip) <= 1:
        raise MobilityError(f"wheel {wheel.name}: slip is {slip!r}, expected -1 to 1")
    if wheel.contact not in (ROLLING, PRESSED):
        raise MobilityError(
            f"wheel {wheel.name}: contact is {wheel.contact!r}, expected {ROLLING} or {PRESSED}"
        )
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = soil.log_covariance
    covariance[0, 0] += scatter**2
    covariance[3, 3] = (load.standard_deviation / load.value) ** 2
    given = wheel, soil, load, covariance
    if effects:
        return _by_differences(*given, slip, speed, effects, strength)
    n, log_depth = soil.n, math.log(soil.reference_sinkage)
    log_size = math.log(wheel.diameter / soil.reference_diameter)
    log_modulus = soil.log_reference_pressure - n * log_depth + soil.m * log_size
    # A pressed wheel meets the soil on both sides: each carries half.
    carried = 0.5 * load.value if wheel.contact == PRESSED else load.value
    point = point_sinkage(carried, wheel.diameter, wheel.width, log_modulus, n)
    if point.sunk_to_axle:
        return None
    sinkage, by_load = math.exp(point.log_sinkage), point.slope_load
    by_exponent = point.slope_exponent + by_load * log_depth
    by_log = np.array([-by_load, by_exponent, -by_load * log_size, by_load])
    by_sinkage = sinkage * by_log
    if wheel.contact != ROLLING:
        return WheelOnSoil(*given, sinkage, 0.0, 0.0, by_sinkage, _NONE, _NONE)
    # R = b p(z) z/(n + 1): Bekker 1960, eq. 14 of Meirion-Griffith and Spenko 2011.
    power = n + 1.0
    compaction = wheel.width * math.exp(log_modulus + power * point.log_sinkage) / power
    direct = np.array([1.0, point.log_sinkage - log_depth - 1.0 / power, log_size, 0.0])
    by_compaction = compaction * (direct + power * by_log)
    return WheelOnSoil(*given, sinkage, compaction, 0.0, by_sinkage, by_compaction, _NONE)


def _by_differences(
    wheel: Wheel,
    soil: SoilEstimate,
    load: Quantity,
    covariance: Array,
    slip: float | None,
    speed: float | None,
    effects: Sequence[Effect],
    strength: Strength | None,
) -> WheelOnSoil | None:
    centre = np.array([soil.log_reference_pressure, soil.n, soil.m, math.log(load.value)])
    step = _STEP * np.maximum(np.abs(centre), 1.0)
    rows = np.concatenate([centre[None], centre + np.diag(step), centre - np.diag(step)])
    depth, size = math.log(soil.reference_sinkage), math.log(soil.reference_diameter)
    shear = (
        ()
        if strength is None
        else (
            strength.cohesion.value,
            strength.friction_angle.value,
            strength.shear_displacement.value,
        )
    )
    soils = [
        Soil(str(i), math.exp(p - n * depth - m * size), n, m, *shear)
        for i, (p, n, m, _) in enumerate(rows.tolist())
    ]
    covariates = {"slip": slip, "speed": speed}
    found = predict(
        Model(soils, effects=effects),
        Conditions.of(
            np.exp(rows[:, 3]),
            wheel.diameter,
            wheel.width,
            contact=wheel.contact,
            soil=[one.name for one in soils],
            **{name: value for name, value in covariates.items() if value is not None},
        ),
    )
    if found.immobilised[0]:
        return None
    table = np.stack(
        [
            found.sinkage,
            found.compaction_resistance,
            found.true_resistance - found.compaction_resistance,
        ]
    )
    if wheel.contact != ROLLING:
        table[1:] = 0.0
    slopes = (table[:, 1:5] - table[:, 5:]) / (2.0 * step)
    factor = 1.0
    if found.thrust is not None and slip and shear and wheel.contact == ROLLING:
        length, _ = point_contact_length(float(found.true_sinkage[0]), wheel.diameter)
        plain = point_thrust(load.value, slip, length, wheel.width, *shear).value
        if plain:
            factor = float(found.thrust[0]) / plain
    sinkage, compaction, other = table[:, 0].tolist()
    return WheelOnSoil(
        wheel,
        soil,
        load,
        covariance,
        sinkage,
        compaction,
        other,
        slopes[0],
        slopes[1],
        slopes[2],
        factor,
    )
