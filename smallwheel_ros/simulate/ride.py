# SPDX-License-Identifier: Apache-2.0
"""What happens to the wheels of a rover on its way: loads, slip, sinkage, forces."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from smallwheel_ros.simulate.contact import Array, bracketed_root
from smallwheel_ros.simulate.hidden_effects import HiddenEffect
from smallwheel_ros.simulate.response import Response, traction_at, wheel_response
from smallwheel_ros.simulate.rover import GRAVITY, STANDS, Rover, Travel, until_stuck, wheel_loads
from smallwheel_ros.simulate.terrain import Ground, Stretch, grip, stretch_index, wave_value
from smallwheel_ros.simulate.truth import (
    Circumstances,
    Places,
    SimulationError,
)

# The driver eases off before the wheels spin, and brakes before they lock.
_SLIP_RANGE = (-0.3, 0.65)
_BLOCK = 4000  # rows at once, so that memory stays small on long drives
# Of the way on which a rover gets stuck: its length (m), and where its balance is worked out.
_FINISH, _STEP = 15.0, 0.05
_SLIPS = (-0.3, -0.15, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)


@dataclass(frozen=True)
class WheelTruth:
    """What really happened; arrays of shape (times, wheels) unless said otherwise."""

    travel: Travel  # (times,)
    slip: Array  # (times,), of all wheels alike; as if rolling on while the rover stands
    stretch: Places  # index of the stretch that the wheel is on
    speed: Array  # m/s, of the wheel's own place
    load: Array  # N
    sinkage: Array  # m, as an instrument without noise would show it
    drawbar_pull: Array  # N, what each wheel adds to moving the rover
    torque: Array  # N m, that drives each wheel
    rim: Array  # m/s


class _Ride:
    """All wheels at all times, flattened to rows, with one response for any slip."""

    def __init__(
        self,
        rover: Rover,
        ground: Ground,
        stretches: tuple[Stretch, ...],
        effects: tuple[HiddenEffect, ...],
        trip: Travel,
    ) -> None:
        self.stretches, self.effects = stretches, effects
        self.shape = (trip.time.size, len(rover.wheels))
        x = np.array([wheel.x for wheel in rover.wheels])
        y = np.array([wheel.y for wheel in rover.wheels])
        way = trip.way[:, None] + x
        twist = wave_value(ground.twist_waves, trip.way)
        self.load = wheel_loads(rover, trip.climb, trip.roll, trip.acceleration, twist)
        self.turning = 1.0 - trip.curvature[:, None] * y
        self.speed = trip.speed[:, None] * self.turning
        self.stretch = stretch_index(stretches, way)
        self.grip = grip(ground, way)
        # Beyond its end, where a rover gets stuck, the texture comes back the other way round.
        end = ground.way[-1]
        place = np.where(way <= end, way, 2.0 * end - way)
        tracks = [
            np.interp(place[:, j], ground.way, ground.texture[0 if y[j] >= 0 else 1])
            for j in range(len(x))
        ]
        self._scatter = np.stack(tracks, axis=1).ravel()
        # A wheel that follows another in its track rolls in that one's rut.
        passes = [
            1.0 + sum(y[i] == y[j] and x[i] > x[j] for i in range(len(x))) for j in range(len(x))
        ]
        self.at = Circumstances.of(
            load=self.load.ravel(),
            diameter=np.tile([wheel.diameter for wheel in rover.wheels], self.shape[0]),
            width=np.tile([wheel.width for wheel in rover.wheels], self.shape[0]),
            # A standing wheel keeps the state of a slow one.
            speed=np.maximum(self.speed, 0.01).ravel(),
            pass_number=np.tile(passes, self.shape[0]),
            hidden=np.interp(place, ground.way, ground.unrecorded).ravel(),
        )
        rows = self.stretch.ravel()
        self._rows = [
            (stretches[i].soil, block)
            for i in np.unique(rows)
            for block in _blocks(np.flatnonzero(rows == i))
        ]

    def response(self, slip: Array) -> Response:
        """Response of every wheel, shape (times, wheels), for a slip at each time."""
        by_row = np.repeat(slip, self.shape[1])
        values = {field.name: np.empty(by_row.size) for field in fields(Response)}
        for soil, rows in self._rows:
            at = _rows_of(self.at, rows).with_slip(by_row[rows])
            part = wheel_response(soil, self.effects, at, self._scatter[rows])
            for name, array in values.items():
                array[rows] = getattr(part, name)
        return Response(**{name: array.reshape(self.shape) for name, array in values.items()})

    def traction(self, slip: Array, depth: Array) -> tuple[Array, Array]:
        """Thrust (N) and torque (N m) of every wheel at known depths (m)."""
        by_row, deep = np.repeat(slip, self.shape[1]), depth.ravel()
        thrust, torque = np.empty(by_row.size), np.empty(by_row.size)
        for soil, rows in self._rows:
            at = _rows_of(self.at, rows).with_slip(by_row[rows])
            thrust[rows], torque[rows] = traction_at(
                soil, self.effects, at, self._scatter[rows], deep[rows]
            )
        return (
            thrust.reshape(self.shape) * self.grip,
            torque.reshape(self.shape) * self.grip,
        )


class _Balance:
    """Forces on the rover along its travel: of each wheel, weight on the slope, and inertia.

    Depth and resistance here are those at no slip: digging in deepens the rut and does not hold the
    rover back. With the resistance of the greater depth as well, a rover that begins to slip in loose
    sand is stuck for good in many drives, and nothing would be left to record.
    """

    def __init__(self, wheels: _Ride, rover: Rover, trip: Travel) -> None:
        self.wheels, self.trip, self.mass = wheels, trip, rover.mass
        still = wheels.response(np.zeros(trip.time.size))
        self.depth, self.resistance = still.depth, still.resistance
        self.slope = rover.mass * GRAVITY * np.sin(trip.climb)

    def pull(self, slip: Array) -> Array:
        """What each wheel adds to moving the rover (N), shape (times, wheels)."""
        return self.wheels.traction(slip, self.depth)[0] - self.resistance

    def slip(self) -> Array:
        """Slip at each time: of the rims where those are given, else where the forces balance."""
        rim, speed = self.trip.rim, self.trip.speed
        weight = self.slope + self.mass * self.trip.acceleration

        def excess(slip: Array) -> Array:
            return np.asarray(np.sum(self.pull(slip), axis=1) - weight)

        low, high = (np.full(rim.size, end) for end in _SLIP_RANGE)
        slip = bracketed_root(excess, low, high, 1e-4)
        with np.errstate(invalid="ignore", divide="ignore"):
            given = np.where(rim >= speed, 1.0 - speed / rim, rim / speed - 1.0)
        return np.where(np.isnan(rim), slip, given)

    def forces(self, slip: Array) -> tuple[Array, Array, Array]:
        """Pull (N) and torque (N m) of each wheel, and the acceleration (m/s^2) that they give.

        Where the driver holds the speed of travel no place is so slippery that the slip would leave
        its range: grip there is what it takes, and the acceleration is his. A rover that is stuck on a
        slope is held by its ruts, in proportion to the loads.
        """
        thrust, torque = self.wheels.traction(slip, self.depth)
        trip = self.trip
        by_driver = np.isnan(trip.rim)
        needed = self.slope + self.mass * trip.acceleration + np.sum(self.resistance, axis=1)
        ends = by_driver & ((slip <= _SLIP_RANGE[0]) | (slip >= _SLIP_RANGE[1]))
        factor = np.where(ends, needed / np.sum(thrust, axis=1), 1.0)[:, None]
        pull, torque = thrust * factor - self.resistance, torque * factor
        acceleration = (np.sum(pull, axis=1) - self.slope) / self.mass
        stands = ~by_driver & (trip.speed < STANDS)
        share = self.wheels.load / np.sum(self.wheels.load, axis=1, keepdims=True)
        held = np.where(stands, -self.mass * acceleration, 0.0)
        acceleration = np.where(by_driver, trip.acceleration, np.where(stands, 0.0, acceleration))
        return pull + share * held[:, None], torque, acceleration


def _blocks(rows: Places) -> list[Places]:
    return np.array_split(rows, -(-rows.size // _BLOCK))


def _rows_of(at: Circumstances, rows: Places) -> Circumstances:
    arrays = {
        f.name: getattr(at, f.name)[rows]
        for f in fields(at)
        if isinstance(getattr(at, f.name), np.ndarray)
    }
    return replace(at, **arrays)


def ride(
    rover: Rover,
    ground: Ground,
    stretches: tuple[Stretch, ...],
    effects: tuple[HiddenEffect, ...],
    trip: Travel,
) -> WheelTruth:
    """Work out the truth of a drive.

    Raises
    ------
    SimulationError
        If a wheel sinks to its axle: soil or hidden effects are too much for this rover.
    """
    if ground.finish is not None:
        trip = _to_the_end(rover, ground, stretches, effects, trip)
    wheels = _Ride(rover, ground, stretches, effects, trip)
    balance = _Balance(wheels, rover, trip)
    slip = balance.slip()
    pull, torque, acceleration = balance.forces(slip)
    response = wheels.response(slip)
    if not np.all(np.isfinite(response.depth)):
        time, wheel = np.argwhere(~np.isfinite(response.depth))[0]
        soil = stretches[wheels.stretch[time, wheel]].soil
        raise SimulationError(
            f"wheel {rover.wheels[wheel].name} sinks to its axle at {trip.way[time]:.1f} m in"
            f" {soil.name} (load {wheels.load[time, wheel]:.0f} N): take a firmer soil, a lighter"
            " rover or a smaller strength"
        )
    forward = np.where(slip >= 0, 1.0 / np.maximum(1.0 - slip, 1e-9), 1.0 + slip)
    rim = np.where(np.isnan(trip.rim), trip.speed * forward, trip.rim)[:, None] * wheels.turning
    return WheelTruth(
        travel=replace(trip, acceleration=acceleration),
        slip=slip,
        stretch=wheels.stretch,
        speed=wheels.speed,
        load=wheels.load,
        sinkage=response.shown_sinkage,
        drawbar_pull=pull,
        torque=np.where(rim > STANDS, torque, 0.0),
        rim=rim,
    )


def _to_the_end(
    rover: Rover,
    ground: Ground,
    stretches: tuple[Stretch, ...],
    effects: tuple[HiddenEffect, ...],
    trip: Travel,
) -> Travel:
    """Let the rover drive on until it is stuck."""
    places: Array = np.arange(trip.way[-1], trip.way[-1] + _FINISH, _STEP, dtype=np.float64)
    steady = replace(
        Travel.over(ground, places, np.full(places.size, trip.speed[-1])),
        acceleration=np.zeros(places.size),
    )
    balance = _Balance(_Ride(rover, ground, stretches, effects, steady), rover, steady)
    pulls = [np.sum(balance.pull(np.full(places.size, slip)), axis=1) for slip in _SLIPS]
    return until_stuck(trip, ground, rover.mass, places, _SLIPS, np.stack(pulls, axis=1))
