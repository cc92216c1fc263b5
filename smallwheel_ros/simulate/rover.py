# SPDX-License-Identifier: Apache-2.0
"""The rovers that the drives are made with: how their weight rests on the wheels, and how they travel.

They go over their ground as their driver wants, and at the end as the soil lets them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.simulate.contact import Array
from smallwheel_ros.simulate.terrain import Ground, climb, wave_value

GRAVITY = 9.81
TICK = 0.1  # s, step of the truth
_PULL = 0.35  # m/s^2, with which the driver gains and loses speed
_SPINNING = 4.0  # s until the driver gives up
_HARDLY = 0.05  # share of the rims' speed: who goes no faster is stuck
STANDS = 1e-3  # m/s, below which nothing moves


@dataclass(frozen=True)
class RoverWheel:
    """One wheel: size and place in base_link (x forward, y left), metres."""

    name: str
    diameter: float
    width: float
    x: float
    y: float


@dataclass(frozen=True)
class Rover:
    """Wheels on a rigid frame. Mass in kg; centre of gravity in m, its height above the ground."""

    wheels: tuple[RoverWheel, ...]
    mass: float = 24.0
    gravity_x: float = 0.02
    gravity_y: float = -0.01
    gravity_height: float = 0.33


def _corners(
    front: tuple[float, float], rear: tuple[float, float], rear_track: float = 0.28
) -> tuple[RoverWheel, ...]:
    return tuple(
        RoverWheel(f"{end}_{side}", *size, x, sign * y)
        for end, x, y, size in (("front", 0.35, 0.28, front), ("rear", -0.35, rear_track, rear))
        for side, sign in (("left", 1.0), ("right", -1.0))
    )


ROVERS: dict[str, Rover] = {
    "four": Rover(_corners((0.25, 0.10), (0.25, 0.10))),
    # The rear wheels run beside the front wheels' ruts: what ruts do is not taken for wheel size.
    "two_sizes": Rover(_corners((0.25, 0.10), (0.40, 0.12), rear_track=0.42)),
}


def wheel_loads(
    rover: Rover, climb: Array, roll: Array, acceleration: Array, twist: Array
) -> Array:
    """Load on each wheel (N), shape (times, wheels).

    Parameters
    ----------
    climb
        Slope in the direction of travel (rad), positive uphill, shape (times,) as the others.
    roll
        Slope across (rad), positive when the left side is higher.
    acceleration
        Forward, m/s^2.
    twist
        Share of a wheel's load that uneven ground moves from one diagonal to the other.
    """
    x = np.array([wheel.x for wheel in rover.wheels])
    y = np.array([wheel.y for wheel in rover.wheels])
    normal = rover.mass * GRAVITY * np.cos(climb) * np.cos(roll)
    # The line of the resultant force meets the ground here; loads vary linearly over the wheels.
    inertia = acceleration / GRAVITY
    centre_x = rover.gravity_x - rover.gravity_height * (np.tan(climb) + inertia)
    centre_y = rover.gravity_y - rover.gravity_height * np.tan(roll)
    share = 1.0 + np.outer(centre_x, x) / np.mean(x**2) + np.outer(centre_y, y) / np.mean(y**2)
    share = share + np.outer(twist, np.sign(x * y))
    loads: Array = normal[:, None] / len(x) * np.maximum(share, 0.05)
    return loads


@dataclass(frozen=True)
class Travel:
    """How the rover goes, by time; arrays of shape (times,).

    rim: speed of the wheels' rims (m/s) where the driver holds that; NaN where he holds the speed of
    travel, and the rims turn as fast as it takes.
    """

    time: Array  # s
    way: Array  # m along the way
    speed: Array  # m/s
    acceleration: Array  # m/s^2
    heading: Array  # rad
    curvature: Array  # 1/m
    climb: Array  # rad
    roll: Array  # rad
    x: Array  # m, in the frame odom
    y: Array  # m
    rim: Array  # m/s

    @classmethod
    def over(cls, ground: Ground, way: Array, speed: Array, rim: Array | None = None) -> Travel:
        """Return everything else for places along the way (m) and speeds (m/s), a TICK apart."""
        size, length, phase = ground.turn_wave[0]
        turn = 2.0 * np.pi / length
        heading = size * np.sin(turn * way + phase) - size * np.sin(phase)
        slope = climb(ground, way)
        steps = speed * TICK * np.cos(slope)
        return cls(
            time=np.arange(way.size, dtype=np.float64) * TICK,
            way=way,
            speed=speed,
            acceleration=np.gradient(speed, TICK),
            heading=heading,
            curvature=size * turn * np.cos(turn * way + phase),
            climb=slope,
            roll=wave_value(ground.roll_waves, way),
            x=np.cumsum(steps * np.cos(heading)),
            y=np.cumsum(steps * np.sin(heading)),
            rim=np.full(way.size, np.nan) if rim is None else rim,
        )

    @property
    def stuck(self) -> int | None:
        """Index from which on the wheels turn and the rover hardly moves; None: it does in the end."""
        hardly = self.speed < _HARDLY * self.rim
        return int(np.flatnonzero(~hardly)[-1]) + 1 if hardly[-1] else None


def travel(ground: Ground, distance: float, speed: float) -> Travel:
    """Stand for 2 s, drive with varying speed, stop for 3 s on the way, arrive, stand for 1 s.

    Where the ground has a finish the rover arrives there at speed.
    """
    halt = 0.5 * distance
    way, now, rows = 0.0, 0.0, []
    waiting, halted = 2.0, False
    while True:
        rows.append((way, now))
        if waiting > 0:
            waiting -= TICK
            continue
        ahead = (distance if halted else halt) - way
        if ahead < 1e-3:
            if halted:
                break
            waiting, halted, now = 3.0, True, 0.0
            continue
        wave = wave_value(ground.speed_waves, np.array([way]))[0]
        wish = speed * (1.0 + wave)
        if not halted or ground.finish is None:
            wish = min(wish, np.sqrt(2.0 * _PULL * ahead) + 1e-3)
        now = min(max(wish, now - 3.0 * _PULL * TICK), now + _PULL * TICK)
        way += min(now * TICK, ahead)
    if ground.finish is None:
        rows += [(way, 0.0)] * round(1.0 / TICK)
    path = np.array(rows)
    place, velocity = path[:, 0], path[:, 1]
    if ground.finish is None:
        velocity[-round(1.0 / TICK) - 1 :] = 0.0
    return Travel.over(ground, place, velocity)


def until_stuck(
    trip: Travel, ground: Ground, mass: float, places: Array, slips: Sequence[float], pulls: Array
) -> Travel:
    """Go on where a trip ends, with rims that turn as before, until the rover hardly moves.

    In each step slip is where what the wheels pull is weight on the slope and inertia.

    Parameters
    ----------
    mass
        kg.
    places, slips, pulls
        Pull of all wheels together (N), shape (places, slips), over the places along the way (m)
        and the slips.
    """
    way, now = float(trip.way[-1]), float(trip.speed[-1])
    slope = mass * GRAVITY * np.sin(climb(ground, places))
    # What a wheel pulls does not fall with slip; the solution is the only one.
    pulls = np.maximum.accumulate(pulls, axis=1)

    def at(place: float, values: Array) -> Array:
        cell = np.clip(np.searchsorted(places, place), 1, len(places) - 1)
        share = np.clip((place - places[cell - 1]) / (places[cell] - places[cell - 1]), 0.0, 1.0)
        between: Array = (1.0 - share) * values[cell - 1] + share * values[cell]
        return between

    steady = float(np.interp(at(way, slope), at(way, pulls), slips))
    rim = now / (1.0 - steady) if steady >= 0 else now * (1.0 + steady)
    travelled = np.array([rim * (1.0 - s) if s >= 0 else rim / (1.0 + s) for s in slips])
    rows: list[tuple[float, float]] = []
    standing = 0
    while standing < round(_SPINNING / TICK) and way < places[-1]:
        place = way + now * TICK
        excess = at(place, pulls) - at(place, slope) - mass * (travelled - now) / TICK
        now = float(np.interp(np.interp(0.0, excess, slips), slips, travelled))
        way += now * TICK
        rows.append((way, now))
        standing = standing + 1 if now < _HARDLY * rim else 0
    path = np.array(rows)
    return Travel.over(
        ground,
        np.concatenate([trip.way, path[:, 0]]),
        np.concatenate([trip.speed, path[:, 1]]),
        np.concatenate([trip.rim, np.full(len(rows), rim)]),
    )
