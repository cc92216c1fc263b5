# SPDX-License-Identifier: Apache-2.0
"""Runs that stand in a table twice are reported and counted once; repeats that are alike by chance are kept.

Also `suspicions.py`: settings that follow the order of the rows, and numbers that have two readings.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from smallwheel_ros.measurements.from_file import read_conditions, read_measurements


def table(digits: int = 2, seed: int = 0) -> pd.DataFrame:
    """24 runs: eight settings, each measured three times, in random order."""
    rng = np.random.default_rng(seed)
    load, slip = np.tile([20.0, 45.0, 80.0, 120.0], 6), np.repeat(np.tile([0.1, 0.3], 3), 4)
    sinkage = 0.4 * load**0.8 * np.exp(slip + rng.normal(0.0, 0.03, 24))
    frame = pd.DataFrame({
        "run": [f"r{i}" for i in range(24)], "load [N]": load, "diameter [mm]": 200, "width [mm]": 100,
        "slip": slip, "sinkage [mm]": np.round(sinkage, digits), "resistance [N]": np.round(0.2 * load, 1),
    })  # fmt: skip
    return frame.sample(frac=1.0, random_state=seed, ignore_index=True)


def renamed(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    return frame.assign(run=[f"{name}{run}" for run in frame["run"]])


@pytest.mark.parametrize("how", ["new names", "the same names", "some", "in another order"])
def test_pasted_rows_count_once_and_are_reported(how: str) -> None:
    frame = table()
    again = frame.iloc[5:17] if how == "some" else frame
    again = again.iloc[::-1] if how == "in another order" else again
    again = again if how == "the same names" else renamed(again, "x")
    data = read_measurements(pd.concat([frame, again], ignore_index=True))
    assert len(data) == 24
    assert data.run.tolist() == frame["run"].tolist()
    assert data.understood[0] == f"24 of {24 + len(again)} rows kept"
    (said,) = (words for words in data.warnings if "copies" in words)
    assert said.startswith(f"{len(again)} rows, in {len(again)} runs, are copies of others")


def test_a_column_that_numbers_the_rows_hides_no_copy() -> None:
    frame = pd.concat([table(), renamed(table(), "x")], ignore_index=True)
    frame.insert(0, "no", range(1, 49))
    assert len(read_measurements(frame)) == 24


def test_copies_without_a_column_of_runs() -> None:
    frame = pd.concat([table(), table()], ignore_index=True).drop(columns="run")
    assert len(read_measurements(frame)) == 24


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("digits", [0, 1, 2])
def test_repeats_that_read_alike_by_chance_are_kept(digits: int, seed: int) -> None:
    data = read_measurements(table(digits, seed).drop(columns="resistance [N]"))
    assert len(data) == 24
    assert not any("copies" in words for words in data.warnings)


def test_a_gauge_that_shows_one_number_makes_no_copies() -> None:
    data = read_measurements(table().assign(**{"sinkage [mm]": 7.25, "resistance [N]": 3.0}))
    assert len(data) == 24


def test_rows_to_be_predicted_are_all_wanted() -> None:
    frame = pd.concat([table(), renamed(table(), "x")], ignore_index=True)
    assert len(read_conditions(frame)) == 48


def notes_of_order(frame: pd.DataFrame) -> list[str]:
    return [note for note in read_measurements(frame).notes if "drift of soil" in note]


def test_a_setting_that_follows_the_order_is_reported() -> None:
    assert notes_of_order(table()) == []
    (said,) = notes_of_order(table().sort_values("slip", kind="stable"))
    assert said.startswith("slip follows the order of the rows: if runs were made in this order")


def test_where_times_are_known_they_are_the_order() -> None:
    ordered = table().sort_values("slip", kind="stable", ignore_index=True)
    mixed = ordered.assign(**{"time [s]": np.random.default_rng(1).permutation(24) * 60.0})
    assert notes_of_order(mixed) == []
    timed = ordered.assign(**{"time [s]": np.arange(24) * 60.0}).sample(frac=1.0, random_state=3)
    (said,) = notes_of_order(timed)
    assert said.startswith("slip followed the time (time) throughout")


def test_loads_that_may_be_kilonewtons_have_both_readings() -> None:
    frame = table().assign(**{"load [N]": table()["load [N]"] / 1e3})
    (said,) = (words for words in read_measurements(frame).warnings if words.startswith("load is"))
    assert "0.02 to 0.12 N, 1 to 6 Pa" in said
    assert "0.02 to 0.12 kN, 1 to 6 kPa" in said
    for good in (table(), frame.rename(columns={"load [N]": "load [kN]"})):
        assert not any("load is" in words for words in read_measurements(good).warnings)


def test_a_diameter_under_the_width_has_both_readings() -> None:
    frame = table().assign(**{"diameter [mm]": 100, "width [mm]": 200})
    (said,) = (w for w in read_measurements(frame).warnings if "interchanged" in w)
    assert "a roller of 100 mm, 200 mm wide, or a wheel of 200 mm, 100 mm wide" in said


@pytest.mark.parametrize(
    ("file", "rows"), [("dups_newnames.csv", (24, 48)), ("mean_rows_R10.csv", (24, 36))]
)
def test_tables_of_others_have_their_rows(
    shared_data: Path, file: str, rows: tuple[int, int]
) -> None:
    path = shared_data.parent / "cases/bench" / file
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    data = read_measurements(path)
    assert len(data) == rows[0]
    assert data.understood[0] == f"{rows[0]} of {rows[1]} rows kept"
