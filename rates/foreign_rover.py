# SPDX-License-Identifier: Apache-2.0
"""A rover of another author: quasi-static, with numerics of its own; it shares nothing with the package.

    drive = driven(ForeignWorld("plain"), seed=1)
    drive.rows["front_left/load"]   # stamps (ns) and values, (rows, columns), as streams have them

Four wheels of two sizes under a body of about 30 kg, on a field whose slope along and across waves by a few
degrees. At each instant one slip is looked for at which the four wheels together give the pull that slope and
acceleration ask for: stresses k z^n D^m under the rim, shear by the displacement of Wong and Reece (1967),
resistance by the work of pressing a rut. A payload swings and moves the loads; the vehicle stops for 3 s in
each 40, weaves, and changes its speed by a quarter.

Sensors drop messages, have noise, gains and zeros; the odometry turns 0.3 % wrong, the imu is tilted by some
milliradians, and one depth sensor is silent for 3 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = dict[str, tuple[NDArray[np.int64], Array]]
GRAVITY = 9.81
EPOCH = 1_760_000_000_000_000_000  # ns, of the first instant
STEP = 0.04  # s
STAND, TURN_IN = 0.02, 0.05  # m/s of the rims, under which it stands, and over which it weaves
_SLIPS = np.concatenate([np.linspace(-0.5, 0.0, 11)[:-1], np.linspace(0.0, 0.95, 39)])
_REFERENCE = 0.4  # slip, at which the margin is
_SPINS, _SPINS_FOR = 0.85, 6.0  # slip and s, after which it is stuck for good
_HEIGHT, _WHEELBASE, _TRACK = 0.35, 0.80, 0.80  # m, of the body, as it moves the loads


@dataclass(frozen=True)
class ForeignWheel:
    """A wheel: diameter and width, and its place ahead and left of base_link, m."""

    name: str
    diameter: float
    width: float
    x: float
    y: float


WHEELS = (
    ForeignWheel("front_left", 0.30, 0.11, 0.40, 0.33),
    ForeignWheel("front_right", 0.30, 0.11, 0.40, -0.33),
    ForeignWheel("rear_left", 0.19, 0.09, -0.40, 0.50),
    ForeignWheel("rear_right", 0.19, 0.09, -0.40, -0.50),
)


@dataclass(frozen=True)
class ForeignWorld:
    """A field and its sensors.

    hidden: what the soil has beside k z^n D^m: wheels sink with slip, a stiff layer begins below, or it is
    stiffer the faster a wheel rolls. border: by how much the soil is stiffer from the middle of the way on.
    fades: 1/m, by which its shear strength falls (exponentially) along the way, from a third of it on. loose,
    waves: its shear displacement and the slopes of the ground, as multiples of the usual.
    lost: share of the messages. zero: deviation of the depth sensors' zeros, m. soil_sensors: whether load
    and sinkage are measured.
    """

    name: str
    hidden: Literal["", "slip", "hardpan", "speed"] = ""
    border: float = 1.0
    distance: float = 60.0
    lost: float = 0.05
    zero: float = 0.001
    soil_sensors: bool = True
    fades: float = 0.0
    loose: float = 1.0
    waves: float = 1.0


@dataclass(frozen=True)
class ForeignSoil:
    """p = k z^n D^m; shear by cohesion (Pa), friction (rad) and a displacement (m)."""

    k: float
    n: float
    m: float
    cohesion: float
    friction: float
    displacement: float
    hardpan: float | None = None  # m, where it begins
    sinks_with_slip: float = 0.0
    stiffens_with_speed: float = 0.0

    def pressure(self, z: Array, diameter: float) -> Array:
        """Under a plate of that size at a depth (m), Pa."""
        size = self.k * diameter**self.m
        found = size * np.maximum(z, 0.0) ** self.n
        if self.hardpan is not None:
            deeper = np.maximum(z - self.hardpan, 0.0) / self.hardpan
            found = found + 8.0 * size * self.hardpan**self.n * deeper
        return np.asarray(found)


class _UnderWheel:
    """Forces of one wheel on one soil, tabulated by sinkage: load, resistance, thrust by slip."""

    def __init__(self, soil: ForeignSoil, wheel: ForeignWheel) -> None:
        radius, self.soil = 0.5 * wheel.diameter, soil
        self.sinkage = np.linspace(1e-5, 0.45 * wheel.diameter, 160)
        entry = np.arccos(1.0 - self.sinkage / radius)[:, None]
        angle = entry * (np.arange(80) + 0.5) / 80
        area = wheel.width * radius * entry / 80
        stress = soil.pressure(radius * (np.cos(angle) - np.cos(entry)), wheel.diameter)
        self.load = (stress * np.cos(angle) * area).sum(axis=1)
        depths = self.sinkage[:, None] * np.linspace(0.0, 1.0, 200)
        work = np.trapezoid(soil.pressure(depths, wheel.diameter), depths, axis=1)
        self.resistance = wheel.width * work
        self.thrust = np.empty((self.sinkage.size, _SLIPS.size))
        for column, slip in enumerate(_SLIPS):
            gone = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)
            shear = radius * ((entry - angle) - gone * (np.sin(entry) - np.sin(angle)))
            strength = soil.cohesion + stress * np.tan(soil.friction)
            tau = np.sign(shear) * strength * -np.expm1(-np.abs(shear) / soil.displacement)
            self.thrust[:, column] = (tau * np.cos(angle) * area).sum(axis=1)

    def forces(self, load: float, speed: float) -> tuple[Array, Array, Array]:
        """Sinkage (m), thrust and resistance (N) by slip. speed: of the rim over the usual one."""
        soil = self.soil
        stiffer = 1.0 + soil.stiffens_with_speed * 2.0 * (speed - 0.5)
        z = np.interp(load / stiffer, self.load, self.sinkage)
        z = np.minimum(z * (1.0 + soil.sinks_with_slip * np.maximum(_SLIPS, 0.0)), self.sinkage[-1])
        row = np.clip(np.searchsorted(self.sinkage, z) - 1, 0, self.sinkage.size - 2)
        share = (z - self.sinkage[row]) / (self.sinkage[row + 1] - self.sinkage[row])
        column = np.arange(_SLIPS.size)
        thrust = self.thrust[row, column] * (1.0 - share) + self.thrust[row + 1, column] * share
        resistance = np.interp(z, self.sinkage, self.resistance)
        if soil.sinks_with_slip or soil.stiffens_with_speed:
            carried = load / np.interp(z, self.sinkage, self.load)
            thrust, resistance = thrust * carried, resistance * carried
        return np.asarray(z), thrust, np.asarray(resistance)


@dataclass(frozen=True)
class ForeignTruth:
    """What was so at each instant; of the wheels (instants, wheels). margin, pull over load: of the vehicle.

    time: s. path: m along the ground. stuck: s, None: it never was.
    """

    soil: ForeignSoil
    mass: float
    stuck: float | None
    time: Array
    path: Array
    x: Array
    y: Array
    heading: Array
    speed: Array
    yaw_rate: Array
    climb: Array
    across: Array
    gain: Array
    margin: Array
    load: Array
    sinkage: Array
    resistance: Array
    pull: Array
    slip: Array
    turned: Array  # rad/s
    rim: Array  # m/s


@dataclass(frozen=True)
class ForeignDrive:
    """A drive: what was so, and what the sensors gave."""

    world: ForeignWorld
    truth: ForeignTruth
    rows: Rows

    def at(self, stamps: NDArray[np.int64]) -> NDArray[np.intp]:
        """Index of the truth at stamps (ns)."""
        found = np.rint((stamps - EPOCH) / 1e9 / STEP).astype(np.intp)
        return np.clip(found, 0, self.truth.time.size - 1)


def driven(world: ForeignWorld, seed: int) -> ForeignDrive:
    """Draw a field and drive over it."""
    rng = np.random.default_rng([seed, 62, *world.name.encode()])
    truth = _driven(world, rng)
    return ForeignDrive(world, truth, _measured(world, truth, rng))


def _soil(world: ForeignWorld, mass: float, rng: np.random.Generator) -> ForeignSoil:
    n, m = rng.uniform(0.55, 1.25), rng.uniform(-0.2, 0.9)
    pressure = np.exp(rng.uniform(np.log(14e3), np.log(60e3)))  # at 10 mm under 0.25 m
    friction, cohesion = np.radians(rng.uniform(26.0, 36.0)), rng.uniform(100.0, 1200.0)
    soil = ForeignSoil(
        float(pressure / (0.01**n * 0.25**m)), n, m, cohesion, float(friction),
        world.loose * rng.uniform(0.008, 0.022),
        sinks_with_slip=float(world.hidden == "slip"),
        stiffens_with_speed=0.35 * (world.hidden == "speed"),
    )  # fmt: skip
    if world.hidden != "hardpan":
        return soil
    # A stiff layer begins at the depth that a front wheel reaches with 80 % of its usual load.
    under = _UnderWheel(soil, WHEELS[0])
    depth = np.interp(0.8 * mass * GRAVITY / 4.0, under.load, under.sinkage)
    return ForeignSoil(**(vars(soil) | {"hardpan": float(depth)}))


def _driven(world: ForeignWorld, rng: np.random.Generator) -> ForeignTruth:
    mass, usual = 30.0 * rng.uniform(0.9, 1.2), 0.4
    soil = _soil(world, mass, rng)
    beyond = ForeignSoil(**(vars(soil) | {"k": soil.k * world.border}))
    under = [[_UnderWheel(one, wheel) for one in (soil, beyond)] for wheel in WHEELS]
    steep = world.waves * rng.uniform(0.03, 0.075, 2)
    length, phase = np.array([rng.uniform(9, 14), rng.uniform(4, 7)]), rng.uniform(0.0, 6.0, 2)
    ahead = np.array([wheel.x for wheel in WHEELS])
    aside = np.array([wheel.y for wheel in WHEELS])
    radius = np.array([0.5 * wheel.diameter for wheel in WHEELS])
    rows: list[tuple[float, ...]] = []
    wheels: list[Array] = []
    t = s = x = y = heading = rim = slip = spinning = 0.0
    stuck = None
    while s < world.distance and t < 2.2 * world.distance / usual and spinning < _SPINS_FOR:
        asked = usual * (1.0 + 0.25 * np.sin(2 * np.pi * t / 23.0)) if t % 40.0 > 4.0 else 0.0
        gain = float(np.clip((asked - rim) / STEP, -0.25, 0.25))
        rim += gain * STEP
        turn = 0.14 * np.sin(2 * np.pi * t / 31.0) if rim > TURN_IN else 0.0
        climb = steep[0] * np.sin(2 * np.pi * s / length[0] + phase[0])
        climb += 0.5 * steep[1] * np.sin(2 * np.pi * s / length[1] + phase[1])
        across = 0.5 * steep[1] * np.sin(2 * np.pi * s / (0.8 * length[0]) + phase[1])
        weight = mass * GRAVITY * np.cos(climb) * np.cos(across)
        arm = 0.16 * np.sin(2 * np.pi * t / 17.0), 0.14 * np.sin(2 * np.pi * t / 11.3)
        back = _HEIGHT * (np.tan(climb) + gain / GRAVITY)
        front_share = 0.5 + np.sign(ahead) * (arm[0] - back) / _WHEELBASE * 0.9
        left_share = 0.5 + np.sign(aside) * (arm[1] - _HEIGHT * np.tan(across)) / _TRACK * 0.9
        load = weight * np.clip(front_share, 0.12, 0.88) * np.clip(left_share, 0.12, 0.88)
        on_second = s + ahead > 0.5 * world.distance
        forces = [
            under[j][int(on_second[j])].forces(float(load[j]), max(rim, 0.0) / usual)
            for j in range(len(WHEELS))
        ]
        if world.fades:
            faded = world.fades * np.maximum(s + ahead - world.distance / 3.0, 0.0)
            forces = [
                (z, one * thrust, resistance)
                for one, (z, thrust, resistance) in zip(np.exp(-faded), forces, strict=True)
            ]
        pull = sum(thrust - resistance for _, thrust, resistance in forces)
        demand = mass * GRAVITY * np.sin(climb) + mass * gain
        slip += (_slip_for(pull, demand, rim) - slip) * min(1.0, STEP / 0.15)
        speed = rim * (1.0 - slip) if slip >= 0.0 else rim / (1.0 + slip)
        yaw_rate = 0.75 * turn * (1.0 - max(slip, 0.0))
        rims, over = rim - 0.9 * turn * aside, speed - yaw_rate * aside
        slips = np.zeros(len(WHEELS))
        drives, rolls = rims >= over, np.abs(rims) >= STAND
        slips[rolls & drives] = 1.0 - over[rolls & drives] / rims[rolls & drives]
        brakes = rolls & ~drives
        slips[brakes] = rims[brakes] / np.maximum(over[brakes], 1e-3) - 1.0
        margin = float(np.interp(_REFERENCE, _SLIPS, pull) / weight)
        rows.append((t, s, x, y, heading, speed, yaw_rate, climb, across, gain, margin))
        of_wheels = [
            [np.interp(one, _SLIPS, column) for column in (z, resistance, thrust - resistance)]
            for one, (z, thrust, resistance) in zip(slips, forces, strict=True)
        ]
        wheels.append(np.column_stack([load, of_wheels, slips, rims / radius, rims]))
        x, y = x + speed * np.cos(heading) * STEP, y + speed * np.sin(heading) * STEP
        heading, s, t = heading + yaw_rate * STEP, s + speed * STEP, t + STEP
        spins = slip > _SPINS and rim > 0.1
        stuck = (t if stuck is None else stuck) if spins else None
        spinning = spinning + STEP if spins else 0.0
    columns, each = np.array(rows).T, np.moveaxis(np.array(wheels), 2, 0)
    return ForeignTruth(soil, mass, stuck, *columns, *each)


def _slip_for(pull: Array, demand: float, rim: float) -> float:
    """Slip at which the vehicle pulls as much as is asked for; 0.93 where none does."""
    enough = np.flatnonzero(pull >= demand)
    if rim < STAND:
        return 0.0
    if not enough.size:
        return 0.93
    a = int(enough[0])
    if a == 0:
        return float(_SLIPS[0])
    share = (demand - pull[a - 1]) / (pull[a] - pull[a - 1])
    return float(_SLIPS[a - 1] + (_SLIPS[a] - _SLIPS[a - 1]) * share)


def _measured(world: ForeignWorld, truth: ForeignTruth, rng: np.random.Generator) -> Rows:
    """What the sensors gave, less the messages that were lost."""
    end, rows = float(truth.time[-1]), {}

    def stream(name: str, times: Array, *columns: Array) -> None:
        kept = rng.random(times.size) >= world.lost
        stamps = EPOCH + np.rint(1e9 * times[kept]).astype(np.int64)
        rows[name] = stamps, np.column_stack(columns)[kept]

    def at(values: Array, times: Array) -> Array:
        return np.interp(times, truth.time, values)

    turns = np.arange(0.0, end, 0.02)
    for j, wheel in enumerate(WHEELS):
        stream(
            f"{wheel.name}/wheel_speed",
            turns,
            at(truth.turned[:, j], turns) + rng.normal(0, 0.02, turns.size),
        )
        if not world.soil_sensors:
            continue
        times = np.arange(0.003, end, 0.025)
        load = at(truth.load[:, j], times) * (1.0 + rng.normal(0.0, 0.03)) + rng.normal(0.0, 1.0)
        stream(f"{wheel.name}/load", times, load + rng.normal(0.0, 1.5, times.size))
        times = np.arange(0.011, end, 0.066)
        if j == 0:
            times = times[(times <= 50.0) | (times >= 53.0)]
        sinkage = at(truth.sinkage[:, j], times) + _roughness(at(truth.path, times), rng)
        sinkage += rng.normal(0.0, world.zero) + rng.normal(0.0, 0.0015, times.size)
        stream(f"{wheel.name}/sinkage", times, sinkage, np.zeros(times.size))
    times = np.arange(0.007, end, 0.05)
    heading, pitch = (
        at(truth.heading, times) * (1.0 + rng.normal(0.0, 0.003)),
        -at(truth.climb, times),
    )
    variance, ones = np.full(times.size, 1e-3), np.ones(times.size)
    stream(
        "odom", times, at(truth.speed, times) + rng.normal(0.0, 0.012, times.size),
        at(truth.yaw_rate, times) + rng.normal(0.0, 0.006, times.size),
        at(truth.x, times), at(truth.y, times),
        np.cos(heading), np.sin(heading), variance, variance, pitch, 0.0 * ones,
    )  # fmt: skip
    times = np.arange(0.001, end, 0.02)
    tilt = rng.normal(0.0, 0.004, 2)
    pitch, roll = -(at(truth.climb, times) + tilt[0]), at(truth.across, times) + tilt[1]
    up = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    felt = GRAVITY * up + rng.normal(0.0, 0.15, up.shape)
    felt[0] += at(truth.gain, times)
    turns = at(truth.yaw_rate, times) + rng.normal(0.0, 0.004, times.size)
    stream("imu", times, turns, *felt, *up, 0.0 * times)
    return rows


def _roughness(path: Array, rng: np.random.Generator) -> Array:
    """Unevenness of the ground, 2 mm, that lasts for 0.12 m, at places along the way (m)."""
    found, last, before = np.zeros(path.size), 0.0, 0.0
    for i, place in enumerate(path.tolist()):
        if i:
            keep = np.exp(-abs(place - before) / 0.12)
            last = keep * last + np.sqrt(1.0 - keep * keep) * rng.normal(0.0, 0.002)
        found[i], before = last, place
    return found
