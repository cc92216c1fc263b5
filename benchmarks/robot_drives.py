# SPDX-License-Identifier: Apache-2.0
"""Drives through `robot_worlds`: what is true, and what the sensors show of it.

The truth is a contact integral of its own (`simulate.truth`, quadrature), with ground, ruts, digging
and sensors composed here and nowhere in the estimator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.robot_worlds import VEHICLES, World
from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.motion import rut_of
from smallwheel_ros.pipeline.tables import Array, Readings, unknown
from smallwheel_ros.simulate.truth import static_sinkage

RATE = 10.0  # Hz, of sinkage with its load
SPEED = 0.3  # m/s
STD = (0.5, 0.2, 0.3)  # of ln pressure, n and m about the prior, for the truth
LOG_SINKAGE = math.log(REFERENCE_SINKAGE)
_LOCAL = 0.25  # m, over which the soil's texture is correlated
_AHEAD = 0.35  # m that the front wheels are ahead of the vehicle's middle
_WITHIN = 1.35  # m of the front wheels' way behind a border: 1 m of the vehicle's middle


@dataclass(frozen=True)
class RobotDrive:
    """Rows of all wheels in order, and of each the true sinkage (m).

    at: m along the vehicle's path, shape (places,). soils: lowest and highest ln pressure, n and
    ln k D^m under the wheels there, shape (places, 3, 2). m: of the diameter. border: the first, m,
    or None.
    """

    world: World
    prior: SoilPrior
    rows: Readings
    sinkage: Array
    at: Array
    soils: Array
    m: float
    border: float | None


def table_of(**columns: Any) -> Readings:
    """A table of these columns; of all others nothing is known."""
    none = unknown(len(columns["stamp"]))
    return Readings(**({field.name: none for field in fields(Readings)} | columns))


def _smooth(rng: np.random.Generator, count: int, std: float, keep: float) -> Array:
    values = std * rng.standard_normal(count)
    for i in range(1, count):
        values[i] = keep * values[i - 1] + math.sqrt(1.0 - keep * keep) * values[i]
    return values


@dataclass(frozen=True)
class _Ground:
    """In steps of 1 cm along the way, m: ln of the factor on k, what n is more by, and the tracks' own.

    tracks: ln of factors on k, shape (4, places).
    """

    way: Array
    common: Array
    exponent: Array
    tracks: Array


def _ground(world: World, rng: np.random.Generator) -> _Ground:
    count = int((world.distance + 4.0) / 0.01)
    way = 0.01 * np.arange(count) - 2.0
    common = np.cumsum(rng.standard_normal(count)) * world.drift * math.sqrt(0.01 / 5.0)
    exponent = np.zeros(count)
    for place, factor, more in world.borders:
        share = np.clip((way - place) / max(world.border_length, 1e-6), 0.0, 1.0)
        common, exponent = common + math.log(factor) * share, exponent + more * share
    keep = math.exp(-0.01 / _LOCAL)
    tracks = np.array([_smooth(rng, count, world.scatter, keep) for _ in range(4)])
    tracks[1::2] += math.log(world.right)
    return _Ground(way, common, exponent, tracks)


def _soils(world: World, ground: _Ground, at: Array, pressure: float, n: float) -> Array:
    """Lowest and highest ln pressure, n and ln k D^m, shape (places, 3, 2), that count as right.

    A border that the front wheels have come to has to be found within a metre: so long the soil
    behind it counts as well. Where sides differ, so do all between them; of bedrock, any.
    """
    if world.bedrock is not None:
        return np.tile([-np.inf, np.inf], (len(at), 3, 1))
    places = at[:, None] + np.linspace(_AHEAD - _WITHIN, _AHEAD, 28)
    there = np.where(places > _turn(world), 2.0 * _turn(world) - places, places)
    low = pressure + np.interp(there, ground.way, ground.common)
    low = low + np.where(places > _turn(world), math.log(world.back), 0.0)
    exponent = n + np.interp(there, ground.way, ground.exponent)
    found = []
    for values, more in (
        (low, world.right),
        (exponent, 1.0),
        (low - exponent * LOG_SINKAGE, world.right),
    ):
        both = np.concatenate([values, values + math.log(more)], axis=1)
        found.append(np.stack([both.min(1), both.max(1)], axis=1))
    return np.stack(found, axis=1)


def _turn(world: World) -> float:
    """Where the vehicle turns back (m)."""
    return math.inf if world.back == 1.0 else 0.5 * world.distance


def make_drive(world: World, seed: int) -> RobotDrive:
    """Draw a drive; a soil that does not carry the wheels is drawn again."""
    rng = np.random.default_rng([seed, 4711])
    base = soil("dry_sand")
    wheels = VEHICLES[world.vehicle]
    ground = _ground(world, rng)
    driving = int(world.distance / SPEED * RATE)
    path = np.cumsum(SPEED / RATE * (1.0 + 0.3 * np.sin(0.7 * np.arange(driving) / RATE)))
    path *= world.distance / path[-1]
    turning = np.zeros(driving)  # rad/s
    standing = int(8.0 * RATE)
    for i in range(world.turns):
        at = int((i + 1) / (world.turns + 1) * len(path))
        path = np.insert(path, at, np.full(standing, path[at]))
        turning = np.insert(turning, at, np.full(standing, 2.0 * math.pi / 8.0))
    time = np.arange(len(path)) / RATE
    speed = np.gradient(path, time)
    climb = sum(
        a * np.sin(2.0 * np.pi * path / length + rng.uniform(0.0, 6.28))
        for a, length in ((0.06, 9.0), (0.06, 4.0))
    )
    bumps = 3.0 if world.delay else 1.0
    twist = sum(
        a * np.sin(2.0 * np.pi * path / length + rng.uniform(0.0, 6.28))
        for a, length in ((0.22, 2.6 / bumps), (0.18, 1.4 / bumps))
    )
    twist = world.load_swing * twist
    grip = (
        0.06
        + 0.9 * np.clip(climb, -0.03, 1.0)
        + 0.3
        * np.clip(np.sin(2.0 * np.pi * path / 6.0 + rng.uniform(0.0, 6.28)) - 0.8, 0.0, 1.0)
        / 0.2
    )
    while True:
        off = [std * rng.standard_normal() for std in STD]
        pressure, n, m = (
            mean + part
            for mean, part in zip((base.log_reference_pressure, base.n, base.m), off, strict=True)
        )
        if world.exponent is not None:
            n = world.exponent
        if world.firm:
            pressure += 3.2
        if not 0.25 < n < 1.8:
            continue
        parts = _truth(world, wheels, (pressure, n, m), ground, path, climb, twist, grip)
        if all(_carried(z, w) for (z, *_), w in zip(parts, wheels, strict=True)):
            break
    tables, true = [], []
    for j, (wheel, (z, load, slip)) in enumerate(zip(wheels, parts, strict=True)):
        shown, weighed = _sensors(world, rng, j, wheel, z, load, climb, time)
        slip = 1.0 - world.odometry * (1.0 - slip)
        own = np.concatenate(
            [[0.0], np.cumsum(np.abs(speed - turning * wheel.lateral_position)[1:] / RATE)]
        )
        moving = np.abs(speed) > 0.02
        heard = np.ones(len(time), dtype=bool)
        if world.silent == j:
            heard = (path <= world.distance / 3) | (path >= world.distance / 3 + 3.0)
        seen = np.clip(slip + 0.02 * _drawn_where(rng, moving & heard), -1.0, 1.0)
        count, yes = len(time), np.ones(len(time), dtype=bool)
        table = table_of(
            stamp=np.array([round(1e9 * (t + 0.001 * j)) for t in time]), wheel=np.full(count, j),
            sinkage=shown, sinkage_std=np.full(count, world.noise), load=weighed,
            load_std=world.told * world.load_noise * weighed,
            vehicle_speed=world.odometry * np.abs(speed), speed=world.odometry * np.abs(speed),
            speed_std=np.zeros(count), rim_std=np.zeros(count), slip=np.where(moving, seen, np.nan),
            slip_std=np.where(moving, 0.02, np.nan), stands=~yes, forward=yes, pitch=-climb,
            distance=world.odometry * path, path=world.odometry * own, onward=yes, due=yes,
        )  # fmt: skip
        tables.append(table.take(heard))
        true.append(z[heard])
    rows = Readings.joined(tables)
    order = np.argsort(rows.stamp, kind="stable")
    rows, z = rows.take(order), np.concatenate(true)[order]
    passes, doubt = rut_of(wheels, rows.wheel, rows.onward, unknown(len(rows)))  # no places
    rows = replace(rows, passes=passes, pass_doubt=doubt)
    prior = replace(
        SoilPrior.from_soil(base),
        log_reference_pressure=base.log_reference_pressure - world.prior[0],
        n=max(base.n - world.prior[1], 0.2),
    )
    at = np.linspace(0.0, world.distance, 241)
    return RobotDrive(
        world,
        prior,
        rows,
        z,
        world.odometry * at,
        _soils(world, ground, at, pressure, n),
        m,
        world.borders[0][0] if world.borders else None,
    )


def _drawn_where(rng: np.random.Generator, wanted: Array) -> Array:
    """Standard normal numbers where they are wanted, and 0."""
    drawn = np.zeros(len(wanted))
    drawn[wanted] = rng.standard_normal(int(wanted.sum()))
    return drawn


def _carried(sinkage: Array, wheel: Wheel) -> bool:
    return bool(np.isfinite(sinkage).all() and sinkage.max() < 0.4 * wheel.diameter)


def _truth(
    world: World,
    wheels: tuple[Wheel, ...],
    law: tuple[float, float, float],
    ground: _Ground,
    path: Array,
    climb: Array,
    twist: Array,
    grip: Array,
) -> list[tuple[Array, Array, Array]]:
    """True sinkage, load and slip of each wheel."""
    pressure, n, m = law
    parts = []
    for j, wheel in enumerate(wheels):
        place = path + wheel.longitudinal_position
        track = j % 2 if "one track" in world.vehicle else j
        there = np.where(place > _turn(world), 2.0 * _turn(world) - place, place)
        local = np.interp(there, ground.way, ground.common + ground.tracks[track])
        local = local + np.where(place > _turn(world), math.log(world.back), 0.0)
        exponent = n + np.interp(there, ground.way, ground.exponent)
        side = 1.0 if j in (0, 3) else -1.0
        end = 1.0 if wheel.longitudinal_position > 0 else -1.0
        transfer = 0.9 * end * world.load_swing * climb
        load = 58.0 * (1.0 - transfer) * np.maximum(1.0 + side * twist, 0.15)
        modulus = np.exp(
            pressure
            + local
            - exponent * math.log(REFERENCE_SINKAGE)
            + m * math.log(wheel.diameter / REFERENCE_DIAMETER)
        )
        rear = wheel.longitudinal_position < 0
        if rear:
            modulus = modulus * world.rut_modulus
        z = static_sinkage(
            partial(_pressure, modulus[:, None], exponent[:, None], world.bedrock),
            load,
            np.full(len(path), wheel.diameter),
            np.full(len(path), wheel.width),
        )
        slip = np.clip(grip, -0.05, 0.5)
        # Soil that is carried out from under the wheel: deeper with the square root at little slip.
        dig = np.where(slip > 0, slip * (1.0 + 0.4 * slip), 0.0)
        z = z * (1.0 + world.slip_sinkage * dig)
        if rear:
            z = z * world.rut_sinkage
        parts.append((z, load, slip))
    return parts


def _pressure(modulus: Array, exponent: Array, bedrock: float | None, depth: Array) -> Array:
    """Pressure at a depth."""
    depth = np.maximum(depth, 0.0)
    pressure: Array = modulus * depth**exponent
    if bedrock is not None:
        pressure = pressure + 29.0 * modulus * np.maximum(depth**exponent - bedrock**exponent, 0.0)
    return pressure


def _sensors(
    world: World,
    rng: np.random.Generator,
    j: int,
    wheel: Wheel,
    z: Array,
    load: Array,
    climb: Array,
    time: Array,
) -> tuple[Array, Array]:
    """What the sensors of sinkage and load show."""
    count = len(z)
    late = np.interp(time - world.delay, time, z)
    length = np.sqrt(np.maximum(z, 1e-6) * wheel.diameter)
    shown = late - world.rebound * load / (wheel.width * length)
    shown = world.gain * shown + world.zero - world.pitch_error * climb
    shown = shown + world.zero_drift * np.linspace(0.0, 1.0, count)
    if world.rough:
        # The surface that the sensor looks at, correlated over 5 cm.
        keep = math.exp(-SPEED / RATE / 0.05)
        shown = shown + _smooth(rng, count, world.rough, keep)
    if world.correlated:
        shown = shown + _smooth(rng, count, world.correlated, math.exp(-1.0 / RATE))
    shown = shown + np.hypot(world.noise, 0.03 * z) * rng.standard_normal(count)
    wild = rng.uniform(size=count) < world.outliers
    shown = np.where(wild, z * rng.uniform(2.0, 5.0, count) + rng.uniform(0, 0.02, count), shown)
    if world.step:
        shown = world.step * np.round(shown / world.step)
    if world.stuck == j:
        third = count // 3
        shown[third:] = shown[third]
    weighed = load * world.load_scale[j] * (1.0 + world.load_noise * rng.standard_normal(count))
    weighed = np.maximum(weighed + 0.4 * rng.standard_normal(count), 0.1)
    return shown, weighed + world.load_tare
