# SPDX-License-Identifier: Apache-2.0
"""Sinkage and motion resistance of one wheel on the soil as it is estimated, and how sure they are.

Without effects their slopes by the law are worked out by hand, in plain floats, since this runs for
every measurement; with effects they are differences of the model itself.
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
from smallwheel_ros.estimator.traction_samples import RollingContact
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
# Sinkage and resistances, the slopes of `WheelOnSoil`, and the factor on thrust.
_Found = tuple[tuple[float, float, float], Array, float]
_BY_LOAD = (0.0, 0.0, 0.0, 1.0)  # slopes of ln load itself


class MobilityError(SmallwheelError):
    """A wheel, a load or a slip that mobility cannot be worked out for."""


@dataclass(frozen=True)
class WheelOnSoil:
    """Sinkage (m), compaction and other resistance (N) of a wheel under a load (N).

    slopes: of these three and of ln load (the rows) by ln reference pressure, n, m and ln load, shape
    (4, 4). covariance: of the same four rows, by law, the place's deviation of ln k, and load.
    thrust_factor: of the effects on thrust, 1 without.
    """

    wheel: Wheel
    soil: SoilEstimate
    load: Quantity
    sinkage: float
    compaction: float
    other: float
    slopes: Array
    covariance: list[list[float]]
    thrust_factor: float = 1.0

    def variance(
        self,
        by_sinkage: float = 0.0,
        by_compaction: float = 0.0,
        by_other: float = 0.0,
        by_log_load: float = 0.0,
    ) -> float:
        """Of a quantity that changes so with sinkage, resistances and ln load."""
        (ss, sc, so, sw), (_, cc, co, cw), (_, _, oo, ow), (_, _, _, ww) = self.covariance
        a, b, c, d = by_sinkage, by_compaction, by_other, by_log_load
        squares = a * a * ss + b * b * cc + c * c * oo + d * d * ww
        pairs = a * (b * sc + c * so + d * sw) + b * (c * co + d * cw) + c * d * ow
        return max(squares + 2.0 * pairs, 0.0)

    @cached_property
    def resistance(self) -> Quantity:
        """All motion resistance that the model gives, N."""
        spread = self.variance(by_compaction=1.0, by_other=1.0)
        return Quantity(self.compaction + self.other, math.sqrt(spread))

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
    if effects:
        found = _by_differences(wheel, soil, load, slip, speed, effects, strength)
    else:
        found = _by_hand(wheel, soil, load)
    if found is None:
        return None
    law = np.zeros((4, 4))
    law[:3, :3] = soil.log_covariance
    law[0, 0] += scatter**2
    law[3, 3] = (load.standard_deviation / load.value) ** 2
    (sinkage, compaction, other), slopes, thrust_factor = found
    covariance = (slopes @ law @ slopes.T).tolist()
    return WheelOnSoil(
        wheel, soil, load, sinkage, compaction, other, slopes, covariance, thrust_factor
    )


def _by_hand(wheel: Wheel, soil: SoilEstimate, load: Quantity) -> _Found | None:
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
    by_log = (-by_load, by_exponent, -by_load * log_size, by_load)  # of ln sinkage
    compaction, by_compaction = 0.0, (0.0, 0.0, 0.0, 0.0)
    if wheel.contact == ROLLING:
        # R = b p(z) z/(n + 1): Bekker 1960, eq. 14 of Meirion-Griffith and Spenko 2011.
        power = n + 1.0
        compaction = wheel.width * math.exp(log_modulus + power * point.log_sinkage) / power
        by_compaction = (
            compaction * (1.0 + power * by_log[0]),
            compaction * (point.log_sinkage - log_depth - 1.0 / power + power * by_log[1]),
            compaction * (log_size + power * by_log[2]),
            compaction * power * by_log[3],
        )
    slopes = np.array((by_log, by_compaction, (0.0, 0.0, 0.0, 0.0), _BY_LOAD))
    slopes[0] *= sinkage
    return (sinkage, compaction, 0.0), slopes, 1.0


def _by_differences(
    wheel: Wheel,
    soil: SoilEstimate,
    load: Quantity,
    slip: float | None,
    speed: float | None,
    effects: Sequence[Effect],
    strength: Strength | None,
) -> _Found | None:
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
    slopes = np.vstack([(table[:, 1:5] - table[:, 5:]) / (2.0 * step), _BY_LOAD])
    factor = 1.0
    if found.thrust is not None and slip and shear and wheel.contact == ROLLING:
        length, _ = point_contact_length(float(found.true_sinkage[0]), wheel.diameter)
        plain = point_thrust(load.value, slip, length, wheel.width, *shear).value
        if plain:
            factor = float(found.thrust[0]) / plain
    sinkage, compaction, other = table[:, 0].tolist()
    return (sinkage, compaction, other), slopes, factor
