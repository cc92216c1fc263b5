# SPDX-License-Identifier: Apache-2.0
"""Random worlds of drives: vehicle, way, ground, sensors and faults are a row, a seed draws the numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from smallwheel_ros.effects.instruments import SINKAGE_ZERO_STD
from smallwheel_ros.simulate.truth import Contact
from smallwheel_ros.simulate.vehicle import SimulatedVehicle, Truth, truth_of
from smallwheel_ros.simulate.wheel_laws import RimStrength
from smallwheel_ros.simulate.world import (
    GRAVITY,
    Leg,
    Range,
    Sensors,
    SimulatedRover,
    World,
    wheels_on_axles,
)
from smallwheel_ros.simulate.world_ground import DIAMETER, SINKAGE, Started, TrueGround, TrueSoil

# What dry sand has: ln pressure at 10 mm under a wheel of 0.2 m, n and m.
_SAND = (math.log(21_500.0), 0.8, 0.39)
_SPOT = 0.5 * math.pi


Axle = tuple[float, float, float, float]


def _vehicle(
    mass: float, axles: tuple[Axle, ...], height: float, ahead: float = 0.0
) -> SimulatedRover:
    return SimulatedRover(wheels_on_axles(*axles), mass, ahead, 0.0, height)


VEHICLES = {
    "four": _vehicle(23.6, ((0.35, 0.28, 0.25, 0.10), (-0.35, 0.28, 0.25, 0.10)), 0.30, 0.02),
    "two sizes": _vehicle(
        30.0, ((0.35, 0.28, 0.25, 0.10), (-0.35, 0.42, 0.40, 0.12)), 0.35, 0.02
    ),
    "two sizes, one track": _vehicle(
        30.0, ((0.35, 0.28, 0.25, 0.10), (-0.35, 0.28, 0.40, 0.12)), 0.35, 0.02
    ),
    "six": _vehicle(
        26.0, tuple((x, 0.30, 0.22, 0.09) for x in (0.45, 0.0, -0.45)), 0.28, 0.02
    ),
    "long": _vehicle(80.0, ((0.60, 0.35, 0.40, 0.15), (-0.50, 0.35, 0.40, 0.15)), 0.45, 0.05),
    "20 kg": _vehicle(20.0, tuple((x, 0.22, 0.20, 0.08) for x in (0.28, -0.28)), 0.22),
    "35 kg, six": _vehicle(35.0, tuple((x, 0.30, 0.22, 0.10) for x in (0.42, 0.0, -0.42)), 0.24),
    "80 kg": _vehicle(80.0, tuple((x, 0.35, 0.33, 0.13) for x in (0.45, -0.45)), 0.36),
    "200 kg": _vehicle(200.0, tuple((x, 0.50, 0.50, 0.20) for x in (0.65, -0.65)), 0.55),
    "300 kg, six": _vehicle(300.0, tuple((x, 0.55, 0.46, 0.20) for x in (0.80, 0.0, -0.80)), 0.51),
}  # fmt: skip

WAYS = {
    "plain": (Leg(20.0, stand=1.0),),
    "straight": (Leg(24.0, stand=1.0),),
    "half": (Leg(12.0, stand=1.0),),
    "short": (Leg(8.0, stand=1.0),),
    "bends": (Leg(6.0, 0.2), Leg(6.0, -0.3), Leg(6.0, 0.1), Leg(6.0, stand=1.0)),
    "stop and go": (Leg(1.5, stand=2.0),) * 14,
    "stops of 40 s": (Leg(4.0, stand=40.0),) * 4,
    "manoeuvres": (Leg(3.0), Leg(-1.5, 0.5, stand=1.0), Leg(2.5, -0.4), Leg(turn=_SPOT, stand=1.0)) * 3,
    "there and back": (Leg(8.0, stand=1.0), Leg(-8.0, stand=1.0), Leg(8.0)),
    "turned": (Leg(8.0), Leg(turn=math.pi), Leg(8.0, 0.05), Leg(turn=_SPOT), Leg(6.0)),
    "turning": (Leg(6.0), Leg(turn=2.0 * math.pi)) * 4,
    "on the spot": (
        Leg(3.0, stand=1.0), Leg(turn=_SPOT), Leg(3.0, stand=1.0), Leg(turn=-2.0 * _SPOT),
        Leg(3.0, stand=1.0), Leg(turn=4.0 * _SPOT, stand=1.0), Leg(3.0), Leg(turn=-_SPOT), Leg(3.0),
        Leg(turn=3.0 * _SPOT, stand=1.0), Leg(4.0), Leg(turn=-3.0 * _SPOT), Leg(3.0),
    ),
    "to and fro": (Leg(6.0, stand=1.0), Leg(-4.0, stand=1.0), Leg(8.0), Leg(-3.0, stand=1.0), Leg(6.0)),
}  # fmt: skip


@dataclass(frozen=True)
class Feature:
    """Something of the ground that begins at a place, a share of the way, over `edge` (m).

    what: `modulus` and `grip` (ln of a factor), `exponent` (added to n), `climb` (rad), `floor` (hard ground,
    size 1). length: m, after which it ends; None: it stays.
    """

    what: str
    size: Range
    start: Range = (0.5, 0.5)
    edge: Range = (0.02, 0.02)
    length: Range | None = None


PLAIN = Sensors(
    sinkage=False, load=False, odometry_rate=(10.0, 15.0, 30.0), lag=(0.0, 0.06), noise=(0.005, 0.015),
    alike=(0.3, 0.3), scale=0.007,
)  # fmt: skip


@dataclass(frozen=True)
class RandomWorld(World):
    """A world whose numbers a seed draws, and what is told of it.

    way: one of `WAYS`, whose legs are taken by `drawn`. soil: `sand` is drawn about dry sand, as a prior has
    it; `any` so that the wheels sink by 2 to 7 % of their diameter; `loam`; `floor`. firmness: added to ln k.
    exponent: n, where it is not drawn. rolling, residual: as in `RimStrength`. priors: whether sensors,
    sides, ruts and digging are off by as much as the node's priors state. told: parameters. faults: of the
    sensors, by name, put in by the code that drives it. said: pattern of what has to be reported; "": nothing
    may be.
    """

    vehicle: str = "four"
    way: str = "plain"
    soil: str = "sand"
    features: tuple[Feature, ...] = ()
    firmness: float = 0.0
    exponent: float | None = None
    rolling: Range = (1.0, 1.0)
    residual: float = 1.0
    priors: bool = False
    told: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    said: str = ""

    def drawn(self, seed: int) -> RandomWorld:
        """The world with its way; with `priors`, what is off of sensors and soil is drawn from their priors.

        Those of docs/estimator.md: of the sinkage sensors' zero 3 mm and of their scale 0.05, of all loads'
        scale 0.1 and of each wheel's half of that, of their zero 0.03 of a wheel's load, of the sides of a
        vehicle a factor of 1.8 in k, of the delay 0.1 s, of pitch 0.01 m/rad, of ruts 0.3 in ln of the
        sinkage. Slip digs, at one deviation, as deep as half of that of its prior: it cannot fill up.
        """
        world = replace(self, legs=WAYS[self.way], floor=self.soil == "floor")
        if not self.priors:
            return world
        normal = np.random.default_rng([seed, *self.name.encode()]).standard_normal
        rover = VEHICLES[self.vehicle]
        count = len(rover.wheels)
        scales = np.exp(0.1 * normal() + 0.05 * normal(count))
        sensors = replace(
            self.sensors, zero=SINKAGE_ZERO_STD * normal(), load_scale=tuple(scales.tolist()),
            tare=0.03 * rover.mass * GRAVITY / count * normal(), delay=0.1 * abs(normal()),
            pitch_error=0.01 * normal(), torque_scale=0.1, friction=0.05,
        )  # fmt: skip
        digging = 0.05 * abs(normal())
        rut, right = math.exp(0.3 * normal()), math.log(1.8) * normal()
        sensors = replace(sensors, gain=math.exp(0.05 * normal()))
        return replace(world, sensors=sensors, rut=rut, right=right, digging=(digging, digging))


def draw_soil(world: RandomWorld, rover: SimulatedRover, rng: np.random.Generator) -> TrueSoil:
    """Draw the law and the strength."""
    rolling = rng.uniform(*world.rolling)
    if world.soil == "sand":
        pressure = _SAND[0] + 0.35 * rng.standard_normal() + world.firmness
        n = _SAND[1] + 0.15 * rng.standard_normal()
        m = _SAND[2] + 0.2 * rng.standard_normal()
        cohesion = abs(300.0 * rng.standard_normal())
        friction = max(0.475 + 0.05 * rng.standard_normal(), 0.3)
        n = float(np.clip(n, 0.35, 1.5)) if world.exponent is None else world.exponent
    else:
        cohesion, friction = abs(400.0 * rng.standard_normal()), rng.uniform(0.47, 0.65)
        n, m = rng.uniform(0.6, 1.2), _SAND[2]
        if world.soil == "loam":
            cohesion, friction, n = rng.uniform(1500.0, 4000.0), 0.35, 0.6
        wheel = rover.wheels[0]
        depth = np.array([rng.uniform(0.02, 0.07) * wheel.diameter])
        contact = Contact.at(np.array([wheel.diameter]), depth)
        carried = contact.upward(np.maximum(contact.depth, 0.0) ** n, np.array([wheel.width]))
        load = rover.mass * GRAVITY / len(rover.wheels)
        modulus = math.log(load / float(carried[0])) + world.firmness
        pressure = modulus + n * math.log(SINKAGE) - m * math.log(wheel.diameter / DIAMETER)
    shear = 0.012 * math.exp(0.3 * rng.standard_normal())
    strength = RimStrength(cohesion, friction, shear, rolling, world.residual)
    return TrueSoil(pressure, n, m, strength)


def draw_features(world: RandomWorld, rng: np.random.Generator) -> tuple[Started, ...]:
    """Draw the numbers of the features of a world."""
    length = sum(abs(leg.metres) for leg in world.legs)
    return tuple(_started(feature, length, rng) for feature in world.features)


def driven(
    world: RandomWorld, rover: SimulatedRover, ground: TrueGround, rng: np.random.Generator
) -> Truth | None:
    """The truth of a drive; None where it went on no drive that this world means."""
    sinks = [w.diameter * (0.4 if world.sticks else 0.25) for w in rover.wheels]
    deep = ground.rest[:, ground.at > -1.0].max(axis=1)
    if not np.isfinite(deep).all() or (deep > sinks).any():
        return None
    vehicle = SimulatedVehicle(world, rover, ground, rng)
    vehicle.run()
    least = 6.0 if world.sticks else 0.0
    if vehicle.failed or vehicle.path < least or (not world.sticks and vehicle.hardly):
        return None
    return truth_of(vehicle)


def _started(feature: Feature, length: float, rng: np.random.Generator) -> Started:
    start = rng.uniform(*feature.start) * length
    edge = rng.uniform(*feature.edge)
    end = math.inf if feature.length is None else start + edge + rng.uniform(*feature.length)
    return Started(feature.what, rng.uniform(*feature.size), start, edge, end)
