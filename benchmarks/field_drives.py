# SPDX-License-Identifier: Apache-2.0
"""Drives through `field_worlds`: what is true along the way, and the messages of the sensors.

The truth integrates normal and shear stress along the arc (`traction_worlds`), takes slip from the balance
of the whole vehicle at each instant, and lays ground, slopes and grip over the plane, so that a vehicle that
turns or comes back meets them from another side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.field_worlds import PROFILES, ROVERS, FieldWorld, Leg, Rover
from benchmarks.traction_worlds import forces
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, soil
from smallwheel_ros.simulate.truth import static_sinkage

Array = NDArray[np.float64]
Message = tuple[int, str, Any]  # stamp (ns), topic, message

GRAVITY = 9.80665
EPOCH = 1_700_000_000_000_000_000  # ns
REFERENCE_SLIP = 0.4
_CELL = 0.02  # m
_TICK = 0.04  # s
_TURNING = 0.5  # rad/s
_STUCK = 0.8  # slip that the vehicle does not get over
SLIPS = np.array(
    [-0.95, -0.6, -0.3, -0.15, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8]
)
_RATES = {"load": 20.0, "odom": 20.0, "joints": 20.0, "imu": 20.0}


class _Field:
    """A random field over the plane with an exponential correlation over a length (m)."""

    def __init__(self, rng: np.random.Generator, deviation: float, length: float) -> None:
        count = 80
        size = np.sqrt(np.maximum(rng.uniform(0.02, 1.0, count) ** -2.0 - 1.0, 0.0)) / length
        angle = rng.uniform(0.0, 2.0 * np.pi, count)
        self._kx, self._ky = size * np.cos(angle), size * np.sin(angle)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, count)
        self._by = deviation * math.sqrt(2.0 / count)

    def __call__(self, x: Array, y: Array) -> Array:
        waves = np.cos(x[..., None] * self._kx + y[..., None] * self._ky + self._phase)
        found: Array = self._by * waves.sum(axis=-1)
        return found


@dataclass
class Way:
    """Cells along the way, shape (cells,): place (m), heading (rad), and 1 forward, -1 backward."""

    x: Array
    y: Array
    yaw: Array
    sense: Array
    ends: list[int]  # cell at which each leg ends


@dataclass
class FieldDrive:
    """What was true by time; arrays of shape (times,) or (times, wheels).

    moves: rolls along. held: pull (N) at the reference slip. reserve: margin less the slope either way.
    law: ln pressure and n of the ground, without places. kind: of terrain. messages: by their stamps.
    """

    world: FieldWorld
    rover: Rover
    parameters: dict[str, Any]
    time: Array
    path: Array
    moves: NDArray[np.bool_]
    slip: Array
    load: Array
    sinkage: Array
    resistance: Array
    pull: Array
    held: Array
    reserve: Array
    law: tuple[float, float]
    kind: Array
    messages: list[Message]
    stuck: bool


def _way(legs: tuple[Leg, ...]) -> Way:
    x = y = yaw = 0.0
    rows, ends = [(x, y, yaw, 1.0)], []
    for leg in legs:
        yaw += leg.turn
        sense = math.copysign(1.0, leg.metres)
        for _ in range(round(abs(leg.metres) / _CELL)):
            yaw += leg.bend * sense * _CELL
            x += sense * _CELL * math.cos(yaw)
            y += sense * _CELL * math.sin(yaw)
            rows.append((x, y, yaw, sense))
        ends.append(len(rows) - 1)
    columns = np.array(rows).T
    return Way(*columns, ends)


def _passes(places: Array, widths: list[float]) -> Array:
    """How often a wheel has been at each place before; places: (cells, wheels, 2)."""
    cells, wheels, _ = places.shape
    tree = cKDTree(places.reshape(-1, 2))
    apart = round(0.4 / _CELL)
    found = np.zeros((cells, wheels))
    for j in range(wheels):
        for i, near in enumerate(tree.query_ball_point(places[:, j], 0.5 * widths[j])):
            cell, wheel = np.divmod(np.array(near), wheels)
            for k in range(wheels):
                mine = np.sort(cell[(wheel == k) & (cell < i)])
                if k == j:
                    mine = mine[mine < i - apart]
                if mine.size:
                    found[i, j] += 1 + int(np.sum(np.diff(mine) > apart))
    return found


def make_drive(world: FieldWorld, seed: int) -> FieldDrive:
    """Draw a drive on a soil that carries the wheels and lets them on."""
    for attempt in range(200):
        made = _drawn(world, np.random.default_rng([seed, attempt, 2828]))
        if made is not None:
            return made
    raise RuntimeError(f"{world.name}: no soil carries these wheels")


def _drawn(world: FieldWorld, rng: np.random.Generator) -> FieldDrive | None:
    base, rover = soil("dry_sand"), ROVERS[world.rover]
    pressure = base.log_reference_pressure + 0.35 * rng.standard_normal() + world.firmness
    n = base.n + 0.15 * rng.standard_normal()
    m = base.m + 0.2 * rng.standard_normal()
    strength = np.array(
        [
            abs(300.0 * rng.standard_normal()),
            base.friction_angle + 0.05 * rng.standard_normal(),
            0.012 * math.exp(0.3 * rng.standard_normal()),
        ]
    )
    if not (0.35 < n < 1.5 and strength[1] > 0.3):
        return None
    way = _way(PROFILES[world.profile])
    ground = _Ground(world, rover, rng, way, (pressure, n, m), strength)
    if not ground.carries:
        return None
    rows = _driven(world, rover, ground, way)
    if rows is None:
        return None
    return _measured(world, rover, rng, ground, way, rows, (pressure, n))


class _Ground:
    """Load (N), sinkage (m), net traction (N) by slip and so on in each cell, for each wheel."""

    def __init__(
        self,
        world: FieldWorld,
        rover: Rover,
        rng: np.random.Generator,
        way: Way,
        law: tuple[float, float, float],
        strength: Array,
    ) -> None:
        pressure, n, m = law
        wheels = rover.wheels
        ahead = np.array([w.longitudinal_position for w in wheels])
        aside = np.array([w.lateral_position for w in wheels])
        cosine, sine = np.cos(way.yaw)[:, None], np.sin(way.yaw)[:, None]
        x = way.x[:, None] + cosine * ahead - sine * aside
        y = way.y[:, None] + sine * ahead + cosine * aside
        # Slopes east and north of a smooth surface.
        east = _Field(rng, world.slope, 4.0)(way.x, way.y)
        north = _Field(rng, world.slope, 4.0)(way.x, way.y)
        self._rover, self._listed = rover, 1.0 - world.spare
        self.dragged = world.spare * rover.mass * GRAVITY * 0.15
        self.east, self.north = east, north
        self.twist = _Field(rng, 0.12, 0.6)(way.x, way.y)
        self.climb, self.roll = self.tilt(np.arange(len(way.x)), way.yaw)
        self.load = self.loads(self.climb, self.roll, self.twist, np.zeros(len(way.x)))
        local = _Field(rng, 0.06, 0.25)(x, y)
        if world.random_ground:
            local = local + _Field(rng, world.random_ground, 1.0)(x, y)
        grip = _Field(rng, 0.12, 0.8)(x, y)
        kind = np.zeros(x.shape)
        if world.border is not None:
            local = local + math.log(1.5) * (x > world.border)
        if world.classes is not None:
            kind = np.floor(x / world.classes) % 2
            harder, stronger = rng.uniform(0.3, 0.8) * rng.choice([-1, 1]), rng.choice([-1, 1])
            local = local + harder * kind
            grip = grip + stronger * rng.uniform(0.1, 0.3) * kind
        self.kind = kind
        passes = _passes(np.stack([x, y], axis=-1), [w.width for w in wheels])
        rut = world.rut ** (passes / (0.5 + 0.5 * np.maximum(passes, 1.0)))
        local = local - (n + 0.5) * np.log(rut)
        self.n = n
        sinkage, nets, resistances = [], [], []
        for j, wheel in enumerate(wheels):
            modulus = np.exp(
                pressure
                + local[:, j]
                - n * math.log(REFERENCE_SINKAGE)
                + m * math.log(wheel.diameter / REFERENCE_DIAMETER)
            )
            size = np.full(len(way.x), wheel.diameter), np.full(len(way.x), wheel.width)
            pressed = _pressure(modulus, n, world.hardpan)
            z = static_sinkage(pressed, self.load[:, j], *size)
            thrust, resistance, _ = forces(
                pressed, np.nan_to_num(z, nan=0.1), wheel, strength, SLIPS
            )
            nets.append(thrust * np.exp(grip[:, j])[:, None] - resistance[:, None])
            sinkage.append(z)
            resistances.append(resistance)
        self.sinkage = np.array(sinkage).T
        deepest = np.array([0.25 * w.diameter for w in wheels])
        self.carries = bool(np.isfinite(self.sinkage).all() and (self.sinkage < deepest).all())
        self.net = np.array(nets)  # (wheels, cells, slips)
        self.resistance = np.array(resistances).T
        held = self.held().sum(axis=1) / self.load.sum(axis=1)
        # No drive here gets stuck, and no warning is right.
        self.carries &= bool((held - np.tan(np.abs(self.climb)) > 0.05).all())

    def held(self) -> Array:
        """Pull at the reference slip, shape (cells, wheels)."""
        at = np.array([[np.interp(REFERENCE_SLIP, SLIPS, row) for row in one] for one in self.net])
        return at.T

    def tilt(self, cell: NDArray[np.intp], yaw: Array) -> tuple[Array, Array]:
        """Climb and roll (rad; positive nose up, left side up) in a cell, looking along a yaw."""
        east, north = self.east[cell], self.north[cell]
        return (
            east * np.cos(yaw) + north * np.sin(yaw),
            north * np.cos(yaw) - east * np.sin(yaw),
        )

    def loads(self, climb: Array, roll: Array, twist: Array, gained: Array) -> Array:
        """Load of each wheel (N) of a rigid frame that gains speed forward (m/s^2)."""
        rover = self._rover
        ahead = np.array([w.longitudinal_position for w in rover.wheels])
        aside = np.array([w.lateral_position for w in rover.wheels])
        along = rover.ahead - rover.height * (np.tan(climb) + gained / GRAVITY)
        across = -rover.height * np.tan(roll)
        share = 1.0 + np.outer(along, ahead) / np.mean(ahead**2)
        share += np.outer(across, aside) / np.mean(aside**2)
        share += np.outer(twist, np.sign(ahead * aside))
        normal = rover.mass * GRAVITY * np.cos(climb) * np.cos(roll) * self._listed
        found: Array = normal[:, None] / len(ahead) * np.maximum(share, 0.1)
        return found


def _pressure(modulus: Array, n: float, hardpan: float | None) -> Callable[[Array], Array]:
    def law(depth: Array) -> Array:
        deep = np.maximum(depth, 0.0)
        found: Array = modulus[:, None] * deep**n
        if hardpan is not None:
            found = found + 8.0 * modulus[:, None] * np.maximum(deep - hardpan, 0.0) ** n
        return found

    return law


def _driven(world: FieldWorld, rover: Rover, ground: _Ground, way: Way) -> Array | None:
    """Time, cell, speed, rim speed, slip, acceleration, yaw rate, yaw, path; None where it gets stuck."""
    total = ground.net.sum(axis=0) - ground.dragged
    weight = rover.mass * GRAVITY * np.sin(ground.climb)
    rows, time, cell, path = [], 0.0, 0, 0.0
    yaw = 0.0

    def row(*values: float) -> None:
        rows.append((time, cell, *values, yaw, path))

    def stand(seconds: float) -> None:
        nonlocal time
        for _ in range(round(seconds / _TICK)):
            row(0.0, 0.0, 0.0, 0.0, 0.0)
            time += _TICK

    stand(2.0)
    for leg, end in zip(PROFILES[world.profile], way.ends, strict=True):
        for _ in range(round(abs(leg.turn) / _TURNING / _TICK)):
            rate = math.copysign(_TURNING, leg.turn)
            yaw += rate * _TICK
            row(0.0, 0.0, 0.0, 0.0, rate)
            time += _TICK
        start, at, speed, rim, spinning = cell, 0.0, 0.0, 0.0, 0
        sense = math.copysign(1.0, leg.metres)
        length = (end - start) * _CELL
        while at < length - 1e-3 and length > 0.0:
            wish = world.speed * (1.0 + 0.12 * math.sin(0.5 * time))
            wish = min(wish, math.sqrt(1.2 * world.ramp * (length - at)) + 0.01)
            rim = min(max(wish, rim - world.ramp * _TICK), rim + world.ramp * _TICK)
            cell = min(start + int(at / _CELL) + 1, end)
            travelled = np.where(SLIPS >= 0.0, rim * (1.0 - SLIPS), rim / (1.0 + SLIPS))
            left = total[cell] - sense * weight[cell] - rover.mass * (travelled - speed) / _TICK
            slip = float(np.interp(0.0, np.maximum.accumulate(left), SLIPS))
            now = rim * (1.0 - slip) if slip >= 0.0 else rim / (1.0 + slip)
            spinning = spinning + 1 if slip >= _STUCK else 0
            if spinning > 60 or time > 4000.0:
                return None
            gained, speed = (now - speed) / _TICK, now
            yaw = float(way.yaw[cell])
            at += speed * _TICK
            path += speed * _TICK
            row(sense * speed, sense * rim, slip, sense * gained, sense * speed * leg.bend)
            time += _TICK
        cell = end
        stand(leg.stand)
    return np.array(rows)


def _measured(
    world: FieldWorld,
    rover: Rover,
    rng: np.random.Generator,
    ground: _Ground,
    way: Way,
    rows: Array,
    law: tuple[float, float],
) -> FieldDrive:
    time, cells, speed, rim, slip, gained, turning, yaw, path = rows.T
    at = cells.astype(int)
    # Loads follow the acceleration; sinkage and forces those, near enough.
    climb, roll = ground.tilt(at, yaw)
    lean = np.convolve(gained, np.ones(5) / 5.0, mode="same")
    load = ground.loads(climb, roll, ground.twist[at], lean)
    factor = load / ground.load[at]
    z = ground.sinkage[at] * factor ** (1.0 / (ground.n + 0.5))
    pull = np.stack(
        [
            [np.interp(s, SLIPS, ground.net[j, c]) for j in range(len(rover.wheels))]
            for s, c in zip(slip, at, strict=True)
        ]
    )
    if world.slip_sinkage:
        z = z * (1.0 + world.slip_sinkage * np.clip(slip, 0.0, 1.0))[:, None]
    moves = np.abs(speed) > 0.004
    held = ground.held()[at]
    reserve = held.sum(axis=1) / ground.load[at].sum(axis=1) - np.tan(np.abs(ground.climb[at]))
    drive = FieldDrive(
        world,
        rover,
        _parameters(world, rover, rng),
        time,
        path,
        moves,
        slip,
        load,
        z,
        ground.resistance[at] * factor,
        pull * factor,
        held,
        reserve,
        law,
        ground.kind[at],
        [],
        False,
    )
    x, y = way.x[at], way.y[at]
    sensed = _Sensed(world, rover, rng, drive, x, y, yaw, speed, turning, rim, climb, roll, gained)
    drive.messages = sorted(sensed.all(), key=lambda message: message[0])
    return drive


def _parameters(world: FieldWorld, rover: Rover, rng: np.random.Generator) -> dict[str, Any]:
    found: dict[str, Any] = {"wheels": [w.name for w in rover.wheels], "soil.name": "dry_sand"}
    for wheel in rover.wheels:
        way = -1.0 if world.mirrored else 1.0
        found[f"{wheel.name}.diameter"] = wheel.diameter
        found[f"{wheel.name}.width"] = wheel.width
        found[f"{wheel.name}.longitudinal_position"] = way * wheel.longitudinal_position
        found[f"{wheel.name}.lateral_position"] = wheel.lateral_position
    told = rover.mass * (1.0 + 0.01 * float(rng.standard_normal()))
    if world.mass:
        found["vehicle.mass"] = told
    if world.imu:
        found["imu_topic"] = "imu"
    if world.zero_std is not None:
        found["sinkage_zero_std"] = world.zero_std
    if world.static:
        found |= {"load.source": "static", "vehicle.mass": told}
    return found


class _Sensed:
    """The messages of a drive."""

    def __init__(
        self,
        world: FieldWorld,
        rover: Rover,
        rng: np.random.Generator,
        drive: FieldDrive,
        *truth: Array,
    ) -> None:
        self.world, self.rover, self.rng, self.drive = world, rover, rng, drive
        (self.x, self.y, self.yaw, self.speed, self.turning, self.rim) = truth[:6]
        self.climb, self.roll, self.gained = truth[6:]
        self.normal = rng.standard_normal

    def all(self) -> Iterator[Message]:
        """Every message."""
        for j in range(len(self.rover.wheels)):
            if not self.world.static:
                yield from self._loads(j)
            yield from self._sinkages(j)
        yield from self._odometry()
        yield from self._joints()
        if self.world.imu:
            yield from self._imu()

    def _times(self, rate: float) -> Array:
        end = float(self.drive.time[-1])
        return (np.arange(int(end * rate) - 1) + self.rng.uniform()) / rate

    def _at(self, time: Array, values: Array) -> Array:
        return np.interp(time, self.drive.time, values)

    def _faulty(self, time: Array) -> NDArray[np.bool_]:
        return self._at(time, self.drive.path) >= self.world.onset

    def _loads(self, j: int) -> Iterator[Message]:
        source = j
        if self.world.swapped and j in self.world.swapped:
            source = sum(self.world.swapped) - j
        time = self._times(_RATES["load"])
        true = self._at(time, self.drive.load[:, source])
        shown = true * (1.0 + 0.012 * self.normal(time.size)) + 0.4 * self.normal(time.size)
        shown = np.maximum(shown, 0.1) * self.world.load_scale
        name = f"{self.rover.wheels[j].name}/load"
        for t, value in zip(time, shown, strict=True):
            force = SimpleNamespace(x=0.0, y=0.0, z=float(value))
            yield _message(t, name, wrench=SimpleNamespace(force=force))

    def _sinkages(self, j: int) -> Iterator[Message]:
        world, time = self.world, self._times(self.world.sinkage_rate)
        true = self._at(time, self.drive.sinkage[:, j])
        shown = true + np.hypot(5e-4, 0.03 * true) * self.normal(time.size)
        if j == 0 and world.frozen is not None:
            late = self._faulty(time)
            first = shown[np.argmax(late)]
            shown = np.where(late, first + world.frozen * self.rng.uniform(-1, 1, time.size), shown)
        shown = shown * world.sinkage_scale
        name = f"{self.rover.wheels[j].name}/sinkage"
        for t, value in zip(time, shown, strict=True):
            yield _message(t, name, sinkage=float(value), variance=0.0)

    def _odometry(self) -> Iterator[Message]:
        world, time = self.world, self._times(_RATES["odom"])
        keep = math.exp(-1.0 / _RATES["odom"] / world.alike) if world.alike else 0.0
        noise = 0.008 * self.normal(time.size)
        for i in range(1, noise.size):
            noise[i] = keep * noise[i - 1] + math.sqrt(1.0 - keep * keep) * noise[i]
        speed = self._at(time, self.speed) + noise
        rate = self._at(time, self.turning) + 0.005 * self.normal(time.size)
        drift = np.cumsum(2e-4 * self.normal((2, time.size)), axis=1)
        x, y = self._at(time, self.x) + drift[0], self._at(time, self.y) + drift[1]
        yaw = self._at(time, self.yaw) + 2e-3 * self.normal(time.size)
        pitch = np.zeros(time.size)
        if not world.imu:
            pitch = -self._at(time, self.climb) + 2e-3 * self.normal(time.size)
        columns = np.stack([x, y, speed, rate, yaw, pitch], axis=1)
        if world.odometry == "repeats":
            late = self._faulty(time)
            columns[late] = columns[np.argmax(late)]
        spread = np.zeros(36)
        spread[[0, 35]] = 0.008**2, 0.005**2
        for t, (px, py, v, w, heading, nose) in zip(time, columns.tolist(), strict=True):
            pose = SimpleNamespace(
                position=SimpleNamespace(x=px, y=py, z=0.0),
                orientation=_quaternion(0.0, nose, heading),
            )
            twist = SimpleNamespace(
                linear=SimpleNamespace(x=v, y=0.0, z=0.0), angular=SimpleNamespace(z=w)
            )
            yield _message(
                t,
                "odom",
                pose=SimpleNamespace(pose=pose),
                twist=SimpleNamespace(twist=twist, covariance=spread),
            )

    def _joints(self) -> Iterator[Message]:
        world, time = self.world, self._times(_RATES["joints"])
        names = [f"{w.name}_joint" for w in self.rover.wheels]
        wrong = 1.0 + 0.01 * self.normal(len(names))
        columns = []
        for j, wheel in enumerate(self.rover.wheels):
            turn = self._at(time, self.turning)
            bend = np.where(
                np.abs(self._at(time, self.speed)) > 0.004,
                self._at(time, self.rim) * _turned(self, time, wheel.lateral_position),
                -turn * wheel.lateral_position / 0.92,
            )
            omega = bend / (0.5 * wheel.diameter)
            spread = np.hypot(0.01 * (np.abs(omega) > 1e-3), 0.004 * omega)
            columns.append(omega * wrong[j] + spread * self.normal(time.size))
        late = self._faulty(time)
        if world.encoder:
            columns[0] = np.where(
                late, 0.0 if world.encoder == "zero" else columns[0][np.argmax(late)], columns[0]
            )
        for t, values in zip(time, np.stack(columns, axis=1).tolist(), strict=True):
            yield _message(t, "joint_states", name=names, velocity=values, effort=[])

    def _imu(self) -> Iterator[Message]:
        world, time = self.world, self._times(_RATES["imu"])
        off = math.radians(0.3) * self.normal(2)
        noise = math.radians(0.2) * self.normal((2, time.size))
        tilt = world.tilt + world.walk * time / 60.0
        climb = self._at(time, self.climb) + off[0] + noise[0] + tilt
        roll = self._at(time, self.roll) + off[1] + noise[1]
        yaw = self._at(time, self.yaw)
        gained = self._at(time, self.gained)
        felt = np.stack(
            [
                GRAVITY * np.sin(climb) + gained,
                GRAVITY * np.cos(climb) * np.sin(roll),
                GRAVITY * np.cos(climb) * np.cos(roll),
            ],
            axis=1,
        ) + 0.1 * self.normal((time.size, 3))
        turn = self._at(time, self.turning) + 5e-3 * self.normal(time.size)
        for i, t in enumerate(time):
            a, b, c = felt[i].tolist()
            yield _message(
                t,
                "imu",
                angular_velocity=SimpleNamespace(z=float(turn[i])),
                orientation=_quaternion(float(roll[i]), float(-climb[i]), float(yaw[i])),
                orientation_covariance=np.zeros(9),
                linear_acceleration=SimpleNamespace(x=a, y=b, z=c),
            )


def _turned(sensed: _Sensed, time: Array, lateral: float) -> Array:
    """Speed of a wheel's place over that of the middle."""
    speed, turning = sensed._at(time, sensed.speed), sensed._at(time, sensed.turning)
    found: Array = (
        1.0 - np.where(np.abs(speed) > 0.004, turning / np.where(speed, speed, 1.0), 0.0) * lateral
    )
    return found


def _message(time: float, topic: str, **fields: Any) -> Message:
    stamp = EPOCH + round(1e9 * float(time))
    when = SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9)
    header = SimpleNamespace(stamp=when, frame_id="odom")
    return stamp, topic, SimpleNamespace(header=header, **fields)


def _quaternion(roll: float, pitch: float, yaw: float) -> SimpleNamespace:
    sr, cr = math.sin(roll / 2), math.cos(roll / 2)
    sp, cp = math.sin(pitch / 2), math.cos(pitch / 2)
    sy, cy = math.sin(yaw / 2), math.cos(yaw / 2)
    return SimpleNamespace(
        x=sr * cp * cy - cr * sp * sy,
        y=cr * sp * cy + sr * cp * sy,
        z=cr * cp * sy - sr * sp * cy,
        w=cr * cp * cy + sr * sp * sy,
    )
