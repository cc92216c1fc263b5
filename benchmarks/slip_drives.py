# SPDX-License-Identifier: Apache-2.0
"""Drives through `slip_worlds`: what was true, and the messages of joints, odometry and imu.

The truth is a vehicle of rigid wheels in time, each with a sinkage of its own that follows from its load
and from how much soil its rim has moved: a wheel that slips digs, and sinks back only by travelling on. Shear
stress is integrated along the arc (`traction_worlds.forces`), the speed follows from the balance with
inertia, ground lies in patches along the tracks. Of all that the package's model has only stresses along an
arc.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from benchmarks.field_drives import GRAVITY, Message, _message, _quaternion
from benchmarks.field_worlds import Rover
from benchmarks.slip_worlds import VEHICLES, WAYS, SlipWorld
from benchmarks.traction_worlds import forces
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.simulate.truth import Contact

Array = NDArray[np.float64]

TICK = 0.02  # s
STUCK, _LASTS, _STUCK_FOR = (
    0.8,
    0.5,
    1.5,
)  # slip; s after which it is stuck, and after which the drive ends
REFERENCE_SLIP = 0.4
_CELL = 0.02  # m
_SLIPS = np.array(
    [-1, -0.7, -0.4, -0.2, -0.1, -0.04, 0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1]
)
_DEPTHS = np.geomspace(0.003, 0.40, 28)  # over the diameter
_STEPS = np.linspace(-1.0, 1.0, 25)  # of what a speed may change by in a tick
_RAMP, _TURNING = 0.6, 0.5  # m/s^2, rad/s, as the driver commands


@dataclass
class SlipDrive:
    """What was true by time; arrays of shape (times,) or (times, wheels).

    slip: of wheels, NaN where one stands. used, held: of the vehicle: thrust over load, and pull over load
    at the reference slip. stuck: the time (s) at which slip had been over 0.8 for half a second, to stay, or
    None. messages: by their stamps.
    """

    world: SlipWorld
    rover: Rover
    parameters: dict[str, Any]
    time: Array
    path: Array
    speed: Array
    rim: Array
    slip: Array
    sinkage: Array
    used: Array
    held: Array
    torque: Array
    climb: Array
    roll: Array
    turning: Array
    yaw: Array
    stuck: float | None
    messages: list[Message]


class _Ground:
    """Sinkage under the load, grip, slope and bumps along the way, and forces by sinkage and slip."""

    def __init__(self, world: SlipWorld, rover: Rover, rng: np.random.Generator) -> None:
        self.world = world
        length = sum(abs(leg.metres) for leg in WAYS[world.way])
        self.at = np.arange(-12.0, length + 3.0, _CELL)
        wheel = rover.wheels[0]
        self.cohesion, friction = abs(400.0 * rng.standard_normal()), rng.uniform(0.47, 0.65)
        self.exponent, shear = rng.uniform(0.6, 1.2), 0.012 * math.exp(0.3 * rng.standard_normal())
        if world.ground == "loam":
            self.cohesion, friction, self.exponent = rng.uniform(1500, 4000), 0.35, 0.6
        depth = rng.uniform(0.02, 0.07)  # over the diameter
        load = rover.mass * GRAVITY / len(rover.wheels)
        strength = np.array([self.cohesion, friction, shear])
        rolling = rng.uniform(0.2, 1.0)  # share of the displacement by rolling that shears soil
        self.thrust, self.resistance, self.torque = _table(
            wheel, load, self.exponent, strength, rolling
        )
        self.digging = rng.uniform(0.015, 0.06)  # m of sinkage per m by which a rim gets ahead
        self.dragging = rng.uniform(0.0, 0.03)
        self.yields = rng.uniform(0.5, 0.9)  # of a turn that is commanded
        edge = np.clip(
            (self.at - rng.uniform(0.35, 0.7) * length) / rng.uniform(*world.edge), 0.0, 1.0
        )
        if world.ends is not None:
            edge = np.clip((self.at - world.ends - 3.0) / rng.uniform(*world.edge), 0.0, 1.0)
        # Slopes east and north of the ground, and what it steepens by the way it drives.
        self.slopes = np.array([self._waves(rng), self._waves(rng)])
        self.steepens = rng.uniform(*(world.steepens or (0.0, 0.0))) * edge
        grip = self._patches(rng, 0.15)
        if world.slippery:
            grip = grip + math.log(rng.uniform(*world.slippery)) * edge
        softer = 1.0
        if world.softens:
            softer = rng.uniform(*world.softens)
            grip = grip + math.log(rng.uniform(0.4, 0.9)) * edge  # wet soil holds less, too
        count = len(rover.wheels)
        self.grip = np.array([np.exp(grip + self._patches(rng, 0.05)) for _ in range(count)])
        self.depth = np.array(
            [
                depth * np.exp(self._patches(rng, 0.1) + math.log(softer) * edge)
                for _ in range(count)
            ]
        )
        self.floor = np.full(len(self.at), world.ground == "floor")
        if world.ends is not None:
            self.floor &= self.at < world.ends
        self.bumps = np.zeros((2, len(self.at)))  # m, left and right
        if world.bumps:
            for side in self.bumps:
                place = 2.0
                while place < length:
                    size = rng.uniform(0.25, 0.4)
                    inside = (self.at > place) & (self.at < place + size)
                    lift = world.bumps * wheel.diameter * rng.uniform(0.4, 1.0)
                    side[inside] += lift * np.sin(np.pi * (self.at[inside] - place) / size) ** 2
                    place += rng.uniform(0.8, 2.5)
        self.steep = np.gradient(self.bumps, _CELL, axis=1)

    def _waves(self, rng: np.random.Generator) -> Array:
        found = np.zeros(len(self.at))
        for wave in (5.0, 11.0):
            size = self.world.slope * rng.uniform(0.4, 1.0)
            found += size * np.sin(2 * np.pi * self.at / wave + rng.uniform(0, 6.3))
        return found

    def tilt(self, cell: int, yaw: float) -> tuple[float, float]:
        """Climb and roll (rad; positive nose up, left side up)."""
        east, north = self.slopes[:, cell].tolist()
        climb = east * math.cos(yaw) + north * math.sin(yaw) + float(self.steepens[cell])
        return climb, north * math.cos(yaw) - east * math.sin(yaw)

    def _patches(self, rng: np.random.Generator, deviation: float) -> Array:
        """Blocks of half a metre to two and a half, with edges of 0.2 m."""
        edges = np.cumsum(rng.uniform(0.5, 2.5, 120)) + self.at[0]
        values = deviation * rng.standard_normal(121)
        found: Array = uniform_filter1d(values[np.searchsorted(edges, self.at)], round(0.2 / _CELL))
        return found

    def cells(self, places: Array) -> NDArray[np.intp]:
        """Cells of places along the way (m)."""
        return np.clip(np.round((places - self.at[0]) / _CELL), 0, len(self.at) - 1).astype(int)


def _table(
    wheel: Wheel, load: float, exponent: float, strength: Array, rolling: float
) -> tuple[Array, Array, Array]:
    """Thrust and torque (as a force at the rim) by depth and slip, resistance by depth; over the load."""
    width, depth = wheel.width, _DEPTHS * wheel.diameter

    def shape(below: Array, modulus: Array) -> Array:
        pressure: Array = modulus[:, None] * np.maximum(below, 0.0) ** exponent
        return pressure

    # The pressure that carries the load: its vertical part is in proportion to the modulus.
    contact = Contact.at(np.full(len(depth), wheel.diameter), depth)
    ones = np.ones(len(depth))
    modulus = load / contact.upward(shape(contact.depth, ones), width * ones)
    thrust, resistance, torque = forces(
        lambda below: shape(below, modulus), depth, wheel, strength, _SLIPS[1:-1], rolling
    )
    ends = [np.pad(one, ((0, 0), (1, 1)), mode="edge") for one in (thrust, torque)]
    return ends[0] / load, resistance / load, ends[1] / load / (0.5 * wheel.diameter)


def make_drive(world: SlipWorld, seed: int) -> SlipDrive:
    """Draw a drive; of ground that gives way nowhere, one that the vehicle gets over."""
    for attempt in range(300):
        rng = np.random.default_rng([seed, attempt, 3434, *world.name.encode()])
        made = _driven(world, rng)
        if made is not None:
            made.messages = sorted(_Sensed(made, rng).all(), key=lambda message: message[0])
            return made
    raise RuntimeError(f"{world.name}: no ground carries this vehicle")


def _commands(world: SlipWorld) -> Iterator[tuple[float, float, float | None]]:
    """For each leg: metres, bend or turn, and s to stand."""
    for leg in WAYS[world.way]:
        yield leg.metres, leg.bend, None
        if leg.turn:
            yield 0.0, leg.turn, None
        yield 0.0, 0.0, leg.stand


def _driven(world: SlipWorld, rng: np.random.Generator) -> SlipDrive | None:
    rover = VEHICLES[world.vehicle]
    ground = _Ground(world, rover, rng)
    car = _Vehicle(world, rover, ground, rng)
    car.stand(2.0)
    for metres, turn, stand in _commands(world):
        if stand is not None:
            car.stand(stand)
        elif metres:
            car.drive(metres, turn)
        else:
            car.turn(turn)
        if car.stuck is not None or car.fast:
            break
    if car.fast or (not world.digs and (car.stuck is not None or car.most > 0.35)):
        return None
    if car.path < 6.0:
        return None
    columns = [np.array(column) for column in zip(*car.rows, strict=True)]
    return SlipDrive(world, rover, _parameters(world, rover, rng), *columns, car.stuck, [])


class _Vehicle:
    """In time: path, speed, sinkages."""

    def __init__(
        self, world: SlipWorld, rover: Rover, ground: _Ground, rng: np.random.Generator
    ) -> None:
        self.world, self.rover, self.ground, self.rng = world, rover, ground, rng
        self.ahead = np.array([w.longitudinal_position for w in rover.wheels])
        self.aside = np.array([w.lateral_position for w in rover.wheels])
        self.side = (self.aside < 0.0).astype(int)
        self.diameter = rover.wheels[0].diameter
        self.share = 1.0 + 0.1 * rng.standard_normal(len(self.aside))
        self.share /= self.share.mean()
        self.place = self.speed = self.path = self.yaw = self.time = 0.0
        self.most, self.fast = 0.0, False  # fast: stuck fast before it came to anything
        self.depth = ground.depth[np.arange(len(self.aside)), ground.cells(self.ahead)]
        self.ripple = np.zeros(len(self.aside))
        self.rows: list[tuple[Any, ...]] = []
        self.stuck: float | None = None
        self._spins = 0

    def stand(self, seconds: float) -> None:
        """Stand."""
        for _ in range(round(seconds / TICK)):
            self.step(0.0, 0.0)

    def turn(self, angle: float) -> None:
        """Turn on the spot, as far as rims say; the ground yields a part of it."""
        rate = math.copysign(_TURNING, angle)
        for _ in range(round(abs(angle) / _TURNING / TICK)):
            self.step(0.0, rate)

    def drive(self, metres: float, bend: float) -> None:
        """Drive so far along a bend, or until it is stuck."""
        sense, rim, begin, ticks = math.copysign(1.0, metres), 0.0, self.path, 0
        while self.path - begin < abs(metres) - 1e-3 and self.stuck is None and not self.fast:
            left = abs(metres) - self.path + begin
            wish = self.world.speed * (1.0 + 0.1 * math.sin(0.5 * self.time))
            wish = min(wish, math.sqrt(1.2 * _RAMP * left) + 0.02)
            rim = min(max(wish, rim - _RAMP * TICK), rim + _RAMP * TICK)
            self.step(sense * rim, sense * rim * bend)
            ticks += 1
            self.fast = ticks * TICK > 300.0

    def step(self, rim: float, turning: float) -> None:
        """One tick: rims are commanded to go at this speed (m/s) and rate (rad/s)."""
        ground, rover = self.ground, self.rover
        sense = -1.0 if rim < 0.0 else 1.0
        keep = math.exp(-TICK / 0.3)
        self.ripple = keep * self.ripple + 0.01 * math.sqrt(1 - keep**2) * self.rng.standard_normal(
            len(self.aside)
        )
        rims = (rim - turning * self.aside) * (1.0 + self.ripple)
        spot = rim == 0.0 and turning != 0.0
        firm = ground.floor[ground.cells(np.array([self.place]))][0]
        yields = 0.9 if firm else ground.yields
        rate = turning * (yields if spot else 1.0)
        cells = ground.cells(self.place + self.ahead)
        order = np.arange(len(cells))
        climb, roll = ground.tilt(int(ground.cells(np.array([self.place]))[0]), self.yaw)
        load = rover.mass * GRAVITY * math.cos(climb) / len(cells) * self._shares(climb)
        steep = np.clip(ground.steep[self.side, cells], -0.5, 0.5)
        moves, dive = bool(rim) or abs(self.speed) > 1e-3, 0.0
        if moves:
            now, slip, thrust = self._balance(rims, rate, load, cells, steep * sense, climb, sense)
        else:
            now, slip, thrust = 0.0, np.full(len(cells), np.nan), np.zeros(len(cells))
            if spot:
                slip = np.full(len(cells), 1.0 - yields)
        self.speed = now
        travel = abs(now) * TICK
        self.place, self.path = self.place + now * TICK, self.path + travel
        self.yaw += rate * TICK
        # Digging, and sinking back over a contact's length of way.
        ahead = np.maximum(np.abs(rims) - np.abs(now - rate * self.aside), 0.0)
        dug = ground.digging * ahead * TICK
        rest = ground.depth[order, cells] * (load / load.mean()) ** (1.0 / (ground.exponent + 0.5))
        kept = np.exp(-travel / (0.5 * self.diameter))
        self.depth = np.minimum(
            rest + (self.depth - rest) * kept + dug / self.diameter, _DEPTHS[-1]
        )
        self.depth = np.maximum(self.depth, 0.3 * rest)
        height = ground.bumps[self.side, cells]
        front = self.ahead > 0.0
        dive = (height[front].mean() - height[~front].mean()) / (2.0 * self.ahead.max())
        held = self._held(cells)
        hard = bool(firm)
        sunk = np.zeros(len(cells)) if hard else self.depth * self.diameter
        torque = self._torque(slip, cells) * load * 0.5 * self.diameter
        shown = np.where(np.abs(rims) > 1e-3, slip, np.nan)
        self.rows.append(
            (self.time, self.path, now, rims, shown, sunk, float(thrust.sum() / load.sum()), held, torque,
             climb + dive, roll, rate, self.yaw)
        )  # fmt: skip
        self.time += TICK
        self._look(rims, sense)

    def _look(self, rims: Array, sense: float) -> None:
        """Whether it is stuck."""
        whole = float(np.mean(rims)) * sense
        spins = whole > 0.03 and self.speed * sense < (1.0 - STUCK) * whole
        if whole > 0.9 * self.world.speed:
            self.most = max(self.most, 1.0 - self.speed * sense / whole)
        self._spins = self._spins + 1 if spins else 0
        if self._spins * TICK >= _STUCK_FOR:
            self.stuck = self.time - self._spins * TICK + _LASTS

    def _shares(self, climb: float) -> Array:
        """Loads over their mean."""
        moved = -self.rover.height * math.tan(climb) * self.ahead / np.mean(self.ahead**2)
        shares: Array = np.maximum(self.share + moved, 0.1)
        return shares

    def _rows(self, cells: NDArray[np.intp], table: Array) -> Array:
        """Rows of a table at the wheels' sinkages."""
        place = np.interp(np.log(self.depth), np.log(_DEPTHS), np.arange(len(_DEPTHS)))
        low = np.minimum(place.astype(int), len(_DEPTHS) - 2)
        part = place - low
        part = part[:, None] if table.ndim == 2 else part
        rows: Array = table[low] * (1.0 - part) + table[low + 1] * part
        return rows

    def _pulls(self, slips: Array, cells: NDArray[np.intp]) -> tuple[Array, Array]:
        """Thrust over load at slips, shape (candidates, wheels), and net of resistance."""
        ground, order = self.ground, np.arange(len(cells))
        rows = self._rows(cells, ground.thrust)
        at = np.interp(slips, _SLIPS, np.arange(len(_SLIPS)))
        low = np.minimum(at.astype(int), len(_SLIPS) - 2)
        thrust = rows[order, low] * (1.0 - at + low) + rows[order, low + 1] * (at - low)
        thrust = thrust * ground.grip[order, cells]
        lost = self._rows(cells, ground.resistance) + ground.dragging
        floor = ground.floor[cells]
        hard = 0.7 * np.sign(slips) * -np.expm1(-np.abs(slips) / 0.03)
        thrust = np.where(floor, hard, thrust)
        return thrust, thrust - np.where(floor, 0.02, lost)

    def _slips(self, speeds: Array, rims: Array, sense: float) -> Array:
        travel, rim = speeds * sense, rims * sense
        fast = np.maximum(np.maximum(np.abs(travel), np.abs(rim)), 1e-6)
        slips: Array = np.clip((rim - travel) / fast, -1.0, 1.0)
        return slips

    def _balance(
        self, rims: Array, rate: float, load: Array, cells: NDArray[np.intp], steep: Array,
        climb: float, sense: float,
    ) -> tuple[float, Array, Array]:  # fmt: skip
        """Speed after this tick, slips and thrusts."""
        mass = self.rover.mass
        candidates = self.speed + 6.0 * TICK * _STEPS
        places = candidates[:, None] - rate * self.aside
        slips = self._slips(places, rims, sense)
        _, net = self._pulls(slips, cells)
        whole = ((net - steep) * load).sum(axis=1) * sense - mass * GRAVITY * math.sin(climb)
        left = np.minimum.accumulate(whole - mass * (candidates - self.speed) / TICK)
        now = float(np.interp(0.0, -left, candidates))
        if now * sense < 0.0 and abs(rims.mean()) > 1e-3:
            now = 0.0  # rigid wheels in their ruts do not roll back against their drives
        slip = self._slips(now - rate * self.aside, rims, sense)
        return now, slip, self._pulls(slip[None], cells)[0][0] * load

    def _held(self, cells: NDArray[np.intp]) -> float:
        """Pull over load of the vehicle at the reference slip."""
        return float(self._pulls(np.full((1, len(cells)), REFERENCE_SLIP), cells)[1].mean())

    def _torque(self, slip: Array, cells: NDArray[np.intp]) -> Array:
        rows, order = self._rows(cells, self.ground.torque), np.arange(len(cells))
        found = [
            np.interp(s, _SLIPS, row) for s, row in zip(np.nan_to_num(slip), rows, strict=True)
        ]
        return np.array(found) * self.ground.grip[order, cells]


def _parameters(world: SlipWorld, rover: Rover, rng: np.random.Generator) -> dict[str, Any]:
    """What the user tells: nothing of soil and noise."""
    mass = rover.mass * (1.0 + 0.03 * float(rng.standard_normal()))
    found: dict[str, Any] = {"wheels": [w.name for w in rover.wheels]}
    found |= {"load.source": "static", "vehicle.mass": mass}
    if world.imu:
        found["imu_topic"] = "imu"
    for wheel in rover.wheels:
        found[f"{wheel.name}.diameter"] = wheel.diameter
        found[f"{wheel.name}.width"] = wheel.width
        found[f"{wheel.name}.longitudinal_position"] = wheel.longitudinal_position
        found[f"{wheel.name}.lateral_position"] = wheel.lateral_position
        found[f"{wheel.name}.sinkage_topic"] = ""
        if world.torque:
            found[f"{wheel.name}.torque_per_effort"] = 1.0
    return found


class _Sensed:
    """The messages of a drive."""

    def __init__(self, drive: SlipDrive, rng: np.random.Generator) -> None:
        self.drive, self.world, self.rng = drive, drive.world, rng
        self.normal = rng.standard_normal
        self.radius = 1.0 + 0.007 * (self.normal() + self.normal(len(drive.rover.wheels)))
        ticks = 2.0 * np.pi / rng.choice([2000, 8000, 30000])  # of an encoder behind the gear, rad
        time = self._times(float(rng.choice([20.0, 30.0, 50.0])))
        places = np.array([w.lateral_position for w in drive.rover.wheels])
        turned = np.cumsum(drive.rim, axis=0) * TICK
        half = 0.5 * drive.rover.wheels[0].diameter * self.radius
        angle = np.floor(self._at(time, turned) / half / ticks) * ticks
        speed = np.diff(angle, axis=0, prepend=angle[:1]) / np.gradient(time)[:, None]
        self.joints = time, speed * (1.0 + 0.004 * self.normal(speed.shape))
        self.places = places

    def all(self) -> Iterator[Message]:
        """Every message."""
        yield from self._joints()
        yield from self._odometry()
        if self.world.imu:
            yield from self._imu()

    def _times(self, rate: float) -> Array:
        end = float(self.drive.time[-1])
        return (np.arange(int(end * rate) - 1) + self.rng.uniform()) / rate

    def _at(self, time: Array, values: Array) -> Array:
        if values.ndim == 1:
            return np.interp(time, self.drive.time, values)
        columns = [np.interp(time, self.drive.time, column) for column in values.T]
        return np.stack(columns, axis=1)

    def _joints(self) -> Iterator[Message]:
        time, speeds = self.joints
        names = [f"{w.name}_joint" for w in self.drive.rover.wheels]
        torque = self._at(time, self.drive.torque) * (1.0 + 0.08 * self.normal(len(names)))
        torque = torque * (1.0 + 0.03 * self.normal(torque.shape)) + 1e-3
        for t, row, effort in zip(time, speeds.tolist(), torque.tolist(), strict=True):
            told = effort if self.world.torque else []
            yield _message(t, "joint_states", name=names, velocity=row, effort=told)

    def _own(self, time: Array, rate: float) -> tuple[Array, float]:
        """A speed that is made of pictures: late, of another scale, with errors that last for a while."""
        world, rng = self.world, self.rng
        late, smooth = rng.uniform(*world.lag), rng.uniform(*world.lag)
        true = self.drive.speed
        if smooth > TICK:
            true = lfilter([TICK / smooth], [1.0, TICK / smooth - 1.0], true)
        deviation, keep = rng.uniform(*world.noise), math.exp(-1.0 / rate / 0.3)
        lasting = lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], self.normal(time.size))
        dive = np.gradient(self.drive.climb, TICK) * 0.15  # a camera above the middle
        speed = self._at(time - late, true + dive) * (1.0 + 0.007 * self.normal())
        part = rng.uniform(0.2, 0.8)
        noise = part * self.normal(time.size) + math.sqrt(1.0 - part**2) * lasting
        return speed + deviation * noise, deviation

    def _of_wheels(self, time: Array, filtered: bool) -> Array:
        """A speed that is made of the joints, as it is or by a filter with the imu's gains."""
        when, speeds = self.joints
        shown = speeds.mean(axis=1) * 0.5 * self.drive.rover.wheels[0].diameter
        if not filtered:
            return np.asarray(np.interp(time, when, shown))
        felt = np.zeros(
            when.size
        )  # half of them use accelerations, half take the speed for constant
        if self.rng.uniform() < 0.5:
            felt = np.gradient(np.interp(when, self.drive.time, self.drive.speed), when)
            felt = felt + 0.05 * self.normal() + 0.1 * self.normal(when.size)
        speed, gain = np.zeros(when.size), self.rng.uniform(0.15, 0.5)
        for i in range(1, when.size):
            expected = speed[i - 1] + felt[i] * (when[i] - when[i - 1])
            speed[i] = expected + gain * (shown[i] - expected)
        return np.asarray(np.interp(time, when, speed))

    def _odometry(self) -> Iterator[Message]:
        world, rate = self.world, float(self.rng.choice([10.0, 15.0, 30.0]))
        time = self._times(rate)
        if world.odometry == "own":
            speed, deviation = self._own(time, rate)
        elif world.odometry == "half":
            speed, deviation = self._own(time, rate)
            speed = 0.5 * (speed + self._of_wheels(time, True))
        else:
            speed, deviation = self._of_wheels(time, world.odometry == "filter"), 0.01
        turning = self._at(time, self.drive.turning) + 0.005 * self.normal(time.size)
        yaw = self._at(time, self.drive.yaw) + 2e-3 * self.normal(time.size)
        x = np.cumsum(speed * np.cos(yaw)) / rate
        y = np.cumsum(speed * np.sin(yaw)) / rate
        pitch = np.zeros(time.size)
        if not world.imu and world.odometry != "wheels":
            pitch = -self._at(time, self.drive.climb) + 5e-3 * self.normal(time.size)
        spread = np.zeros(36)
        if world.told:
            spread[[0, 35]] = (world.told * deviation) ** 2, 0.005**2
        for i, t in enumerate(time):
            pose = SimpleNamespace(
                position=SimpleNamespace(x=float(x[i]), y=float(y[i]), z=0.0),
                orientation=_quaternion(0.0, float(pitch[i]), float(yaw[i])),
            )
            twist = SimpleNamespace(
                linear=SimpleNamespace(x=float(speed[i]), y=0.0, z=0.0),
                angular=SimpleNamespace(z=float(turning[i])),
            )
            yield _message(
                t,
                "odom",
                pose=SimpleNamespace(pose=pose),
                twist=SimpleNamespace(twist=twist, covariance=spread),
            )

    def _imu(self) -> Iterator[Message]:
        time = self._times(50.0)
        off, noise = math.radians(0.5) * self.normal(2), math.radians(0.3)
        climb = self._at(time, self.drive.climb) + off[0] + noise * self.normal(time.size)
        roll = self._at(time, self.drive.roll) + off[1] + noise * self.normal(time.size)
        yaw = self._at(time, self.drive.yaw)
        gained = np.interp(time, self.drive.time, np.gradient(self.drive.speed, TICK))
        turn = self._at(time, self.drive.turning) + 5e-3 * self.normal(time.size)
        for i, t in enumerate(time):
            felt = SimpleNamespace(
                x=float(GRAVITY * math.sin(climb[i]) + gained[i] + 0.3 * self.normal()),
                y=float(GRAVITY * math.sin(roll[i]) + 0.3 * self.normal()),
                z=float(GRAVITY + 0.5 * self.normal()),
            )
            yield _message(
                t,
                "imu",
                angular_velocity=SimpleNamespace(z=float(turn[i])),
                orientation=_quaternion(float(roll[i]), float(-climb[i]), float(yaw[i])),
                orientation_covariance=np.zeros(9),
                linear_acceleration=felt,
            )
