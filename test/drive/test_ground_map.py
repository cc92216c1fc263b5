# SPDX-License-Identifier: Apache-2.0
"""What estimates become on the ground: seen or expected, and what ground has shown that was crossed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rows_of_drives import drive, give, static_rover

from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.drive.ground_map import GroundMapper, cost_map_of, with_margin_of_class
from smallwheel_ros.pipeline.intake.layout import widths_of
from smallwheel_ros.pipeline.mobility.status import Condition, Status
from smallwheel_ros.pipeline.mobility.vehicle import (
    ANY_GROUND,
    MEASURED,
    OF_CLASS,
    VehicleEstimates,
)
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates

VEHICLE = static_rover()


@pytest.fixture(scope="module")
def crossed() -> Estimates:
    """Estimates of 3 m over ground on which it slips by a tenth."""
    pipeline = Pipeline(VEHICLE.onboard)
    known = set(widths_of(VEHICLE.onboard))
    give(pipeline.streams, [row for row in drive(soil=False) if row[0] in known])
    return Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)])


def test_where_nothing_is_known_the_margin_is_that_of_the_terrain_class() -> None:
    """Ice holds a tenth, grass a half; what was measured stands."""
    settings = static_rover(**{"terrain.names": ["grass", "ice"]})
    ground = cost_map_of(settings)
    ground.frame = "odom"
    pipeline = Pipeline(settings.onboard)
    known = set(widths_of(settings.onboard))
    give(pipeline.streams, [row for row in drive(soil=False) if row[0] in known])
    turns = list(pipeline.turns(last=True))
    newest = Estimates.joined([turn.estimates for turn in turns])
    rows = VehicleEstimates.joined([turn.vehicle for turn in turns])
    rows = replace(rows, margin_source=np.where(rows.stamp % 2 == 0, ANY_GROUND, MEASURED))
    assert with_margin_of_class(rows, ground, newest) is rows  # no grid of classes
    for number, holds in ((0, 0.5), (1, 0.1)):
        cells = np.full((400, 400), number, dtype=np.int8)
        ground.ahead.take_classes(Grid("odom", 0.1, (-20.0, -20.0), cells))
        found = with_margin_of_class(rows, ground, newest)
        prior = rows.margin_source == ANY_GROUND
        assert prior.any()
        assert set(found.margin_source[prior].tolist()) == {OF_CLASS}
        assert abs(found.margin[prior] - holds).max() < 0.2
        np.testing.assert_array_equal(found.margin[~prior], rows.margin[~prior])
    ground.ahead.take_classes(Grid("map", 0.1, (-20.0, -20.0), cells))
    assert with_margin_of_class(rows, ground, newest) is rows  # nobody knows where that is


def bare(rows: Estimates, **columns: np.ndarray) -> Grid:
    """The map after rows, some of their columns replaced, without the vehicle on it."""
    mapper = GroundMapper(cost_map_of(VEHICLE), VEHICLE.onboard.wheels)
    mapper.add(replace(rows, **columns), "odom")
    mapper.map._pose = None
    grids = mapper.map.grids()
    assert grids is not None
    return grids.bare


def in_the_end(rows: Estimates, value: object, otherwise: object) -> np.ndarray:
    """A column that has a value from 2 m on."""
    return np.where(rows.distance > 2.0, value, otherwise)


def test_good_ground_is_free(crossed: Estimates) -> None:
    assert set(np.unique(bare(crossed).cells).tolist()) == {-1, 0}


def test_a_wheel_that_the_law_says_is_sunk_is_feared_and_one_that_is_measured_so_is_seen(
    crossed: Estimates,
) -> None:
    sunk = in_the_end(crossed, int(Status.SUNK_TO_AXLE), crossed.status)
    assert bare(crossed, status=sunk).cells.max() == 99
    depth = in_the_end(crossed, 0.14, np.nan)
    spread = np.full(len(crossed), 0.005)
    assert bare(crossed, sinkage_measured=depth, sinkage_measured_std=spread).cells.max() == 100
    unsure = np.full(len(crossed), 0.02)
    assert bare(crossed, sinkage_measured=depth, sinkage_measured_std=unsure).cells.max() == 0


def test_a_warning_is_a_grade(crossed: Estimates) -> None:
    first = in_the_end(crossed, crossed.conditions | Condition.WARNED, crossed.conditions)
    assert bare(crossed, conditions=first).cells.max() == 50
    second = in_the_end(crossed, True, False).astype(bool)
    assert bare(crossed, conditions=first, digging_in=second).cells.max() == 90
    assert bare(crossed, spins=second).cells.max() == 100


def test_ground_that_it_got_over_has_shown_what_was_asked_for(crossed: Estimates) -> None:
    """A margin that is hardly known: on the level a risk of 40 %; P(margin < 0 | margin > -0.06) is 16 %."""
    count = len(crossed)
    poor = {"margin_median": np.full(count, 0.05), "margin_lower_std": np.full(count, 0.2)}
    level = np.zeros(count)
    tilt = {"demand": level, "tilt": level}
    assert bare(crossed, **poor, **tilt).cells.max() == 16
    unshown = bare(crossed, **poor, **tilt, slip=np.full(count, np.nan))
    assert unshown.cells.max() == 40
    slipped = bare(crossed, **poor, **tilt, slip=np.full(count, 0.6))
    assert slipped.cells.max() == 40
    # A slope that was driven down has shown little for a way up.
    down = {"demand": np.full(count, -0.1), "tilt": np.full(count, 0.1)}
    assert bare(crossed, **poor, **down).cells.max() >= 40


def test_who_stands_learns_nothing_new(crossed: Estimates) -> None:
    count = len(crossed)
    poor = {"margin_median": np.full(count, 0.05), "margin_lower_std": np.full(count, 0.2)}
    poor |= {"demand": np.zeros(count), "tilt": np.zeros(count)}
    halts = in_the_end(crossed, True, False).astype(bool)
    conditions = np.where(halts, crossed.conditions | Condition.STANDS, crossed.conditions)
    slip = np.where(halts, np.nan, crossed.slip)
    assert bare(crossed, **poor, conditions=conditions, slip=slip).cells.max() == 16
