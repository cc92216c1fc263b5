# SPDX-License-Identifier: Apache-2.0
"""Drives as robots have them: stops, creeping, manoeuvres, ruts; wrong wiring, sensors that die.

A world is a row of settings; a seed draws its soil, ground, vehicle and noise.

    drive = make_drive(WORLDS["loads in kg"], seed=1)   # of `field_drives`
    score = run(drive)                                  # of `field_scores`
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from smallwheel_ros.physics.wheel import Wheel


@dataclass(frozen=True)
class Rover:
    """Wheels on a frame. mass: kg; height, ahead: of the centre of gravity, m."""

    wheels: tuple[Wheel, ...]
    mass: float
    height: float
    ahead: float = 0.02


def axle(name: str, x: float, half_track: float, diameter: float, width: float) -> list[Wheel]:
    return [
        Wheel(
            f"{name}_{side}",
            diameter,
            width,
            longitudinal_position=x,
            lateral_position=sign * half_track,
        )
        for side, sign in (("left", 1.0), ("right", -1.0))
    ]


ROVERS = {
    "equal": Rover(
        (*axle("front", 0.35, 0.28, 0.25, 0.10), *axle("rear", -0.35, 0.28, 0.25, 0.10)),
        23.6,
        0.30,
    ),
    "two sizes": Rover(
        (*axle("front", 0.35, 0.28, 0.25, 0.10), *axle("rear", -0.35, 0.42, 0.40, 0.12)),
        30.0,
        0.35,
    ),
    "six": Rover(
        (
            *axle("front", 0.45, 0.30, 0.22, 0.09),
            *axle("middle", 0.0, 0.30, 0.22, 0.09),
            *axle("rear", -0.45, 0.30, 0.22, 0.09),
        ),
        26.0,
        0.28,
    ),
    "long": Rover(
        (*axle("front", 0.60, 0.35, 0.40, 0.15), *axle("rear", -0.50, 0.35, 0.40, 0.15)),
        80.0,
        0.45,
        0.05,
    ),
}


@dataclass(frozen=True)
class Leg:
    """Drive so far (m, backward below 0) along a bend (1/m), or turn on the spot (rad), then stand (s)."""

    metres: float = 0.0
    bend: float = 0.0
    turn: float = 0.0
    stand: float = 0.0


def _repeated(*legs: Leg, times: int) -> tuple[Leg, ...]:
    return legs * times


PROFILES = {
    "plain": (Leg(20.0, stand=1.0),),
    "stop and go": _repeated(Leg(1.5, stand=3.0), times=14),
    "stops of 40 s": _repeated(Leg(4.0, stand=40.0), times=4),
    "short": (Leg(8.0, stand=1.0),),
    "manoeuvres": _repeated(
        Leg(3.0), Leg(-1.5, 0.5, stand=1.0), Leg(2.5, -0.4), Leg(turn=1.57, stand=1.0), times=3
    ),
    "there and back": (Leg(8.0, stand=1.0), Leg(-8.0, stand=1.0), Leg(8.0)),
    "turned": (Leg(8.0), Leg(turn=math.pi), Leg(8.0, 0.05), Leg(turn=1.57), Leg(6.0)),
    "parked": (Leg(6.0, stand=600.0), Leg(4.0)),
}


@dataclass(frozen=True)
class FieldWorld:
    """What is in a world besides the nominal; a sensor's fault begins after `onset` m.

    speed: m/s. ramp: m/s^2 of the rims. slope: deviation, rad. mass, imu: whether they are told and there.
    zero_std: of the sinkage sensors, as told. rut: factor on the sinkage of a wheel in a track, once.
    border: m, behind which k is 1.5 times as much. random_ground: deviation of ln k over 1 m. hardpan: m.
    classes: m of each of two soils in turn. alike: s over which errors of the odometry are alike.
    spare: share of the weight on a wheel that nobody listed. swapped: wheels whose loads are. mirrored:
    places of the wheels are told the wrong way round. tilt, walk: of the imu, rad, and rad per minute.
    encoder: of the first wheel, "zero" or "holds"; odometry: "repeats"; frozen: m, by which the first
    wheel's frozen sinkage wavers. said: what has to be said of it; "": nothing.
    """

    name: str
    rover: str = "equal"
    profile: str = "plain"
    speed: float = 0.3
    ramp: float = 0.6
    slope: float = 0.06
    mass: bool = True
    imu: bool = True
    zero_std: float | None = None
    rut: float = 1.0
    border: float | None = None
    random_ground: float = 0.0
    hardpan: float | None = None
    classes: float | None = None
    alike: float = 0.0
    slip_sinkage: float = 0.0
    sinkage_rate: float = 10.0
    firmness: float = 0.0
    onset: float = 0.0
    load_scale: float = 1.0
    sinkage_scale: float = 1.0
    spare: float = 0.0
    swapped: tuple[int, int] | None = None
    mirrored: bool = False
    tilt: float = 0.0
    walk: float = 0.0
    encoder: str = ""
    odometry: str = ""
    frozen: float | None = None
    static: bool = False
    said: str = ""


_KG = 1.0 / 9.80665
_SWAPPED, _STUCK = r"follow each the load|interchanged", r"front_left.*(stuck|one and the same)"
_ALL = (
    FieldWorld("plain"),
    FieldWorld("plain, two sizes", "two sizes"),
    FieldWorld("plain, six", "six"),
    FieldWorld("plain, long", "long", speed=0.5),
    FieldWorld("plain, zero known", "two sizes", zero_std=3e-4),
    FieldWorld("plain, turned", profile="turned"),
    FieldWorld("plain, slow sensors", sinkage_rate=5.0),
    FieldWorld("plain, no mass", mass=False),
    FieldWorld("plain, odometry alike", alike=1.0),
    FieldWorld("stop and go", profile="stop and go"),
    FieldWorld("stop and go, six", "six", "stop and go", ramp=1.5),
    FieldWorld("stop and go, long", "long", "stop and go", speed=0.6),
    FieldWorld("creeping", profile="short", speed=0.05),
    FieldWorld("creeping, long", "long", "short", speed=0.05),
    FieldWorld("stops of 40 s", profile="stops of 40 s"),
    FieldWorld("stops of 40 s, two sizes", "two sizes", "stops of 40 s"),
    FieldWorld("manoeuvres", profile="manoeuvres"),
    FieldWorld("manoeuvres, six", "six", "manoeuvres", speed=0.2),
    FieldWorld("there and back, ruts", profile="there and back", rut=1.23),
    FieldWorld("there and back, firm ruts", profile="there and back", rut=0.8),
    FieldWorld("back over a border", "two sizes", "there and back", border=4.0, rut=1.15),
    FieldWorld("random ground", random_ground=0.2, zero_std=3e-4),
    FieldWorld("hardpan", hardpan=0.015, zero_std=3e-4, firmness=-0.4),
    FieldWorld("two classes", classes=6.0),
    FieldWorld("loads in kg", load_scale=_KG, said=r"kg"),
    FieldWorld("loads 15 % high", "two sizes", load_scale=1.15, said=r"loads add up"),
    FieldWorld("caster not listed", spare=0.15, said=r"loads add up"),
    FieldWorld("front and rear loads swapped", swapped=(0, 2), said=_SWAPPED),
    FieldWorld("left and right loads swapped", swapped=(0, 1), said=_SWAPPED),
    FieldWorld("front for rear", "two sizes", mirrored=True, said=_SWAPPED),
    FieldWorld("sinkage in mm", sinkage_scale=1e3, said=r"in mm"),
    FieldWorld("imu tilted", tilt=math.radians(3.0), said=r"imu|slope"),
    FieldWorld("imu tilted, turned", profile="turned", tilt=math.radians(3.0), said=r"imu|slope"),
    FieldWorld("imu walks", "long", walk=math.radians(1.5), said=r"imu|slope"),
    FieldWorld("encoder at 0", encoder="zero", onset=5.0, said=r"front_left.*(joint|encoder)"),
    FieldWorld("encoder holds", encoder="holds", onset=5.0, said=r"front_left.*(joint|encoder)"),
    FieldWorld("odometry repeats", odometry="repeats", onset=5.0, said=r"odom"),
    FieldWorld("frozen at 5 Hz", frozen=0.0, sinkage_rate=5.0, onset=4.0, said=_STUCK),
    FieldWorld("frozen, wavers", frozen=2e-5, onset=4.0, said=_STUCK),
    FieldWorld("static loads", static=True),
    FieldWorld("static loads, long", "long", static=True),
)  # fmt: skip
WORLDS = {world.name: world for world in _ALL}
# The same faults where there are stops and turns.
WORLDS |= {
    f"{name}, stops": replace(WORLDS[name], name=f"{name}, stops", profile="stop and go")
    for name in ("encoder holds", "odometry repeats", "imu tilted", "caster not listed")
}
