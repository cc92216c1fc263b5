# SPDX-License-Identifier: Apache-2.0
"""Tables as outsiders have them: they read as what was measured, or say everything that is wrong."""

from __future__ import annotations

from pathlib import Path

import messy_tables as messy
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements, MeasurementsError


def read(folder: Path, content: bytes) -> Measurements:
    path = folder / "table"
    path.write_bytes(content)
    return read_measurements(path)


@pytest.mark.parametrize("name", messy.GOOD)
def test_a_table_reads_as_what_was_measured(tmp_path: Path, name: str) -> None:
    data = read(tmp_path, messy.GOOD[name])
    run, load, diameter, width, slip, sinkage = (list(c) for c in zip(*messy.TRUTH, strict=True))
    assert data.run.tolist() == run
    np.testing.assert_allclose(data.conditions.load, load, rtol=1e-5)
    np.testing.assert_allclose(data.conditions.diameter, np.array(diameter) / 1000.0)
    np.testing.assert_allclose(data.conditions.width, np.array(width) / 1000.0)
    np.testing.assert_allclose(data.conditions["slip"], np.array(slip) / 100.0)
    np.testing.assert_allclose(data.channels["sinkage"], np.array(sinkage) / 1000.0)


@pytest.mark.parametrize("name", messy.BAD)
def test_everything_that_is_wrong_is_said_at_once(tmp_path: Path, name: str) -> None:
    content, words = messy.BAD[name]
    with pytest.raises(MeasurementsError) as caught:
        read(tmp_path, content)
    for word in words:
        assert word in str(caught.value)


def test_a_sheet_and_a_column_are_chosen_on_the_command_line(tmp_path: Path) -> None:
    header = ["F3", "Diameter (mm)", "Width (mm)", "Sinkage (mm)"]
    rows: list[list[messy.Cell]] = [[0.01 * i, 275.0, 100.0, 1.4 * i] for i in range(4, 9)]
    old: list[list[messy.Cell]] = [[0.02 * i, 275.0, 100.0, 1.4 * i] for i in range(4, 9)]
    path = tmp_path / "rig.xlsx"
    path.write_bytes(messy.xlsx(Sand=[[*header], *rows], Clay=[[*header], *old]))
    run = CliRunner().invoke
    asked = ["compare", str(path)]
    refused = run(main, asked)
    assert "name one with --sheet, there is: 'Sand', 'Clay'" in refused.stderr
    refused = run(main, [*asked, "--sheet", "Clay"])
    assert "no column 'load'" in refused.stderr
    for sheet in ("clay", "2"):
        said = run(main, [*asked, "--sheet", sheet, "--map", "load [kN]=F3"])
        assert ["load", "[kN]", "0.08", "0.16", "varied"] in map(
            str.split, said.stdout.splitlines()
        )
        assert "'F3' -> load [kN]" in said.stderr


def test_a_data_frame_reads_as_its_file(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(messy.GOOD["English Excel, CSV UTF-8"])
    frame = pd.read_csv(path)
    frame.loc[1, "Sinkage (mm)"] = np.nan
    found = read_measurements(frame.set_index(frame.index + 7))
    one, other = read_measurements(path), found
    assert np.isnan(other.channels["sinkage"][1])
    np.testing.assert_array_equal(other.conditions.load, one.conditions.load)
    np.testing.assert_array_equal(other.run, one.run)
    with pytest.raises(MeasurementsError, match=r"data frame, row 3, column 'Load .N.'"):
        read_measurements(frame.astype({"Load (N)": object}).replace({"Load (N)": {80.5: "x"}}))
