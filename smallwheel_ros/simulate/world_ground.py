# SPDX-License-Identifier: Apache-2.0
"""The ground of a world along its route: soil, grip, slopes, hard places and bumps, in cells of 2 cm."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from smallwheel_ros.simulate.truth import Array, static_sinkage
from smallwheel_ros.simulate.wheel_laws import RimStrength
from smallwheel_ros.simulate.world import GRAVITY, SimulatedRover, World

CELL = 0.02  # m
_BEFORE, _BEHIND = 12.0, 3.0  # m of ground before the start and after the end
# Depth and diameter (m) to which `TrueSoil.pressure` refers.
SINKAGE, DIAMETER = 0.01, 0.2
_HARDER = 8.0  # k of the pressure that is added below a hardpan, over the soil's


@dataclass(frozen=True)
class TrueSoil:
    """A soil of a world, without its variation from place to place.

    Attributes
    ----------
    pressure
        ln of the pressure (Pa) at a depth of 10 mm under a wheel of 0.2 m.
    n, m
        Exponents of depth and diameter in p = k z^n D^m.
    strength
        Shear strength.
    """

    pressure: float
    n: float
    m: float
    strength: RimStrength


@dataclass(frozen=True)
class Started:
    """A change of the ground along part of the route.

    Attributes
    ----------
    what
        Its kind, and what its size is added to: `grip` (to ln grip), `modulus` (to ln k), `exponent` (to n),
        `climb` (to the slope along the path, rad), `floor` (hard where the sum of sizes is over 0.5).
    size
        Size within the feature.
    start, end
        Place where it begins to grow from 0, and place where it begins to fall to 0, m along the path.
    edge
        Length over which it grows and falls, linearly, m.
    """

    what: str
    size: float
    start: float
    edge: float
    end: float

    def at(self, place: Array) -> Array:
        """Size of the feature at places (m along the path), in the unit of its kind; the same shape."""
        into = np.clip((place - self.start) / self.edge, 0.0, 1.0)
        out = np.clip((self.end + self.edge - place) / self.edge, 0.0, 1.0)
        found: Array = self.size * into * out
        return found


@dataclass
class TrueGround:
    """Ground in cells along the route; arrays of shape (cells,) where no other is given.

    Attributes
    ----------
    world, rover
        The world, and the rover for which its ground was made.
    soils, starts
        Soils, and the place where each begins, m along the path.
    started
        Features that change the ground along parts of the route.
    at
        Place of each cell along the path, m.
    east, north
        Slope of each cell towards east (yaw 0) and north, positive upward, rad.
    steepens
        Climb that features add to these slopes, rad.
    twist
        Share of load that uneven ground shifts between the diagonals.
    common
        ln of the factor on k that all wheels share: drift and features.
    kind
        Index in `soils` of the soil of each wheel and cell, (wheels, cells).
    modulus, exponent
        ln of the whole factor on the soil's k, and n, (wheels, cells).
    grip
        ln of the factor on forces of shear, (wheels, cells).
    floor
        Whether the cell is hard, (wheels, cells).
    bumps
        Height of bumps under left and right wheels, m, (2, cells).
    load
        Load at rest, as slopes and uneven ground distribute it, N, (wheels, cells).
    rest
        Sinkage under that load, without slip and ruts, m, (wheels, cells); see `settle`.
    dragging
        Resistance over load in addition to that of the pressure, (wheels, cells).
    """

    world: World
    rover: SimulatedRover
    soils: tuple[TrueSoil, ...]
    starts: tuple[float, ...]
    started: tuple[Started, ...]
    at: Array
    east: Array
    north: Array
    steepens: Array
    twist: Array
    common: Array
    kind: NDArray[np.intp]
    modulus: Array
    exponent: Array
    grip: Array
    floor: NDArray[np.bool_]
    bumps: Array
    load: Array
    rest: Array
    dragging: Array

    @property
    def soil(self) -> TrueSoil:
        """The first soil, which is the only one in most worlds."""
        return self.soils[0]

    def kinds(self, places: Array) -> NDArray[np.intp]:
        """Index of the soil at places (m along the path), same shape; before the start the first one's."""
        return np.maximum(np.searchsorted(self.starts, places, side="right") - 1, 0)

    def cells(self, places: Array) -> NDArray[np.intp]:
        """Index of the cell nearest to each place (m along the path), same shape."""
        cells = np.clip(np.round((places - self.at[0]) / CELL), 0, self.at.size - 1)
        return np.asarray(cells, dtype=np.intp)

    def value(self, what: str, places: Array) -> Array:
        """Sum up the sizes of all features of one kind at places along the path.

        Parameters
        ----------
        what
            Kind of the features, as in `Started`.
        places
            m along the path, any shape.

        Returns
        -------
        ndarray
            Same shape, in the unit of the kind; 0 where there is no such feature.
        """
        found: Array = np.zeros(np.shape(places))
        for one in self.started:
            if one.what == what:
                found = found + one.at(places)
        return found


class Frame:
    """A rigid frame whose weight rests on the wheels of a rover.

    Parameters
    ----------
    rover
        The rover: wheels, mass and centre of gravity.
    spare
        Share of the weight on a wheel that is not listed, 0 to 1.
    """

    def __init__(self, rover: SimulatedRover, spare: float) -> None:
        x = np.array([w.x for w in rover.wheels])
        y = np.array([w.y for w in rover.wheels])
        self._rover, self._weight = rover, rover.mass * GRAVITY * (1.0 - spare) / x.size
        self._x, self._y = x / np.mean(x**2), y / np.mean(y**2)
        self._diagonal = np.sign(x * y)

    def loads(self, climb: Any, roll: Any, gained: Any, twist: Any) -> Array:
        """Compute the load of each wheel.

        Parameters
        ----------
        climb, roll
            Angles of the vehicle, rad; positive nose up, left side up. All arguments are numbers, or arrays
            of one shape.
        gained
            Acceleration forward, m/s^2.
        twist
            Share of load that uneven ground shifts to the front left and rear right wheels from the others.

        Returns
        -------
        ndarray
            Load, N, at least a tenth of a wheel's equal share; the arguments' shape + (wheels,).
        """
        rover = self._rover
        along = rover.gravity_x - rover.gravity_height * (np.tan(climb) + gained / GRAVITY)
        across = rover.gravity_y - rover.gravity_height * np.tan(roll)
        share = 1.0 + np.multiply.outer(along, self._x) + np.multiply.outer(across, self._y)
        share = np.maximum(share + np.multiply.outer(twist, self._diagonal), 0.1)
        found: Array = np.multiply(self._weight * np.cos(climb) * np.cos(roll), share.T).T
        return found


def make_ground(
    world: World,
    rover: SimulatedRover,
    soils: Sequence[TrueSoil],
    starts: Sequence[float],
    started: Sequence[Started],
    rng: np.random.Generator,
) -> TrueGround:
    """Draw the ground of a world.

    Parameters
    ----------
    world
        Specification of the world.
    rover
        The rover that drives on it.
    soils
        Soils, one for each of `starts`.
    starts
        Place where each soil begins, m along the path, rising.
    started
        Features that change the ground along parts of the route.
    rng
        Random number generator for the draws.

    Returns
    -------
    TrueGround
        `rest` and `dragging` are 0; `settle` computes the first.
    """
    length = sum(abs(leg.metres) for leg in world.legs)
    at: Array = np.arange(-_BEFORE, length + _BEHIND, CELL, dtype=np.float64)
    names = [wheel.name for wheel in rover.wheels]
    x = np.array([wheel.x for wheel in rover.wheels])
    tracks = {y: blocks(rng, at, 1.0) for y in dict.fromkeys(w.y for w in rover.wheels)}
    waves = [_waves(rng, at, world.slope) for _ in range(2)]
    twist = 0.12 * world.swing * _waves(rng, at, 1.0, (2.6, 1.4))
    common: Array = np.cumsum(rng.standard_normal(at.size)) * world.drift * math.sqrt(CELL / 5.0)
    own = {y: texture(rng, at, world.scatter) for y in tracks}
    grip = blocks(rng, at, world.grip)
    shape = len(names), at.size
    modulus, exponent, slipped, load, rest, dragging = (np.zeros(shape) for _ in range(6))
    found = TrueGround(
        world=world, rover=rover, soils=tuple(soils), starts=tuple(starts), started=tuple(started), at=at,
        east=waves[0], north=waves[1], steepens=np.zeros(at.size), twist=twist, common=common,
        kind=np.zeros(shape, dtype=np.intp), modulus=modulus, exponent=exponent,
        grip=slipped, floor=np.zeros(shape, dtype=bool), bumps=_bumps(world, rover, at, length, rng),
        load=load, rest=rest, dragging=dragging,
    )  # fmt: skip
    found.steepens = found.value("climb", at)
    found.common = common + found.value("modulus", at)
    exponents = np.array([soil.n for soil in soils])
    for j, wheel in enumerate(rover.wheels):
        side = world.right if wheel.y < 0 else 0.0
        found.modulus[j] = found.common + own[wheel.y] + side
        found.kind[j] = found.kinds(at)
        found.exponent[j] = exponents[found.kind[j]] + found.value("exponent", at)
        found.grip[j] = grip + world.own_grip * tracks[wheel.y] + found.value("grip", at)
        found.floor[j] = world.floor | (found.value("floor", at) > 0.5)
    # Loads of the planned heading; what a turn or a start changes comes on top in time.
    yaw = _heading(world, at)
    climb, roll = tilt(found, np.arange(at.size), yaw)
    middle = Frame(rover, world.spare).loads(climb, roll, np.zeros(at.size), twist).T
    for j in range(len(rover.wheels)):
        found.load[j] = np.interp(at - x[j], at, middle[j])
    return found


def settle(ground: TrueGround) -> None:
    """Compute the sinkage of each wheel at rest in each cell, in place: `ground.rest`, m.

    NaN where the wheel would sink to its axle.
    """
    cells = ground.at.size
    for j, wheel in enumerate(ground.rover.wheels):
        pressure, m = (
            np.array([getattr(soil, name) for soil in ground.soils])[ground.kind[j]]
            for name in ("pressure", "m")
        )
        modulus = pressure + ground.modulus[j] - ground.exponent[j] * math.log(SINKAGE)
        modulus = np.exp(modulus + m * math.log(wheel.diameter / DIAMETER))
        law = pressure_law(modulus, ground.exponent[j], ground.world.hardpan)
        size = np.full(cells, wheel.diameter), np.full(cells, wheel.width)
        ground.rest[j] = static_sinkage(law, ground.load[j], *size)


def pressure_law(modulus: Array, n: Array, hardpan: float | None) -> Callable[[Array], Array]:
    """Make the function that returns the pressure at depths in each cell.

    The pressure is K z^n; below a hard layer at depth h, 8 K (z - h)^n is added.

    Parameters
    ----------
    modulus
        K, shape (cells,), Pa/m^n.
    n
        Exponent of depth, shape (cells,).
    hardpan
        Depth of a hard layer, m; None for none.

    Returns
    -------
    callable
        Takes depths (m), shape (cells, points); returns pressures (Pa), same shape.
    """

    def law(depth: Array) -> Array:
        deep = np.maximum(depth, 0.0)
        found: Array = modulus[:, None] * deep ** n[:, None]
        if hardpan is not None:
            below = np.maximum(deep - hardpan, 0.0)
            found = found + _HARDER * modulus[:, None] * below ** n[:, None]
        return found

    return law


def tilt(
    ground: TrueGround, cell: NDArray[np.intp] | int, yaw: Array | float
) -> tuple[Array, Array]:
    """Climb and roll of a vehicle with a heading on the ground, without bumps.

    Parameters
    ----------
    ground
        The ground.
    cell
        Index of a cell, or shape (rows,).
    yaw
        Heading, rad, a number or shape (rows,).

    Returns
    -------
    climb, roll : ndarray
        rad, a number or shape (rows,); positive nose up, left side up.
    """
    east, north, cosine, sine = ground.east[cell], ground.north[cell], np.cos(yaw), np.sin(yaw)
    return east * cosine + north * sine + ground.steepens[cell], north * cosine - east * sine


def _heading(world: World, at: Array) -> Array:
    """Planned yaw (rad) at each place (m) when the vehicle is there for the first time, shape (cells,)."""
    found, place, yaw = np.zeros(at.size), 0.0, 0.0
    farthest = 0.0
    for leg in world.legs:
        yaw += leg.turn
        fresh = (at >= farthest) & (at < max(place + leg.metres, farthest))
        found[fresh] = yaw + leg.bend * (at[fresh] - place)
        place, yaw = place + leg.metres, yaw + leg.bend * leg.metres
        farthest = max(farthest, place)
    found[at >= farthest] = yaw
    return found


def _waves(
    rng: np.random.Generator, at: Array, size: float, lengths: tuple[float, ...] = (5.0, 11.0)
) -> Array:
    found = np.zeros(at.size)
    for length in lengths:
        phase = rng.uniform(0.0, 2.0 * np.pi)
        found += size * rng.uniform(0.4, 1.0) * np.sin(2.0 * np.pi * at / length + phase)
    return found


def blocks(rng: np.random.Generator, at: Array, deviation: float) -> Array:
    """Draw values that are constant in blocks of 0.5 to 2.5 m, with edges smoothed over 0.2 m.

    Parameters
    ----------
    rng
        Random number generator for the draws.
    at
        Places along the path, `CELL` apart, shape (cells,), m.
    deviation
        Standard deviation, in the unit of the values.

    Returns
    -------
    ndarray
        Shape (cells,), of mean 0.
    """
    edges = np.cumsum(rng.uniform(0.5, 2.5, at.size)) + at[0]
    values = deviation * rng.standard_normal(at.size + 1)
    found: Array = uniform_filter1d(values[np.searchsorted(edges, at)], round(0.2 / CELL))
    return found


def texture(rng: np.random.Generator, at: Array, deviation: float, length: float = 0.25) -> Array:
    """Draw normal values along the path whose correlation falls exponentially with distance.

    Parameters
    ----------
    rng
        Random number generator for the draws.
    at
        Places along the path, `CELL` apart, shape (cells,), m.
    deviation
        Standard deviation, in the unit of the values.
    length
        Distance at which the correlation is 1/e, m.

    Returns
    -------
    ndarray
        Shape (cells,), of mean 0.
    """
    keep, values = math.exp(-CELL / length), deviation * rng.standard_normal(at.size)
    for i in range(1, at.size):
        values[i] = keep * values[i - 1] + math.sqrt(1.0 - keep * keep) * values[i]
    return values


def _bumps(
    world: World, rover: SimulatedRover, at: Array, length: float, rng: np.random.Generator
) -> Array:
    """Height (m) of stones under left and right wheels, shape (2, cells); 0 between them."""
    found = np.zeros((2, at.size))
    for side in found if world.bumps else ():
        place = 2.0
        while place < length:
            size = rng.uniform(0.25, 0.4)
            inside = (at > place) & (at < place + size)
            lift = world.bumps * rover.wheels[0].diameter * rng.uniform(0.4, 1.0)
            side[inside] += lift * np.sin(np.pi * (at[inside] - place) / size) ** 2
            place += rng.uniform(0.8, 2.5)
    return found
