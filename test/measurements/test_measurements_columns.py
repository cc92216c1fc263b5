# SPDX-License-Identifier: Apache-2.0
"""The one table of columns: units, ranges, and which columns the wheel answers with.

Tests `columns.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.measurements.columns import (
    CHANNEL_UNITS,
    CHANNELS,
    COLUMNS,
    SETTINGS,
    is_bookkeeping,
    is_response,
    to_base,
    unit_of,
)
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import MeasurementsError
from smallwheel_ros.measurements.settings import order_columns, set_columns

GOOD = {"load": "60", "diameter": "0.2", "width": "0.1", "sinkage": "0.01", "slip": "0.1"}


def write(path: Path, **cells: str) -> Path:
    plain = ",".join([*GOOD, *(name for name in cells if name not in GOOD)])
    extra = ["0.01" if name == "grouser_height" else "1" for name in cells if name not in GOOD]
    first = ",".join([*GOOD.values(), *extra])
    second = ",".join((GOOD | cells).values())
    path.write_text(f"{plain}\n{first}\n{second}\n")
    return path


def test_units() -> None:
    assert CHANNEL_UNITS == {
        "sinkage": "m",
        "resistance": "N",
        "drawbar_pull": "N",
        "torque": "N m",
    }
    assert tuple(CHANNEL_UNITS) == CHANNELS
    assert [unit_of(n) for n in ("load", "slip", "slope", "speed")] == ["N", "1", "rad", "m/s"]
    assert unit_of("moisture") == ""
    assert all(unit_of(name) for name in SETTINGS)


@pytest.mark.parametrize("name", COLUMNS)
def test_each_unit_of_the_table_is_one_that_values_are_held_in(name: str) -> None:
    spec = COLUMNS[name]
    assert to_base(np.ones(1), spec.unit, spec.unit).tolist() == [1.0]
    assert not spec.bad(np.array([spec.low, spec.high, np.nan])).any()
    assert spec.bad(np.array([-np.inf, np.inf])).all()


@pytest.mark.parametrize("value", ["1e300", "-1e300", "1e13"])
@pytest.mark.parametrize("name", COLUMNS)
def test_an_absurd_number_is_refused_with_its_place(tmp_path: Path, name: str, value: str) -> None:
    path = write(tmp_path / "a.csv", **{name: value})
    with pytest.raises(MeasurementsError) as caught:
        read_measurements(path)
    place = (
        f"{path}, line 3, column '{name}': {name} is {value}, expected {COLUMNS[name].expected()}"
    )
    assert str(caught.value).startswith(place)


@pytest.mark.parametrize("value", ["1e300", "-1e300", "1e13", "inf"])
def test_a_column_that_nobody_needs_is_left_out_and_never_refuses(
    tmp_path: Path, value: str
) -> None:
    found = read_measurements(write(tmp_path / "a.csv", temperature=value))
    assert "temperature" not in found.conditions
    assert "column 'temperature' is left out, and not needed: line 3" in "; ".join(found.warnings)
    asked = {"temperature": "temperature"}
    with pytest.raises(MeasurementsError, match="line 3, column 'temperature'"):
        read_measurements(tmp_path / "a.csv", map=asked)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("begin", [0.0, 1_765_274_443.0])
def test_a_time_in_any_unit_is_the_order_of_the_rows(
    tmp_path: Path, unit: float, begin: float
) -> None:
    rows = [f"{unit * (begin + 7 * i):.0f},{20 + i},0.2,0.1,0.01{i}" for i in range(5)]
    (tmp_path / "a.csv").write_text("\n".join(["timestamp,load,diameter,width,sinkage", *rows]))
    found = read_measurements(tmp_path / "a.csv")
    assert order_columns(found) == ("timestamp",)
    assert (np.diff(found.conditions["timestamp"]) > 0.0).all()


def test_rows_that_were_left_out_are_counted_first(tmp_path: Path) -> None:
    rows = [
        f"R{i},{20 + i},0.2,0.1,{0.01 + 0.001 * (k + i):.4f}" for i in range(1, 13) for k in (0, 1)
    ]
    lines = []
    for i in range(0, 24, 2):
        both = [float(row.split(",")[-1]) for row in rows[i : i + 2]]
        load = rows[i].split(",")[1]
        lines += [*rows[i : i + 2], f"mean,{load},0.2,0.1,{sum(both) / 2:.5f}"]
    (tmp_path / "a.csv").write_text("\n".join(["run,load,diameter,width,sinkage", *lines]))
    found = read_measurements(tmp_path / "a.csv")
    assert (len(found), len(found.runs)) == (24, 12)
    assert found.understood[0] == "24 of 36 rows kept"


def test_a_diameter_under_the_width_is_said(tmp_path: Path) -> None:
    found = read_measurements(write(tmp_path / "a.csv", diameter="0.1", width="0.2"))
    assert "the diameter is under the width in line 3: a roller of 100 mm" in "; ".join(
        found.warnings
    )


@pytest.mark.parametrize("name", ["load", "diameter", "width", "sinkage_std", "resistance_std"])
def test_a_number_too_small_to_be_real_is_refused(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "a.csv", **{"resistance": "3", name: "1e-320"})
    with pytest.raises(MeasurementsError, match=f"column '{name}': {name} is 1e-320, expected"):
        read_measurements(path)


@pytest.mark.parametrize("name", ["sinkage", "slip", "speed", "slope", "temperature"])
def test_where_zero_is_allowed_a_number_near_it_is_zero(tmp_path: Path, name: str) -> None:
    data = read_measurements(write(tmp_path / "a.csv", **{name: "1e-320"}))
    values = data.channels[name] if name in CHANNELS else data.conditions[name]
    assert values[1] == 0.0
    assert any(f"column '{name}': 1 numbers under 1e-30" in note for note in data.notes)


@pytest.mark.parametrize("header", ["load [MN]", "load [N]"])
def test_a_unit_that_makes_a_number_absurd_or_infinite(tmp_path: Path, header: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header},diameter,width,sinkage\n1e308,0.2,0.1,0.01\n")
    with pytest.raises(MeasurementsError, match=r"load is 1e308 .*expected 0\.001 to 1000000 N"):
        read_measurements(path)


def test_millimetres_without_a_unit_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", diameter="275")
    with pytest.raises(MeasurementsError, match=r"for mm the header is 'diameter \[mm\]'"):
        read_measurements(path)


# What the wheel answers


@pytest.mark.parametrize(
    ("header", "response"),
    [
        ("motor torque [N m]", True),
        ("motor_torque [Nm]", True),
        ("t1 [N m]", True),
        ("steering_moment", True),
        ("side_force", True),
        ("fy [N]", True),
        ("motor_current [A]", True),
        ("motor current", True),
        ("contact_pressure [kPa]", True),
        ("drive_power [W]", True),
        ("energy [J]", True),
        ("rut_depth [mm]", True),
        ("tyre_pressure [kPa]", False),
        ("inflation_pressure [bar]", False),
        ("cone_index [kPa]", False),
        ("axle_load [N]", False),
        ("moisture", False),
        ("temperature [degC]", False),
        ("speed [m/s]", False),
        ("slip", False),
        ("density [kg/m^3]", False),
    ],
)
def test_a_force_torque_or_power_is_an_answer_of_the_wheel(
    tmp_path: Path, header: str, response: bool
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"load,diameter,width,sinkage,{header}\n60,0.2,0.1,0.01,0.5\n")
    data = read_measurements(path)
    name = header.split(" [")[0]
    assert data.responses == ((name,) if response else ())
    assert any("responses of the wheel" in note for note in data.notes) == response
    if "torque" in header:
        assert data.units[name] == "N m"


@pytest.mark.parametrize(
    ("header", "value"),
    [
        ("torque", 0.5),
        ("torque [N m]", 0.5),
        ("Drehmoment (Nm)", 0.5),
        ("couple [N.mm]", 0.5e-3),
        ("wheel torque / kNm", 500.0),
    ],
)
def test_the_torque_of_the_axle_is_measured_and_no_setting(
    tmp_path: Path, header: str, value: float
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"load,diameter,width,slip,{header},torque_std [Nm]\n60,0.2,0.1,0.1,0.5,0.02\n")
    data = read_measurements(path)
    assert tuple(data.channels) == ("torque",)
    assert data.channels["torque"] == pytest.approx(value)
    assert data.declared_std["torque"] == pytest.approx(0.02)
    assert data.units["torque"] == "N m"
    assert data.responses == ()
    assert not any("torque" in name for name in set_columns(data))


@pytest.mark.parametrize("unit", ["%", "A", "N", "V", "kW"])
def test_a_torque_in_another_unit_is_refused_with_what_to_do(tmp_path: Path, unit: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"load,diameter,width,slip,torque [{unit}]\n60,0.2,0.1,0.1,0.5\n")
    with pytest.raises(MeasurementsError) as caught:
        read_measurements(path)
    said = str(caught.value)
    assert said.startswith(f"{path}, line 1, column 'torque': unit '{unit}' is ")
    assert (
        "expected a torque (N m); if the column is no torque on the wheel's axle, give it" in said
    )


# What no wheel can have


def test_lugs_higher_than_the_radius_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "60,0.2,0.1,0.01,99\n60,0.2,0.1,0.01,101\n60,0.3,0.1,0.01,160\n"
    path.write_text(f"load,diameter,width,sinkage,grouser_height [mm]\n{rows}")
    with pytest.raises(MeasurementsError) as caught:
        read_measurements(path)
    assert str(caught.value) == (
        f"{path}, line 3, column 'grouser_height': grouser_height is 101 mm (0.101 in SI), "
        "expected at most 0.1 m, the wheel's radius: is the unit right? (and 1 more like it: line 4)"
        "; the row begins with '60'"
    )


@given(st.text("xyz_ 0", max_size=20), st.sampled_from(["", "1", "m", "s", "K"]))
def test_the_columns_of_the_contract_are_what_they_are(name: str, unit: str) -> None:
    assert not any(is_response(known, "N") for known in COLUMNS if known not in CHANNELS)
    assert not any(is_bookkeeping(known) for known in COLUMNS)
    assert is_response(name + "_torque", unit)


def test_time_and_trial_say_which_row_it_is() -> None:
    assert all(is_bookkeeping(name) for name in ("t", "trial", "stamp", "test_no"))
    assert not any(is_bookkeeping(name) for name in ("moisture", "note", "speed", "grain_size"))
    assert not any(is_bookkeeping(name) for name in ("rest_time", "cone_index", "time_in_box"))
    assert is_bookkeeping("soil_sample_id")
