# SPDX-License-Identifier: Apache-2.0
"""Sinkage and motion resistance of one wheel on the soil as it is estimated, and how sure they are.

Without effects their slopes by the law are worked out by hand; with effects they are differences of the
model itself, one call of it for all wheels. `mean_contacts` are what the strength needs of all readings on a
step of the path: arrays, one solution for all wheels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.estimator.path_steps import RollingContact, Sample
from smallwheel_ros.estimator.reading import Reading, covariates_of
from smallwheel_ros.estimator.wheel_sinkage import NO_SINKAGE, Law, static_sinkage
from smallwheel_ros.model.nearby import Shear, neighbours, slopes
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.onboard.settings import REFERENCE_SLIP as REFERENCE_SLIP
from smallwheel_ros.physics.conditions import PRESSED, ROLLING, Conditions
from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

Array = NDArray[np.float64]
# Sinkage and resistances, their slopes and that of ln load by the law and ln load; share of the load that
# reaches the soil, and factor on thrust.
_Found = tuple[tuple[float, float, float], Array, tuple[float, float]]
_LOG_DEPTH = math.log(REFERENCE_SINKAGE)
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


def wheels_on_soil(
    samples: Sequence[Sample],
    *,
    missed: float = 0.0,
    scatter: float = 0.0,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> list[WheelOnSoil | None]:
    """Put wheels on the soil that is under each of them; None for one that sinks to its axle.

    samples: with loads (N, over 0) as their cells show them, with the deviations of their noise; slip and
    speed of their readings are for the effects that read them, like strength. missed: variance of ln k by an
    effect that the model lacks; scatter: standard deviation of ln k from place to place.

    Raises
    ------
    MobilityError
        If a load or a slip is outside its domain, or a wheel's contact is not known here.
    ModelError
        If an effect lacks its covariate.
    """
    for one in samples:
        _check(one)
    found = _by_differences(samples, effects, strength) if effects else map(_by_hand, samples)
    return [
        None if one is None else _with_deviations(sample, one, missed, scatter)
        for sample, one in zip(samples, found, strict=True)
    ]


def _check(sample: Sample) -> None:
    wheel, load, slip = sample.reading.wheel, sample.load, sample.reading.slip
    if load is None or not (math.isfinite(load.value) and load.value > 0):
        shown = None if load is None else load.value
        raise MobilityError(f"wheel {wheel.name}: load is {shown!r} N, expected more than 0")
    if slip is not None and not abs(slip.value) <= 1:
        raise MobilityError(f"wheel {wheel.name}: slip is {slip.value!r}, expected -1 to 1")
    if wheel.contact not in (ROLLING, PRESSED):
        raise MobilityError(
            f"wheel {wheel.name}: contact is {wheel.contact!r}, expected {ROLLING} or {PRESSED}"
        )


def _with_deviations(sample: Sample, found: _Found, missed: float, scatter: float) -> WheelOnSoil:
    soil, shown = sample.law, sample.load
    assert shown is not None, "`_check` says so"
    load = soil.load(shown)
    forces, by_law, acting = found
    by_law[:, 1] -= by_law[:, 0] * _LOG_DEPTH  # from here on by ln pressure, n, m and ln load
    spread = np.empty((4, 4))
    spread[:3, :3] = soil.covariance[:3, :3]
    spread[0, 0] += missed
    spread[3] = spread[:, 3] = soil.with_load(shown.value)
    own = by_law @ np.diag([scatter**2, 0.0, 0.0, (load.standard_deviation / load.value) ** 2])
    alone = own @ by_law.T
    both = (by_law @ spread @ by_law.T + alone).tolist()
    log_pressure, n, _ = soil.law.tolist()
    wheel = sample.reading.wheel
    return WheelOnSoil(wheel, log_pressure, n, load, *forces, both, alone.tolist(), acting)


def _by_hand(sample: Sample) -> _Found | None:
    wheel, shown = sample.reading.wheel, sample.load
    assert shown is not None, "`_check` says so"
    log_pressure, n, m = sample.law.law.tolist()
    law, load = Law(log_pressure - _LOG_DEPTH * n, n, m), sample.law.load(shown).value
    sinkage, by_law, sunk = static_sinkage(law, load, wheel.diameter, wheel.width, wheel.contact)
    if sunk:
        return None
    compaction, by_compaction = 0.0, [0.0] * 4
    if wheel.contact == ROLLING:
        # R = b K z^(n + 1)/(n + 1): Bekker 1960, eq. 14 of Meirion-Griffith and Spenko 2011.
        power, log_z = law.n + 1.0, math.log(sinkage)
        across = math.log(wheel.diameter / REFERENCE_DIAMETER)
        log_work = law.log_modulus + law.m * across + power * log_z
        compaction = wheel.width * math.exp(log_work) / power
        direct = np.array([1.0, log_z - 1.0 / power, across, 0.0])
        along = direct + power / sinkage * np.array(by_law)
        by_compaction = (compaction * along).tolist()
    by_all = np.array((by_law, by_compaction, (0.0, 0.0, 0.0, 0.0), _BY_LOAD))
    return (sinkage, compaction, 0.0), by_all, (1.0, 1.0)


def _by_differences(
    samples: Sequence[Sample], effects: Sequence[Effect], strength: Strength | None
) -> list[_Found | None]:
    rows = _of_model(samples, effects, strength)
    found: list[_Found | None] = []
    for i, load in enumerate(rows.load.tolist()):
        by_law = np.vstack([rows.slopes[:, :, i], _BY_LOAD])
        sinkage, compaction, other = rows.values[:, i].tolist()
        acting = float(rows.reaching[i]) / load, float(rows.factor[i])
        sunk = rows.immobilised[i]
        found.append(None if sunk else ((sinkage, compaction, other), by_law, acting))
    return found


class _Rows(NamedTuple):
    """Samples of wheels: load (N), variance of its logarithm by noise, and the soil's exponent, (rows,).

    values: sinkage, compaction and other resistance, shape (3, rows). slopes: of these by the law and ln
    load, (3, 4, rows). reaching: load on the soil, N. factor: on thrust.
    """

    load: Array
    noise: Array
    exponent: Array
    values: Array
    slopes: Array
    reaching: Array
    factor: Array
    immobilised: NDArray[np.bool_]

    def where(self, own: slice | NDArray[np.bool_]) -> _Rows:
        """Some of the rows."""
        return _Rows._make(column[..., own] for column in self)


def _of_model(
    samples: Sequence[Sample], effects: Sequence[Effect], strength: Strength | None
) -> _Rows:
    """What the model with its effects says; slip and speed are known of all samples, or of those apart."""
    groups: dict[tuple[bool, bool], list[int]] = {}
    for i, (reading, *_) in enumerate(samples):
        groups.setdefault((reading.slip is None, reading.speed is None), []).append(i)
    found = [_alike([samples[i] for i in own], effects, strength) for own in groups.values()]
    if len(found) == 1:
        return found[0]
    order = np.argsort(np.concatenate(list(groups.values())))
    columns = zip(*found, strict=True)
    return _Rows._make(np.concatenate(parts, axis=-1)[..., order] for parts in columns)


def _alike(
    samples: Sequence[Sample], effects: Sequence[Effect], strength: Strength | None
) -> _Rows:
    """The same for samples of which the same is known."""
    laws, loads, noise = _laws_and_loads(samples)
    conditions = _conditions([one.reading for one in samples], loads)
    cohesion = angle = 0.0
    shear: Shear = ()
    if strength is not None:
        cohesion, angle = strength.cohesion.value, strength.friction_angle.value
        shear = cohesion, angle, strength.shear_displacement.value
    found = neighbours(laws, conditions, effects, shear)
    compaction = found.compaction_resistance
    table = np.stack([found.sinkage, compaction, found.true_resistance - compaction])
    rolling = conditions.rolling
    table[1:, np.tile(~rolling, 9)] = 0.0
    count, reaching = len(samples), loads
    factor: Array = np.ones(count)
    if strength is not None and rolling.any():
        stages = Stages(effects, conditions)
        k = np.exp(laws[:, 0] - laws[:, 2] * math.log(REFERENCE_DIAMETER))
        on_soil, diameter, modulus, n = stages.loaded(k, laws[:, 1], laws[:, 2])
        width, sinkage = conditions.width, found.true_sinkage[:count]
        of_soil = modulus, n, np.full(count, cohesion), np.full(count, angle)
        state = WheelState(on_soil, diameter, width, sinkage, *of_soil)
        factor = np.where(rolling, stages.product("thrust_factor", state), factor)
        reaching = np.where(rolling, on_soil, loads)
    by_law = np.stack([slopes(column) for column in table])
    sunk = found.immobilised[:count]
    return _Rows(loads, noise, laws[:, 1], table[:, :count], by_law, reaching, factor, sunk)


def _conditions(readings: Sequence[Reading], loads: Array) -> Conditions:
    """Wheels under loads (N), with what is known of slip and speed."""
    columns = {
        "slip": [one.slip.value for one in readings if one.slip is not None],
        "speed": [one.speed for one in readings if one.speed is not None],
    }
    return Conditions(
        loads,
        np.array([one.wheel.diameter for one in readings]),
        np.array([one.wheel.width for one in readings]),
        np.array([one.wheel.contact for one in readings]),
        None,
        {name: np.array(known) for name, known in columns.items() if known},
    )


def mean_contacts(
    samples: Mapping[str, Sequence[Sample]],
    *,
    scatter: float = 0.0,
    effects: Sequence[Effect] = (),
    strength: Strength | None = None,
) -> dict[str, RollingContact]:
    """Means of the contacts of rolling wheels' samples, by name, as `WheelOnSoil.contact` has them.

    A wheel is left out whose first sample has none: it is sunk to its axle, or the effects do not know
    enough of it.
    """
    needs = covariates_of(effects)
    known = {
        name: [one for one in found if _knows(one.reading, needs)]
        for name, found in samples.items()
        if _knows(found[0].reading, needs)
    }

    def solve(samples: Sequence[Sample]) -> _Rows:
        return _of_model(samples, effects, strength) if effects else _plain(samples)

    with np.errstate(
        all="ignore"
    ):  # of a load that is next to none: what has no number is left out
        solved = _solved(known, solve)
    found = {}
    for name, rows in solved.items():
        contact = _mean_contact(known[name][0].reading.wheel, rows, scatter)
        if contact is not None:
            found[name] = contact
    return found


def _knows(reading: Reading, needs: Sequence[str]) -> bool:
    return all(getattr(reading, name) is not None for name in needs)


def _solved(
    samples: Mapping[str, Sequence[Sample]], solve: Callable[[Sequence[Sample]], _Rows]
) -> dict[str, _Rows]:
    """Rows of each wheel, by name: of all at once, or, where there is no sinkage, of those that have one."""
    if not samples:
        return {}
    try:
        whole = solve([one for found in samples.values() for one in found])
    except NO_SINKAGE:
        if len(samples) == 1:
            return {}
        alone = [_solved({name: found}, solve) for name, found in samples.items()]
        return {name: rows for found in alone for name, rows in found.items()}
    rows, begin = {}, 0
    for name, found in samples.items():
        rows[name] = whole.where(slice(begin, begin + len(found)))
        begin += len(found)
    return rows


def _laws_and_loads(samples: Sequence[Sample]) -> tuple[Array, Array, Array]:
    """Rows of `Law`, loads (N), and the variances of their logarithms by their noise."""
    carried = [one.law.load(one.load) for one in samples if one.load is not None]
    loads, deviations = np.array(carried).T
    laws = np.array([one.law.law for one in samples])
    laws[:, 0] -= laws[:, 1] * _LOG_DEPTH
    return laws, loads, (deviations / loads) ** 2


def _plain(samples: Sequence[Sample]) -> _Rows:
    """Without effects: of rolling wheels the sinkage alone, and its slopes by ln modulus and ln load."""
    laws, loads, noise = _laws_and_loads(samples)
    wheels = [one.reading.wheel for one in samples]
    diameter, width = np.array([(wheel.diameter, wheel.width) for wheel in wheels]).T
    modulus = np.exp(laws[:, 0] + laws[:, 2] * np.log(diameter / REFERENCE_DIAMETER))
    solved = contact_sinkage(loads, diameter, width, modulus, laws[:, 1])
    values, by_law = np.zeros((3, loads.size)), np.zeros((3, 4, loads.size))
    values[0] = solved.sinkage
    by_law[0, 3] = solved.sinkage * solved.slope_load
    by_law[0, 0] = -by_law[0, 3]
    factor, sunk = np.ones(loads.size), solved.sunk_to_axle
    return _Rows(loads, noise, laws[:, 1], values, by_law, loads, factor, sunk)


def _mean_contact(wheel: Wheel, rows: _Rows, scatter: float) -> RollingContact | None:
    """Mean over a wheel's samples. scatter: of ln k from place to place."""
    good = ~rows.immobilised & np.isfinite([*rows.values, rows.noise]).all(axis=0)
    if not good[0]:
        return None
    rows = rows.where(good)
    by_modulus, by_load, noise = rows.slopes[0, 0], rows.slopes[0, 3], rows.noise
    own = by_modulus**2 * scatter**2 + by_load**2 * noise, by_load * noise, noise
    columns = [rows.reaching, *rows.values[[0, 2]], rows.factor, *own]
    load, sinkage, other, factor, *spread = np.mean(columns, axis=1).tolist()
    size, n = (wheel.diameter, wheel.width), float(rows.exponent[0])
    zz, zw, ww = spread
    return RollingContact(load, sinkage, *size, n, other, factor, (zz, zw, ww))
