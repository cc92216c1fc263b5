"""What happens to the wheels of a rover on its way: loads, slip, sinkage, forces."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from smallwheel_ros.simulate.contact import Array, bracketed_root
from smallwheel_ros.simulate.hidden_effects import HiddenEffect
from smallwheel_ros.simulate.response import Response, thrust_at, wheel_response
from smallwheel_ros.simulate.rover import GRAVITY, Rover, wheel_loads
from smallwheel_ros.simulate.terrain import (
    Ground,
    Stretch,
    Travel,
    grip,
    stretch_index,
    wave_value,
)
from smallwheel_ros.simulate.truth import (
    Circumstances,
    Places,
    SimulationError,
)

# The driver eases off before the wheels spin, and brakes before they lock.
_SLIP_RANGE = (-0.3, 0.65)
_BLOCK = 4000  # rows at once, so that memory stays small on long drives


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
        self.speed = trip.speed[:, None] * (1.0 - trip.curvature[:, None] * y)
        self.stretch = stretch_index(stretches, way)
        self.grip = grip(ground, way)
        tracks = [
            np.interp(way[:, j], ground.way, ground.texture[0 if y[j] >= 0 else 1])
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
            hidden=np.interp(way, ground.way, ground.unrecorded).ravel(),
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

    def _thrust(self, slip: Array, depth: Array) -> Array:
        by_row, deep = np.repeat(slip, self.shape[1]), depth.ravel()
        thrust = np.empty(by_row.size)
        for soil, rows in self._rows:
            at = _rows_of(self.at, rows).with_slip(by_row[rows])
            thrust[rows] = thrust_at(soil, self.effects, at, self._scatter[rows], deep[rows])
        return thrust.reshape(self.shape)

    def balance(self, rover: Rover, trip: Travel) -> tuple[Array, Array]:
        """Slip at each time, and the pull of each wheel (N) that together move the rover.

        Depth and resistance in this balance are those at no slip: here digging in deepens the rut
        and does not hold the rover back. With the resistance of the greater depth as well, a rover
        that begins to slip in loose sand is stuck for good in many drives, and nothing would be
        left to record.
        """
        still = self.response(np.zeros(self.shape[0]))
        weight = rover.mass * (GRAVITY * np.sin(trip.climb) + trip.acceleration)

        def pull(slip: Array) -> Array:
            return self._thrust(slip, still.depth) * self.grip - still.resistance

        def excess(slip: Array) -> Array:
            total: Array = np.sum(pull(slip), axis=1) - weight
            return total

        low, high = (np.full(self.shape[0], end) for end in _SLIP_RANGE)
        slip = bracketed_root(excess, low, high, 1e-4)
        return slip, pull(slip)


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
    wheels = _Ride(rover, ground, stretches, effects, trip)
    slip, pull = wheels.balance(rover, trip)
    response = wheels.response(slip)
    if not np.all(np.isfinite(response.depth)):
        time, wheel = np.argwhere(~np.isfinite(response.depth))[0]
        soil = stretches[wheels.stretch[time, wheel]].soil
        raise SimulationError(
            f"wheel {rover.wheels[wheel].name} sinks to its axle at {trip.way[time]:.1f} m in"
            f" {soil.name} (load {wheels.load[time, wheel]:.0f} N): take a firmer soil, a lighter"
            " rover or a smaller strength"
        )
    return WheelTruth(
        travel=trip,
        slip=slip,
        stretch=wheels.stretch,
        speed=wheels.speed,
        load=wheels.load,
        sinkage=response.shown_sinkage,
        drawbar_pull=pull,
    )
