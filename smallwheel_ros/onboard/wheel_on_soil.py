# SPDX-License-Identifier: Apache-2.0
"""Sinkage and motion resistance of one wheel on the soil as it is estimated, and how sure they are.

Without effects their slopes by the law are worked out by hand; with effects they are differences of the
model itself. `mean_contacts` are what the strength needs of all readings on a step of the path: arrays, one
solution for all wheels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.estimator.path_steps import RollingContact, Sample
from smallwheel_ros.estimator.reading import Reading, covariates_of
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

    log_pressure, exponent: of the law, ln of Pa at the soil's reference sinkage and diameter, and n.
    covariance: of these three and of ln load, by law, the place's deviation of ln k, and load; own: of that
    what is the wheel's own, by place and the noise of its load. acting: by the effects, the share of the
    load that reaches the soil, and the factor on thrust.
    """

    wheel: Wheel
    log_pressure: float
    exponent: float
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
            self.exponent,
            self.other,
            factor,
            own,
        )


def wheel_on_soil(
    wheel: Wheel,
    soil: LocalLaw,
    shown: Quantity,
    *,
    missed: float = 0.0,
    scatter: float = 0.0,
    slip: float | None = None,
    speed: float | None = None,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> WheelOnSoil | None:
    """Put a wheel under a load (N, over 0) on the soil that is under it; None where it sinks to its axle.

    shown: the load as its cell shows it, with the deviation of its noise. missed: variance of ln k by an
    effect that the model lacks; scatter: standard deviation of ln k from place to place. slip, speed (m/s),
    strength: for the effects that read them.

    Raises
    ------
    MobilityError
        If load or slip is outside its domain, or the wheel's contact is not known here.
    ModelError
        If an effect lacks its covariate.
    """
    if not (math.isfinite(shown.value) and shown.value > 0):
        raise MobilityError(f"wheel {wheel.name}: load is {shown.value!r} N, expected more than 0")
    if slip is not None and not abs(slip) <= 1:
        raise MobilityError(f"wheel {wheel.name}: slip is {slip!r}, expected -1 to 1")
    if wheel.contact not in (ROLLING, PRESSED):
        raise MobilityError(
            f"wheel {wheel.name}: contact is {wheel.contact!r}, expected {ROLLING} or {PRESSED}"
        )
    load = soil.load(shown)
    log_pressure, n, m = soil.law.tolist()
    by_n = -math.log(REFERENCE_SINKAGE)  # slope of ln modulus, for the law's pressure
    law = Law(log_pressure + by_n * n, n, m)
    at = LoadedWheel(load.value, wheel.diameter, wheel.width, wheel.contact, slip, speed)
    found = _by_differences(law, at, effects, strength) if effects else _by_hand(law, at)
    if found is None:
        return None
    forces, by_law, acting = found
    by_law[:, 1] += by_law[:, 0] * by_n  # from here on by ln pressure, n, m and ln load
    spread = np.empty((4, 4))
    spread[:3, :3] = soil.covariance[:3, :3]
    spread[0, 0] += missed
    spread[3] = spread[:, 3] = soil.with_load(shown.value)
    own = by_law @ np.diag([scatter**2, 0.0, 0.0, (load.standard_deviation / load.value) ** 2])
    alone = own @ by_law.T
    both = (by_law @ spread @ by_law.T + alone).tolist()
    return WheelOnSoil(wheel, log_pressure, n, load, *forces, both, alone.tolist(), acting)


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

    def where(self, own: slice) -> _Rows:
        """Some of the rows."""
        columns = self.values[:, own], self.slopes[:, :, own], self.reaching[own], self.factor[own]
        return _Rows(*columns, self.immobilised[own])


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


def mean_contacts(
    samples: Mapping[str, Sequence[Sample]],
    *,
    scatter: float = 0.0,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> dict[str, RollingContact]:
    """Means of the contacts of rolling wheels' readings, by name, as `WheelOnSoil.contact` has them.

    A wheel is left out whose first reading has none: it is sunk to its axle, or the effects do not know
    enough of it.
    """
    needs = covariates_of(effects)
    known = {
        name: [one for one in found if _knows(one.reading, needs)]
        for name, found in samples.items()
        if _knows(found[0].reading, needs)
    }
    rows = _of_wheels(known, effects, strength) if effects else _plain(known)
    found = {}
    for name, (laws, noise, row) in rows.items():
        contact = _mean_contact(known[name][0].reading.wheel, laws, noise, row, scatter)
        if contact is not None:
            found[name] = contact
    return found


_Loaded = tuple[
    Array, Array, _Rows
]  # laws (rows, 3), variance of ln load (rows,), what comes of them


def _knows(reading: Reading, needs: Sequence[str]) -> bool:
    return all(getattr(reading, name) is not None for name in needs)


def _laws_and_loads(samples: Sequence[Sample]) -> tuple[Array, Array, Array]:
    """Rows of `Law`, loads (N), and the variances of their logarithms by their noise."""
    carried = [one.law.load(one.load) for one in samples if one.load is not None]
    loads, deviations = np.array([(q.value, q.standard_deviation) for q in carried]).T
    laws = np.array([one.law.law for one in samples])
    laws[:, 0] -= laws[:, 1] * math.log(REFERENCE_SINKAGE)
    return laws, loads, (deviations / loads) ** 2


def _plain(samples: Mapping[str, Sequence[Sample]]) -> dict[str, _Loaded]:
    """Without effects: sinkage alone, one solution for the readings of all wheels."""
    if not samples:
        return {}
    laws, loads, noise = _laws_and_loads([one for found in samples.values() for one in found])
    sizes = [
        (one.reading.wheel.diameter, one.reading.wheel.width)
        for found in samples.values()
        for one in found
    ]
    diameter, width = np.array(sizes).T
    modulus = np.exp(laws[:, 0] + laws[:, 2] * np.log(diameter / REFERENCE_DIAMETER))
    try:
        solved = contact_sinkage(loads, diameter, width, modulus, laws[:, 1])
    except NO_SINKAGE:
        return {}
    values, by_law = np.zeros((3, loads.size)), np.zeros((3, 4, loads.size))
    values[0] = solved.sinkage
    by_law[0, 3] = solved.sinkage * solved.slope_load
    by_law[0, 0] = -by_law[0, 3]
    whole = _Rows(values, by_law, loads, np.ones(loads.size), solved.sunk_to_axle)
    rows, begin = {}, 0
    for name, found in samples.items():
        own = slice(begin, begin + len(found))
        rows[name] = laws[own], noise[own], whole.where(own)
        begin += len(found)
    return rows


def _of_wheels(
    samples: Mapping[str, Sequence[Sample]], effects: Sequence[Effect], strength: Strength | None
) -> dict[str, _Loaded]:
    """With effects: wheel by wheel; one in whose soil they leave it no sinkage is left out."""
    rows = {}
    for name, found in samples.items():
        readings, wheel = [one.reading for one in found], found[0].reading.wheel
        laws, loads, noise = _laws_and_loads(found)
        at = LoadedWheel(0.0, wheel.diameter, wheel.width, wheel.contact)
        slips = [one.slip.value for one in readings if one.slip is not None]
        speeds = [one.speed for one in readings if one.speed is not None]
        columns = {"slip": slips, "speed": speeds}
        known = {n: np.array(column) for n, column in columns.items() if len(column) == len(found)}
        with suppress(*NO_SINKAGE):
            rows[name] = laws, noise, _of_model(laws, loads, at, known, effects, strength)
    return rows


def _mean_contact(
    wheel: Wheel, laws: Array, noise: Array, rows: _Rows, scatter: float
) -> RollingContact | None:
    """Mean over a wheel's readings. scatter: of ln k from place to place."""
    good = ~rows.immobilised & np.isfinite(rows.values).all(axis=0)
    if not good[0]:
        return None
    by_modulus, by_load = rows.slopes[0, 0], rows.slopes[0, 3]
    own = by_modulus**2 * scatter**2 + by_load**2 * noise, by_load * noise, noise
    columns = [rows.reaching, *rows.values[[0, 2]], rows.factor, *own]
    load, sinkage, other, factor, *spread = np.mean(np.array(columns)[:, good], axis=1).tolist()
    size, n = (wheel.diameter, wheel.width), float(laws[0, 1])
    zz, zw, ww = spread
    return RollingContact(load, sinkage, *size, n, other, factor, (zz, zw, ww))
