# SPDX-License-Identifier: Apache-2.0
"""Motion of a vehicle in time on the ground of a world, until the end of its route or until it gets stuck.

The speeds of the rims are commanded. Each wheel has its own sinkage, from its load and from the soil that
its rim has dug away over time: a wheel that slips digs, and climbs out only by travelling on. The speed
follows from the forces of all wheels and inertia. A differential gives both wheels of an axle the same
torque, so that the lighter one spins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.simulate.steered_wheels import SteeredWheels
from smallwheel_ros.simulate.truth import Array
from smallwheel_ros.simulate.wheel_laws import DEPTHS, LAWS, SLIPS
from smallwheel_ros.simulate.world import GRAVITY, SimulatedRover, World
from smallwheel_ros.simulate.world_ground import CELL, Frame, TrueGround, TrueSoil, tilt

# 2025-06-12 09:30:00 UTC: drives start at one fixed instant, so that a seed gives the same bytes.
EPOCH = 1_749_720_600 * 10**9  # ns
TICK = 0.04  # s
STUCK = 0.8  # mean slip over which a vehicle counts as spinning
REFERENCE_SLIP = 0.4
_LASTS = 0.5  # s of spinning after which it is stuck
# A leg is given up after so many seconds, or the time that it takes at this share of the speed if longer.
_LONGEST, _SLOWEST = 900.0, 0.2
_HARDLY = 0.35  # mean slip at full speed over which the ground was hard to cross
_STEPS = np.linspace(-1.0, 1.0, 25)  # candidate changes of speed, over the largest in a tick
_GAIN = 6.0  # m/s^2, largest change of the speed
# m/s^2 by which rims of a differential diverge per difference of their torques (over radius and mean load).
_TORQUE_GAIN = 5.0
_LEAVING = 0.5  # diameters over which a wheel climbs out of what it dug
_LOWEST, _RATIO = math.log(DEPTHS[0]), math.log(DEPTHS[1] / DEPTHS[0])
_HARD_RESISTANCE, _HARD_GRIP, _HARD_STIFF = 0.02, 0.7, 0.03  # on hard ground


@dataclass(frozen=True)
class Truth:
    """True values over time; arrays of shape (times,), those of wheels (times, wheels).

    Attributes
    ----------
    time
        s since the start of the drive, one value for each `TICK`.
    path, place
        Distance travelled, and place along the route, m; the latter falls when driving backward.
    speed, rate
        Speed along the course, m/s, negative backward; yaw rate, rad/s.
    yaw, climb, roll
        Angles of the vehicle, rad, positive to the left, nose up, left side up.
    rim, slip
        Of each wheel: speed of the rim, m/s; slip, NaN where the rim stands.
    sinkage
        Of each wheel, m; 0 on hard ground.
    load, thrust, resistance, torque
        Of each wheel: N, N, N, N m.
    held
        Drawbar pull that each wheel would have at a slip of 0.4 (`REFERENCE_SLIP`), N.
    steering
        Angle of each wheel to the left of straight ahead, rad.
    crab
        Angle of the course to the left of the vehicle's heading, rad.
    stuck
        Time at which slip has been over 0.8 for half a second and stays so, s; None if never.
    """

    time: Array
    path: Array
    place: Array
    speed: Array
    rate: Array
    yaw: Array
    climb: Array
    roll: Array
    rim: Array
    slip: Array
    sinkage: Array
    load: Array
    thrust: Array
    resistance: Array
    torque: Array
    held: Array
    steering: Array
    crab: Array
    stuck: float | None

    def at(self, time: Array, values: Array) -> Array:
        """Interpolate true values linearly to other times.

        Parameters
        ----------
        time
            The other times, shape (rows,), s.
        values
            Values at the times of the truth, shape (times,) or (times, wheels).

        Returns
        -------
        ndarray
            Shape (rows,) or (rows, wheels), in the unit of `values`.
        """
        if values.ndim == 1:
            return np.interp(time, self.time, values)
        return np.stack([self.at(time, of_wheel) for of_wheel in values.T], axis=1)

    def felt(self, time: Array, lean: Array | tuple[float, float] = (0.0, 0.0)) -> Array:
        """Specific force that an IMU without noise measures.

        Parameters
        ----------
        time
            Times of the readings, shape (rows,), s.
        lean
            Error of its mounting, nose up and left side up, rad.

        Returns
        -------
        ndarray
            Components along the course, to its left, and up; shape (rows, 3), m/s^2.
        """
        climb, roll = self.at(time, self.climb), self.at(time, self.roll)
        turning = self.at(time, self.speed) * self.at(time, self.rate)
        ahead = GRAVITY * np.sin(climb + lean[0]) + self.at(time, self.acceleration)
        left = GRAVITY * np.cos(climb) * np.sin(roll + lean[1]) + turning
        return np.stack([ahead, left, GRAVITY * np.cos(climb) * np.cos(roll)], axis=1)

    def travel(self, rover: SimulatedRover, wheel: int) -> Array:
        """Compute the speed at which a wheel travels along its own heading.

        Parameters
        ----------
        rover
            The rover that drove.
        wheel
            Index of the wheel in `rover.wheels`.

        Returns
        -------
        ndarray
            Shape (times,), m/s, negative backward.
        """
        own, angle = rover.wheels[wheel], self.steering[:, wheel]
        lever = (own.x - rover.pivot) * np.sin(angle) - own.y * np.cos(angle)
        return np.asarray(np.cos(angle - self.crab) * self.speed + lever * self.rate)

    def aside(self, rover: SimulatedRover) -> Array:
        """Speed of base_link to the left, m/s, shape (times,). rover: the rover that drove."""
        return np.asarray(np.sin(self.crab) * self.speed - self.rate * rover.pivot)

    @property
    def pull(self) -> Array:
        """Drawbar pull of each wheel, thrust less resistance, N, shape (times, wheels)."""
        return self.thrust - self.resistance

    @property
    def acceleration(self) -> Array:
        """Rate of change of the speed, m/s^2, shape (times,)."""
        return np.asarray(np.gradient(self.speed, self.time))

    @property
    def course(self) -> tuple[Array, Array, Array]:
        """Position in the frame odom: x, y, and height, m, shape (times,) each."""
        step = self.speed * TICK
        level, way = step * np.cos(self.climb), self.yaw + self.crab
        parts = level * np.cos(way), level * np.sin(way), step * np.sin(self.climb)
        x, y, height = (np.cumsum(part) for part in parts)
        return x, y, height

    @property
    def margin(self) -> Array:
        """Mobility margin: pull of all wheels at the reference slip over their load, shape (times,)."""
        return np.asarray(self.held.sum(axis=1) / self.load.sum(axis=1))

    @property
    def reserve(self) -> Array:
        """Margin less the tangent of the climb (positive nose up), shape (times,)."""
        return np.asarray(self.margin - np.tan(self.climb))

    @property
    def middle_slip(self) -> Array:
        """Median of the wheels' slips (0 for a rim that stands), shape (times,).

        0 where the vehicle stands or turns on the spot, unless its rims spin.
        """
        known = np.nan_to_num(self.slip)
        turning = np.isnan(self.slip).all(axis=1) | (np.abs(self.speed) < 0.02)
        rolls = np.abs(self.rim).mean(axis=1) > 0.03
        stalls = rolls & (np.abs(self.rim.mean(axis=1)) > 0.03)
        return np.asarray(np.where(turning & ~stalls, 0.0, np.median(known, axis=1)))


class SimulatedVehicle:
    """Drives the legs of a world's route, tick by tick; `truth_of` returns the true values of the drive.

    Parameters
    ----------
    world
        The world: legs, speeds, and the properties of the vehicle.
    rover
        The rover.
    ground
        The ground, on which `rest` is computed already (`settle`).
    rng
        Random number generator for what varies from drive to drive, and for the ripple of the rims' speeds.

    Attributes
    ----------
    rows
        Values of each tick, in the order of the fields of `Truth` without `stuck`.
    stuck
        As `Truth.stuck`.
    failed
        Whether a leg took too long and was given up.
    most
        Largest mean slip of the wheels in a tick at more than 0.9 of the world's speed, dimensionless.
    """

    def __init__(
        self, world: World, rover: SimulatedRover, ground: TrueGround, rng: np.random.Generator
    ) -> None:
        self.world, self.rover, self.ground, self.rng = world, rover, ground, rng
        wheels = rover.wheels
        self.x, self.y = (np.array([getattr(w, axis) for w in wheels]) for axis in "xy")
        self.diameter = np.array([w.diameter for w in wheels])
        self.all = np.arange(len(wheels))
        self.side = (self.y < 0.0).astype(int)
        self.steered = SteeredWheels(rover) if rover.steers else None
        # Travel of each wheel per metre of the vehicle, and per radian of its turning (m).
        self.share: Array = np.ones(len(wheels))
        self.lever: Array = -self.y
        weight = rover.mass * GRAVITY / len(wheels)
        # Thrust, resistance and torque, (soils, wheels, depths, 3, slips); of this tick, (3, wheels, slips).
        self.curves = np.stack([self._curves_on(soil, weight) for soil in ground.soils])
        self.now = self.curves[0, :, 0].transpose(1, 0, 2)
        self.frame = Frame(rover, world.spare)
        self.steep = np.gradient(ground.bumps, CELL, axis=1).clip(-0.5, 0.5)
        self.axles = [
            (int(left), int(right))
            for left in self.all for right in self.all
            if self.x[left] == self.x[right] and self.y[left] > 0.0 > self.y[right]
        ]  # fmt: skip
        self.digging = rng.uniform(*world.digging)
        self.dragging = rng.uniform(*world.dragging)
        self.yields = rng.uniform(*world.skid) if world.skid else rng.uniform(0.5, 0.9)
        self.place = self.speed = self.path = self.yaw = self.time = 0.0
        self.most = 0.0
        self.failed = False
        self.crab = 0.0
        self.waits = False  # for its wheels to reach their steering angles
        self.dug: Array = np.zeros(self.all.size)
        self.ripple: Array = np.zeros(self.all.size)
        self.apart: Array = np.zeros(self.all.size)  # m/s, rims of a differential from their mean
        self.gained = 0.0
        tracks = {y: i for i, y in enumerate(dict.fromkeys(self.y.tolist()))}
        self.track = np.array([tracks[y] for y in self.y.tolist()])
        self.rolled = np.zeros((len(tracks), ground.at.size))
        self.passes: Array = np.zeros(self.all.size)
        self.last_cells = ground.cells(self.x) - 1
        self.rows: list[tuple[float | Array, ...]] = []
        self.stuck: float | None = None
        self._spins = 0

    def run(self) -> None:
        """Stand for 2 s, then drive leg by leg until the end, or until it is stuck or has failed."""
        self._stand(2.0)
        for leg in self.world.legs:
            if leg.turn:
                rate = math.copysign(self.world.turning, leg.turn)
                for _ in range(round(abs(leg.turn) / self.world.turning / TICK)):
                    self.step(0.0, rate)
            self.crab = leg.crab
            self._drive(leg.metres, leg.bend)
            self.crab = 0.0
            self._stand(leg.stand)
            if self.stuck is not None or self.failed:
                return

    def _stand(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.step(0.0, 0.0)

    def _drive(self, metres: float, bend: float) -> None:
        """Drive a distance (m, negative backward) along a bend (1/m), or until it is stuck or has failed."""
        sense, rim, begin = math.copysign(1.0, metres), 0.0, self.path
        gain = self.world.ramp * TICK
        until = self.time + max(_LONGEST, abs(metres) / (_SLOWEST * self.world.speed))
        while self.path - begin < abs(metres) - 1e-3 and self.stuck is None and not self.failed:
            left = abs(metres) - self.path + begin
            wish = self.world.speed * (1.0 + 0.12 * math.sin(0.5 * self.time))
            wish = min(wish, math.sqrt(1.2 * self.world.ramp * left) + 0.02)
            rim = min(max(wish, rim - gain), rim + gain)
            self.step(sense * rim, sense * rim * bend)
            rim = 0.0 if self.waits else rim
            self.failed = self.time > until

    def step(self, rim: float, turning: float) -> None:
        """Advance by one tick, and append its values to `rows`.

        Parameters
        ----------
        rim
            Commanded speed of the rims, m/s, negative backward.
        turning
            Commanded rate of turning, rad/s, positive to the left.
        """
        ground, sense = self.ground, -1.0 if rim < 0.0 else 1.0
        cells = ground.cells(self.place + self.x)
        here = int(ground.cells(np.array([self.place]))[0])
        climb, roll = map(float, tilt(ground, here, self.yaw))
        self._count_passes(cells)
        load = self.frame.loads(climb, roll, self.gained, float(ground.twist[here]))
        keep = math.exp(-TICK / 0.3)
        noise = math.sqrt(1.0 - keep**2) * self.rng.standard_normal(self.all.size)
        self.ripple = keep * self.ripple + 0.01 * noise
        if self.steered is not None:
            rim, turning = self._steer(rim, turning)
        rims = (self.share * rim + self.lever * turning) * (1.0 + self.ripple)
        spot = rim == 0.0 and turning != 0.0
        hard = bool(ground.floor[0, here])
        yields = 0.9 if hard and not self.world.skid else self.yields
        rate = turning * (yields if spot or self.world.skid else 1.0)
        depth = self._depth(cells, load)
        self._look_up(depth, cells)
        if self.world.differential and rim:
            rims = self._by_torque(rims, rate, cells, load, sense)
        now = 0.0
        slip: Array = np.full(self.all.size, 1.0 - yields if spot else np.nan)
        thrust: Array = np.zeros(self.all.size)
        resistance: Array = thrust
        if rim or abs(self.speed) > 1e-3:
            now, slip, thrust, resistance = self._balance(rims, rate, load, cells, climb, sense)
        self.gained += 0.2 * ((now - self.speed) / TICK - self.gained)
        self.speed = now
        travel = abs(now) * TICK
        self.place, self.path = self.place + now * TICK, self.path + travel
        self.yaw += rate * TICK
        floor = ground.floor[self.all, cells]
        ahead = np.maximum(np.abs(rims) - np.abs(self.share * now + self.lever * rate), 0.0)
        self.dug = self.dug * np.exp(-travel / (_LEAVING * self.diameter))
        self.dug = np.where(floor, 0.0, self.dug + self.digging * ahead * TICK)
        held = self._forces(np.full((1, self.all.size), REFERENCE_SLIP), cells)
        shown = np.where(np.abs(rims) > 1e-3, slip, np.nan)
        sunk = np.where(floor, 0.0, depth)
        torque = self._torque(np.nan_to_num(slip), cells) * load * 0.5 * self.diameter
        dive = self._dive(cells)
        self.rows.append(
            (self.time, self.path, self.place, now, rate, self.yaw, climb + dive, roll, rims, shown, sunk,
             load, thrust * load, resistance * load, torque, (held[0] - held[1])[0] * load,
             self._angles, self.crab)
        )  # fmt: skip
        self.time += TICK
        self._look(rims, sense)

    def _steer(self, rim: float, turning: float) -> tuple[float, float]:
        """Turn the wheels; return the rims' speed (m/s) and the rate (rad/s), 0 until they are ready."""
        assert self.steered is not None
        turning = self.steered.bent(rim, turning, TICK)
        self.waits = not self.steered.turn_to(rim, turning, self.crab, TICK)
        if self.waits:
            rim = turning = 0.0
        self.share, self.lever = self.steered.share, self.steered.lever
        return rim, turning

    @property
    def _angles(self) -> Array:
        return np.zeros(self.all.size) if self.steered is None else self.steered.angle

    def _count_passes(self, cells: NDArray[np.intp]) -> None:
        """Update `passes`, the number of earlier passes over the cell of each wheel, shape (wheels,)."""
        fresh = cells != self.last_cells
        for j in np.flatnonzero(fresh):
            self.passes[j] = self.rolled[self.track[j], cells[j]]
        for j in np.flatnonzero(fresh):
            low, high = sorted((int(self.last_cells[j]), int(cells[j])))
            self.rolled[self.track[j], low + 1 : high + 1] += 1.0
        self.last_cells = cells

    def _depth(self, cells: NDArray[np.intp], load: Array) -> Array:
        """Sinkage of each wheel, m, (wheels,): due to its load (N) and to ruts, and the depth that it dug."""
        ground, j = self.ground, self.all
        power = 1.0 / (ground.exponent[j, cells] + 0.5)
        rest = ground.rest[j, cells] * (load / ground.load[j, cells]) ** power
        rest = rest * self.world.rut ** (self.passes / (0.5 + 0.5 * np.maximum(self.passes, 1.0)))
        return np.asarray(np.minimum(rest + self.dug, DEPTHS[-1] * self.diameter))

    def _dive(self, cells: NDArray[np.intp]) -> float:
        """Angle by which bumps tilt the vehicle, rad, positive nose up."""
        if not self.world.bumps:
            return 0.0
        height, front = self.ground.bumps[self.side, cells], self.x > 0.0
        return float((height[front].mean() - height[~front].mean()) / (2.0 * self.x.max()))

    def _look(self, rims: Array, sense: float) -> None:
        """Update `stuck` and `most`. rims: speeds, m/s; sense: 1 forward, -1 backward."""
        whole = float(np.mean(rims)) * sense
        spins = whole > 0.03 and self.speed * sense < (1.0 - STUCK) * whole
        if whole > 0.9 * self.world.speed:
            self.most = max(self.most, 1.0 - self.speed * sense / whole)
        self._spins = self._spins + 1 if spins else 0
        if self._spins * TICK >= self.world.patience:
            self.stuck = self.time - self._spins * TICK + _LASTS

    @property
    def hardly(self) -> bool:
        """Whether it got stuck, or its mean slip at full speed was over 0.35."""
        return self.stuck is not None or self.most > _HARDLY

    # --- Forces, over the loads

    def _curves_on(self, soil: TrueSoil, weight: float) -> Array:
        """Curves of all wheels on a soil, shape (wheels, depths, 3, slips)."""
        law, found = LAWS[self.world.law], {}
        for size in {(w.diameter, w.width) for w in self.rover.wheels}:
            found[size] = np.stack(law(*size, weight, soil.n, soil.strength), axis=1)
        return np.stack([found[w.diameter, w.width] for w in self.rover.wheels])

    def _look_up(self, depth: Array, cells: NDArray[np.intp]) -> None:
        """Set `now` to the curves at the wheels' sinkages (m) on their soils, shape (3, wheels, slips)."""
        place = (np.log(depth / self.diameter) - _LOWEST) / _RATIO
        low = np.clip(place.astype(int), 0, DEPTHS.size - 2)
        part = np.clip(place - low, 0.0, 1.0)[:, None, None]
        kind = self.ground.kind[self.all, cells]
        found = self.curves[kind, self.all, low] * (1.0 - part)
        found = found + self.curves[kind, self.all, low + 1] * part
        self.now = found.transpose(1, 0, 2)

    def _curve(self, what: int | slice, slips: Array) -> Array:
        """Interpolate this tick's curves to slips, shape (..., wheels); the same shape for one curve.

        what: 0 thrust, 1 resistance, 2 torque over the radius, each over the load; or a slice of these.
        """
        at = np.interp(slips, SLIPS, np.arange(SLIPS.size))
        low = np.minimum(at.astype(int), SLIPS.size - 2)
        part, of = at - low, self.now[what]
        found: Array = of[..., self.all, low] * (1.0 - part) + of[..., self.all, low + 1] * part
        return found

    def _gripped(self, force: Array, slips: Array, cells: NDArray[np.intp]) -> Array:
        """Shear force over load, times the grip of the cells; on hard ground, the law of a hard floor."""
        ground, j = self.ground, self.all
        hard = _HARD_GRIP * np.sign(slips) * -np.expm1(-np.abs(slips) / _HARD_STIFF)
        return np.where(ground.floor[j, cells], hard, force * np.exp(ground.grip[j, cells]))

    def _forces(self, slips: Array, cells: NDArray[np.intp]) -> tuple[Array, Array]:
        """Thrust and resistance over the load at slips, all of shape (candidates, wheels)."""
        thrust, resistance = self._curve(slice(2), slips)
        dragging = self.dragging + self.ground.dragging[self.all, cells]
        floor = self.ground.floor[self.all, cells]
        resistance = np.where(floor, _HARD_RESISTANCE, resistance + dragging)
        return self._gripped(thrust, slips, cells), resistance

    def _torque(self, slips: Array, cells: NDArray[np.intp]) -> Array:
        """Torque over radius and load at slips, shape (wheels,)."""
        return self._gripped(self._curve(2, slips), slips, cells)

    def _slips(self, speeds: Array, rims: Array, sense: float) -> Array:
        travel, rim = speeds * sense, rims * sense
        fast = np.maximum(np.maximum(np.abs(travel), np.abs(rim)), 1e-6)
        slips: Array = np.clip((rim - travel) / fast, -1.0, 1.0)
        return slips

    def _balance(
        self, rims: Array, rate: float, load: Array, cells: NDArray[np.intp], climb: float, sense: float,
    ) -> tuple[float, Array, Array, Array]:  # fmt: skip
        """Find the speed after this tick at which forces and inertia balance.

        Returns this speed (m/s) and, of each wheel, slip, thrust / load and resistance / load, (wheels,).
        """
        mass, steep = self.rover.mass, self.steep[self.side, cells]
        candidates = self.speed + _GAIN * TICK * _STEPS
        slips = self._slips(candidates[:, None] * self.share + rate * self.lever, rims, sense)
        thrust, resistance = self._forces(slips, cells)
        spare = 0.15 * self.world.spare * mass * GRAVITY * sense
        whole = ((thrust - resistance - steep * sense) * load * self.share).sum(axis=1) * sense
        whole = whole - spare - mass * GRAVITY * math.sin(climb)
        left = np.minimum.accumulate(whole - mass * (candidates - self.speed) / TICK)
        now = float(np.interp(0.0, -left, candidates))
        if now * sense < 0.0 and abs(rims.mean()) > 1e-3:
            now = 0.0  # rigid wheels in their ruts do not roll back against their drives
        slip = self._slips(now * self.share + rate * self.lever, rims, sense)
        thrust, resistance = self._forces(slip[None], cells)
        return now, slip, thrust[0], resistance[0]

    def _by_torque(
        self, rims: Array, rate: float, cells: NDArray[np.intp], load: Array, sense: float
    ) -> Array:
        """Speeds of the rims (m/s, (wheels,)), shifted at each differential towards equal torques."""
        slip = self._slips(self.speed - rate * self.y, rims + self.apart, sense)
        torque = self._torque(slip, cells) * load * sense
        for left, right in self.axles:
            more = (torque[left] - torque[right]) / load.mean()
            change = _TORQUE_GAIN * TICK * more * sense
            most = 0.95 * abs(rims[left] + rims[right]) / 2.0
            self.apart[right] = np.clip(self.apart[right] + change, -most, most)
            self.apart[left] = -self.apart[right]
        return rims + self.apart


def stamps_of(time: Array) -> NDArray[np.int64]:
    """Stamps (ns since 1970) of times since the start of a drive (s); the same shape."""
    return EPOCH + np.round(1e9 * time).astype(np.int64)


def truth_of(vehicle: SimulatedVehicle) -> Truth:
    """True values of a vehicle's drive, once it was run."""
    columns: list[Any] = [np.array(column) for column in zip(*vehicle.rows, strict=True)]
    names = [field.name for field in fields(Truth)]
    return Truth(**dict(zip(names, [*columns, vehicle.stuck], strict=True)))
