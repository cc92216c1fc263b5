# SPDX-License-Identifier: Apache-2.0
"""What drive is asked for, and what happens to the wheels: loads, slip, sinkage, forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from smallwheel_ros.common.options import Option
from smallwheel_ros.simulate.hidden import (
    FRACTION,
    FormOfHidden,
    Hidden,
    Seed,
    Strength,
    check_settings,
    in_drives,
)
from smallwheel_ros.simulate.terrain import (
    FINISHES,
    GRAVITY,
    ROVERS,
    STANDS,
    TERRAINS,
    Ground,
    Rover,
    Stretch,
    Travel,
    grip,
    until_stuck,
    wave_value,
    wheel_loads,
)
from smallwheel_ros.simulate.truth import (
    Array,
    Circumstances,
    HiddenEffect,
    Places,
    Response,
    SimulationError,
    WheelsOnSoil,
    bracketed_root,
)

# The driver eases off before the wheels spin, and brakes before they lock.
_SLIP_RANGE = (-0.3, 0.65)
_BLOCK = 4000  # rows at once, so that memory stays small on long drives
# Of the way on which a rover gets stuck: its length (m), and where its balance is worked out.
_FINISH, _STEP = 15.0, 0.05
_SLIPS = (-0.3, -0.15, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)


@dataclass(frozen=True)
class DriveSettings:
    """What drive to simulate: the options of `smallwheel simulate drive`.

    The same seed gives the same drive, to the byte. `wheels` may be a rover of your own, and `stretches`,
    where given, are driven over instead of `terrain`. A `finish` is what the drive ends in after
    `distance`, stuck: a slope that steepens, or slippery ground. With dropouts above 0 one wheel's
    sinkage is also missing for 1.5 s.
    """

    seed: Seed = 0
    distance: Annotated[float, Option("Way, m.", (2.0, 20_000.0, "m"))] = 30.0
    speed: Annotated[float, Option("Middle speed, m/s.", (0.01, 3.0, "m/s"))] = 0.5
    wheels: Annotated[str | Rover, Option(f"{' or '.join(ROVERS)}.", tuple(ROVERS))] = "four"
    terrain: Annotated[str, Option(f"{' or '.join(TERRAINS)} soil.", TERRAINS)] = "mixed"
    stretches: tuple[Stretch, ...] | None = None
    finish: Annotated[str, Option(f"What it ends in, stuck: {', '.join(FINISHES)}.", FINISHES)] = (
        "none"
    )
    hidden: Hidden = ()
    strength: Strength = 1.0
    form: FormOfHidden = "own"
    noise: Annotated[float, Option("Factor on every sensor's noise.", (0.0, 20.0))] = 1.0
    outliers: Annotated[
        float, Option("Share of measured sinkages that are grossly wrong.", (0.0, 0.5), FRACTION)
    ] = 0.0
    dropouts: Annotated[
        float, Option("Share of load and sinkage messages that are missing.", (0.0, 0.9), FRACTION)
    ] = 0.01

    def check(self) -> DriveSettings:
        """Return the settings without `none` among the hidden effects.

        Raises SimulationError, naming the setting, what it was, and what was expected.
        """
        hidden = check_settings(self)
        for name in hidden:
            if not in_drives(name):
                raise SimulationError(
                    f"hidden effect {name!r} cannot be in a drive: what it depends on or acts on"
                    " has no sensor there; use `simulate rig`"
                )
        return replace(self, hidden=hidden)


# --- What happens to the wheels: loads, slip, sinkage, forces


@dataclass(frozen=True)
class WheelTruth:
    """What really happened; arrays of shape (times, wheels) unless said otherwise."""

    travel: Travel  # (times,)
    slip: Array  # (times,), of all wheels alike; as if rolling on while the rover stands
    stretch: Places  # index of the stretch that the wheel is on
    load: Array  # N
    sinkage: Array  # m, as an instrument without noise would show it
    drawbar_pull: Array  # N, what each wheel adds to moving the rover
    torque: Array  # N m, that drives each wheel
    rim: Array  # m/s


class _Ride:
    """All wheels at all times, and the forces on the rover: of each wheel, its weight, and inertia.

    Depth and resistance in the balance are those at no slip: digging in deepens the rut and does not
    hold the rover back. With the resistance of the greater depth as well, a rover that begins to slip
    in loose sand is stuck for good in many drives, and nothing would be left to record.
    """

    def __init__(
        self,
        rover: Rover,
        ground: Ground,
        stretches: tuple[Stretch, ...],
        effects: tuple[HiddenEffect, ...],
        trip: Travel,
    ) -> None:
        self.trip, self.mass, self.effects = trip, rover.mass, effects
        self.shape = (trip.time.size, len(rover.wheels))
        x = np.array([wheel.x for wheel in rover.wheels])
        y = np.array([wheel.y for wheel in rover.wheels])
        way = trip.way[:, None] + x
        twist = wave_value(ground.twist_waves, trip.way)
        self.load = wheel_loads(rover, trip.climb, trip.roll, trip.acceleration, twist)
        self.turning = 1.0 - trip.curvature[:, None] * y
        starts = [stretch.start for stretch in stretches]  # the first one reaches back without end
        self.stretch = np.maximum(np.searchsorted(starts, way, side="right") - 1, 0)
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
        self._at = Circumstances.of(
            load=self.load.ravel(),
            diameter=np.tile([wheel.diameter for wheel in rover.wheels], self.shape[0]),
            width=np.tile([wheel.width for wheel in rover.wheels], self.shape[0]),
            # A standing wheel keeps the state of a slow one.
            speed=np.maximum(trip.speed[:, None] * self.turning, 0.01).ravel(),
            pass_number=np.tile(passes, self.shape[0]),
            hidden=np.interp(place, ground.way, ground.unrecorded).ravel(),
        )
        row = self.stretch.ravel()
        self._blocks = [
            (stretches[i].soil, rows)
            for i in np.unique(row)
            for rows in np.array_split(np.flatnonzero(row == i), -(-np.sum(row == i) // _BLOCK))
        ]
        still = self.response(np.zeros(trip.time.size))
        self.depth, self.resistance = still.depth, still.resistance
        self.slope = rover.mass * GRAVITY * np.sin(trip.climb)

    def _each(self, slip: Array, ask: Callable[[WheelsOnSoil, Places], tuple[Array, ...]]) -> Array:
        """Ask the wheels on each soil, block by block, with a slip at each time.

        Gives a row of shape (times, wheels) for each array of the answer.
        """
        by_row = np.repeat(slip, self.shape[1])
        answers = []
        for soil, rows in self._blocks:
            at = replace(self._at.rows(rows), slip=by_row[rows])
            wheels = WheelsOnSoil(soil, self.effects, at, self._scatter[rows])
            answers.append(np.stack(ask(wheels, rows)))
        found: Array = np.empty((len(answers[0]), by_row.size))
        found[:, np.concatenate([rows for _, rows in self._blocks])] = np.hstack(answers)
        return found.reshape(-1, *self.shape)

    def response(self, slip: Array) -> Response:
        """Response of every wheel, shape (times, wheels), for a slip at each time."""
        return Response(*self._each(slip, lambda wheels, _: wheels.response()))

    def traction(self, slip: Array) -> Array:
        """Thrust (N) and torque (N m) of every wheel, shape (2, times, wheels)."""
        deep = self.depth.ravel()
        return self._each(slip, lambda wheels, rows: wheels.traction(deep[rows])) * self.grip

    def pull(self, slip: Array) -> Array:
        """What all wheels add to moving the rover (N), shape (times,)."""
        return np.asarray(np.sum(self.traction(slip)[0] - self.resistance, axis=1))

    def slip(self) -> Array:
        """Slip at each time: of the rims where those are given, else where the forces balance."""
        rim, speed = self.trip.rim, self.trip.speed
        weight = self.slope + self.mass * self.trip.acceleration
        low, high = (np.full(rim.size, end) for end in _SLIP_RANGE)
        slip = bracketed_root(lambda at: self.pull(at) - weight, low, high, 1e-4)
        with np.errstate(invalid="ignore", divide="ignore"):
            given = np.where(rim >= speed, 1.0 - speed / rim, rim / speed - 1.0)
        return np.where(np.isnan(rim), slip, given)

    def forces(self, slip: Array) -> tuple[Array, Array, Array]:
        """Pull (N) and torque (N m) of each wheel, and the acceleration (m/s^2) that they give.

        Where the driver holds the speed of travel no place is so slippery that the slip would leave
        its range: grip there is what it takes, and the acceleration is his. A rover that is stuck on a
        slope is held by its ruts, in proportion to the loads.
        """
        thrust, torque = self.traction(slip)
        trip = self.trip
        by_driver = np.isnan(trip.rim)
        needed = self.slope + self.mass * trip.acceleration + np.sum(self.resistance, axis=1)
        ends = by_driver & ((slip <= _SLIP_RANGE[0]) | (slip >= _SLIP_RANGE[1]))
        factor = np.where(ends, needed / np.sum(thrust, axis=1), 1.0)[:, None]
        pull, torque = thrust * factor - self.resistance, torque * factor
        acceleration = (np.sum(pull, axis=1) - self.slope) / self.mass
        stands = ~by_driver & (trip.speed < STANDS)
        share = self.load / np.sum(self.load, axis=1, keepdims=True)
        held = np.where(stands, -self.mass * acceleration, 0.0)
        acceleration = np.where(by_driver, trip.acceleration, np.where(stands, 0.0, acceleration))
        return pull + share * held[:, None], torque, acceleration


def ride(
    rover: Rover,
    ground: Ground,
    stretches: tuple[Stretch, ...],
    effects: tuple[HiddenEffect, ...],
    trip: Travel,
) -> WheelTruth:
    """Work out the truth of a drive.

    Raises SimulationError if a wheel sinks to its axle: the soil or hidden effects are too much.
    """
    if ground.finish is not None:
        # Let the rover drive on until it is stuck.
        places: Array = np.arange(trip.way[-1], trip.way[-1] + _FINISH, _STEP, dtype=np.float64)
        steady = replace(
            Travel.over(ground, places, np.full(places.size, trip.speed[-1])),
            acceleration=np.zeros(places.size),
        )
        on = _Ride(rover, ground, stretches, effects, steady)
        pulls = np.stack([on.pull(np.full(places.size, slip)) for slip in _SLIPS], axis=1)
        trip = until_stuck(trip, ground, rover.mass, places, _SLIPS, pulls)
    wheels = _Ride(rover, ground, stretches, effects, trip)
    slip = wheels.slip()
    pull, torque, acceleration = wheels.forces(slip)
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
        load=wheels.load,
        sinkage=response.shown_sinkage,
        drawbar_pull=pull,
        torque=np.where(rim > STANDS, torque, 0.0),
        rim=rim,
    )
