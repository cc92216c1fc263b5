# SPDX-License-Identifier: Apache-2.0
"""What estimates become on the ground: seen or expected, and what ground has shown that was crossed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rows_of_drives import drive, give, static_rover

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.grid import Grid
from smallwheel_ros.drive.ground_map import GroundMapper, cost_map_of
from smallwheel_ros.pipeline.intake.layout import widths_of
from smallwheel_ros.pipeline.mobility.status import Condition, MarginSource, Status
from smallwheel_ros.pipeline.mobility.vehicle import (
    VehicleEstimates,
)
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.pipeline.warning.hazard import PERIOD

VEHICLE = static_rover()


@pytest.fixture(scope="module")
def crossed() -> Estimates:
    """Estimates of 3 m over ground on which it slips by a tenth."""
    pipeline = Pipeline(VEHICLE.onboard)
    known = set(widths_of(VEHICLE.onboard))
    give(pipeline.streams, [row for row in drive(soil=False) if row[0] in known])
    return Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)])


ICE_AHEAD = 1.5  # m along the way: grass up to there, ice from there on


def classes(frame: str = "odom") -> Grid:
    """Grass, number 0, and ice, number 1."""
    cells = np.zeros((400, 400), dtype=np.int8)
    cells[:, 200 + round(10.0 * ICE_AHEAD) :] = 1
    return Grid(frame, 0.1, (-20.0, -20.0), cells)


@pytest.fixture(scope="module")
def turns() -> list[tuple[Estimates, VehicleEstimates]]:
    """Turns of a second each; every second row of the vehicle has a margin that was measured."""
    pipeline = Pipeline(VEHICLE.onboard)
    known = set(widths_of(VEHICLE.onboard))
    give(pipeline.streams, [row for row in drive(soil=False) if row[0] in known])
    made = []
    for turn in pipeline.turns(last=True, span=SECOND):
        rows = turn.vehicle
        prior = rows.stamp // PERIOD % 2 == 0
        source = np.where(prior, MarginSource.ANY_GROUND, MarginSource.MEASURED)
        made.append((turn.estimates, replace(rows, margin_source=source)))
    return made


def with_classes(
    turns: list[tuple[Estimates, VehicleEstimates]], grid: Grid | None
) -> VehicleEstimates:
    settings = static_rover(**{"terrain.names": ["grass", "ice"]})
    mapper = GroundMapper(cost_map_of(settings), settings.onboard.wheels)
    if grid is not None:
        mapper.map.take_classes(grid)
    return VehicleEstimates.joined([mapper.take(*turn, "odom") for turn in turns])


def test_where_nothing_is_known_the_margin_is_that_of_the_terrain_class_there(
    turns: list[tuple[Estimates, VehicleEstimates]],
) -> None:
    """Ice holds a tenth, grass a half, each row's own place counts; what was measured stands."""
    before = VehicleEstimates.joined([rows for _, rows in turns])
    estimates = Estimates.joined([rows for rows, _ in turns])
    found = with_classes(turns, classes())
    prior = before.margin_source == MarginSource.ANY_GROUND
    newest = np.searchsorted(estimates.stamp, before.stamp, side="left") - 1
    placed = prior & (newest >= 0)
    on_ice = estimates.x[newest] >= ICE_AHEAD
    for there, holds in ((placed & ~on_ice, 0.5), (placed & on_ice, 0.1)):
        assert there.any()
        assert set(found.margin_source[there].tolist()) == {MarginSource.CLASS}
        assert abs(found.margin[there] - holds).max() < 0.2
        assert (found.information[there] > 0.5).all()  # a class tells more than any ground
    for name in ("margin", "margin_std", "margin_source", "information"):
        kept = getattr(found, name)[~prior], getattr(before, name)[~prior]
        np.testing.assert_array_equal(*kept)
    assert set(found.margin_source[placed].tolist()) == {MarginSource.CLASS}


def test_cuts_do_not_matter_for_the_margin_of_a_class(
    turns: list[tuple[Estimates, VehicleEstimates]],
) -> None:
    parts = (
        Estimates.joined([one for one, _ in turns]),
        VehicleEstimates.joined([v for _, v in turns]),
    )
    whole, cut = with_classes([parts], classes()), with_classes(turns, classes())
    for name in vars(whole):
        np.testing.assert_array_equal(getattr(whole, name), getattr(cut, name), err_msg=name)


def test_without_a_class_the_margin_stays_that_of_any_ground(
    turns: list[tuple[Estimates, VehicleEstimates]],
) -> None:
    """No grid; one in a frame that nobody knows; no place; a place that is old."""
    before = VehicleEstimates.joined([rows for _, rows in turns])
    lost = [(replace(one, x=one.x + np.nan), rows) for one, rows in turns]
    later = replace(before, stamp=before.stamp + 10 * SECOND)
    old = [(Estimates.joined([one for one, _ in turns]), later.take(slice(-5, None)))]
    for given, grid, same in (
        (turns, None, before), (turns, classes("map"), before), (lost, classes(), before),
        (old, classes(), old[0][1]),
    ):  # fmt: skip
        found = with_classes(given, grid)
        np.testing.assert_array_equal(found.margin_source, same.margin_source)
        np.testing.assert_array_equal(found.margin, same.margin)


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
    poor |= {"margin_beyond": np.zeros(count)}
    level = np.zeros(count)
    tilt = {"demand": level, "tilt": level}
    assert bare(crossed, **poor, **tilt).cells.max() == 16
    unshown = bare(crossed, **poor, **tilt, slip=np.full(count, np.nan))
    assert unshown.cells.max() == 40
    # Stuck is who slips by 0.7: P(margin + 0.05 < 0).
    gains = {**poor, "margin_beyond": np.full(count, 0.05)}
    assert bare(crossed, **gains, **tilt, slip=np.full(count, np.nan)).cells.max() == 31
    slipped = bare(crossed, **poor, **tilt, slip=np.full(count, 0.6))
    assert slipped.cells.max() == 40
    # A slope that was driven down has shown little for a way up.
    down = {"demand": np.full(count, -0.1), "tilt": np.full(count, 0.1)}
    assert bare(crossed, **poor, **down).cells.max() >= 40


def test_who_stands_learns_nothing_new(crossed: Estimates) -> None:
    count = len(crossed)
    poor = {"margin_median": np.full(count, 0.05), "margin_lower_std": np.full(count, 0.2)}
    poor |= {"margin_beyond": np.zeros(count), "demand": np.zeros(count), "tilt": np.zeros(count)}
    halts = in_the_end(crossed, True, False).astype(bool)
    conditions = np.where(halts, crossed.conditions | Condition.STANDS, crossed.conditions)
    slip = np.where(halts, np.nan, crossed.slip)
    assert bare(crossed, **poor, conditions=conditions, slip=slip).cells.max() == 16
