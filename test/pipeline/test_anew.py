# SPDX-License-Identifier: Apache-2.0
"""What a sensor has taught that was wrong from the beginning is dropped once it is found to be."""

from __future__ import annotations

import numpy as np
import pytest
from rows_of_drives import SECOND, Row, drive, rover, run
from world_drives import driven_world

from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.soil.local_law import Version
from smallwheel_ros.pipeline.soil.stretches import Stretches, StretchState, stretches
from smallwheel_ros.pipeline.strength.steps import StepState, steps
from smallwheel_ros.pipeline.strength.two_filters import Strengths

DRIVE = driven_world("traction", "cruise; balance and torque", "short", 2)
ANEW = int(np.quantile(DRIVE.rows.stamp, 0.4)) + 1


def soils_of(settings: OnboardSettings) -> Soils:
    return Soils(
        settings.prior, settings.estimator, settings.effects, settings.wheels, settings.mass
    )


def strengths_of(settings: OnboardSettings) -> Strengths:
    rolling = np.flatnonzero([wheel.contact == ROLLING for wheel in settings.wheels])
    return Strengths(settings.strength, settings.wheels, rolling, settings.mass)


def believed(anew: tuple[int, ...], since: int = 0) -> tuple[Soils, Strengths, np.ndarray]:
    """Soils and strengths over the drive; the version at each row. since: ns, earlier ones are not told."""
    rows, settings = DRIVE.rows, DRIVE.settings
    closed, loads = stretches(StretchState.of(settings), rows, settings)
    assert closed is not None
    told: Stretches = closed.take(closed.end > since)
    soils, strengths = soils_of(settings), strengths_of(settings)
    version, _ = soils.take(told, rows, anew)
    made = steps(StepState(), rows, loads.load, loads.load_std, version, soils, settings)
    assert made is not None
    strengths.take(made, anew)
    return soils, strengths, version


def laws(one: Version) -> np.ndarray:
    return np.concatenate([one.mean, one.covariance.ravel(), one.law, np.array(one.scatter)])


def test_a_soil_that_begins_anew_is_as_one_that_heard_nothing_before() -> None:
    soils, strengths, version = believed((ANEW,))
    fresh, _, _ = believed((), since=ANEW)
    np.testing.assert_array_equal(laws(soils.versions.newest), laws(fresh.versions.newest))
    assert soils.accepted == fresh.accepted
    assert soils.versions.newest.number != fresh.versions.newest.number, "another soil"
    # Rows up to then are of what was believed then, those behind it of nothing until a stretch has closed.
    stamp = DRIVE.rows.stamp
    begun = version[stamp > ANEW][0]
    assert (version[stamp <= ANEW] < begun).all()
    assert (version[stamp > ANEW] >= begun).all()
    without, told, _ = believed(())
    assert without.accepted > soils.accepted
    assert told.steps > strengths.steps > 0


@pytest.mark.parametrize("before", [-SECOND, 0])
def test_a_stamp_counts_once_and_one_that_has_not_come_does_not(before: int) -> None:
    last = int(DRIVE.rows.stamp[-1])
    soils, _, _ = believed((last - before,))
    assert soils.accepted == believed(())[0].accepted
    twice, _, _ = believed((ANEW, ANEW))
    np.testing.assert_array_equal(
        laws(twice.versions.newest), laws(believed((ANEW,))[0].versions.newest)
    )


def in_millimetres(rows: list[Row], wheel: str, factor: float = 1e3) -> list[Row]:
    return [
        (name, stamp, (factor * values[0], *values[1:]), now)
        if name == f"{wheel}/sinkage"
        else (name, stamp, values, now)
        for name, stamp, values, now in rows
    ]


def test_what_millimetres_have_taught_does_not_stay() -> None:
    rows, vehicle = drive(30.0), rover()
    wrong, right = Pipeline(vehicle.onboard), Pipeline(vehicle.onboard)
    _, estimates = run(vehicle, in_millimetres(rows, "fl"), pipeline=wrong)
    run(vehicle, rows, pipeline=right)
    (found,) = wrong.checks.rules.anew
    assert "what the soil has learnt until then is dropped" in wrong.findings[0]
    soil, good = wrong.soil, right.soil
    assert abs(soil.log_pressure - good.log_pressure) < 0.1
    # The wheel itself has a place in the soil of the others: its sinkage is what they show.
    later = (estimates.stamp > found + 3 * SECOND) & (estimates.wheel == 0)
    assert np.median(estimates.sinkage[later]) == pytest.approx(0.012, rel=0.2)


def test_nothing_begins_anew_where_all_cells_are_off_alike() -> None:
    """The filter has weighed the vehicle: n and m are as they would be, and the pressure is unsure."""
    rows, vehicle = drive(20.0), rover(**{"vehicle.mass": 30.0})
    pipeline = Pipeline(vehicle.onboard)
    run(vehicle, rows, pipeline=pipeline)
    assert any("times the weight" in text for text in pipeline.findings)
    assert not pipeline.checks.rules.anew
    assert pipeline.soil.accepted
