# SPDX-License-Identifier: Apache-2.0
"""Several sheets of a workbook are one table, and merged cells of an ods stand for those below them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import messy_tables as messy
import pytest
from click.testing import CliRunner

import smallwheel_ros as sw
from smallwheel_ros.cli import main
from smallwheel_ros.measurements.from_file import read_tests
from smallwheel_ros.measurements.measurements import MeasurementsError, ShearTests

Sheet = list[list[messy.Cell]]
HEADER: list[messy.Cell] = [*messy.ENGLISH]
DRY: Sheet = [HEADER, ["1", 60.0, 275.0, 100.0, 10.0, 8.5], ["2", 80.0, 275.0, 100.0, 20.0, 11.0]]
WET: Sheet = [HEADER, ["1", 60.0, 275.0, 100.0, 10.0, 12.5], ["7", 90.0, 275.0, 100.0, 20.0, 19.0]]


@pytest.mark.parametrize("made", [messy.xlsx, messy.ods])
def test_two_sheets_are_one_table(tmp_path: Path, made: Callable[..., bytes]) -> None:
    path = tmp_path / "lab.book"
    path.write_bytes(made(dry=DRY, notes=[["x"]], wet=WET))
    data = sw.read(path, sheet=["dry", "wet"])
    assert data.run.tolist() == ["dry 1", "dry 2", "wet 1", "wet 7"]
    assert data.channels["sinkage"].tolist() == [0.0085, 0.011, 0.0125, 0.019]
    assert any("'1' is 'dry 1'" in line for line in data.understood)
    assert data.understood[0] == "rows of the sheets 'dry' and 'wet', one after the other"
    one = sw.read(path, sheet="dry")
    assert (data.source, data.sha256) == (one.source, one.sha256)
    assert sw.read(path, sheet=[3, "1"]).run.tolist() == ["wet 1", "wet 7", "dry 1", "dry 2"]


def test_names_that_differ_stay_and_units_may_differ(tmp_path: Path) -> None:
    path = tmp_path / "lab.xlsx"
    metres = [
        [*HEADER[:5], "Einsinkung (m)", "remark"],
        ["3", 60.0, 275.0, 100.0, 10.0, 0.0125, "wet"],
    ]
    path.write_bytes(messy.xlsx(dry=DRY, wet=metres))
    data = sw.read(path, sheet=["dry", "wet"])
    assert data.run.tolist() == ["1", "2", "3"]
    assert data.channels["sinkage"].tolist() == [0.0085, 0.011, 0.0125]
    assert not any("different runs" in line for line in data.understood)


def test_sheets_are_named_on_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "lab.xlsx"
    path.write_bytes(messy.xlsx(dry=DRY, wet=WET))
    found = CliRunner().invoke(main, ["fit", str(path), "--sheet", "dry", "--sheet", "2"])
    assert found.exit_code == 0, found.output
    assert "rows of the sheets 'dry' and 'wet'" in found.stderr
    assert "'1' is 'dry 1'" in found.stderr


def test_sheets_of_different_columns_are_refused_with_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "lab.xlsx"
    torque: Sheet = [["Run", "Torque (Nm)"], ["1", 0.5]]
    path.write_bytes(messy.xlsx(dry=DRY, torque=torque, wet=WET))
    with pytest.raises(MeasurementsError) as caught:
        sw.read(path, sheet=["dry", "torque"])
    for words in (
        f"{path}: sheets 'dry' and 'torque' have different columns: only 'dry' has diameter, load, ",
        "only 'torque' has torque",
        "Columns of one run that stand on several sheets have to be brought side by side",
        "XLOOKUP",
    ):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("sheets", "words"),
    [
        (["dry", "1"], "sheet 'dry' is given twice"),
        (["dry", "clay"], "no sheet 'clay', there is: 'dry', 'wet'"),
        (["dry", "wet"], "lab.xlsx, sheet 'wet', row 3, column 'Load (N)': 'x' found"),
    ],
)
def test_what_is_wrong_is_said_with_its_sheet(
    tmp_path: Path, sheets: list[str], words: str
) -> None:
    path = tmp_path / "lab.xlsx"
    path.write_bytes(messy.xlsx(dry=DRY, wet=[*WET[:2], ["8", "x", *WET[2][2:]]]))
    with pytest.raises(MeasurementsError) as caught:
        sw.read(path, sheet=sheets)
    assert words in str(caught.value)


def test_merged_cells_of_an_ods_are_filled_by_name_and_refused_of_a_size(tmp_path: Path) -> None:
    """calamine does not give them: a run that is named once stands for the blanks below it, a size not."""
    rows: Sheet = [HEADER, *([*row] for row in messy.TRUTH)]
    path = tmp_path / "lab.ods"
    path.write_bytes(messy.ods({(1, 0): 2, (3, 0): 2}, lab=rows))
    data = sw.read(path)
    assert data.run.tolist() == ["a", "a", "b", "b"]
    assert sum("filled from above" in line for line in data.understood) == 1
    path.write_bytes(messy.ods({(1, 0): 2, (1, 2): 4, (3, 0): 2}, lab=rows))
    with pytest.raises(MeasurementsError, match=r"column 'Diameter \(mm\)': the cell is blank"):
        sw.read(path)


def test_a_text_file_has_no_sheets(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(messy.text(messy.ENGLISH))
    with pytest.raises(MeasurementsError, match="this is no workbook"):
        sw.read(path, sheet=["a", "b"])


def test_shear_tests_of_two_sheets(tmp_path: Path) -> None:
    def sheet(stress: float) -> Sheet:
        rows: Sheet = [[stress, 2.0 * i, 0.5 * i] for i in range(1, 6)]
        return [["normal_stress [kPa]", "shear_stress [kPa]", "shear_displacement [mm]"], *rows]

    path = tmp_path / "box.xlsx"
    path.write_bytes(messy.xlsx(a=sheet(10.0), b=sheet(20.0), c=DRY))
    found = read_tests(path, sheet=["a", "b"])
    assert isinstance(found, ShearTests)
    assert found.run.tolist() == ["a test 1"] * 5 + ["b test 1"] * 5
