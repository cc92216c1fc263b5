# SPDX-License-Identifier: Apache-2.0
"""Rows that were computed from those above are left out in any language, and no measurement is."""

from __future__ import annotations

from pathlib import Path

import made_tables as made
import numpy as np
import pytest

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements, MeasurementsError

MOST_LOST = 1 / 400  # of tables
FEWEST_FOUND = 0.9  # of means and deviations with a name of their own

HEADER = "run,load [N],diameter [mm],width [mm],slip [%],sinkage [mm]\n"
ROWS = [("a", 60.0, 8.9), ("a", 60.5, 8.5), ("a", 61.5, 9.1), ("b", 80.5, 11.2), ("b", 79.0, 11.0)]
ROWS += [("b", 80.0, 11.6)]
TEXT = HEADER + "".join(f"{r},{w},275,100,10,{z}\n" for r, w, z in ROWS)


def read(folder: Path, text: str) -> Measurements:
    path = folder / "a.csv"
    path.write_text(text, encoding="utf-8")
    return read_measurements(path)


@pytest.mark.parametrize("seeds", [400, pytest.param(2000, marks=pytest.mark.slow)])
def test_no_measurement_of_made_tables_is_taken_for_a_statistic(tmp_path: Path, seeds: int) -> None:
    """Tables of eight structures and five kinds of names; a third end in their own centre."""
    lost, tables = [], 0
    for seed in range(seeds):
        cells, grid, kind = made.measured(seed)
        data = read(tmp_path, made.text(cells, kind != "none"))
        tables += 1
        # Rows without noise that say the same to the last digit may count once, and that is reported.
        if len(data) < len({tuple(row[1:]) for row in cells}):
            lost.append((seed, grid, kind))
    assert len(lost) <= MOST_LOST * tables, lost


@pytest.mark.parametrize("language", made.LABELS)
def test_means_and_deviations_of_any_language_are_left_out(tmp_path: Path, language: str) -> None:
    found = tables = 0
    for seed in range(0, 600, 7):
        cells, _, kind = made.measured(seed)
        if len(cells) < 3 or kind in ("none", "words", "letters"):
            continue
        x = np.array([[float(c) for c in row[1:]] for row in cells])
        digits = [max(len(c.partition(".")[2]) for c in column) for column in x.astype(str).T]
        rows = [
            [label, *(f"{v:.{d + 1}f}" for v, d in zip(values, digits, strict=True))]
            for label, values in zip(
                made.LABELS[language], (x.mean(axis=0), x.std(axis=0, ddof=1)), strict=True
            )
        ]
        tables += 1
        try:
            found += len(read(tmp_path, made.text([*cells, *rows], True))) == len(cells)
        except MeasurementsError as error:  # a deviation of 0 below a table in which nothing varies
            found += made.LABELS[language][1] in str(error)
    assert tables > 20
    assert found >= FEWEST_FOUND * tables


@pytest.mark.parametrize("label", [mean for mean, _ in made.LABELS.values()])
@pytest.mark.parametrize("gap", ["", "\n", ",,,,,\n\n"])
def test_a_mean_is_left_out_and_said_with_line_and_first_cell(
    tmp_path: Path, label: str, gap: str
) -> None:
    data = read(tmp_path, f"{TEXT}{gap}{label},70.25,275,100,10,10.05\n")
    line = 8 + gap.count("\n")
    assert len(data) == 6
    assert any(said.startswith(f"row {line} '{label}' is ") for said in data.understood)


def test_statistics_below_each_block_are_of_that_block(tmp_path: Path) -> None:
    one = "Zörgl,60.67,275,100,10,8.833\nBlapf,0.764,0,0,0,0.306\n"
    other = "Zörgl,79.83,275,100,10,11.267\nBlapf,0.764,0,0,0,0.306\n"
    lines = TEXT.splitlines(keepends=True)
    data = read(tmp_path, "".join([*lines[:4], one, "\n", *lines[4:], other]))
    assert data.line.tolist() == [2, 3, 4, 8, 9, 10]
    assert sum("the mean of the 3 rows above" in said for said in data.understood) == 2
    assert (
        sum("the standard deviation of the 3 rows above" in said for said in data.understood) == 2
    )


@pytest.mark.parametrize(
    "rows",
    [
        "c,70,275,100,10,10\n",  # near the mean
        "b,70.25,275,100,10,10.05\n",  # the mean itself, of a run that is there
        "c,60,275,100,10,8.9\n",  # the first row again
        "c,61.5,275,100,10,11.6\nc,60,275,100,10,8.5\n",
    ],
)
def test_a_measurement_that_is_like_a_statistic_is_kept(tmp_path: Path, rows: str) -> None:
    assert len(read(tmp_path, TEXT + rows)) == 6 + rows.count("\n")


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_equal_rows_are_kept(tmp_path: Path, count: int) -> None:
    rows = [f"{run},60,275,100,10,8.5\n" for run in "aabbccdd"[:count]]
    assert len(read(tmp_path, HEADER + "".join(rows))) == count


def test_a_row_of_a_statistic_that_is_wrong_is_refused_with_its_first_cell(tmp_path: Path) -> None:
    with pytest.raises(MeasurementsError, match=r"line 8, column 'diameter'.*begins with 'Zörgl'"):
        read(tmp_path, f"{TEXT}Zörgl,75,,100,10,10\n")


def test_each_fault_of_a_column_is_named_in_one_answer(tmp_path: Path) -> None:
    """A word, a blank, a value out of range and a wheel below its axle, all in two columns."""
    rows = ["a,x,275,100,10,8.5", "b,,275,100,10,-3", "c,-5,275,100,10,500", "d,60,275,100,10,?!"]
    with pytest.raises(MeasurementsError) as caught:
        read(tmp_path, HEADER + "\n".join(rows) + "\n")
    found = str(caught.value).splitlines()[1:]
    for line, name, column, words in (
        (2, "a", "load", "'x' found"),
        (3, "b", "load", "blank"),
        (4, "c", "load", "load is -5 N"),
        (3, "b", "sinkage", "sinkage is -3 mm"),
        (4, "c", "sinkage", "at most 0.1375 m"),
        (5, "d", "sinkage", "'?!' found"),
    ):
        at = f"line {line}, column '{column}': "
        assert any(
            at in one and words in one and one.endswith(f"begins with '{name}'") for one in found
        ), words
    assert len(found) == 6
