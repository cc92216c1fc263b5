# SPDX-License-Identifier: Apache-2.0
"""Soil and map saved by themselves: when, as one pair, and never over what is worth more."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
from rows_of_drives import drive, rover
from test_messages import turned
from test_soil_file import mapped

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.drive.autosave import Autosave
from smallwheel_ros.drive.soil_file import SoilFile
from smallwheel_ros.pipeline.pipeline import Pipeline

SETTINGS = rover()
Driven = tuple[Pipeline, CostMap]


@pytest.fixture(scope="module")
def shorter() -> Driven:
    pipeline, _, found = turned(SETTINGS, drive(12.0))
    return pipeline, mapped(found)


@pytest.fixture(scope="module")
def longer() -> Driven:
    pipeline, _, found = turned(SETTINGS, drive(20.0))
    return pipeline, mapped(found)


def known(path: Path) -> tuple[int, str]:
    """Measurements, and what came of the map, of a new start from a file."""
    file, pipeline = SoilFile(str(path)), Pipeline(SETTINGS.onboard)
    file.restore(pipeline)
    assert file.problem == ""
    return pipeline.soil.accepted, file.restore_map(CostMap(SETTINGS.cost, SETTINGS.onboard.wheels))


def test_what_changed_is_saved_and_what_did_not_is_left(
    shorter: Driven, longer: Driven, tmp_path: Path
) -> None:
    path = tmp_path / "soil.json"
    autosave = Autosave(SoilFile(str(path)))
    autosave.finish(Pipeline(SETTINGS.onboard), CostMap(SETTINGS.cost, SETTINGS.onboard.wheels))
    assert not path.exists()  # nothing was measured
    autosave.finish(*shorter)
    accepted, said = known(path)
    assert accepted == shorter[0].soil.accepted
    assert said.startswith("cost map restored")
    written = path.stat().st_mtime_ns
    autosave.finish(*shorter)
    assert path.stat().st_mtime_ns == written
    autosave.finish(*longer)
    assert known(path)[0] == longer[0].soil.accepted > accepted
    assert (autosave.problem, autosave.failures, autosave.held) == ("", 0, "")


def test_it_is_written_while_turns_go_on(shorter: Driven, longer: Driven, tmp_path: Path) -> None:
    path = tmp_path / "soil.json"
    autosave = Autosave(SoilFile(str(path)))
    autosave.begin(*shorter)
    autosave.begin(*longer)  # comes to nothing where the first is still being written
    autosave.finish(*longer)
    assert known(path)[0] == longer[0].soil.accepted


def test_what_is_killed_between_map_and_soil_leaves_a_pair(
    shorter: Driven, longer: Driven, tmp_path: Path
) -> None:
    path = tmp_path / "soil.json"
    autosave = Autosave(SoilFile(str(path)))
    autosave.finish(*shorter)
    old = path.read_bytes()
    autosave.finish(*longer)
    path.write_bytes(old)  # the map had its new name, the soil not yet
    for _ in range(2):
        accepted, said = known(path)
        assert accepted == shorter[0].soil.accepted
        assert said.startswith("cost map restored")
        assert "before" in said
        # Who goes on from there and is killed at the same place finds the same pair.
        again = SoilFile(str(path))
        again.restore(Pipeline(SETTINGS.onboard))
        again.save(*longer)
        path.write_bytes(old)


def test_a_map_of_another_soil_is_not_used_and_the_soil_is(
    shorter: Driven, longer: Driven, tmp_path: Path
) -> None:
    path, other = tmp_path / "soil.json", tmp_path / "other.json"
    Autosave(SoilFile(str(path))).finish(*shorter)
    Autosave(SoilFile(str(other))).finish(*longer)
    # As after a kill between the two, or where somebody copied one of them.
    path.write_bytes(other.read_bytes())
    accepted, said = known(path)
    assert accepted == longer[0].soil.accepted
    assert "the saved cost map is not used" in said
    assert "the soil is used alone" in said


def test_a_map_of_somebody_else_is_left_as_it_is(shorter: Driven, tmp_path: Path) -> None:
    path, precious = tmp_path / "soil.json", tmp_path / "soil.json.cost_map.pgm"
    precious.write_text("precious")
    saved, words = SoilFile(str(path)).save(*shorter)
    assert saved
    assert "the cost map is not saved" in words
    assert precious.read_text() == "precious"
    assert known(path) == (shorter[0].soil.accepted, "")


def test_a_file_of_another_prior_is_left_as_it_is(shorter: Driven, tmp_path: Path) -> None:
    path = tmp_path / "soil.json"
    Autosave(SoilFile(str(path))).finish(*shorter)
    saved = path.read_bytes()
    another = rover(**{"soil.name": "wong_snow"})
    file, pipeline = SoilFile(str(path)), Pipeline(another.onboard)
    file.restore(pipeline)
    assert "saved under another prior" in file.problem
    autosave = Autosave(file)
    assert "left as it is" in autosave.held
    autosave.finish(*shorter)
    assert path.read_bytes() == saved


def test_after_a_defect_nothing_is_saved_until_somebody_says_so(
    shorter: Driven, longer: Driven, tmp_path: Path
) -> None:
    path = tmp_path / "soil.json"
    autosave = Autosave(SoilFile(str(path)))
    autosave.finish(*longer)
    autosave.hold("a turn failed")
    autosave.finish(*shorter)
    assert known(path)[0] == longer[0].soil.accepted
    autosave.go_on()
    autosave.finish(*shorter)
    assert known(path)[0] == shorter[0].soil.accepted


def tried_twice(file: Path, driven: Driven) -> Autosave:
    """An autosave that could not write, and says so."""
    autosave = Autosave(SoilFile(str(file)))
    for failures in (1, 2):
        autosave.finish(*driven)
        assert autosave.failures == failures
        assert autosave.problem.startswith("nothing saved: ")
        assert str(file) in autosave.problem
    return autosave


def test_a_disc_that_is_full_keeps_what_was_saved(
    shorter: Driven, longer: Driven, tmp_path: Path
) -> None:
    path = tmp_path / "soil.json"
    Autosave(SoilFile(str(path))).finish(*shorter)
    saved, beside = path.read_bytes(), sorted(tmp_path.iterdir())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # A file can grow no more, as on a disc without room, whoever writes it.
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(saved) // 2, limits[1]))
    try:
        tried_twice(path, longer)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == saved
    assert sorted(tmp_path.iterdir()) == beside  # no draft is left
    accepted, said = known(path)
    assert accepted == shorter[0].soil.accepted
    assert said.startswith("cost map restored")


def test_a_folder_that_is_none_is_said_until_it_is_one(shorter: Driven, tmp_path: Path) -> None:
    path = tmp_path / "card" / "soil.json"
    path.parent.write_text("x")
    autosave = tried_twice(path, shorter)
    path.parent.unlink()
    autosave.finish(*shorter)
    assert autosave.problem == ""
    assert known(path)[0] == shorter[0].soil.accepted
