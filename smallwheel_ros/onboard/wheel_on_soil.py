# SPDX-License-Identifier: Apache-2.0
"""Sinkage and motion resistance of one wheel on the soil as it is estimated, and how sure they are.

Without effects their slopes by the law are worked out by hand; with effects they are differences of the
model itself. `mean_contact` is what the strength needs of all readings of a wheel on a step of the path:
arrays, one solution for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.path_steps import RollingContact
from smallwheel_ros.estimator.sinkage_measurement import covariates_of
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.estimator.wheel_sinkage import (
    NO_SINKAGE,
    Law,
    LoadedWheel,
    Shear,
    neighbours,
    slopes,
    static_sinkage,
)
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE
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
    rows = _of_model(np.array([law]), np.array([at.load]), at, at.known, effects, strength)
    if rows.immobilised[0]:
        return None
    by_law = np.vstack([rows.slopes[:, :, 0], _BY_LOAD])
    sinkage, resistance, other = rows.values[:, 0].tolist()
    acting = float(rows.reaching[0]) / at.load, float(rows.factor[0])
    return (sinkage, resistance, other), by_law, acting


class _Rows(NamedTuple):
    """Readings of a wheel: values of sinkage, compaction and other resistance, shape (3, rows).

    slopes: of these by the law and ln load, (3, 4, rows). reaching: load on the soil, N. factor: on thrust.
    """

    values: Array
    slopes: Array
    reaching: Array
    factor: Array
    immobilised: NDArray[np.bool_]


def _of_model(
    laws: Array,
    loads: Array,
    at: LoadedWheel,
    known: Mapping[str, Array | float],
    effects: Sequence[Effect],
    strength: Strength | None,
) -> _Rows:
    """What the model with its effects says; laws, loads, known: see `neighbours`."""
    count = loads.size
    shear: Shear = ()
    if strength is not None:
        cohesion, angle = strength.cohesion.value, strength.friction_angle.value
        shear = cohesion, angle, strength.shear_displacement.value
    found = neighbours(laws, loads, at, known, effects, shear)
    compaction = found.compaction_resistance
    table = np.stack([found.sinkage, compaction, found.true_resistance - compaction])
    reaching, factor = loads, np.ones(count)
    if at.contact != ROLLING:
        table[1:] = 0.0
    elif strength is not None:
        stages = Stages(effects, at.conditions(loads, known))
        k = np.exp(laws[:, 0] - laws[:, 2] * math.log(REFERENCE_DIAMETER))
        reaching, diameter, modulus, n = stages.loaded(k, laws[:, 1], laws[:, 2])
        width, sinkage = stages.conditions.width, found.true_sinkage[:count]
        of_soil = modulus, n, np.full(count, cohesion), np.full(count, angle)
        state = WheelState(reaching, diameter, width, sinkage, *of_soil)
        for effect in stages.acting_at("thrust_factor"):
            factor = factor * stages.call(effect, "thrust_factor", 1.0, state)
    by_law = np.stack([slopes(column) for column in table])
    return _Rows(table[:, :count], by_law, reaching, factor, found.immobilised[:count])


class ContactReading(NamedTuple):
    """One reading of a wheel: the law under it, its load as shown (N), slip and speed (m/s)."""

    law: LocalLaw
    load: Quantity
    slip: float | None
    speed: float | None


def mean_contact(
    wheel: Wheel,
    readings: Sequence[ContactReading],
    *,
    scatter: float = 0.0,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> RollingContact | None:
    """Mean of the contacts of a rolling wheel's readings, as `WheelOnSoil.contact` has them.

    None where the first has none: a wheel sunk to its axle, or one of which the effects do not know enough.
    """
    needs = covariates_of(effects)
    if any(getattr(readings[0], name) is None for name in needs):
        return None
    readings = [one for one in readings if all(getattr(one, name) is not None for name in needs)]
    loads, deviations = np.array(
        [(q.value, q.standard_deviation) for q in (one.law.load(one.load) for one in readings)]
    ).T
    laws = np.array([one.law.law for one in readings])
    laws[:, 0] -= laws[:, 1] * math.log(REFERENCE_SINKAGE)
    try:
        if effects:
            at = LoadedWheel(0.0, wheel.diameter, wheel.width, wheel.contact)
            known = {
                name: np.array(column)
                for name in ("slip", "speed")
                if None not in (column := [getattr(one, name) for one in readings])
            }
            rows = _of_model(laws, loads, at, known, effects, strength)
        else:
            rows = _plain(wheel, laws, loads)
    except NO_SINKAGE:
        return None
    good = ~rows.immobilised & np.isfinite(rows.values).all(axis=0)
    if not good[0]:
        return None
    noise = (deviations / loads) ** 2
    by_modulus, by_load = rows.slopes[0, 0], rows.slopes[0, 3]
    own = by_modulus**2 * scatter**2 + by_load**2 * noise, by_load * noise, noise
    columns = [rows.reaching, *rows.values[[0, 2]], rows.factor, *own]
    load, sinkage, other, factor, *spread = np.mean(np.array(columns)[:, good], axis=1).tolist()
    size, n = (wheel.diameter, wheel.width), float(laws[0, 1])
    zz, zw, ww = spread
    return RollingContact(load, sinkage, *size, n, other, factor, (zz, zw, ww))


def _plain(wheel: Wheel, laws: Array, loads: Array) -> _Rows:
    """Sinkage alone, without effects."""
    modulus = np.exp(laws[:, 0] + laws[:, 2] * math.log(wheel.diameter / REFERENCE_DIAMETER))
    found = contact_sinkage(loads, wheel.diameter, wheel.width, modulus, laws[:, 1])
    values, by_law = np.zeros((3, loads.size)), np.zeros((3, 4, loads.size))
    values[0] = found.sinkage
    by_law[0, 3] = found.sinkage * found.slope_load
    by_law[0, 0] = -by_law[0, 3]
    return _Rows(values, by_law, loads, np.ones(loads.size), found.sunk_to_axle)
