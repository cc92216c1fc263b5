# SPDX-License-Identifier: Apache-2.0
"""Which drive to simulate, and what it goes over: soils in a row, slippery patches, and what it ends in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from smallwheel_ros.common.options import Option
from smallwheel_ros.simulate.hidden import (
    FRACTION,
    Hidden,
    Seed,
    Strength,
    check_settings,
    in_drives,
)
from smallwheel_ros.simulate.truth import SimulationError, TruthSoil
from smallwheel_ros.simulate.wheel_laws import RimStrength
from smallwheel_ros.simulate.world import ROVERS, Rover, Sensors
from smallwheel_ros.simulate.world_ground import DIAMETER, SINKAGE, Soil, Started

TERRAINS = ("mixed", "single")
FINISHES = ("none", "slope", "slippery")
# Of `soil_of_pressure`.
_REFERENCE_SINKAGE, _REFERENCE_DIAMETER = 0.01, 0.25
_TO_BE_STUCK = (
    12.0  # m over which a slope steepens; every soil here holds less than what it ends in
)
SENSORS = Sensors(
    torque=True, pull=True, sinkage_told=0.03, load_rate=50.0, joint_rate=50.0, encoder_steps=(30_000,),
    odometry_rate=(30.0,), pitch=True,
)  # fmt: skip


@dataclass(frozen=True)
class Stretch:
    """A soil from `start` (m along the way) to the next stretch."""

    start: float
    soil: TruthSoil


@dataclass(frozen=True)
class DriveSettings:
    """What drive to simulate: the options of `smallwheel simulate drive`.

    The same seed gives the same drive, to the byte. `wheels` may be a rover of your own, and `stretches`,
    where given, are driven over instead of `terrain`; `sensors`, of which the noise and the share of
    outliers are those of the settings, may be your own, too. A `finish` is what the drive ends in after
    `distance`, stuck: a slope that steepens, or slippery ground. With dropouts above 0 one wheel's
    sinkage is also missing for 1.5 s.
    """

    seed: Seed = 0
    distance: Annotated[float, Option("Distance, m.", (2.0, 20_000.0, "m"))] = 30.0
    speed: Annotated[float, Option("Mean speed, m/s.", (0.01, 3.0, "m/s"))] = 0.5
    wheels: Annotated[str | Rover, Option(f"{' or '.join(ROVERS)}.", tuple(ROVERS))] = "four"
    terrain: Annotated[str, Option(f"{' or '.join(TERRAINS)} soil.", TERRAINS)] = "mixed"
    stretches: tuple[Stretch, ...] | None = None
    sensors: Sensors = SENSORS
    finish: Annotated[
        str, Option(f"What the drive gets stuck on at its end: {', '.join(FINISHES)}.", FINISHES)
    ] = "none"
    hidden: Hidden = ()
    strength: Strength = 1.0
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


def soil_of_pressure(name: str, pressure: float, n: float, m: float, **rest: float) -> TruthSoil:
    """Make a soil from its pressure (Pa) at 10 mm sinkage of a wheel of 0.25 m diameter."""
    k = pressure / (_REFERENCE_SINKAGE**n * _REFERENCE_DIAMETER**m)
    return TruthSoil(name, k, n, m, **rest)


def in_ground(soil: TruthSoil) -> Soil:
    """The same soil as the ground of a world has it."""
    pressure = math.log(soil.k) + soil.n * math.log(SINKAGE) + soil.m * math.log(DIAMETER)
    strength = RimStrength(soil.cohesion, soil.friction_angle, soil.shear_deformation)
    return Soil(pressure, soil.n, soil.m, strength)


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


def draw_patches(distance: float, rng: np.random.Generator) -> tuple[Started, ...]:
    """Draw slippery places, one every 6 m or so, with 0.7 of the grip."""
    count = max(1, round(distance / 6.0))
    starts = (np.arange(count) + rng.uniform(0.3, 0.8, count)) * distance / count
    ends = starts + rng.uniform(0.9, 1.5, count)
    return tuple(
        Started("grip", math.log(0.7), float(start), 0.16, float(end))
        for start, end in zip(starts, ends, strict=True)
    )


def draw_finish(name: str, distance: float, rng: np.random.Generator) -> tuple[Started, ...]:
    """Draw the end of a drive, one of `FINISHES`, after `distance`.

    A slope of 2.5 to 4.5 degrees more in each metre; or grip that falls to a tenth.
    """
    if name == "slope":
        rise = np.radians(rng.uniform(2.5, 4.5)) * _TO_BE_STUCK
        return (Started("climb", float(rise), distance, _TO_BE_STUCK, math.inf),)
    if name == "slippery":
        grip = math.log(rng.uniform(0.05, 0.15))
        return (Started("grip", grip, distance, rng.uniform(0.8, 1.6), math.inf),)
    return ()
