# SPDX-License-Identifier: Apache-2.0
"""A long text file says the same as its rows do in short ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements, MeasurementsError

HEADER = ["run", "load [N]", "diameter [mm]", "width [mm]", "slip [%]", "sinkage [mm]"]
ROWS = [
    [f"{i // 3 + 1:02d}", f"{40 + i % 7:.2f}", "275", "100.5", f"{i % 40}.25", f"{8 + i % 11:.3f}"]
    for i in range(400)
]


def plain(row: list[str]) -> str:
    return ",".join(row)


def german(row: list[str]) -> str:
    return ";".join(cell.replace(".", ",") for cell in row)


def quoted(row: list[str]) -> str:
    return ",".join(f'"{cell.replace(".", ",")}"' for cell in row)


def read(folder: Path, lines: list[str], end: str = "\n") -> Measurements:
    path = folder / "a.csv"
    path.write_bytes((end.join(lines) + end).encode())
    return read_measurements(path)


def columns(table: Measurements) -> list[list[object]]:
    c = table.conditions
    numbers = (c.load, c.diameter, c.width, c["slip"], table.channels["sinkage"])
    return [table.run.tolist(), *(np.round(n, 12).tolist() for n in numbers)]


WITH_GAPS = [[*row[:5], "n/a" if i % 5 == 1 else row[5]] for i, row in enumerate(ROWS)]


@pytest.mark.parametrize("rows", [ROWS, WITH_GAPS], ids=["full", "with gaps"])
@pytest.mark.parametrize("written", [plain, german, quoted])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_long_file_reads_as_its_parts(
    tmp_path: Path, rows: list[list[str]], written: object, end: str
) -> None:
    assert callable(written)
    head = ["Rig 7", written(HEADER), written([""] * 6)]
    long = columns(read(tmp_path, [*head, *map(written, rows)], end))
    parts = [columns(read(tmp_path, [*head, *map(written, rows[i : i + 50])], end))
             for i in range(0, 400, 50)]  # fmt: skip
    for at, column in enumerate(long):
        np.testing.assert_array_equal(column, [v for part in parts for v in part[at]])
    assert long[0][0] == "01"


@pytest.mark.parametrize("row", [3, 250, 400])
def test_what_is_wrong_far_below_is_said_with_its_line(tmp_path: Path, row: int) -> None:
    lines = [plain(HEADER), *map(plain, ROWS)]
    lines[row] = "9,27o,275,100,10,8.5"
    with pytest.raises(MeasurementsError, match=rf"line {row + 1}, column 'load': '27o'"):
        read(tmp_path, lines)
    lines[row] = "9,60,275,100,10"
    with pytest.raises(MeasurementsError, match=f"line {row + 1}: 5 cells, expected 6"):
        read(tmp_path, lines)
    lines[row] = "9,60,275,100,10,8.5,7"
    with pytest.raises(MeasurementsError, match=f"line {row + 1}: 7 cells, expected 6"):
        read(tmp_path, lines)
    lines[row] = "9,inf,275,100,10,8.5"
    with pytest.raises(MeasurementsError, match=rf"line {row + 1}, column 'load': inf found"):
        read(tmp_path, lines)


@pytest.mark.parametrize("row", [250, 400])
@pytest.mark.parametrize("other", ["# new sand", "Mittelwert,43,275,100.5,20,12", ",,,,,", ""])
def test_what_is_no_measurement_is_left_out_far_below(tmp_path: Path, row: int, other: str) -> None:
    lines = [plain(HEADER), *map(plain, ROWS)]
    lines.insert(row, other)
    found = read(tmp_path, lines)
    assert len(found) == 400
    assert found.line[row - 1] == row + 2


def test_marks_that_a_long_file_mixes_are_refused(tmp_path: Path) -> None:
    lines = [german(HEADER), *map(german, ROWS)]
    lines[300] = lines[300].replace("100,5", "100.5")
    with pytest.raises(
        MeasurementsError, match=r"line 301.*'100.5' .*decimal points and decimal commas"
    ):
        read(tmp_path, lines)
    lines = [german([*HEADER, "x"]), *(f"{german(row)};1.234" for row in ROWS)]
    assert "two ways" in "; ".join(read(tmp_path, lines).warnings)  # the column is nobody's


def test_a_long_file_may_have_marks_of_thousands(tmp_path: Path) -> None:
    lines = [german(HEADER), *(german(row).replace(";4", ";1.04", 1) for row in ROWS)]
    assert read(tmp_path, lines).conditions.load[0] == 1040.0
