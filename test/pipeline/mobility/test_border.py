# SPDX-License-Identifier: Apache-2.0
"""At a border of two soils each wheel's mobility is that of its own soil.

Tests `answer.py` and `wheel.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from rows_of_drives import rover_of, rows_of, run

from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Estimates, Flags, Integers
from smallwheel_ros.simulate import DriveSettings, simulate_drive
from smallwheel_ros.simulate.settings import Stretch
from smallwheel_ros.simulate.truth import soil_of_pressure
from smallwheel_ros.simulate.vehicle import EPOCH

BORDER = 8.0  # m


class Crossed(NamedTuple):
    """Estimates; number of the true soil under each, ln of its sinkage over the true one, and place (m)."""

    made: Estimates
    soil: Integers
    error: Array
    place: Array

    @property
    def behind(self) -> Flags:
        """Of wheels that are on the first soil while others are known to be on the second."""
        return self.made.elsewhere & (self.soil == 0)


@pytest.fixture(scope="module", params=[0.25, 6.0])
def crossed(request: pytest.FixtureRequest) -> Crossed:
    """A drive from a sand to a soil of so many times its modulus."""
    ground = {"n": 0.85, "m": 0.35, "friction_angle": 0.54, "cohesion": 600.0}
    stretches = tuple(
        Stretch(start, soil_of_pressure(name, pressure=pressure, **ground))
        for start, name, pressure in ((0.0, "first", 19e3), (BORDER, "then", 19e3 * request.param))
    )
    drive = simulate_drive(DriveSettings(seed=7, distance=11.0, stretches=stretches))
    settings, rows = rover_of(drive), rows_of(drive)
    _, made = run(settings, rows, range(0, len(rows), 400))
    assert made is not None
    truth, time, wheel = drive.truth, (made.stamp - EPOCH) / 1e9, made.wheel
    row = np.searchsorted(truth.time, time, side="right") - 1
    each = range(len(drive.rover.wheels))
    depth = np.stack([np.interp(time, truth.time, truth.sinkage[:, j]) for j in each])
    ahead = np.array([w.x for w in drive.rover.wheels])[wheel]
    way = np.interp(time, truth.time, truth.path)
    error = np.log(made.sinkage / depth[wheel, np.arange(len(made))])
    return Crossed(made, drive.stretch[row, wheel], error, way + ahead)


def test_a_wheel_behind_the_border_has_the_mobility_of_its_own_soil(crossed: Crossed) -> None:
    behind = crossed.behind & np.isfinite(crossed.error)
    assert set(crossed.made.wheel[behind].tolist()) == {2, 3}  # the rear ones
    assert behind.sum() >= 10
    # The soil's modulus is another one by more than a factor of two.
    assert abs(np.median(crossed.error[behind])) < 0.05
    assert np.mean(np.abs(crossed.error[behind]) < 0.15) > 0.8


def test_all_wheels_are_on_one_soil_away_from_the_border(crossed: Crossed) -> None:
    away = ~((crossed.place > BORDER - 1.0) & (crossed.place < BORDER + 1.3))
    assert set(crossed.soil[away].tolist()) == {0, 1}
    assert not crossed.made.elsewhere[away].any()


def test_a_version_that_no_row_needs_is_not_asked_for() -> None:
    """Front and rear wheel in one track, their sinkages 30 ms apart, and turns as often as they come.

    The rear wheel's rows are on the soil before the border; versions of the soil beyond it come and go
    between its rows, and no later stage may ask for one that no row needs.
    """
    rover: dict[str, object] = {"wheels": ["front", "rear"], "soil.name": "dry_sand"}
    for name, place in (("front", 0.8), ("rear", -0.8)):
        rover |= {f"{name}.diameter": 0.25, f"{name}.width": 0.1}
        rover |= {f"{name}.longitudinal_position": place, f"{name}.lateral_position": 0.0}
    pipeline, random, speed = Pipeline(settings_from(rover).onboard), np.random.default_rng(1), 0.2
    rows: list[tuple[float, str, tuple[float, ...]]] = []
    for t in 0.1 * np.arange(1, 560):
        move = (speed + 0.004 * random.normal(), 0.003 * random.normal(), speed * t, 0.0, 1.0)
        rows.append((t, "odom", (*move, 0.0, 0.0, 0.0, 0.0, 0.0)))
        for name, ahead, late in (("front", 0.8, 0.03), ("rear", -0.8, 0.0)):
            load = 55.0 + 12.0 * np.sin(t / 2.0 + (name == "rear"))
            softer = 1.9 if speed * (t + late) + ahead > BORDER else 1.0
            depth = 0.011 * (load / 55.0) ** 0.7 * softer * np.exp(0.03 * random.normal())
            rows.append((t + late, f"{name}/load", (load + random.normal(),)))
            rows.append((t + late, f"{name}/sinkage", (depth + 4e-4 * random.normal(), 3.6e-7)))
    due, elsewhere = 0.0, list[tuple[int, bool]]()
    for t, stream, values in sorted(rows, key=lambda row: row[0]):
        if t >= due:
            due = t + (0.01 if 38.0 < t < 50.0 else 1.0)
            for turn in pipeline.turns():
                made = turn.estimates
                elsewhere += zip(made.wheel.tolist(), made.elsewhere.tolist(), strict=True)
        pipeline.streams.add(stream, round(t * 1e9) + 10**9, values)
    assert pipeline.soils.changes == 1
    # The border is known when the front wheel is 0.6 m beyond it: the rear one is then 1 m before it.
    assert sum(away for wheel, away in elsewhere if wheel == 1) >= 20
    assert not any(away for wheel, away in elsewhere if wheel == 0)
