# SPDX-License-Identifier: Apache-2.0
"""Tables with a row a quantity are turned; those with a row a reading are refused with that reason."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_examples import examples, settings

from smallwheel_ros.measurements.cells import MeasurementsError
from smallwheel_ros.measurements.from_file import read_measurements

HEAD = ["run", "load [N]", "diameter [mm]", "width [mm]", "sinkage [mm]"]
ROWS = [["a1", 20, 200, 80, 3.1], ["a2", 40, 200, 80, 5.1], ["a3", 60, 250, 80, 7.1]]


def read(tmp_path, text: str, **how):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    return read_measurements(path, **how)


def written(rows: list[list[object]], by: str = ",") -> str:
    return "".join(by.join(map(str, row)) + "\n" for row in rows)


@pytest.mark.parametrize("title", ["", "Wheel trial 7\n\n", "# raked\n"])
def test_a_table_that_is_turned_is_the_table(tmp_path, title: str) -> None:
    plain = read(tmp_path, title + written([HEAD, *ROWS]))
    turned = [list(column) for column in zip(HEAD, *ROWS, strict=True)]
    data = read(tmp_path, title + written(turned))
    for name in ("load", "diameter", "width"):
        np.testing.assert_array_equal(
            getattr(data.conditions, name), getattr(plain.conditions, name)
        )
    np.testing.assert_array_equal(data.channels["sinkage"], plain.channels["sinkage"])
    assert data.run.tolist() == ["a1", "a2", "a3"]
    assert "the first column names the quantities: read as a table that is turned" in (
        data.understood
    )
    turned[4][2] = "5.1x"
    with pytest.raises(MeasurementsError, match="column 3, column 'sinkage"):
        read(tmp_path, title + written(turned))


def test_units_in_the_second_column_and_runs_above(tmp_path) -> None:
    text = ",unit,1,2,3\nload,N,20,40,60\ndiameter,mm,200,200,200\nsinkage,mm,3.1,5.1,7.1\n"
    data = read(tmp_path, text, contact="plate")
    np.testing.assert_allclose(data.channels["sinkage"], [0.0031, 0.0051, 0.0071])
    assert data.run.tolist() == ["1", "2", "3"]


@settings(max_examples=examples(60))
@given(
    st.lists(st.sampled_from("bisrpvzWD") | st.text("abcxyz", min_size=3), min_size=2, max_size=9)
)
def test_a_table_that_stands_upright_is_not_turned(tmp_path_factory, runs: list[str]) -> None:
    tmp_path = tmp_path_factory.mktemp("upright")
    data = read(
        tmp_path, written([HEAD, *([run, *ROWS[0][1:4], i] for i, run in enumerate(runs, 1))])
    )
    assert data.run.tolist() == runs


LONG = """VarName;TimeString;VarValue;Validity
{0};28.11.2026 10:00:00;20,1;1
{1};28.11.2026 10:00:00;3,1;1
{0};28.11.2026 10:00:01;40,1;1
{1};28.11.2026 10:00:01;5,1;1
"""


@pytest.mark.parametrize("names", [("Radlast", "Einsinkung"), ("DB_Mess.Kraft", "DB_Mess.Weg")])
def test_a_row_a_reading_is_said_and_how_to_pivot_it(tmp_path, names: tuple[str, str]) -> None:
    with pytest.raises(
        MeasurementsError, match="it has one row a reading: column 'VarName'"
    ) as error:
        read(tmp_path, LONG.format(*names))
    said = str(error.value)
    assert "values='VarValue'" in said
    assert "no column 'load'" not in said
    assert all(name in said for name in names)


def test_a_label_beside_columns_that_are_missing_is_no_row_a_reading(tmp_path) -> None:
    text = "site;operator;depth_mm\nN;Meier;3\nS;Meier;4\nN;Huber;5\nS;Huber;6\n"
    with pytest.raises(MeasurementsError, match="no column 'load'") as error:
        read(tmp_path, text)
    assert "one row a reading" not in str(error.value)


def test_two_gauges_are_named_where_none_is_the_sinkage(tmp_path) -> None:
    rows = [[*row[:4], row[4], row[4]] for row in ROWS]
    head = [*HEAD[:4], "sinkage left [mm]", "sinkage right [mm]"]
    with pytest.raises(MeasurementsError, match="their mean is one sinkage, or say which is it"):
        read(tmp_path, written([head, *rows]))
    with pytest.raises(MeasurementsError, match="nothing was measured") as error:
        read(tmp_path, written([[*HEAD[:4], "sinkage left [mm]", "tilt"], *rows]))
    assert "their mean" not in str(error.value)
    data = read(tmp_path, written([head, *rows]), map={"sinkage": "sinkage right [mm]"})
    assert "sinkage" in data.channels
