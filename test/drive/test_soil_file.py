# SPDX-License-Identifier: Apache-2.0
"""What node and replay do with a drive: say what happens, lay it down as ground, save it, go on from it.

Tests `events.py`, `ground_map.py` and `statements.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rows_of_drives import START, drive, rover
from test_messages import turned

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.drive.events import DriveEvents
from smallwheel_ros.drive.ground_map import GroundMapper
from smallwheel_ros.drive.soil_file import SoilFile
from smallwheel_ros.drive.statements import Statement, alarms, statements
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import Estimates

SETTINGS = rover()
Driven = tuple[Pipeline, list[Turn], Estimates]


@pytest.fixture(scope="module")
def driven() -> Driven:
    return turned(SETTINGS, drive(20.0))


def mapped(found: Estimates) -> CostMap:
    ground = CostMap(SETTINGS.cost, SETTINGS.onboard.wheels)
    GroundMapper(ground, SETTINGS.onboard.wheels).add(found, "odom")
    return ground


def test_a_soil_is_saved_with_its_map_and_gone_on_from(driven: Driven, tmp_path: Path) -> None:
    pipeline, _, found = driven
    file, ground = SoilFile(str(tmp_path / "soil.json")), mapped(found)
    assert file.restore(Pipeline(SETTINGS.onboard)) == ""  # there is none yet
    saved, words = file.save(pipeline, ground)
    assert saved, words
    again, other = Pipeline(SETTINGS.onboard), CostMap(SETTINGS.cost, SETTINGS.onboard.wheels)
    assert f"{pipeline.soil.accepted} measurements" in file.restore(again)
    assert again.soil.k == pytest.approx(pipeline.soil.k, rel=1e-9)
    assert "cost map restored" in file.restore_map(other)
    one, two = ground.whole(), other.remembered
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.cells, two.cells)


def test_what_is_no_saved_soil_is_said_and_nothing_is_lost(driven: Driven, tmp_path: Path) -> None:
    path = tmp_path / "soil.json"
    path.write_text("{")
    file, pipeline = SoilFile(str(path)), Pipeline(SETTINGS.onboard)
    assert file.restore(pipeline) == ""
    assert "the saved soil is not used" in file.problem
    assert pipeline.soil.accepted == 0
    ground = CostMap(SETTINGS.cost, SETTINGS.onboard.wheels)
    assert not file.save(driven[0], ground)[0]
    assert path.read_text() == "{"
    assert SoilFile("").save(driven[0], ground) == (
        False,
        "nothing saved: parameter soil.file is empty: set the file to save to",
    )


def test_ground_lies_where_the_wheels_were(driven: Driven) -> None:
    grids = mapped(driven[2]).grids()
    assert grids is not None
    grid = grids.bare
    known = np.argwhere(grid.cells >= 0) * grid.resolution + np.flip(grid.origin)
    way = driven[2].x[np.isfinite(driven[2].x)]
    assert known[:, 1].min() < way.min() + 0.1
    assert known[:, 1].max() > way.max() - 0.1
    assert CostMap(SETTINGS.cost, SETTINGS.onboard.wheels).grids() is None


def test_a_drive_without_events_has_none_and_a_good_one_nothing_to_say(driven: Driven) -> None:
    pipeline, turns, found = driven
    events = DriveEvents(pipeline, START)
    for turn in turns:
        events.take(turn)
    events.finish()
    assert events.events == []
    assert events.travel == pytest.approx(float(turns[-1].readings.distance.max()))
    newest = events.newest
    assert sorted(newest.wheel.tolist()) == [0, 1, 2, 3]
    assert newest.stamp.min() > found.stamp.max() - 10**9
    assert alarms(pipeline) == statements(pipeline, newest) == ()


def test_a_mirrored_joint_is_one_event_of_sensors() -> None:
    rows = [
        (name, stamp, (-values[0],) if name == "fl/wheel_speed" else values, now)
        for name, stamp, values, now in drive(30.0, noise=0.03, wave=0.5)
    ]
    pipeline, turns, _ = turned(SETTINGS, rows)
    events = DriveEvents(pipeline, START)
    for turn in turns:
        events.take(turn)
    (event,) = [one for one in events.events if one.kind == "sensor"]
    assert "fl" in event.text
    assert statements(pipeline, events.newest)[-1].entry == "sensors"


def test_what_a_statement_is_about_does_not_change_with_its_numbers() -> None:
    one, two = (Statement("sensors", "sensor", False, f"late by {n} s") for n in (0.12, 1e-3))
    assert one.about == two.about
