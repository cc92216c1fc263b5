# SPDX-License-Identifier: Apache-2.0
"""The tables and robot descriptions of the shared cases, each with what is right.

The bags of the cases are made by their kind in `test_bags_of_others.py`, the tables of cases/bench in
`test_copies.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import smallwheel_ros as sw
from smallwheel_ros.cli import main

N = 0.9  # of the plates
SIX = {f"{row}_{side}" for row in ("front", "middle", "rear") for side in ("left", "right")}
FOUR = {name for name in SIX if "middle" not in name}


@pytest.fixture(scope="module")
def cases(shared_data: Path) -> Path:
    folder = shared_data.parent / "cases/tables_and_bags"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


@pytest.mark.parametrize("table", ["plates_clean", "plates_spikes", "plates_free_travel"])
def test_plates_have_their_exponent(cases: Path, table: str) -> None:
    data = sw.read(cases / f"{table}.csv")
    found = sw.fit(data)
    assert abs(found["n"].value - N) < 2 * found["n"].std
    said = "; ".join(data.understood)
    assert ("begin before the body touches" in said) == (table == "plates_free_travel")
    assert (found.fit.outliers.size > 0) == (table == "plates_spikes")


@pytest.mark.parametrize("table", ["gauge_stuck", "wheel_gauge_stuck"])
def test_a_stuck_gauge_is_named(cases: Path, table: str) -> None:
    found = sw.diagnose(cases / f"{table}.csv")
    assert "the gauge does not move" in json.dumps(found.document)
    assert found.verdict not in ("adequate", "missing_effect")


def test_a_gauge_stuck_in_one_curve_is_named(cases: Path) -> None:
    found = sw.diagnose(cases / "gauge_stuck_in_one_curve.csv")
    assert len(found.document["bad_runs"]) == 1


def test_a_column_of_mixed_decimals_is_left_out_and_reported(cases: Path) -> None:
    used = {
        "load [N]": "pressure_force_N",
        "sinkage [mm]": "pressure_pos_mm",
        "pressure_pos": "pressure_pos",
    }
    data = sw.read(cases / "mixed_decimals.csv", map=used, diameter=0.1, contact="plate")
    assert len(data) == 8
    assert "ts_host" in "; ".join((*data.understood, *data.warnings))


def test_times_of_all_units_are_the_order_of_the_runs(cases: Path) -> None:
    read = [sw.read(cases / f"time_{unit}.csv") for unit in ("s", "ms", "ns")]
    first = read[0]
    for data in read[1:]:
        np.testing.assert_allclose(data.conditions.load, first.conditions.load)
        np.testing.assert_allclose(data.channels["sinkage"], first.channels["sinkage"])
        assert [w.split("'")[0] for w in data.warnings] == [w.split("'")[0] for w in first.warnings]


def parameters(cases: Path, urdf: str, tmp_path: Path) -> tuple[dict[str, Any], str]:
    out = tmp_path / "x.yaml"
    result = CliRunner().invoke(main, ["init", str(cases / urdf), "-o", str(out)])
    assert result.exit_code == 0, result.output
    node = next(iter(yaml.safe_load(out.read_text().replace("FILL_IN", "null")).values()))
    found = node["ros__parameters"]
    every = found.get("all_wheels", {})
    return {wheel: every | (found.get(wheel) or {}) for wheel in found["wheels"]}, result.output


def test_wheels_of_meshes_have_places_and_sizes_to_fill_in(cases: Path, tmp_path: Path) -> None:
    wheels, said = parameters(cases, "wheels_are_meshes.urdf", tmp_path)
    assert {*wheels} == FOUR
    assert "to be filled in: all_wheels.diameter, all_wheels.width" in said
    for name, wheel in wheels.items():
        assert (wheel["longitudinal_position"] > 0.0) == ("front" in name)
        assert (wheel["lateral_position"] > 0.0) == ("left" in name)


def test_letters_of_a_side_are_told_by_what_stands_beside_them(cases: Path, tmp_path: Path) -> None:
    assert {*parameters(cases, "names_with_R.urdf", tmp_path)[0]} == SIX


def test_a_turned_base_has_its_wheels_where_they_are(cases: Path, tmp_path: Path) -> None:
    wheels, said = parameters(cases, "turned_base.urdf", tmp_path)
    front = wheels["front_left"]
    assert front["longitudinal_position"] == pytest.approx(0.23, abs=0.01)
    assert front["lateral_position"] == pytest.approx(0.16, abs=0.01)
    assert "base_link is turned" in said
