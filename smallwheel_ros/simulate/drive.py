# SPDX-License-Identifier: Apache-2.0
"""Simulated drives of a small rover: what its sensors record, and separately the true values.

Ground and vehicle are those of the worlds (`world_ground`, `vehicle`), with several soils in a row. Hidden
effects act in two places. They change depth and resistance of a wheel without slip, which slow the vehicle
down; and they change the reading of sinkage, which follows from each wheel's load, slip and speed by the
stress at the points of its contact (`truth`). Sinkage due to slip deepens the rut but does not slow the
rover: with the resistance of the greater depth as well, a rover that begins to slip in loose sand would
be stuck for good in many drives, with nothing left to record.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.simulate.hidden import HiddenEffect
from smallwheel_ros.simulate.sensors import Integers, MeasuredRows, Rows
from smallwheel_ros.simulate.settings import (
    DriveSettings,
    SimulationError,
    Stretch,
    draw_effects,
)
from smallwheel_ros.simulate.truth import (
    Array,
    Circumstances,
    Contact,
    Places,
    TruthSoil,
    soil_of_pressure,
)
from smallwheel_ros.simulate.vehicle import EPOCH, SimulatedVehicle, Truth, truth_of
from smallwheel_ros.simulate.wheel_laws import RimStrength, WheelsOnSoil
from smallwheel_ros.simulate.world import ROVERS, Leg, SimulatedRover, World
from smallwheel_ros.simulate.world_ground import (
    DIAMETER,
    SINKAGE,
    Started,
    TrueSoil,
    make_ground,
    texture,
)

# m over which a slope steepens; no soil here gives enough thrust for the slope at its end
_TO_BE_STUCK = 12.0
_BLOCK = 4000  # wheels on soil at once, so that memory stays small on long drives
_FINISH = 15.0  # m of ground after the distance, on which a rover gets stuck
_SLOWEST = 0.01  # m/s: a standing wheel is treated as one of this speed
_SPARE = 1.15  # speed of the rims over that of the rover, since wheels on these soils slip by 0.13
_ATTEMPTS = 20
_GAP = 1.5  # s for which the sinkage of the second wheel is missing, with dropouts


@dataclass(frozen=True)
class Drive:
    """One simulated drive: the readings of its sensors, and the true values.

    Attributes
    ----------
    settings
        The settings, checked.
    rover
        The rover that drove.
    stretches
        Soils by the place where they begin, m along the path.
    effects
        Hidden effects with their numbers.
    truth
        True values over time; the sinkage is what an instrument without noise would show.
    stretch
        Index in `stretches` of the soil under each wheel, shape (times, wheels).
    rows
        Readings by stream, such as `front_left/sinkage`: stamps (ns since 1970), shape (rows,), and values,
        shape (rows, columns), whose columns the module `sensors` describes. Missing rows are left out.
    outliers
        By stream of sinkage: which of its rows are gross errors, shape (rows,).
    """

    settings: DriveSettings
    rover: SimulatedRover
    stretches: tuple[Stretch, ...]
    effects: tuple[HiddenEffect, ...]
    truth: Truth
    stretch: Places
    rows: Rows
    outliers: Mapping[str, NDArray[np.bool_]]

    def answer(self) -> dict[str, Any]:
        """The file of the truth, which the bag must not contain, as dicts, lists and numbers.

        Its keys: kind, epoch_ns, settings, mass, stuck (time and way; None if it never got stuck), hidden
        (effects), stretches (soils), wheels (by name; true values at the stamps of the wheel's sinkage) and
        rover (values over time). Times are in seconds after `epoch_ns` (ns since 1970), all else in SI units.
        Slip is 0 where a wheel stands.
        """
        truth, time = self.truth, self.truth.time
        settings = asdict(self.settings) | {"wheels": [asdict(w) for w in self.rover.wheels]}
        for own in ("stretches", "sensors"):
            settings.pop(own)
        slip = np.nan_to_num(truth.slip)
        x, y, _ = truth.course
        wheels = {}
        for j, wheel in enumerate(self.rover.wheels):
            stream = f"{wheel.name}/sinkage"
            at = (self.rows[stream][0] - EPOCH) / 1e9
            wheels[wheel.name] = {
                "time": _rounded(at, 9),
                "sinkage": _rounded(np.interp(at, time, truth.sinkage[:, j]), 7),
                "load": _rounded(np.interp(at, time, truth.load[:, j]), 4),
                "slip": _rounded(np.interp(at, time, slip[:, j]), 5),
                "drawbar_pull": _rounded(np.interp(at, time, truth.pull[:, j]), 4),
                "torque": _rounded(np.interp(at, time, truth.torque[:, j]), 4),
                "stretch": self.stretch[np.searchsorted(time, at, side="right") - 1, j].tolist(),
                "moving": (np.interp(at, time, truth.speed) > 1e-3).tolist(),
                "outlier": self.outliers[stream].tolist(),
            }
        return {
            "kind": "drive",
            "epoch_ns": EPOCH,
            "settings": settings,
            "mass": self.rover.mass,
            "stuck": None
            if truth.stuck is None
            else {
                "time": round(truth.stuck, 3),
                "way": round(float(np.interp(truth.stuck, time, truth.path)), 4),
            },
            "hidden": [effect.describe() for effect in self.effects],
            "stretches": [{"start": s.start} | asdict(s.soil) for s in self.stretches],
            "wheels": wheels,
            "rover": {
                "time": _rounded(time, 3),
                "way": _rounded(truth.path, 4),
                "speed": _rounded(truth.speed, 4),
                "slip": _rounded(slip.mean(axis=1), 5),
                "climb": _rounded(truth.climb, 5),
                "x": _rounded(x, 4),
                "y": _rounded(y, 4),
            },
        }


def _rounded(values: Any, digits: int) -> list[float]:
    rounded: list[float] = np.round(values, digits).tolist()
    return rounded


def simulate_drive(settings: DriveSettings) -> Drive:
    """Simulate a drive; the same settings give the same numbers.

    Ground is drawn anew until the rover covers the distance and, only if there is a `finish`, gets stuck.

    Raises
    ------
    SimulationError
        If a setting is wrong, a wheel sinks to its axle, or that happens on none of 20 grounds.
    """
    settings = settings.check()
    rover, distance = settings.wheels, settings.distance
    if isinstance(rover, str):
        rover = ROVERS[rover]
    # Streams of their own: more outliers do not change the ground, nor another soil the noise.
    effects = draw_effects(settings.hidden, _stream(settings, 10), settings.strength)
    stretches = settings.stretches or draw_stretches(
        settings.terrain, distance, _stream(settings, 11)
    )
    for attempt in range(_ATTEMPTS):
        wheels = _Wheels(settings, rover, stretches, effects, attempt)
        truth = wheels.drive()
        if (truth.stuck is None) == (settings.finish == "none") and truth.path[-1] >= distance:
            break
    else:
        raise SimulationError(
            f"the rover gets no farther than {truth.path[-1]:.1f} m: take a firmer soil, a lighter rover or"
            " a smaller strength"
        )
    rows, outliers = _recorded(wheels.world, rover, truth, settings)
    kinds = wheels.kinds(truth)
    return Drive(settings, rover, stretches, effects, truth, kinds, rows, outliers)


def in_ground(soil: TruthSoil) -> TrueSoil:
    """A soil of the simulator in the form that the ground of a world uses, with the same law and strength."""
    pressure = math.log(soil.k) + soil.n * math.log(SINKAGE) + soil.m * math.log(DIAMETER)
    strength = RimStrength(soil.cohesion, soil.friction_angle, soil.shear_deformation)
    return TrueSoil(pressure, soil.n, soil.m, strength)


def draw_stretches(terrain: str, distance: float, rng: np.random.Generator) -> tuple[Stretch, ...]:
    """Draw the soils along a drive: `single` is one sand, `mixed` three in turn, about 10 m each.

    Parameters
    ----------
    terrain
        `single` or `mixed`.
    distance
        Length of the drive, m.
    rng
        Random number generator for the draws.

    Returns
    -------
    tuple of Stretch
        Soils with the place where each begins, in order; the first at 0 m.
    """

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


def draw_patches(distance: float, rng: np.random.Generator) -> tuple[Started, ...]:
    """Draw slippery places, one every 6 m or so, about 1 m long, where shear forces are 0.7 of the usual.

    Parameters
    ----------
    distance
        Length of the drive, m.
    rng
        Random number generator for the draws.

    Returns
    -------
    tuple of Started
        Features of kind `grip`, whose size is ln 0.7, with their start and end (m along the path).
    """
    count = max(1, round(distance / 6.0))
    starts = (np.arange(count) + rng.uniform(0.3, 0.8, count)) * distance / count
    ends = starts + rng.uniform(0.9, 1.5, count)
    return tuple(
        Started("grip", math.log(0.7), float(start), 0.16, float(end))
        for start, end in zip(starts, ends, strict=True)
    )


def draw_finish(name: str, distance: float, rng: np.random.Generator) -> tuple[Started, ...]:
    """Draw the ground after the distance, on which a rover gets stuck.

    `slope` steepens by 2.5 to 4.5 degrees in each of 12 metres; on `slippery` ground shear forces fall to
    0.05 to 0.15 of the usual within 0.8 to 1.6 m.

    Parameters
    ----------
    name
        One of `FINISHES`.
    distance
        Where that ground begins, m along the path.
    rng
        Random number generator for the draws.

    Returns
    -------
    tuple of Started
        One feature, of kind `climb` or `grip`, without an end; empty for `none`.
    """
    if name == "slope":
        rise = np.radians(rng.uniform(2.5, 4.5)) * _TO_BE_STUCK
        return (Started("climb", float(rise), distance, _TO_BE_STUCK, math.inf),)
    if name == "slippery":
        grip = math.log(rng.uniform(0.05, 0.15))
        return (Started("grip", grip, distance, rng.uniform(0.8, 1.6), math.inf),)
    return ()


def _stream(settings: DriveSettings, *purpose: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, *purpose])


def _recorded(
    world: World, rover: SimulatedRover, truth: Truth, settings: DriveSettings
) -> tuple[Rows, dict[str, NDArray[np.bool_]]]:
    """Readings by stream without those that are missing, and which rows of each sinkage are gross errors.

    As `Drive.rows` and `Drive.outliers`.
    """
    measured = MeasuredRows(world, rover, truth, _stream(settings, 1))
    rows, outliers = measured.rows(), {}
    for j, wheel in enumerate(rover.wheels):
        for number, what in enumerate(("load", "sinkage"), 2):
            stream = f"{wheel.name}/{what}"
            stamps, values = rows[stream]
            keep = _kept(
                stamps, settings, _stream(settings, number, j), what == "sinkage" and j == 1
            )
            rows[stream] = stamps[keep], values[keep]
        outliers[stream] = measured.outliers[wheel.name][keep]
    return rows, outliers


def _kept(
    stamps: Integers, settings: DriveSettings, rng: np.random.Generator, gap: bool
) -> NDArray[np.bool_]:
    """Draw which rows are kept, (rows,): single rows are missing and, if `gap`, all in one span of time."""
    keep = rng.uniform(size=stamps.size) >= settings.dropouts
    if gap and settings.dropouts > 0:
        begin = int(stamps[int(rng.uniform(0.3, 0.9) * stamps.size)])
        keep &= (stamps < begin) | (stamps > begin + round(_GAP * 1e9))
    return keep


def _world(settings: DriveSettings, rover: SimulatedRover, rng: np.random.Generator) -> World:
    """Make the world of a drive: two bends that form an S, with a halt of 3 s between them, then the finish.

    A rover that steers has tighter bends, and turns on the spot at the halt.
    """
    half = 0.5 * settings.distance
    bend = min(rng.uniform(0.5, 1.0) / half, 0.1)
    turn = 0.0
    if rover.steers:
        bend, turn = rng.uniform(0.4, 0.7), rng.uniform(0.8, 1.5)
    legs = Leg(half, bend, stand=3.0), Leg(half + _FINISH, -bend, turn=turn, stand=1.0)
    sensors = replace(settings.sensors, noise_factor=settings.noise, outliers=settings.outliers)
    return World(
        "drive", legs=legs, speed=_SPARE * settings.speed, ramp=0.35, slope=0.06, swing=1.6, grip=0.05,
        own_grip=0.02, scatter=0.05, sticks=True, patience=4.0, sensors=sensors,
    )  # fmt: skip


class _Wheels:
    """The wheels of a rover on the ground of a drive, with hidden effects.

    attempt: number of the ground that is drawn. Raises SimulationError if a wheel sinks to its axle at rest.
    """

    def __init__(
        self,
        settings: DriveSettings,
        rover: SimulatedRover,
        stretches: tuple[Stretch, ...],
        effects: tuple[HiddenEffect, ...],
        attempt: int,
    ) -> None:
        self.rover, self.stretches, self.effects = rover, stretches, effects
        self.x = np.array([wheel.x for wheel in rover.wheels])
        self.y = np.array([wheel.y for wheel in rover.wheels])
        # A wheel that follows another in its track rolls in that one's rut.
        ahead = (self.y[:, None] == self.y) & (self.x[:, None] > self.x)
        self.passes = 1.0 + ahead.sum(axis=0)
        self.rng = _stream(settings, 12, attempt)
        distance, world = settings.distance, _world(settings, rover, self.rng)
        finish = draw_finish(settings.finish, distance, _stream(settings, 13))
        started = *draw_patches(distance, self.rng), *finish
        soils = [in_ground(stretch.soil) for stretch in stretches]
        starts = [stretch.start for stretch in stretches]
        self.ground = make_ground(world, rover, soils, starts, started, self.rng)
        # The ground is as long with a finish as without; what comes before is the same.
        first, last = world.legs
        arrives = first, replace(last, metres=last.metres - _FINISH)
        self.world = world if finish else replace(world, legs=arrives)
        self.unrecorded = np.tanh(texture(self.rng, self.ground.at, 1.0, 5.0))
        self._settle(settings.speed)

    def drive(self) -> Truth:
        """Drive over the ground; the sinkage returned is what instruments without noise show."""
        vehicle = SimulatedVehicle(self.world, self.rover, self.ground, self.rng)
        vehicle.run()
        truth = truth_of(vehicle)
        shown = np.empty_like(truth.sinkage)
        for j in range(len(self.rover.wheels)):
            cells = self.ground.cells(truth.place + self.x[j])
            travel = np.abs(truth.travel(self.rover, j))
            slip = np.nan_to_num(truth.slip[:, j])
            for rows, wheels in self._on_soil(j, cells, truth.load[:, j], slip, travel):
                shown[rows, j] = wheels.response().shown_sinkage
        if not np.isfinite(shown).all():
            time, wheel = np.argwhere(~np.isfinite(shown))[0]
            raise self._sunk(int(wheel), float(truth.place[time]), float(truth.load[time, wheel]))
        return replace(truth, sinkage=shown)

    def kinds(self, truth: Truth) -> Places:
        """Index of the stretch that each wheel is on, shape (times, wheels)."""
        return self.ground.kinds(truth.place[:, None] + self.x)

    def _settle(self, speed: float) -> None:
        """Set the ground's `rest` and `dragging`: sinkage (m) without slip, and resistance over load.

        `dragging` is the part that the pressure k z^n D^m alone does not give.
        """
        ground, cells = self.ground, np.arange(self.ground.at.size)
        for j, wheel in enumerate(self.rover.wheels):
            nothing, same = np.zeros(cells.size), np.full(cells.size, speed)
            for rows, wheels in self._on_soil(j, cells, ground.load[j], nothing, same):
                found = wheels.response()
                contact = Contact.at(wheels.at.diameter, found.depth)
                stress = np.maximum(contact.depth, 0.0) ** wheels.soil.n
                width = wheels.at.width
                plain = contact.backward(stress, width) / contact.upward(stress, width)
                ground.rest[j, rows] = found.depth
                ground.dragging[j, rows] = found.resistance / wheels.at.load - plain
            sunk = ~np.isfinite(ground.rest[j]) & (ground.at >= wheel.x)
            if sunk.any():
                cell = int(np.argmax(sunk))
                raise self._sunk(j, float(ground.at[cell] - wheel.x), float(ground.load[j, cell]))

    def _on_soil(
        self, j: int, cells: Places, load: Array, slip: Array, speed: Array
    ) -> Iterator[tuple[Places, WheelsOnSoil]]:
        """Yield the states of wheel j in blocks of rows on one soil: indices of the rows, and their wheels.

        cells, load (N), slip and speed (m/s): shape (rows,).
        """
        ground, wheel = self.ground, self.rover.wheels[j]
        at = Circumstances.of(
            load=load, diameter=wheel.diameter, width=wheel.width, slip=slip,
            speed=np.maximum(speed, _SLOWEST), pass_number=self.passes[j],
            hidden=self.unrecorded[cells],
        )  # fmt: skip
        factor, kind = np.exp(ground.modulus[j, cells]), ground.kind[j, cells]
        for i in np.unique(kind):
            whole = np.flatnonzero(kind == i)
            for rows in np.array_split(whole, -(-whole.size // _BLOCK)):
                soil = self.stretches[i].soil
                yield rows, WheelsOnSoil(soil, self.effects, at.rows(rows), factor[rows])

    def _sunk(self, j: int, place: float, load: float) -> SimulationError:
        soil = self.stretches[int(self.ground.kinds(np.array([place]))[0])].soil
        return SimulationError(
            f"wheel {self.rover.wheels[j].name} sinks to its axle at {place:.1f} m in {soil.name}"
            f" (load {load:.0f} N): take a firmer soil, a lighter rover or a smaller strength"
        )
