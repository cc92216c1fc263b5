# SPDX-License-Identifier: Apache-2.0
"""Headers in languages never seen: refused, or left as columns of the user's own; never another quantity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import unknown_tables as unknown

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements, MeasurementsError

SI = {"mm": 1e-3, "%": 0.01}
NEEDED = ("load", "diameter", "width")


def unit_of(table: unknown.Table, quantity: str) -> str:
    return "" if "none, SI" in table.name else unknown.UNITS[quantity]


def assert_right(table: unknown.Table, data: Measurements) -> None:
    """Each quantity that was read has the numbers of its own column."""
    lines = [line.split(";") for line in table.text.splitlines()]
    body = lines[2:] if "row" in table.name else lines[1:]
    assert len(data) == len(body), table.name
    read = data.columns()
    for quantity in (*NEEDED, "slip", "sinkage", "resistance", "drawbar_pull", "torque"):
        if quantity in read:
            assert quantity in table.truth, (table.name, quantity)
            column = lines[0].index(table.truth[quantity])
            truth = np.array([float(row[column]) for row in body])
            factor = SI.get(unit_of(table, quantity), 1.0)
            np.testing.assert_allclose(
                read[quantity], factor * truth, rtol=1e-9, err_msg=table.name
            )


@pytest.mark.parametrize("first", [0, 1000, 2000, 3000, 4000])
def test_no_made_table_is_read_wrong_in_silence(tmp_path: Path, first: int) -> None:
    """44 tables in twelve languages; then with the loads, sizes and depths named by --map."""
    path, read, mapped = tmp_path / "table.csv", 0, 0
    for table in unknown.tables(first):
        path.write_text(table.text, encoding="utf-8")
        try:
            assert_right(table, read_measurements(path))
            read += 1
        except MeasurementsError:
            pass
        names = [n for n in (*NEEDED, "sinkage") if n in table.truth]
        units = {n: unit_of(table, n) for n in names}
        given = {f"{n} [{units[n]}]" if units[n] else n: table.truth[n] for n in names}
        try:
            assert_right(table, read_measurements(path, map=given))
            mapped += 1
        except MeasurementsError:  # a further header that is nearly a word of ours
            continue
    assert mapped > 30
    assert read < mapped


@pytest.mark.parametrize("header", ["F_N [kg]", "F_N (kg)", "Fz [kg]", "weight [kg]", "weight_kg"])
def test_a_load_in_kg_is_the_weight_of_that_mass(tmp_path: Path, header: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header},diameter [mm],width [mm],sinkage [mm]\n6,275,100,8\n")
    data = read_measurements(path)
    assert data.conditions.load[0] == pytest.approx(6 * 9.80665, rel=1e-12)
    assert f"'{header}' -> load [kg], the weight of that mass" in data.understood


@pytest.mark.parametrize("header", ["F_N", "Fz", "weight", "load", "load_N"])
@pytest.mark.parametrize("row", ["(kg)", "(N)", "(kN)"])
def test_a_given_map_wins_over_header_and_row_of_units(
    tmp_path: Path, header: str, row: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header},diameter,width,sinkage\n{row},(mm),(mm),(mm)\n6,275,100,8\n")
    data = read_measurements(path, map={"load [kg]": header})
    assert data.conditions.load[0] == pytest.approx(6 * 9.80665, rel=1e-12)
    others = {row.strip("()"), *(["N"] if header == "load_N" else [])} - {"kg"}
    said = [line for line in data.understood if "as --map says" in line]
    assert said == (
        [f"'{header}' is in kg, as --map says, not in {' or '.join(sorted(others))}"]
        if others
        else []
    )


def test_units_that_differ_are_refused_with_the_map_that_decides(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("load,diameter [cm],width,sinkage\n(kg),(mm),(mm),(mm)\n6,27.5,100,8\n")
    with pytest.raises(MeasurementsError) as caught:
        read_measurements(path)
    assert "differ: say which with --map 'diameter [mm]=diameter [cm]'" in str(caught.value)
    assert "no column" not in str(caught.value)
    data = read_measurements(path, map={"diameter [cm]": "diameter [cm]"})
    assert data.conditions.diameter.tolist() == [0.275]


def test_a_bare_f_n_may_be_a_force_in_newtons_and_is_not_guessed(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("F_N,diameter [mm],width [mm],sinkage [mm]\n60,275,100,8\n")
    with pytest.raises(MeasurementsError, match="no column 'load'"):
        read_measurements(path)
    assert read_measurements(path, map={"load": "F_N"}).conditions.load.tolist() == [60.0]


def test_a_word_among_codes_that_is_no_exact_mean_is_read_with_a_warning(tmp_path: Path) -> None:
    rows = "".join(f"r{i},60,275,100,{8 + i}\n" for i in range(6))
    path = tmp_path / "a.csv"
    path.write_text(
        f"run,load [N],diameter [mm],width [mm],sinkage [mm]\n{rows}Zörgl,60,275,100,9.9\n"
    )
    data = read_measurements(path)
    assert len(data) == 7
    assert any(w.startswith("row 8 has the name 'Zörgl'") for w in data.warnings)
