# SPDX-License-Identifier: Apache-2.0
"""Worlds for strength, grip and risk: slippery patches, slopes, firm and soft ground.

The truth integrates shear stress along the arc with Wong and Reece's displacement (1967), so that a
wheel has thrust at no slip, and takes slip from the balance of the whole vehicle; the model has one
shear displacement for the contact as a whole, and no such thrust. Grip varies in blocks with soft
edges, of which the estimator's fading cells know nothing.

    drive = make_drive(WORLDS["patch"], seed=1)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.robot_worlds import VEHICLES
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.simulate.truth import Contact, static_sinkage

Array = NDArray[np.float64]

GRAVITY = 9.81
MASS = 23.6  # kg
RATE = 10.0  # Hz
RIM_SPEED = 0.3  # m/s
STUCK = 0.8  # slip that the vehicle does not get over
REFERENCE_SLIP = 0.4
_SLIPS = np.array([-0.3, -0.15, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, STUCK])
_CELL = 0.02  # m, of the truth along the path
_AMPLE = 0.04  # reserve of drives on which nothing is to be warned of


@dataclass(frozen=True)
class TractionWorld:
    """A structure of ground and vehicle.

    patch: factors on grip between which that of one long patch is drawn; slope: rad that it rises
    to, over a ramp between these lengths (m); lowered: factor on k at half way; firmness: added to ln
    pressure. grip_varies, own_grip: deviations of ln grip, of places and of what each wheel finds besides.
    rolling: share of the displacement by rolling that shears soil, as a tread yields; residual: what is
    left of the shear stress far behind its peak (Wong 1979), over that; dragging: resistance that no law
    of sinkage gives, over load.
    """

    name: str
    vehicle: str = "two sizes"
    distance: float = 16.0
    patch: tuple[float, float] | None = None
    slope: float | None = None
    ramp: tuple[float, float] = (4.0, 7.0)
    lowered: float = 1.0
    firmness: float = 0.0
    grip_varies: float = 0.18
    own_grip: float = 0.05
    torque_scale: float = 0.03
    friction: float = 0.05  # N m in the drive
    rolling: float = 1.0
    residual: float = 1.0
    dragging: float = 0.0


WORLDS = {
    w.name: w
    for w in (
        TractionWorld("cruise"),
        TractionWorld("cruise, equal", "equal"),
        TractionWorld("patch", patch=(0.15, 0.7)),
        TractionWorld("patch, equal", "equal", patch=(0.15, 0.7)),
        TractionWorld("slope", slope=0.5),
        TractionWorld("slow slope", slope=0.45, distance=34.0, ramp=(20.0, 28.0)),
        TractionWorld("soft ahead", lowered=0.5),
        TractionWorld("firm", firmness=1.5),
        TractionWorld("bad motors", torque_scale=0.12, friction=0.15),
        TractionWorld("other shear", slope=0.4, rolling=0.3, residual=0.8, dragging=0.015),
        TractionWorld("even patch", patch=(0.15, 0.5), grip_varies=0.05),
        TractionWorld("even slope", slope=0.5, distance=26.0, ramp=(10.0, 16.0), grip_varies=0.05),
        TractionWorld("uneven", grip_varies=0.3, own_grip=0.1),
    )
}


@dataclass
class TractionDrive:
    """What was true and what was measured; arrays over time, those of wheels (time, wheels).

    stuck: the last instant is one of no way on. held: pull at the reference slip, N.
    """

    world: TractionWorld
    time: Array
    path: Array
    speed: Array
    climb: Array
    load: Array
    sinkage: Array
    slip: Array
    pull: Array
    held: Array
    shown_sinkage: Array
    weighed: Array
    rim: Array
    odometry: Array
    pitch: Array
    torque: Array
    pulled: Array
    stuck: bool
    law: tuple[float, float, float]

    @property
    def true_margin(self) -> Array:
        """Of the vehicle: pull of all wheels at the reference slip over the load of all."""
        return self.held.sum(axis=1) / self.load.sum(axis=1)

    @property
    def reserve(self) -> Array:
        """True reserve: margin less the tangent of the slope."""
        return self.true_margin - np.tan(self.climb)


def _blocks(rng: np.random.Generator, way: Array, spread: float) -> Array:
    """Ln grip in blocks of 0.4 to 2 m with edges of 10 cm."""
    edges, values = [way[0]], []
    while edges[-1] < way[-1]:
        edges.append(edges[-1] + rng.uniform(0.4, 2.0))
        values.append(spread * rng.standard_normal())
    plain = np.array(values)[np.searchsorted(edges, way, side="right") - 1]
    kernel = np.ones(5) / 5.0
    return np.convolve(np.pad(plain, 2, mode="edge"), kernel, mode="valid")


def forces(
    law: Callable[[Array], Array],
    sinkage: Array,
    wheel: Wheel,
    strength: Array,
    slips: Array,
    rolling: float = 1.0,
    residual: float = 1.0,
) -> tuple[Array, Array, Array]:
    """Thrust (N) and torque (N m) for each place and slip, without the factor of grip.

    law: pressure (Pa) at depths (m), shape (places, nodes). strength: cohesion (Pa), friction angle and
    shear displacement (m). rolling, residual: as in `TractionWorld`. Returns thrust (places, slips),
    resistance (places,), torque (places, slips).
    """
    diameter, width = wheel.diameter, wheel.width
    contact = Contact.at(np.full(len(sinkage), diameter), sinkage)
    stress = law(contact.depth)
    cohesion, friction, shear = strength
    radius = diameter / 2
    entry = contact.entry[:, None]
    thrusts, torques = [], []
    for slip in slips:
        # A skidding wheel turns slower than it travels: 1 - r omega / v as rim over travel.
        ratio = 1.0 - slip if slip >= 0 else 1.0 / (1.0 + slip)
        lower = np.sin(entry) - np.sin(contact.angle)
        by_rolling = rolling * (entry - contact.angle - lower)
        moved = radius * (by_rolling + (1.0 - ratio) * lower)
        shown = -np.expm1(-np.abs(moved) / shear) * np.sign(moved)
        shown *= residual + (1.0 - residual) * np.exp(-np.abs(moved) / (5.0 * shear))
        tangential = (cohesion + stress * math.tan(friction)) * shown
        area = width * radius * contact.weight
        thrusts.append(np.sum(tangential * np.cos(contact.angle) * area, axis=1))
        torques.append(radius * np.sum(tangential * area, axis=1))
    resistance = contact.backward(stress, np.full(len(sinkage), width))
    return np.stack(thrusts, 1), resistance, np.stack(torques, 1)


def make_drive(world: TractionWorld, seed: int) -> TractionDrive:
    """Draw a drive on a soil that carries the wheels."""
    rng = np.random.default_rng([seed, 815])
    wheels = VEHICLES[world.vehicle]
    while True:
        law, strength = drawn(world, rng)
        found = make_truth(world, rng, wheels, law, strength)
        if found is None:
            continue
        drive = _measured(world, rng, wheels, found, law)
        if world.patch or world.slope or drive.reserve.min() > _AMPLE:
            return drive


def drawn(
    world: TractionWorld, rng: np.random.Generator
) -> tuple[tuple[float, float, float], Array]:
    """Law (ln reference pressure, n, m) and strength (Pa, rad, m) of a soil around dry sand."""
    base = soil("dry_sand")
    while True:
        pressure = base.log_reference_pressure + 0.4 * rng.standard_normal() + world.firmness
        n, m = base.n + 0.15 * rng.standard_normal(), base.m + 0.2 * rng.standard_normal()
        strength = np.array(
            [
                abs(300.0 * rng.standard_normal()),
                base.friction_angle + 0.06 * rng.standard_normal(),
                0.012 * math.exp(0.35 * rng.standard_normal()),
            ]
        )
        if 0.3 < n < 1.6 and strength[1] > 0.25:
            return (pressure, n, m), strength


def make_truth(world, rng, wheels, soil_law, strength, slips=_SLIPS, level=False):  # type: ignore[no-untyped-def]
    """Way, climb, loads, sinkages, pulls and torques along it by slips; None where it does not carry."""
    pressure, n, m = soil_law
    way = np.arange(-1.0, world.distance + 1.5, _CELL)
    climb = sum(
        (0.0 if level else a) * np.sin(2 * np.pi * way / length + rng.uniform(0, 6.28))
        for a, length in ((0.05, 9.0), (0.03, 3.5))
    )
    if world.slope is not None and not level:
        start = min(rng.uniform(0.25, 0.5) * world.distance, 9.0)
        climb = climb + world.slope * np.clip((way - start) / rng.uniform(*world.ramp), 0.0, 1.0)
    grip = _blocks(rng, way, world.grip_varies)
    if world.patch is not None:
        low = math.log(rng.uniform(*world.patch))
        start = rng.uniform(0.35, 0.7) * world.distance
        edge, long = rng.uniform(0.3, 1.0), rng.uniform(1.0, 3.0)
        grip = grip + low * np.clip((way - start) / edge, 0, 1) * np.clip(
            (start + long + edge - way) / edge, 0, 1
        )
    soft = np.zeros(len(way))
    if world.lowered != 1.0:
        soft = math.log(world.lowered) * np.clip(way - 0.5 * world.distance, 0.0, 1.0)
    twist = 0.15 * np.sin(2 * np.pi * way / 2.3 + rng.uniform(0, 6.28))
    loads, sinkages, nets, torques = [], [], [], []
    inside = (way >= 0) & (way <= world.distance)
    for j, wheel in enumerate(wheels):
        place = way + wheel.longitudinal_position
        own = np.interp(place, way, grip) + world.own_grip * np.interp(
            place, way, _blocks(rng, way, 1.0)
        )
        local = np.interp(place, way, soft + 0.06 * _blocks(rng, way, 1.0))
        side = 1.0 if j in (0, 3) else -1.0
        end = 1.0 if wheel.longitudinal_position > 0 else -1.0
        load = (
            MASS
            * GRAVITY
            / 4
            * np.cos(climb)
            * (1 - 0.7 * end * np.tan(climb))
            * (1 + side * twist)
        )
        modulus = np.exp(
            pressure
            + local
            - n * math.log(REFERENCE_SINKAGE)
            + m * math.log(wheel.diameter / REFERENCE_DIAMETER)
        )

        def law(depth: Array, modulus: Array = modulus) -> Array:
            return modulus[:, None] * np.maximum(depth, 0.0) ** n

        z = static_sinkage(
            law,
            load,
            np.full(len(way), wheel.diameter),
            np.full(len(way), wheel.width),
        )
        if not np.isfinite(z[inside]).all() or z[inside].max() > 0.3 * wheel.diameter:
            return None
        z = np.nan_to_num(z, nan=0.1)
        by_world = world.rolling, world.residual
        thrust, resistance, torque = forces(law, z, wheel, strength, slips, *by_world)
        resistance = resistance + world.dragging * load
        factor = np.exp(own)[:, None]
        loads.append(load)
        sinkages.append(z)
        nets.append(thrust * factor - resistance[:, None])
        torques.append(torque * factor)
    return way, climb, np.array(loads), np.array(sinkages), np.array(nets), np.array(torques)


def _measured(world, rng, wheels, truth, law):  # type: ignore[no-untyped-def]
    way, climb, loads, sinkages, nets, torques = truth
    total = nets.sum(axis=0)
    # Drive: the rim's speed varies, slip follows from the balance at each instant.
    at, speed, rows, stuck = 0.0, RIM_SPEED * 0.9, [], False
    for i in range(int(6 * world.distance / RIM_SPEED * RATE)):
        rim = RIM_SPEED * (1.0 + 0.15 * math.sin(0.5 * i / RATE))
        cell = min(int((at - way[0]) / _CELL), len(way) - 1)
        curve = np.maximum.accumulate(total[cell])
        # The balance with the inertia of getting to the speed that a slip has.
        travel = np.where(_SLIPS >= 0, rim * (1 - _SLIPS), rim / (1 + np.minimum(_SLIPS, 0)))
        left = curve - MASS * (GRAVITY * math.sin(climb[cell]) + (travel - speed) * RATE * 0.2)
        slip = float(np.interp(0.0, left, _SLIPS)) if left[-1] > 0 else 1.0
        slip = max(slip, float(_SLIPS[0]))
        now = rim * (1 - slip) if slip >= 0 else rim / (1 + slip)
        rows.append((i / RATE, at, now, (now - speed) * RATE * 0.2, slip, rim, cell))
        speed = now
        at += now / RATE
        if slip >= STUCK:
            stuck = len(rows) > 5 and all(row[4] >= STUCK for row in rows[-5:])
            if stuck:
                break
        if at > world.distance:
            break
    time, path, speeds, _, slip, rim, cells = (np.array(c) for c in zip(*rows, strict=True))
    cells = cells.astype(int)
    load, z = loads[:, cells].T, sinkages[:, cells].T
    held = np.clip(slip, _SLIPS[0], STUCK)
    pull = np.array(
        [
            [np.interp(s, _SLIPS, nets[j, c]) for j in range(4)]
            for s, c in zip(held, cells, strict=True)
        ]
    )
    torque = np.array(
        [
            [np.interp(s, _SLIPS, torques[j, c]) for j in range(4)]
            for s, c in zip(held, cells, strict=True)
        ]
    )
    there = np.array(
        [[np.interp(REFERENCE_SLIP, _SLIPS, nets[j, c]) for j in range(4)] for c in cells]
    )
    count = len(time)
    normal = rng.standard_normal
    radius_error = 1.0 + 0.01 * normal(4)
    scale = 1.0 + world.torque_scale * normal(4)
    shown = torque + world.friction + 0.03 * normal((count, 4))
    return TractionDrive(
        world,
        time,
        path,
        speeds,
        climb[cells],
        load,
        z,
        slip,
        pull,
        there,
        z + 1e-3 * normal((count, 4)),
        np.maximum(load * (1 + 0.02 * normal((count, 4))), 1.0),
        rim[:, None] * radius_error + 0.002 * normal((count, 4)),
        speeds + 0.008 * normal(count),
        -(climb[cells] + math.radians(0.3) * normal() + math.radians(0.3) * normal(count)),
        shown * scale,
        pull + 0.6 * normal((count, 4)),
        stuck,
        law,
    )
