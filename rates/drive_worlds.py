# SPDX-License-Identifier: Apache-2.0
"""Worlds of drives, a row each, by the subject whose rates they are for; and the drives through them.

    drive = make_drive(world, seed=1)
    drive.rows["front_left/load"]   # stamps (ns) and values, shape (rows, columns)

`soil`: what is believed of k, n and m, with sensors as they are. `traction`: pull, margin and risk, by
what tells of the strength. `priors`: everything is off by as much as the node's priors say. `field`: the
whole vehicle, its stops, ruts, wiring and dying sensors. `slip`: vehicles that measure neither sinkage nor
load. `robots`: what real drives taught (docs/real_robots.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rates.random_worlds import (
    PLAIN,
    VEHICLES,
    Feature,
    RandomWorld,
    draw_features,
    draw_soil,
    driven,
)
from smallwheel_ros.simulate.sensors import Integers, MeasuredRows, Rows
from smallwheel_ros.simulate.vehicle import EPOCH, Truth
from smallwheel_ros.simulate.world import Sensors, SimulatedRover
from smallwheel_ros.simulate.world_ground import TrueGround, make_ground, settle

_ATTEMPTS = 300


@dataclass(frozen=True)
class WorldDrive:
    """A drive. parameters: what its user tells of the vehicle, by name."""

    world: RandomWorld
    rover: SimulatedRover
    ground: TrueGround
    truth: Truth
    parameters: dict[str, Any]
    rows: Rows

    def at(self, stamps: Integers) -> Integers:
        """Index of the truth at stamps (ns)."""
        found = np.searchsorted(self.truth.time, (stamps - EPOCH) / 1e9 + 1e-9, side="right") - 1
        return np.clip(found, 0, self.truth.time.size - 1)


def make_drive(world: RandomWorld, seed: int) -> WorldDrive:
    """Draw a drive; one that got on where the world does not let it get stuck."""
    world, rover = world.drawn(seed), VEHICLES[world.vehicle]
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt, 50, *world.name.encode()])
        soil = draw_soil(world, rover, rng)
        started = draw_features(world, rng)
        ground = make_ground(world, rover, (soil,), (0.0,), started, rng)
        settle(ground)
        truth = driven(world, rover, ground, rng)
        if truth is not None:
            rows = MeasuredRows(world, rover, truth, rng).rows()
            told = parameters_of(world, rover, rng) | dict(world.told)
            return WorldDrive(world, rover, ground, truth, told, rows)
    raise RuntimeError(f"{world.name}: no ground carries this vehicle")


def parameters_of(
    world: RandomWorld, rover: SimulatedRover, rng: np.random.Generator
) -> dict[str, Any]:
    """What the user tells: nothing of the noise, and of the soil only where sinkage is measured."""
    sensors = world.sensors
    found: dict[str, Any] = {"wheels": [w.name for w in rover.wheels]}
    if sensors.sinkage:
        found["soil.name"] = "dry_sand"
    found["vehicle.mass"] = rover.mass * (1.0 + 0.01 * float(rng.standard_normal()))
    if not sensors.load:
        found["load.source"] = "static"
    if sensors.imu:
        found["imu_topic"] = "imu"
    for wheel in rover.wheels:
        found |= {f"{wheel.name}.diameter": wheel.diameter, f"{wheel.name}.width": wheel.width}
        found[f"{wheel.name}.longitudinal_position"] = wheel.x
        found[f"{wheel.name}.lateral_position"] = wheel.y
        if not sensors.sinkage:
            found[f"{wheel.name}.sinkage_topic"] = ""
        if sensors.torque:
            found[f"{wheel.name}.torque_per_effort"] = 1.0
        if sensors.pull:
            found[f"{wheel.name}.drawbar_pull_topic"] = f"{wheel.name}/load"
    return found


# --- Rows


Worlds = dict[str, RandomWorld]


def _named(worlds: Iterable[RandomWorld]) -> Worlds:
    return {world.name: world for world in worlds}


def _modulus(factor: float, edge: float = 0.02) -> tuple[Feature, ...]:
    size = math.log(factor)
    return (Feature("modulus", (size, size), edge=(edge, edge)),)


def _with(**sensors: object) -> Sensors:
    return replace(Sensors(), **sensors)  # type: ignore[arg-type]


# --- What is believed of the soil

_ZERO = {"sinkage_zero_std": 3e-4}  # a zero that is known
_WAY = {"vehicle": "two sizes", "way": "straight"}
_SOIL = (
    RandomWorld("nominal"),
    RandomWorld("nominal, equal", vehicle="four"),
    RandomWorld("zero known", told=_ZERO),
    RandomWorld("zero known, equal", vehicle="four", told=_ZERO),
    RandomWorld("load noise 10 %", sensors=_with(load_noise=0.10)),
    RandomWorld("zero +3 mm", sensors=_with(zero=3e-3)),
    RandomWorld("zero -1 mm", sensors=_with(zero=-1e-3)),
    RandomWorld("zero +5 mm", sensors=_with(zero=5e-3)),
    RandomWorld("zero drifts by 2 mm", sensors=_with(zero_drift=2e-3)),
    RandomWorld("load -20 %", sensors=_with(load_scale=(0.8,) * 4), said="loads add up"),
    RandomWorld("load +20 %, one wheel", sensors=_with(load_scale=(1.2, 1, 1, 1)), said="load"),
    RandomWorld("load tare +6 N, zero known", sensors=_with(tare=6.0), told=_ZERO, said="load"),
    RandomWorld("sinkage gain 1.1, zero known", sensors=_with(gain=1.1), told=_ZERO),
    RandomWorld("delay 200 ms", sensors=_with(delay=0.2)),
    RandomWorld("rough 3 mm", sensors=_with(rough=3e-3)),
    RandomWorld("one track", vehicle="two sizes, one track"),
    RandomWorld("ruts z x1.23, equal", vehicle="four", rut=1.23),
    RandomWorld("ruts z x0.8, one track", vehicle="two sizes, one track", rut=0.8, told=_ZERO),
    RandomWorld("scatter 15 %", scatter=0.15, told=_ZERO),
    RandomWorld("drift 20 %", drift=0.2),
    RandomWorld("correlated noise", sensors=_with(correlated=1e-3)),
    RandomWorld("quantised 1 mm", sensors=_with(step=1e-3)),
    RandomWorld("outliers 5 %", sensors=_with(outliers=0.05)),
    RandomWorld("turning", way="turning"),
    RandomWorld("firm", firmness=2.5, sensors=_with(sinkage_noise=1e-3)),
    RandomWorld("rebound", sensors=_with(rebound=1e-7)),
    RandomWorld("pitch error", sensors=_with(pitch_error=0.03)),
    RandomWorld("slip digs", digging=(0.06, 0.06)),
    RandomWorld("slip digs much", digging=(0.2, 0.2)),
    RandomWorld("load hardly varies", swing=0.2, slope=0.01),
    RandomWorld("n 0.45", exponent=0.45),
    RandomWorld("n 1.3, zero known", exponent=1.3, told=_ZERO),
    RandomWorld("right x1.5", right=math.log(1.5)),
    RandomWorld("right x3, equal", vehicle="four", right=math.log(3.0)),
    RandomWorld("hard at 8 mm", hardpan=8e-3),
    RandomWorld("another law of the rim", law="peaked"),
    RandomWorld("soil x1.5", features=_modulus(1.5)),
    RandomWorld("soil x2", features=_modulus(2.0)),
    RandomWorld("soil x3, zero known", features=_modulus(3.0), told=_ZERO),
    RandomWorld("soil x0.67", features=_modulus(0.67)),
    RandomWorld("soil x0.5", features=_modulus(0.5)),
    RandomWorld("soil x2 over 1 m", features=_modulus(2.0, 1.0)),
    RandomWorld("soil x2, n +0.3", features=(*_modulus(2.0), Feature("exponent", (0.3, 0.3)))),
)
SOIL = _named(
    replace(w, way="straight" if w.way == "plain" else w.way,
            vehicle="two sizes" if w.vehicle == "four" and "equal" not in w.name else w.vehicle)
    for w in _SOIL
)  # fmt: skip

# --- Pull, margin and risk

_PATCH = Feature("grip", (-1.9, -0.36), (0.35, 0.7), (0.3, 1.0), (1.0, 3.0))
_SLOPE = Feature("climb", (0.5, 0.5), (0.25, 0.5), (4.0, 7.0))
_GROUNDS = (
    RandomWorld("cruise"),
    RandomWorld("patch", features=(_PATCH,), sticks=True),
    RandomWorld("slope", features=(_SLOPE,), sticks=True),
    RandomWorld("slow slope", features=(replace(_SLOPE, edge=(10.0, 12.0)),), sticks=True),
    RandomWorld("soft ahead", features=_modulus(0.5, 1.0), sticks=True),
    RandomWorld("firm", firmness=1.5),
    RandomWorld("uneven", grip=0.3, own_grip=0.1, sticks=True),
    RandomWorld("another law of the rim", law="peaked", features=(_SLOPE,), sticks=True),
    RandomWorld(
        "other shear", rolling=(0.3, 0.3), residual=0.8, dragging=(0.015, 0.015), features=(_SLOPE,),
        sticks=True,
    ),
    RandomWorld("bad motors", sensors=_with(torque_scale=0.12, friction=0.15)),
)  # fmt: skip
# Without an imu the odometry tells the slope.
_NO_IMU = {"imu": "", "pitch": True}
# What tells of the strength: the balance needs mass and slope; with neither, nothing does.
KINDS: dict[str, tuple[dict[str, object], dict[str, object]]] = {
    "nothing": (_NO_IMU, {"vehicle.mass": None}),
    "balance": ({}, {}),
    "balance and torque": ({"torque": True}, {}),
    "pull sensor": ({**_NO_IMU, "pull": True}, {"vehicle.mass": None}),
}
TRACTION = _named(
    replace(
        ground, name=f"{ground.name}; {kind}", vehicle="two sizes",
        sensors=replace(ground.sensors, **sensors), told={"sinkage_zero_std": 1e-3} | told,
    )
    for ground in _GROUNDS
    for kind, (sensors, told) in KINDS.items()
    if kind in ("balance", "balance and torque") or ground.name in ("cruise", "patch", "slope", "uneven")
)  # fmt: skip

# --- Everything off by as much as the node allows for

PRIORS = _named(
    replace(SOIL["nominal"], name=f"{vehicle}, {kind}", vehicle=vehicle, grip=0.25,
            sensors=_with(**KINDS[kind][0]), told=KINDS[kind][1], priors=True)
    for vehicle in ("two sizes", "six")
    for kind in ("balance", "balance and torque", "pull sensor")
)  # fmt: skip

# --- In the field

_SWAPPED, _STUCK = r"follow each the load|interchanged", r"front_left.*(stuck|the same)"
_ENCODER = r"front_left.*(joint|encoder)"
_FIELD = (
    RandomWorld("plain"),
    RandomWorld("plain, two sizes", vehicle="two sizes"),
    RandomWorld("plain, six", vehicle="six"),
    RandomWorld("plain, long", vehicle="long", speed=0.5),
    RandomWorld("turned", way="turned"),
    RandomWorld("slow sensors", sensors=_with(sinkage_rate=5.0)),
    RandomWorld("no mass", told={"vehicle.mass": None}),
    RandomWorld("odometry alike", sensors=_with(alike=(1.0, 1.0))),
    RandomWorld("stop and go", way="stop and go"),
    RandomWorld("stop and go, six", vehicle="six", way="stop and go", ramp=1.5),
    RandomWorld("stop and go, long", vehicle="long", way="stop and go", speed=0.6),
    RandomWorld("creeping", way="short", speed=0.05),
    RandomWorld("stops of 40 s", vehicle="two sizes", way="stops of 40 s"),
    RandomWorld("manoeuvres", way="manoeuvres"),
    RandomWorld("manoeuvres, six", vehicle="six", way="manoeuvres", speed=0.2),
    RandomWorld("there and back, ruts", way="there and back", rut=1.23),
    RandomWorld("there and back, firm ruts", way="there and back", rut=0.8),
    RandomWorld("random ground", scatter=0.2, told=_ZERO),
    RandomWorld("hardpan", hardpan=0.015, firmness=-0.4, told=_ZERO),
    RandomWorld("static loads", sensors=_with(load=False)),
    RandomWorld("static loads, long", vehicle="long", sensors=_with(load=False)),
    RandomWorld("caster not listed", spare=0.15, said="loads add up"),
    RandomWorld("loads in kg", faults=("loads in kg",), said="kg"),
    RandomWorld(
        "loads 15 % high", vehicle="two sizes", sensors=_with(load_scale=(1.15,) * 4), said="loads add up",
    ),
    RandomWorld("front loads swapped", faults=("front loads swapped",), said=_SWAPPED),
    RandomWorld("left loads swapped", faults=("left loads swapped",), said=_SWAPPED),
    RandomWorld("sinkage in mm", faults=("one sinkage in mm",), said="in mm"),
    RandomWorld("sinkage frozen", faults=("one sinkage frozen",), said=_STUCK),
    RandomWorld("imu tilted", faults=("imu 3 degrees",), said=r"imu|slope"),
    RandomWorld("imu tilted, turned", way="turned", faults=("imu 3 degrees",), said=r"imu|slope"),
    RandomWorld("encoder at 0", faults=("encoder shows 0",), said=_ENCODER),
    RandomWorld("encoder holds", faults=("encoder holds",), said=_ENCODER),
    RandomWorld("encoder holds, stops", way="stop and go", faults=("encoder holds",), said=_ENCODER),
    RandomWorld("odometry repeats", faults=("odometry repeats",), said="odom"),
    RandomWorld("odometry repeats, stops", way="stop and go", faults=("odometry repeats",), said="odom"),
)  # fmt: skip
FIELD = _named(_FIELD)

# --- Without soil sensors

_DIGS = (0.015, 0.06)
_BASE = RandomWorld(
    "", way="straight", speed=0.4, soil="any", slope=0.04, swing=0.6, grip=0.15, scatter=0.1, digging=_DIGS,
    rolling=(0.2, 1.0), dragging=(0.0, 0.03), sensors=PLAIN,
)  # fmt: skip
_EDGE = {"start": (0.35, 0.7), "edge": (0.5, 4.0)}
_SOFT = (Feature("modulus", (-1.95, -0.82), **_EDGE), Feature("grip", (-0.9, -0.1), **_EDGE))  # type: ignore[arg-type]
_SLIPPERY = (Feature("grip", (-1.4, -0.5), **_EDGE),)  # type: ignore[arg-type]
_STEEP = (Feature("climb", (0.25, 0.6), (0.35, 0.7), (2.0, 8.0)),)


def _plain(name: str, vehicle: str = "20 kg", soil: str = "any", **more: object) -> RandomWorld:
    sensors = {
        k: more.pop(k) for k in list(more) if k in PLAIN.__dataclass_fields__ and k != "grip"
    }
    return replace(
        _BASE, name=name, vehicle=vehicle, soil=soil, sensors=replace(PLAIN, **sensors),
        sticks=bool(more.get("features")), **more,
    )  # type: ignore[arg-type] # fmt: skip


SLIP = _named((
    _plain("soil"),
    _plain("soil, six", "35 kg, six", way="bends"),
    _plain("soil, 80 kg", "80 kg", way="bends", speed=0.7, told=0.0),
    _plain("soil, 200 kg", "200 kg", speed=1.0, told=0.5),
    _plain("soil, 300 kg", "300 kg, six", speed=0.8),
    _plain("loam", "80 kg", "loam", way="bends", told=2.0),
    _plain("slopes", "35 kg, six", slope=0.10),
    _plain("no imu", slope=0.07, **_NO_IMU),
    _plain("torque", "80 kg", slope=0.07, torque=True),
    _plain("stop and go", way="stop and go"),
    _plain("stop and go, 200 kg", "200 kg", way="stop and go", speed=0.8, told=0.0),
    _plain("to and fro", "35 kg, six", way="to and fro"),
    _plain("noisy odometry", "80 kg", noise=(0.02, 0.04), told=0.5),
    _plain("slow", speed=0.12),
    _plain("softens", features=_SOFT),
    _plain("softens, six", "35 kg, six", features=_SOFT, speed=0.3),
    _plain("softens, 80 kg", "80 kg", features=_SOFT, told=0.0),
    _plain("softens, 200 kg", "200 kg", features=_SOFT, speed=0.8),
    _plain("softens, 300 kg", "300 kg, six", features=_SOFT, speed=0.6, told=2.0),
    _plain("softens, no imu", features=_SOFT, **_NO_IMU),
    _plain("softens, torque", "80 kg", features=_SOFT, torque=True),
    _plain("slippery", "80 kg", "loam", features=_SLIPPERY),
    _plain("slippery, 20 kg", features=_SLIPPERY, told=0.5),
    _plain("steepens", "35 kg, six", features=_STEEP),
    _plain("steepens, 200 kg", "200 kg", features=_STEEP, speed=0.8),
    _plain("floor", soil="floor", way="bends", slope=0.02),
    _plain("floor, 80 kg, stops", "80 kg", "floor", way="stop and go", speed=0.8, told=0.0),
    _plain("floor, 300 kg, ramps", "300 kg, six", "floor", slope=0.10, speed=1.0),
    _plain("floor, bumps", "35 kg, six", "floor", bumps=0.12, speed=0.5),
    _plain("soil, bumps", bumps=0.08),
    _plain("soil, bumps, 200 kg", "200 kg", bumps=0.08, speed=0.8),
    _plain("on the spot, floor", "35 kg, six", "floor", way="on the spot"),
    _plain("on the spot", "35 kg, six", way="on the spot", told=0.0),
    _plain("filter, softens", features=_SOFT, odometry="filter"),
    _plain("filter, stop and go", "80 kg", way="stop and go", odometry="filter", told=0.0),
    _plain("half of wheels", odometry="half"),
))  # fmt: skip

# --- What real drives taught

_OF_WHEELS, _NO_TWIST, _LATE, _DOWN = (
    "shows no slip|of the wheels", "twist|pose", "late|later|behind", "z|down|upside",
)  # fmt: skip
_BOG = (Feature("modulus", (-3.2, -2.2), **_EDGE), Feature("grip", (-1.2, -0.5), **_EDGE))  # type: ignore[arg-type]
_STUCK_SO = {"features": _BOG, "differential": True, "swing": 3.0}
_SKID = {"skid": (0.5, 0.75), "turning": 1.2, "speed": 0.8}
_FIRM = (Feature("floor", (1.0, 1.0), (0.25, 0.35), (0.02, 0.02), (5.0, 6.0)),)
ROBOTS = _named((
    _plain("skid steering, spins", "200 kg", way="on the spot", **_SKID),
    _plain("skid steering, spins, floor", "200 kg", "floor", way="on the spot", **_SKID),
    _plain("skid steering, bends, 80 kg", "80 kg", way="bends", **_SKID),
    _plain("spins diagonally, stuck", "80 kg", **_STUCK_SO),
    _plain("spins diagonally, stuck, 200 kg", "200 kg", speed=0.8, **_STUCK_SO),
    _plain("odometry without twist", "80 kg", odometry="pose", said=_NO_TWIST),
    _plain("odometry without twist, softens", "80 kg", odometry="pose", features=_SOFT, said=_NO_TWIST),
    _plain("odometry at 4 Hz", "80 kg", odometry_rate=(4.0,)),
    _plain("odometry at 4 Hz, softens", "80 kg", odometry_rate=(4.0,), features=_SOFT),
    _plain("odometry late", "80 kg", way="stop and go", lag=(0.25, 0.35), said=_LATE),
    _plain("odometry late, softens", "80 kg", features=_SOFT, lag=(0.25, 0.35), said=_LATE),
    _plain("odometry of wheels", odometry="wheels", said=_OF_WHEELS),
    _plain("odometry of wheels, on the spot", "80 kg", way="on the spot", odometry="wheels", said=_OF_WHEELS),
    _plain("filter of wheels, on the spot", "80 kg", way="on the spot", odometry="filter"),
    _plain("driven imu", "200 kg", imu="driven", way="stop and go", speed=0.8),
    _plain("driven imu, softens", "200 kg", imu="driven", features=_SOFT, speed=0.8),
    _plain("driven imu, skid steering", "200 kg", imu="driven", way="on the spot", **_SKID),
    _plain("firm between soft", "80 kg", features=_FIRM),
    _plain("firm between soft, sinkage measured", "80 kg", features=_FIRM, sinkage=True, load=True),
    _plain("motor current", "80 kg", way="stop and go", torque=True, current=True),
    _plain("imu z down", "80 kg", slope=0.07, faults=("imu z down",), said=_DOWN),
    _plain("imu z down, softens", "80 kg", features=_SOFT, faults=("imu z down",), said=_DOWN),
))  # fmt: skip

WORLDS = {
    "soil": SOIL,
    "traction": TRACTION,
    "priors": PRIORS,
    "field": FIELD,
    "slip": SLIP,
    "robots": ROBOTS,
}
