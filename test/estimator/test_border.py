# SPDX-License-Identifier: Apache-2.0
"""At a border of two soils, each wheel's mobility and the cost under it are those of its own soil."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from readings import Given as Onboard
from test_onboard import messages_of, settings_of

from smallwheel_ros.costmap.cost_map import CostMap, CostSettings
from smallwheel_ros.onboard.ground import GroundMapper
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.simulate.drive import EPOCH, simulate_drive
from smallwheel_ros.simulate.ride import DriveSettings
from smallwheel_ros.simulate.terrain import Stretch, soil_of_pressure

BORDER = 8.0  # m


class Step(NamedTuple):
    """A result with what was true of its wheel then: number of its soil, sinkage and place (m)."""

    result: Result
    soil: int
    sinkage: float
    place: tuple[float, float]

    @property
    def error(self) -> float:
        """Error of the logarithm of the sinkage that goes with the forces."""
        assert self.result.forces is not None
        return math.log(self.result.forces.sinkage.value / self.sinkage)


@pytest.fixture(scope="module", params=[0.25, 6.0])
def steps(request: pytest.FixtureRequest) -> list[Step]:
    """A drive from a sand to a soil of so many times its modulus."""
    ground = {"n": 0.85, "m": 0.35, "friction_angle": 0.54, "cohesion": 600.0}
    stretches = tuple(
        Stretch(start, soil_of_pressure(name, pressure=pressure, **ground))
        for start, name, pressure in ((0.0, "first", 19e3), (BORDER, "then", 19e3 * request.param))
    )
    drive = simulate_drive(DriveSettings(seed=5, distance=11.0, stretches=stretches))
    onboard = Onboard(settings_of(drive))
    results = [r for message in messages_of(drive) for r in message.give(onboard)]
    truth = drive.truth
    number = {wheel.name: j for j, wheel in enumerate(drive.rover.wheels)}
    found = []
    for result in results:
        at, j = (result.reading.stamp - EPOCH) / 1e9, number[result.wheel]
        row = int(np.searchsorted(truth.travel.time, at, side="right")) - 1
        depth = float(np.interp(at, truth.travel.time, truth.sinkage[:, j]))
        way = float(np.interp(at, truth.travel.time, truth.travel.way))
        wheel = drive.rover.wheels[j]
        found.append(Step(result, int(truth.stretch[row, j]), depth, (way + wheel.x, wheel.y)))
    return found


def test_a_wheel_behind_the_border_has_the_mobility_of_its_own_soil(steps: list[Step]) -> None:
    behind = [
        step for step in steps if step.soil == 0 and step.result.elsewhere and step.result.forces
    ]
    assert {step.result.wheel for step in behind} == {"rear_left", "rear_right"}
    assert len(behind) >= 10
    # The soil's modulus is another one by more than a factor of two.
    assert abs(np.median([step.error for step in behind])) < 0.05
    assert np.mean([abs(step.error) < 0.15 for step in behind]) > 0.8


def test_all_wheels_are_on_one_soil_away_from_the_border(steps: list[Step]) -> None:
    away = [s for s in steps if not BORDER - 1.0 < s.place[0] < BORDER + 1.3]
    assert {s.soil for s in away} == {0, 1}
    assert [s for s in away if s.result.elsewhere] == []


def test_the_cost_up_to_the_border_is_that_of_the_soil_before_it(steps: list[Step]) -> None:
    wheels = {step.result.wheel: step.result.reading.wheel for step in steps}
    cost_map = CostMap(
        CostSettings(size=40.0, resolution=0.05, spread=0.0, unknown="none"), list(wheels.values())
    )
    across = {step.result.wheel: step.place[1] for step in steps}
    mapper = GroundMapper(cost_map)
    for step in steps:
        wheel, (x, y) = step.result.reading.wheel, step.place
        middle = x - wheel.longitudinal_position, y - wheel.lateral_position
        reading = step.result.reading._replace(vehicle=middle, heading=0.0, distance=middle[0])
        mapper.add(replace(step.result, reading=reading), "odom")
    grid = cost_map.grid()
    assert grid is not None

    def costs(start: float, end: float) -> np.ndarray:
        row, first = grid.cell(start, across["rear_left"])
        _, last = grid.cell(end, across["rear_left"])
        line = grid.cells[row, first:last]
        return line[line >= 0].astype(int)

    before, up_to, after = costs(5.0, 7.0), costs(7.4, 7.95), costs(9.3, 10.5)
    assert up_to.size >= 8
    assert abs(np.median(before) - np.median(after)) >= 2  # or this would show nothing
    assert np.abs(up_to - np.median(before)).max() <= 1
