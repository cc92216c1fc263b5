# SPDX-License-Identifier: Apache-2.0
"""Drives through a `World`: what was true, and rows of what its sensors show, by stream.

drive = make_drive(world, seed=1)
drive.rows["front_left/load"]   # stamps (ns) and values, shape (rows, columns)

"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from smallwheel_ros.simulate.sensors import Integers, Measured, Rows
from smallwheel_ros.simulate.vehicle import EPOCH, Truth, driven
from smallwheel_ros.simulate.world import VEHICLES, Rover, World
from smallwheel_ros.simulate.world_ground import (
    Ground,
    draw_features,
    draw_soil,
    make_ground,
    settle,
)

_ATTEMPTS = 300


@dataclass(frozen=True)
class WorldDrive:
    """A drive. parameters: what its user tells of the vehicle, by name."""

    world: World
    rover: Rover
    ground: Ground
    truth: Truth
    parameters: dict[str, Any]
    rows: Rows

    def at(self, stamps: Integers) -> Integers:
        """Index of the truth at stamps (ns)."""
        found = np.searchsorted(self.truth.time, (stamps - EPOCH) / 1e9 + 1e-9, side="right") - 1
        return np.clip(found, 0, self.truth.time.size - 1)


def make_drive(world: World, seed: int) -> WorldDrive:
    """Draw a drive; one that got on where the world does not let it get stuck."""
    world, rover = world.drawn(seed), VEHICLES[world.vehicle]
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt, 50, *world.name.encode()])
        soil = draw_soil(world, rover, rng)
        started = draw_features(world, rng)
        ground = make_ground(world, rover, (soil,), (0.0,), started, rng)
        settle(ground)
        truth = driven(world, rover, ground, rng)
        if truth is not None:
            rows = Measured(world, rover, truth, rng).rows()
            told = parameters_of(world, rover, rng) | dict(world.told)
            return WorldDrive(world, rover, ground, truth, told, rows)
    raise RuntimeError(f"{world.name}: no ground carries this vehicle")


def parameters_of(world: World, rover: Rover, rng: np.random.Generator) -> dict[str, Any]:
    """What the user tells: nothing of the noise, and of the soil only where sinkage is measured."""
    sensors = world.sensors
    found: dict[str, Any] = {"wheels": [w.name for w in rover.wheels]}
    if sensors.sinkage:
        found["soil.name"] = "dry_sand"
    found["vehicle.mass"] = rover.mass * (1.0 + 0.01 * float(rng.standard_normal()))
    if not sensors.load:
        found["load.source"] = "static"
    if sensors.imu:
        found["imu_topic"] = "imu"
    for wheel in rover.wheels:
        found |= {f"{wheel.name}.diameter": wheel.diameter, f"{wheel.name}.width": wheel.width}
        found[f"{wheel.name}.longitudinal_position"] = wheel.x
        found[f"{wheel.name}.lateral_position"] = wheel.y
        if not sensors.sinkage:
            found[f"{wheel.name}.sinkage_topic"] = ""
        if sensors.torque:
            found[f"{wheel.name}.torque_per_effort"] = 1.0
        if sensors.pull:
            found[f"{wheel.name}.drawbar_pull_topic"] = f"{wheel.name}/load"
    return found
