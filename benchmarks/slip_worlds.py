# SPDX-License-Identifier: Apache-2.0
"""Worlds of vehicles that measure neither sinkage nor load: wheel speeds, odometry, at most imu and torque.

A world is a structure of vehicle, ground, way and sensors; a seed draws the numbers.

    drive = make_drive(WORLDS["softens"], seed=1)   # of `slip_drives`
    score = run(drive)                              # of `without_soil_sensors`
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.field_worlds import Leg, Rover, axle


def _vehicle(
    mass: float, diameter: float, width: float, places: tuple[float, ...], half_track: float
) -> Rover:
    names = ("front", "rear") if len(places) == 2 else ("front", "middle", "rear")
    wheels = [
        wheel
        for name, x in zip(names, places, strict=True)
        for wheel in axle(name, x, half_track, diameter, width)
    ]
    return Rover(tuple(wheels), mass, 1.1 * diameter, 0.0)


VEHICLES = {
    "20 kg": _vehicle(20.0, 0.20, 0.08, (0.28, -0.28), 0.22),
    "35 kg, six": _vehicle(35.0, 0.22, 0.10, (0.42, 0.0, -0.42), 0.30),
    "80 kg": _vehicle(80.0, 0.33, 0.13, (0.45, -0.45), 0.35),
    "200 kg": _vehicle(200.0, 0.50, 0.20, (0.65, -0.65), 0.50),
    "300 kg, six": _vehicle(300.0, 0.46, 0.20, (0.80, 0.0, -0.80), 0.55),
}

_SPOT = 0.5 * math.pi
WAYS = {
    "straight": (Leg(24.0, stand=1.0),),
    "bends": (Leg(6.0, 0.2), Leg(6.0, -0.3), Leg(6.0, 0.1), Leg(6.0, stand=1.0)),
    "stop and go": (Leg(1.5, stand=2.0),) * 14,
    "on the spot": (
        Leg(3.0, stand=1.0), Leg(turn=_SPOT), Leg(3.0, stand=1.0), Leg(turn=-2.0 * _SPOT),
        Leg(3.0, stand=1.0), Leg(turn=4.0 * _SPOT, stand=1.0), Leg(3.0), Leg(turn=-_SPOT), Leg(3.0),
        Leg(turn=3.0 * _SPOT, stand=1.0), Leg(4.0), Leg(turn=-3.0 * _SPOT), Leg(3.0),
    ),
    "to and fro": (Leg(6.0, stand=1.0), Leg(-4.0, stand=1.0), Leg(8.0), Leg(-3.0, stand=1.0), Leg(6.0)),
}  # fmt: skip


@dataclass(frozen=True)
class SlipWorld:
    """What is in a world; lengths in m.

    ground: "soil" (granular, drawn about sand), "loam" (cohesive), "floor". speed: m/s. slope: deviation of
    the waves, rad. softens: factors between which the sinkage rises from a place on. slippery: factors on
    grip from a place on. steepens: rad between which a slope rises. bumps: height over the diameter.
    ends: of the floor, where soil begins. odometry: "own" is made of pictures or echoes, "wheels" of the
    joints, "filter" of joints and imu, "half" a filter of wheels and pictures. lag: s. noise: m/s. told:
    deviation in the messages over the true one, 0: none is given. stuck: whether it may get stuck.
    """

    name: str
    vehicle: str = "20 kg"
    ground: str = "soil"
    way: str = "straight"
    speed: float = 0.4
    slope: float = 0.04
    softens: tuple[float, float] | None = None
    slippery: tuple[float, float] | None = None
    steepens: tuple[float, float] | None = None
    edge: tuple[float, float] = (0.5, 4.0)
    bumps: float = 0.0
    ends: float | None = None
    odometry: str = "own"
    lag: tuple[float, float] = (0.0, 0.06)
    noise: tuple[float, float] = (0.005, 0.015)
    told: float = 1.0
    imu: bool = True
    torque: bool = False

    @property
    def digs(self) -> bool:
        """Whether the ground gives way somewhere."""
        return bool(self.softens or self.slippery or self.steepens)

    @property
    def quiet(self) -> bool:
        """Firm floors, turns on the spot and bumps: no warning is right there."""
        return not self.digs and (self.ground == "floor" and self.ends is None) | (
            self.way == "on the spot" or self.bumps > 0.0
        )


_SOFT, _STEEP, _SLIPPERY = (1.8, 4.0), (0.25, 0.6), (0.25, 0.6)
_ALL = (
    SlipWorld("soil"),
    SlipWorld("soil, six", "35 kg, six", way="bends"),
    SlipWorld("soil, 80 kg", "80 kg", way="bends", speed=0.7, told=0.0),
    SlipWorld("soil, 200 kg", "200 kg", speed=1.0, told=0.5),
    SlipWorld("soil, 300 kg", "300 kg, six", speed=0.8),
    SlipWorld("loam", "80 kg", "loam", "bends", told=2.0),
    SlipWorld("slopes", "35 kg, six", slope=0.10),
    SlipWorld("no imu", slope=0.07, imu=False),
    SlipWorld("torque", "80 kg", slope=0.07, torque=True),
    SlipWorld("stop and go", way="stop and go"),
    SlipWorld("stop and go, 200 kg", "200 kg", way="stop and go", speed=0.8, told=0.0),
    SlipWorld("to and fro", "35 kg, six", way="to and fro"),
    SlipWorld("late odometry", lag=(0.1, 0.2), way="stop and go", noise=(0.01, 0.02), told=0.5),
    SlipWorld("noisy odometry", "80 kg", noise=(0.02, 0.04), told=0.5),
    SlipWorld("slow", speed=0.12),
    SlipWorld("softens", softens=_SOFT),
    SlipWorld("softens, six", "35 kg, six", softens=_SOFT, speed=0.3),
    SlipWorld("softens, 80 kg", "80 kg", softens=_SOFT, told=0.0),
    SlipWorld("softens, 200 kg", "200 kg", softens=_SOFT, speed=0.8),
    SlipWorld("softens, 300 kg", "300 kg, six", softens=_SOFT, speed=0.6, told=2.0),
    SlipWorld("softens, no imu", softens=_SOFT, imu=False),
    SlipWorld("softens, torque", "80 kg", softens=_SOFT, torque=True),
    SlipWorld("slippery", "80 kg", "loam", slippery=_SLIPPERY),
    SlipWorld("slippery, 20 kg", slippery=_SLIPPERY, told=0.5),
    SlipWorld("steepens", "35 kg, six", steepens=_STEEP, edge=(2.0, 8.0)),
    SlipWorld("steepens, 200 kg", "200 kg", steepens=_STEEP, edge=(3.0, 10.0), speed=0.8),
    SlipWorld("floor ends", "20 kg", "floor", ends=8.0, softens=_SOFT),
    SlipWorld("floor", ground="floor", way="bends", slope=0.02),
    SlipWorld("floor, 80 kg, stops", "80 kg", "floor", "stop and go", 0.8, told=0.0),
    SlipWorld("floor, 300 kg, ramps", "300 kg, six", "floor", slope=0.10, speed=1.0),
    SlipWorld("floor, late odometry", "35 kg, six", "floor", "stop and go", 0.6, lag=(0.1, 0.2)),
    SlipWorld("floor, bumps", "35 kg, six", "floor", bumps=0.12, speed=0.5),
    SlipWorld("floor, bumps, 80 kg", "80 kg", "floor", bumps=0.12, speed=1.0, told=0.0),
    SlipWorld("soil, bumps", bumps=0.08),
    SlipWorld("soil, bumps, 200 kg", "200 kg", bumps=0.08, speed=0.8),
    SlipWorld("on the spot, floor", "35 kg, six", "floor", "on the spot"),
    SlipWorld("on the spot", "35 kg, six", way="on the spot", told=0.0),
    SlipWorld("on the spot, 80 kg", "80 kg", way="on the spot", speed=0.6),
    SlipWorld("wheel odometry", odometry="wheels"),
    SlipWorld("wheel odometry, floor", "80 kg", "floor", "bends", odometry="wheels"),
    SlipWorld("filter of wheels and imu", "35 kg, six", way="bends", odometry="filter"),
    SlipWorld("filter, stop and go", "80 kg", way="stop and go", odometry="filter", told=0.0),
    SlipWorld("filter, softens", softens=_SOFT, odometry="filter"),
    SlipWorld("filter, on the spot", "35 kg, six", way="on the spot", odometry="filter"),
    SlipWorld("half of wheels", odometry="half"),
)  # fmt: skip
WORLDS = {world.name: world for world in _ALL}
