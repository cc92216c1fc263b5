# SPDX-License-Identifier: Apache-2.0
"""Sinkage and motion resistance of one wheel on the soil as it is estimated, and how sure they are.

Without effects their slopes by the law are worked out by hand, since this runs for every measurement;
with effects they are differences of the model itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.point_sinkage import Law, static_sinkage
from smallwheel_ros.estimator.traction_samples import RollingContact
from smallwheel_ros.estimator.wheel_sinkage import (
    LoadedWheel,
    neighbours,
    slopes,
)
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4
Array = NDArray[np.float64]
# Sinkage and resistances, their slopes and that of ln load by the law and ln load; share of the load that
# reaches the soil, and factor on thrust.
_Found = tuple[tuple[float, float, float], Array, tuple[float, float]]
_BY_LOAD = (0.0, 0.0, 0.0, 1.0)  # slopes of ln load itself


class MobilityError(SmallwheelError):
    """A wheel, a load or a slip that mobility cannot be worked out for."""


@dataclass(frozen=True)
class WheelOnSoil:
    """Sinkage (m), compaction and other resistance (N) of a wheel under a load (N).

    covariance: of these three and of ln load, by law, the place's deviation of ln k, and load; own: of that
    what is the wheel's own, by place and the noise of its load. acting: by the effects, the share of the
    load that reaches the soil, and the factor on thrust.
    """

    wheel: Wheel
    soil: SoilEstimate
    load: Quantity
    sinkage: float
    compaction: float
    other: float
    covariance: list[list[float]]
    own: list[list[float]]
    acting: tuple[float, float] = (1.0, 1.0)

    def variance(
        self,
        by_sinkage: float = 0.0,
        by_compaction: float = 0.0,
        by_other: float = 0.0,
        by_log_load: float = 0.0,
    ) -> float:
        """Of a quantity that changes so with sinkage, resistances and ln load."""
        a, b, c, d = by_sinkage, by_compaction, by_other, by_log_load
        (ss, sc, so, sw), (_, cc, co, cw), (_, _, oo, ow), (_, _, _, ww) = self.covariance
        squares = a * a * ss + b * b * cc + c * c * oo + d * d * ww
        pairs = a * (b * sc + c * so + d * sw) + b * (c * co + d * cw) + c * d * ow
        return max(squares + 2.0 * pairs, 0.0)

    @cached_property
    def contact(self) -> RollingContact:
        """What the traction filter needs of it."""
        wheel, (reaching, factor) = self.wheel, self.acting
        own = self.own[0][0], self.own[0][3], self.own[3][3]
        return RollingContact(
            self.load.value * reaching,
            self.sinkage,
            wheel.diameter,
            wheel.width,
            self.soil.n,
            self.other,
            factor,
            own,
        )


def wheel_on_soil(
    wheel: Wheel,
    soil: SoilEstimate,
    load: Quantity,
    *,
    with_load: Array | None = None,
    scatter: float = 0.0,
    slip: float | None = None,
    speed: float | None = None,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> WheelOnSoil | None:
    """Put a wheel under a load (N, over 0) on a soil; None where it sinks to its axle.

    load: its deviation is that of its noise. with_load: covariance of what else is wrong with ln load, its
    scale, with ln of the soil's pressure, n and m and with itself, shape (4,); None: none. scatter:
    standard deviation of ln k from place to place. slip, speed (m/s), strength: for the effects that read
    them.

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
    depth, size = soil.reference_sinkage, soil.reference_diameter / REFERENCE_DIAMETER
    by_n, by_m = -math.log(depth), -math.log(size)  # slopes of ln modulus, for the law's pressure
    log_modulus = soil.log_reference_pressure + by_n * soil.n + by_m * soil.m
    law = Law(log_modulus, soil.n, soil.m)
    at = LoadedWheel(load.value, wheel.diameter, wheel.width, wheel.contact, slip, speed)
    found = _by_differences(law, at, effects, strength) if effects else _by_hand(law, at)
    if found is None:
        return None
    forces, by_law, acting = found
    by_law[:, 1:3] += by_law[:, :1] * (by_n, by_m)  # from here on by ln pressure, n, m and ln load
    spread = np.zeros((4, 4))
    spread[:3, :3] = soil.log_covariance
    own = by_law @ np.diag([scatter**2, 0.0, 0.0, (load.standard_deviation / load.value) ** 2])
    if with_load is not None:
        spread[3] = spread[:, 3] = with_load
    alone = own @ by_law.T
    both = (by_law @ spread @ by_law.T + alone).tolist()
    return WheelOnSoil(wheel, soil, load, *forces, both, alone.tolist(), acting)


def _by_hand(law: Law, at: LoadedWheel) -> _Found | None:
    sinkage, by_law, sunk = static_sinkage(law, *at[:4])
    if sunk:
        return None
    compaction, by_compaction = 0.0, [0.0] * 4
    if at.contact == ROLLING:
        # R = b K z^(n + 1)/(n + 1): Bekker 1960, eq. 14 of Meirion-Griffith and Spenko 2011.
        power, log_z = law.n + 1.0, math.log(sinkage)
        across = math.log(at.diameter / REFERENCE_DIAMETER)
        log_work = law.log_modulus + law.m * across + power * log_z
        compaction = at.width * math.exp(log_work) / power
        direct = np.array([1.0, log_z - 1.0 / power, across, 0.0])
        along = direct + power / sinkage * np.array(by_law)
        by_compaction = (compaction * along).tolist()
    by_all = np.array((by_law, by_compaction, (0.0, 0.0, 0.0, 0.0), _BY_LOAD))
    return (sinkage, compaction, 0.0), by_all, (1.0, 1.0)


def _by_differences(
    law: Law, at: LoadedWheel, effects: Sequence[Effect], strength: Strength | None
) -> _Found | None:
    shear = (
        ()
        if strength is None
        else (
            strength.cohesion.value,
            strength.friction_angle.value,
            strength.shear_displacement.value,
        )
    )
    found = neighbours(law, at, effects, shear)
    if found.immobilised[0]:
        return None
    compaction = found.compaction_resistance
    table = np.stack([found.sinkage, compaction, found.true_resistance - compaction])
    acting = 1.0, 1.0
    if at.contact != ROLLING:
        table[1:] = 0.0
    elif strength is not None:
        acting = _on_thrust(law, at, effects, strength, found.true_sinkage[:1])
    by_law = np.array([*map(slopes, table), _BY_LOAD])
    sinkage, resistance, other = table[:, 0].tolist()
    return (sinkage, resistance, other), by_law, acting


def _on_thrust(
    law: Law, at: LoadedWheel, effects: Sequence[Effect], strength: Strength, sinkage: Array
) -> tuple[float, float]:
    """Share of the load that reaches the soil, and the factor of the effects on thrust."""
    stages = Stages(effects, at.conditions(np.array([at.load])))
    load, diameter, modulus, n = stages.loaded(law.k, law.n, law.m)
    shear = np.array([[strength.cohesion.value], [strength.friction_angle.value]])
    state = WheelState(load, diameter, stages.conditions.width, sinkage, modulus, n, *shear)
    factor = np.ones(1)
    for effect in stages.acting_at("thrust_factor"):
        factor = factor * stages.call(effect, "thrust_factor", 1.0, state)
    return float(load[0]) / at.load, float(factor[0])
