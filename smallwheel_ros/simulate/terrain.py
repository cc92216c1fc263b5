# SPDX-License-Identifier: Apache-2.0
"""The ground of a drive, and how rovers go over it.

Stretches of soil, slopes, slippery patches, and what ends the drive; how a rover's weight rests on its
wheels, and how it travels: as its driver wants, and at the end as the soil lets it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.simulate.truth import Array, TruthSoil

GRAVITY = 9.81
TICK = 0.1  # s, step of the truth
_PULL = 0.35  # m/s^2, with which the driver gains and loses speed
_SPINNING = 4.0  # s until the driver gives up
_HARDLY = 0.05  # share of the rims' speed: who goes no faster is stuck
STANDS = 1e-3  # m/s, below which nothing moves
TERRAINS = ("mixed", "single")
FINISHES = ("none", "slope", "slippery")
_GROUND_STEP = 0.02  # m, step of the soil's texture
_REFERENCE_SINKAGE, _REFERENCE_DIAMETER = 0.01, 0.25
_STEEPEST = 0.6  # rad, steeper than any soil here is climbed


@dataclass(frozen=True)
class Stretch:
    """A soil from `start` (m along the way) to the next stretch."""

    start: float
    soil: TruthSoil


def soil_of_pressure(name: str, pressure: float, n: float, m: float, **rest: float) -> TruthSoil:
    """Make a soil from its pressure (Pa) at 10 mm sinkage of a wheel of 0.25 m diameter."""
    k = pressure / (_REFERENCE_SINKAGE**n * _REFERENCE_DIAMETER**m)
    return TruthSoil(name, k, n, m, **rest)


def draw_stretches(terrain: str, distance: float, rng: np.random.Generator) -> tuple[Stretch, ...]:
    """Draw what the rover drives over: `single` is one soil, `mixed` changes about every 10 m."""

    def draw(name: str, pressure: float, n: float, m: float, **rest: float) -> TruthSoil:
        return soil_of_pressure(
            name, pressure * np.exp(rng.normal(0.0, 0.08)), n + rng.normal(0.0, 0.03), m, **rest
        )

    soils = (
        draw("dry_sand", 19e3, 0.85, 0.35, friction_angle=0.54, cohesion=600.0),
        draw("loose_sand", 9.5e3, 0.95, 0.35, friction_angle=0.52, cohesion=300.0),
        draw("compacted_sand", 36e3, 0.75, 0.30, friction_angle=0.60, cohesion=1200.0),
    )
    if terrain == "single":
        return (Stretch(0.0, soils[0]),)
    count = max(3, round(distance / 10.0))
    # Borders are not at round numbers, nor at equal distances.
    starts = (np.arange(count) + rng.uniform(-0.15, 0.15, count)) * distance / count
    starts[0] = 0.0
    return tuple(Stretch(float(start), soils[i % 3]) for i, start in enumerate(starts))


@dataclass(frozen=True)
class Finish:
    """Ground at the end of a drive that gets worse until the rover is stuck.

    From `start` (m along the way) on it rises by `rise` (rad/m) more and more, or over `edge` (m) the
    grip falls to the factor `grip`.
    """

    start: float
    rise: float = 0.0
    grip: float = 1.0
    edge: float = 1.0


def draw_finish(name: str, distance: float, rng: np.random.Generator) -> Finish | None:
    """Draw the end of a drive, one of `FINISHES`: a slope of 2.5 to 4.5 degrees more in each metre."""
    if name == "none":
        return None
    if name == "slope":
        return Finish(distance, rise=float(np.radians(rng.uniform(2.5, 4.5))))
    return Finish(distance, grip=rng.uniform(0.05, 0.15), edge=rng.uniform(0.8, 1.6))


@dataclass(frozen=True)
class Ground:
    """Everything that depends on the place along the way."""

    way: Array  # m, of the texture
    texture: Array  # (2, places): factor on k in the left and the right track
    unrecorded: Array  # (places,): -1 .. 1, drives the effect `unrecorded`
    climb_waves: Array  # (waves, 3): amplitude, wavelength (m), phase
    roll_waves: Array
    twist_waves: Array
    speed_waves: Array
    turn_wave: Array  # (1, 3): heading (rad)
    patches: Array  # (patches, 2): start and end of slippery places (m)
    finish: Finish | None = None


def draw_ground(distance: float, rng: np.random.Generator) -> Ground:
    """Draw slopes up to about 9 degrees, uneven ground, and a slippery patch every 6 m or so."""
    way: Array = np.arange(-2.0, distance + 3.0, _GROUND_STEP, dtype=np.float64)

    def smooth(length: float, spread: float) -> Array:
        """Noise whose correlation falls exponentially over a length (m)."""
        steps = length / _GROUND_STEP
        kernel = np.exp(-np.arange(round(8 * steps)) / steps)
        kernel *= spread / np.sqrt(np.sum(kernel**2))
        noise = rng.normal(0.0, 1.0, way.size + kernel.size - 1)
        return np.convolve(noise, kernel, mode="valid")

    def waves(amplitude: float, lengths: Sequence[float]) -> Array:
        count = len(lengths)
        size = amplitude * rng.uniform(0.7, 1.3, count) / np.sqrt(count)
        length = np.asarray(lengths) * rng.uniform(0.85, 1.15, count)
        return np.stack([size, length, rng.uniform(0.0, 2.0 * np.pi, count)], axis=1)

    patches = max(1, round(distance / 6.0))
    starts = (np.arange(patches) + rng.uniform(0.3, 0.8, patches)) * distance / patches
    return Ground(
        way=way,
        texture=np.exp([smooth(0.25, 0.05), smooth(0.25, 0.05)]),
        unrecorded=np.tanh(smooth(5.0, 1.0)),
        climb_waves=waves(np.radians(5.5), (17.0, 8.5)),
        roll_waves=waves(np.radians(5.5), (13.0, 6.0)),
        twist_waves=waves(0.24, (2.6, 1.4)),
        speed_waves=waves(0.25, (9.0, 5.0)),
        turn_wave=waves(0.25, (15.0,)),
        patches=np.stack([starts, starts + rng.uniform(0.9, 1.5, patches)], axis=1),
    )


def wave_value(waves: Array, way: Array) -> Array:
    """Sum of waves at places along the way."""
    size, length, phase = waves.T[:, :, None]
    total: Array = np.sum(size * np.sin(2.0 * np.pi * way / length + phase), axis=0)
    return total


def climb(ground: Ground, way: Array) -> Array:
    """Slope in the direction of travel (rad), positive uphill."""
    slope = wave_value(ground.climb_waves, way)
    if ground.finish is not None:
        slope = slope + ground.finish.rise * np.maximum(way - ground.finish.start, 0.0)
    return np.minimum(slope, _STEEPEST)


def grip(ground: Ground, way: Array) -> Array:
    """Factor on the thrust: 1, and 0.5 on slippery patches, with soft edges."""
    edge = 0.08
    inside = np.zeros_like(way)
    for start, end in ground.patches:
        inside = inside + (np.tanh((way - start) / edge) - np.tanh((way - end) / edge)) / 2
    factor: Array = 1.0 - 0.5 * np.clip(inside, 0.0, 1.0)
    if (finish := ground.finish) is not None:
        factor = factor * finish.grip ** np.clip((way - finish.start) / finish.edge, 0.0, 1.0)
    return factor


# --- Rovers


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
        rows[-1:] = [(way, 0.0)] * (1 + round(1.0 / TICK))
    return Travel.over(ground, *np.array(rows).T)


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
    places, speeds = np.array(rows).T
    return Travel.over(
        ground,
        np.concatenate([trip.way, places]),
        np.concatenate([trip.speed, speeds]),
        np.concatenate([trip.rim, np.full(len(rows), rim)]),
    )
