# SPDX-License-Identifier: Apache-2.0
"""Tests `cells.py`, `from_file.py`, `layout.py` and `reading.py`."""

from __future__ import annotations

import builtins
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements, MeasurementsError

SHARED = Path(os.environ.get("SMALLWHEEL_SHARED", Path(__file__).parents[3] / "shared"))
RIG = SHARED / "data" / "cmu_wheel_rig"

HEADER = "load [N],diameter [m],width [m],sinkage [mm],slip"
ROW = "60,0.2,0.1,8,0.1"
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def _write(*lines: str, name: str = "rig.csv") -> Path:
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return _write


def fault(path: Path | str, **sizes: Any) -> str:
    with pytest.raises(MeasurementsError) as caught:
        read_measurements(path, **sizes)
    message = str(caught.value)
    assert message.startswith(str(path))
    message = message.partition("\n  By units")[0]  # the line that is offered, where one is
    assert "\n" not in message
    return message


# What is read


def test_every_column_arrives_in_si_units(write: Write) -> None:
    path = write(
        "run,soil,wheel,load [kN],diameter [mm],width [cm],sinkage [mm],sinkage_std [mm],"
        "resistance [N],slip [%],slip_angle [deg],speed [mm/s],pass_number,moisture,note",
        "a,sand,big,0.06,200,10,8,0.5,12.5,20,90,100,1,0.03,dry day",
        "a,sand,big,0.06,200,10,8.5,,,-20,0,100,2,0.04,rain",
        "b,loam,big,0.08,200,10,9,0.5,13.5,0,0,100,1,0.05,rain",
    )
    data = read_measurements(path)
    assert len(data) == 3
    np.testing.assert_allclose(data.conditions.load, [60.0, 60.0, 80.0])
    np.testing.assert_allclose(data.conditions.diameter, 0.2)
    np.testing.assert_allclose(data.conditions.width, 0.1)
    np.testing.assert_allclose(data.channels["sinkage"], [0.008, 0.0085, 0.009])
    np.testing.assert_allclose(data.channels["resistance"], [12.5, np.nan, 13.5])
    np.testing.assert_allclose(data.declared_std["sinkage"], [0.0005, np.nan, 0.0005])
    np.testing.assert_allclose(data.conditions["slip"], [0.2, -0.2, 0.0])
    np.testing.assert_allclose(data.conditions["slip_angle"], [np.pi / 2, 0.0, 0.0])
    np.testing.assert_allclose(data.conditions["speed"], 0.1)
    np.testing.assert_allclose(data.conditions["moisture"], [0.03, 0.04, 0.05])
    assert set(data.conditions.covariates) == {
        "slip",
        "slip_angle",
        "speed",
        "pass_number",
        "moisture",
    }
    assert data.run.tolist() == ["a", "a", "b"]
    assert data.runs.tolist() == ["a", "b"]
    assert data.runs_given
    assert data.soil.tolist() == ["sand", "sand", "loam"]
    assert data.wheel.tolist() == ["big"] * 3
    assert data.labels["note"].tolist() == ["dry day", "rain", "rain"]
    assert data.units["sinkage"] == "m"
    assert data.units["slip_angle"] == "rad"
    assert data.units["moisture"] == ""
    assert data.line.tolist() == [2, 3, 4]
    assert data.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert data.channel_rows("resistance").tolist() == [0, 2]
    assert data.channel_rows("drawbar_pull").size == 0
    assert data.warnings == ()


def test_take_keeps_every_column_in_step(write: Write) -> None:
    data = read_measurements(
        write("run,load,diameter,width,sinkage,slip,note", *(
            f"r{i},{10 + i},0.2,0.1,{0.001 * i},{0.1 * i},n{i}" for i in range(5)
        ))
    )  # fmt: skip
    part = data.take(np.array([3, 1]))
    assert part.run.tolist() == ["r3", "r1"]
    assert part.conditions.load.tolist() == [13.0, 11.0]
    assert part.channels["sinkage"].tolist() == [0.003, 0.001]
    assert part.conditions["slip"].tolist() == pytest.approx([0.3, 0.1])
    assert part.labels["note"].tolist() == ["n3", "n1"]
    assert part.line.tolist() == [5, 3]
    assert len(data.take(data.conditions.load > 12)) == 2


def test_sizes_may_be_given_once_for_all_rows(write: Write) -> None:
    data = read_measurements(write("load,sinkage", "60,0.008", "70,0.009"), diameter=0.2, width=0.1)
    assert data.conditions.diameter.tolist() == [0.2, 0.2]
    assert data.conditions.width.tolist() == [0.1, 0.1]


def test_without_a_run_column_rows_of_the_same_settings_are_one_run_and_that_is_said(
    write: Write,
) -> None:
    rows = ("60,0.2,0.1,8,0.1", "70,0.2,0.1,8,0.1", "60,0.2,0.1,9,0.1")
    data = read_measurements(write(HEADER, *rows))
    assert data.run.tolist() == ["line 2", "line 3", "line 2"]
    assert not data.runs_given
    assert any("2 of 3 rows repeat 1 settings" in note for note in data.notes)


def test_a_wheel_without_a_name_is_named_by_its_size(write: Write) -> None:
    data = read_measurements(write(HEADER, ROW, "60,0.3,0.1,8,0.1"))
    assert data.wheel.tolist() == ["200 mm x 100 mm", "300 mm x 100 mm"]


def test_byte_order_mark_blank_lines_and_quotes_are_tolerated(tmp_path: Path) -> None:
    path = tmp_path / "excel.csv"
    path.write_bytes(
        b'\xef\xbb\xbfload,diameter,width,sinkage,"note"\r\n\r\n60,0.2,0.1,0.008,"a, b"\r\n,,,,\r\n'
        b"\r\n70,0.2,0.1,0.009,c\r\n"
    )
    data = read_measurements(path)
    assert data.conditions.load.tolist() == [60.0, 70.0]
    assert data.line.tolist() == [3, 6]
    assert data.labels["note"].tolist() == ["a, b", "c"]


@pytest.mark.parametrize(
    "lines",
    [
        ("contact,load,diameter,sinkage", "plate,60,0.06,0.01"),
        ("contact,load,diameter,width,sinkage", "plate,60,0.06,,0.01"),
    ],
)
def test_a_table_of_plates_needs_no_width_at_all(write: Write, lines: tuple[str, ...]) -> None:
    assert np.isnan(read_measurements(write(*lines)).conditions.width).all()


def test_one_rolling_wheel_among_plates_needs_a_width(write: Write) -> None:
    lines = ("contact,load,diameter,sinkage", "plate,60,0.06,0.01", ",60,0.2,0.01")
    with pytest.raises(MeasurementsError, match="no column 'width'"):
        read_measurements(write(*lines))


def test_a_plate_needs_no_width_and_may_sink_past_half_its_diameter(write: Write) -> None:
    data = read_measurements(
        write(
            "contact,load,diameter,width,sinkage,slip,speed",
            "plate,60,0.06,,0.040,,",
            "pressed,60,0.116,0.05,0.020,,",
            ",60,0.116,0.05,0.020,0.2,0.1",
        )
    )
    assert data.conditions.contact.tolist() == ["plate", "pressed", "rolling"]
    assert np.isnan(data.conditions.width[0])
    assert not data.sunk_to_axle.any()
    # pressed straight down, it does not slip; at which speed is unknown
    np.testing.assert_array_equal(data.conditions["slip"], [0.0, 0.0, 0.2])
    np.testing.assert_array_equal(data.conditions["speed"], [np.nan, np.nan, 0.1])


def test_an_extra_column_with_gaps_is_no_covariate_and_that_is_said(write: Write) -> None:
    data = read_measurements(write(HEADER + ",moisture", ROW + ",0.1", ROW + ","))
    assert "moisture" not in data.conditions
    assert any("'moisture' is blank in 1 rolling rows" in note for note in data.notes)


def test_a_wheel_ploughed_in_sideways_is_kept_and_marked(write: Write) -> None:
    data = read_measurements(write(HEADER + ",slip_angle [deg]", "20,0.116,0.05,70,0.5,90"))
    assert data.sunk_to_axle.tolist() == [True]
    assert any("over half the diameter" in warning for warning in data.warnings)
    message = fault(write(HEADER + ",slip_angle [deg]", "20,0.116,0.05,70,0.5,10"))
    assert "half the diameter" in message


# Parquet


def frame() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "run": ["a", "a", "b"],
            "load": [60, 70, 80],
            "diameter [mm]": [200.0, 200.0, 200.0],
            "width": [0.1, 0.1, 0.1],
            "sinkage [mm]": [8.0, None, 9.0],
            "resistance": [12.0, 13.0, 14.0],
        }
    )


def test_parquet_reads_as_the_same_table_in_csv(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    frame().to_parquet(tmp_path / "a.parquet", index=False)
    frame().to_csv(tmp_path / "a.csv", index=False)
    one, other = (read_measurements(tmp_path / f"a.{kind}") for kind in ("parquet", "csv"))
    assert_same(one, other)
    assert one.line.tolist() == [1, 2, 3]


def assert_same(one: Measurements, other: Measurements) -> None:
    assert one.run.tolist() == other.run.tolist()
    assert one.wheel.tolist() == other.wheel.tolist()
    for name in ("load", "diameter", "width"):
        np.testing.assert_allclose(one.conditions[name], other.conditions[name], rtol=1e-12)
    assert one.channels.keys() == other.channels.keys()
    for name, values in one.channels.items():
        np.testing.assert_allclose(values, other.channels[name], rtol=1e-12)


def test_parquet_is_known_by_its_content_and_keeps_text_and_integers(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    table = frame()
    table["run"] = [1, 1, 2]
    table["day"] = pd.Categorical(["mon", "mon", "tue"])
    table.to_parquet(tmp_path / "a.csv", index=False)
    data = read_measurements(tmp_path / "a.csv")
    assert data.run.tolist() == ["1", "1", "2"]
    assert data.labels["day"].tolist() == ["mon", "mon", "tue"]


def test_faults_in_parquet_name_the_row(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    table = frame()
    table.loc[1, "load"] = -1
    table.to_parquet(tmp_path / "a.parquet")
    assert "row 2, column 'load': load is -1" in fault(tmp_path / "a.parquet")


def test_parquet_without_pyarrow_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PAR1....PAR1")
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.split(".")[0] == "pyarrow":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    assert "pip install 'smallwheel_ros[parquet]'" in fault(tmp_path / "a.parquet")


def test_damaged_parquet(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    frame().to_parquet(tmp_path / "a.parquet")
    data = bytearray((tmp_path / "a.parquet").read_bytes())
    (tmp_path / "cut.parquet").write_bytes(data[: len(data) // 2])
    assert "a damaged Parquet file" in fault(tmp_path / "cut.parquet")


# Faults: file, line, column, found, expected


@pytest.mark.parametrize(
    ("header", "row", "words"),
    [
        # unknown unit, wrong dimension
        ("load [Foo],diameter,width,sinkage", "60,0.2,0.1,0.01", "'load': unknown unit 'Foo'"),
        (
            "load,diameter,width,sinkage [N]",
            "60,0.2,0.1,0.01",
            "column 'sinkage': unit 'N' is a force, expected a length (m)",
        ),
        (HEADER + ",moisture [Foo]", ROW + ",1", "column 'moisture': unknown unit 'Foo'"),
        (HEADER + ",run [s]", ROW + ",1", "column 'run': unit 's' on a text"),
        # no numbers
        (HEADER, "abc,0.2,0.1,8,0.1", "line 3, column 'load': 'abc' found, expected a number"),
        (HEADER, '"1,234",0.2,0.1,8,0.1', "'1,234' found, expected a number: can be read in two ways"),
        (HEADER, "60,0.2,0.1,x,0.1", "line 3, column 'sinkage': 'x' found, expected a number"),
        (HEADER, "60,0.2,0.1,1_000,0.1", "'1_000' found, expected a number"),
        (HEADER, "E35,0.2,0.1,8,0.1", "line 3, column 'load': 'E35' found, expected a number"),
        (HEADER, '60,0.2,0.1,"8,0",",e1"', "line 3, column 'slip': ',e1' found, expected a number"),
        (HEADER, "60,0.2,0.1,nan,0.1", "line 3, column 'sinkage': nan found, expected a finite"),
        (HEADER, "inf,0.2,0.1,8,0.1", "column 'load': inf found, expected a finite number"),
        (HEADER, "60,0.2,0.1,8,-Infinity", "column 'slip': -Infinity found, expected a finite"),
        (HEADER, "1e400,0.2,0.1,8,0.1", "column 'load': 1e400 found, expected a finite number"),
        # outside of what it can be
        (HEADER, "0,0.2,0.1,8,0.1", "column 'load': load is 0 N, expected 0.001 to 1000000 N"),
        (HEADER, "-5,0.2,0.1,8,0.1", "column 'load': load is -5 N, expected 0.001 to 1000000 N"),
        (HEADER, "60,0,0.1,8,0.1", "column 'diameter': diameter is 0 m, expected 0.001 to 20 m"),
        (HEADER, "60,0.2,-0.1,8,0.1", "column 'width': width is -0.1 m, expected 0.001 to 20 m"),
        (HEADER, "60,0.2,0.1,-8,0.1", "sinkage is -8 mm (-0.008 in SI), expected 0 to 20 m"),
        (HEADER, "60,0.2,0.1,101,0.1", "expected at most 0.1 m, half the diameter"),
        (HEADER, "60,0.2,0.1,8,1.1", "column 'slip': slip is 1.1, expected -1 to 1"),
        (HEADER, "60,0.2,0.1,8,-20", "then the header is 'slip [%]'"),
        (HEADER + ",slip_angle", ROW + ",30", "then the header is 'slip_angle [deg]'"),
        (HEADER + ",speed", ROW + ",-1", "speed is -1, expected 0 to 1000 m/s"),
        (HEADER + ",pass_number", ROW + ",0", "pass_number is 0, expected 1 to 1000000"),
        (HEADER + ",sinkage_std", ROW + ",0", "sinkage_std is 0, expected 1e-09 to 20 m"),
        (HEADER + ",contact", ROW + ",flat", "'flat' found, expected one of rolling, pressed"),
        # blank where a value is needed
        (HEADER, ",0.2,0.1,8,0.1", "line 3, column 'load': the cell is blank"),
        (HEADER, "60,0.2,,8,0.1", "line 3, column 'width': the cell is blank"),
        (HEADER, "60,0.2,0.1,8,", "line 3, column 'slip': the cell is blank in a rolling row"),
        (HEADER + ",contact,soil", ROW + ",,", ""),
        # the table's shape
        (HEADER, "60,0.2,0.1", "line 3: 3 cells, expected 5 as in the header"),
        (HEADER, "60,0.2,0,1,8,0.1", "line 3: 6 cells, expected 5"),
        (HEADER, '60,0.2,0.1,8,"0.1', "not CSV"),
        (HEADER + ",Sinkage", ROW + ",.008", "two columns are named 'sinkage' ('sinkage [mm]' and 'Sink"),
        (HEADER + ",", ROW + ",8", "column 6 has no name"),
        ("60,0.2,0.1,8", ROW, "line 1: nothing but numbers, expected a header"),
        (HEADER + ",q [m", ROW + ",8", "header 'q [m': expected a name and one unit"),
        (
            "diameter,width,sinkage",
            "1,1,0.1",
            "no column 'load' (normal load on the wheel). The columns are diam",
        ),
        ("load,diameter,width,sinkge_mm", "1,1,1,0.1", "'sinkge_mm' is no known word, but nearly"),
        ("load,width,sinkage", "1,1,0.1", "no column 'diameter' (wheel diameter) and no diameter given"),
        ("load,diameter,sinkage", "1,1,0.1", "no column 'width' (wheel width) and no width given"),
        ("load,diameter,width", "1,1,1", "nothing was measured"),
        ("load,diameter,width,sinkage", "1,1,1,", "nothing was measured"),
        ("load,diameter,width,sinkage", ",1,1,0.1", "the whole column is blank"),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_place(write: Write, header: str, row: str, words: str) -> None:
    good = ROW if header.startswith(HEADER) and header.count(",") == 4 else None
    path = write(header, good, row) if good else write(header, row)
    if not words:
        assert len(read_measurements(path)) == 1
        return
    assert words in fault(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b"\n \n\n", "the file is empty"),
        (b",,\n,,\n", "nothing but empty cells"),
        (b"load,diameter,width,sinkage\n", "no rows below the header"),
        (b"load,diameter,width,sinkage\n\n,,,\n", "no rows below the header"),
        (b"\x89PNG\r\n\x1a\n123", "a PNG picture"),
        (b"PK\x03\x04xlsx", "a damaged workbook"),
        (b"\x1f\x8b\x08", "gzip"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag (use smallwheel replay)"),
        (b"\x89MCAP0\r\n", "MCAP bag"),
        (b"SQLite format 3\x00", "rosbag2"),
        (b'{"load": [1, 2]}', "looks like JSON"),
        (b"[[1, 2], [3, 4]]", "looks like JSON"),
        (b"<html><body>", "HTML or XML"),
        (b"\xff\xfe1\x00,", "not UTF-16 text as its first bytes say"),
        (b"load,a\n1,\xff\x81\n", "line 2: byte 0xff is neither UTF-8 nor Windows-1252"),
        (b"load,a\n1,\x00\n", "a binary file"),
        (b"PAR1" + b"\x01" * 100, "damaged Parquet"),
    ],
)
def test_a_file_of_another_kind_is_told_apart(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    assert words in fault(path)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    assert "no such file" in fault(tmp_path / "missing.csv")
    assert "a folder" in fault(tmp_path)
    assert "cannot be read" in fault("a\0b.csv")


@pytest.mark.parametrize("size", [0.0, -0.1, 1e-320, 1e300, float("nan"), float("inf")])
def test_a_size_given_for_all_rows_is_checked(write: Write, size: float) -> None:
    with pytest.raises(MeasurementsError, match=r"diameter given as .*, expected 0\.001 to 20 m"):
        read_measurements(write("load,width,sinkage", "60,0.1,0.01"), diameter=size)


def test_a_size_given_twice_is_refused(write: Write) -> None:
    assert "expected one of the two" in fault(write(HEADER, ROW), diameter=0.3)


# Warnings


@pytest.mark.parametrize(
    ("header", "row", "words"),
    [
        (HEADER, "60,0.2,0.1,70,0.1", "sinkage is over a third of the diameter in line 2"),
        (HEADER, "60,0.2,0.1,8,0.97", "slip is beyond ±0.95"),
        ("load,diameter [m],width [m],sinkage", "60,17,10,8", "diameter is 17 m in line 2, more than"),
        ("load,diameter,width [m],sinkage", "60,0.2,10,0.01", "width is 10 m"),
        ("load,diameter [mm],width,sinkage", "60,2,0.1,0", "diameter is 0.002 m in line 2"),
        (HEADER + ",speed", ROW + ",100", "'speed [mm/s]'"),
        (HEADER + ",resistance", ROW + ",-3", "resistance is negative"),
    ],
)  # fmt: skip
def test_what_is_only_suspicious_is_a_warning(
    write: Write, header: str, row: str, words: str
) -> None:
    warnings = read_measurements(write(header, row)).warnings
    assert any(words in warning for warning in warnings), warnings


def test_runs_that_are_no_repeats_are_a_warning(write: Write) -> None:
    curve = read_measurements(write("run," + HEADER, "a," + ROW, "a,200,0.2,0.1,20,0.1"))
    assert any("the load varies within 1 of 1 runs" in warning for warning in curve.warnings)
    wheels = read_measurements(write("run," + HEADER, "1," + ROW, "1,60,0.3,0.1,8,0.1"))
    assert any("rows of several wheels" in warning for warning in wheels.warnings)


def test_wheels_of_one_vehicle_are_no_mistake(write: Write) -> None:
    """One row of each wheel in a run: a stretch of a drive, whatever load each wheel carries."""
    header, there, far = "run,wheel," + HEADER, ",40,0.2,0.1,8,0.1", ",90,0.2,0.1,9,0.1"
    drive = read_measurements(write(header, "1,left" + there, "1,right" + far, "2,left" + there))
    assert drive.warnings == ()
    assert any("wheels of one vehicle" in note for note in drive.notes)
    # Repeats of each wheel under one name are a rig whose runs are numbered anew.
    rows = ["1,left" + there, "1,left" + there, "1,right" + far, "2,right" + far]
    rig = read_measurements(write(header, *rows))
    assert any("rows of several wheels" in warning for warning in rig.warnings)
    assert any("the load varies within 1 of 2 runs" in warning for warning in rig.warnings)
    single = read_measurements(write(header, "1,left" + there, "2,right" + far))
    assert not any("vehicle" in note for note in single.notes)


def test_a_row_that_measures_nothing_is_a_warning(write: Write) -> None:
    data = read_measurements(write(HEADER, ROW, "60,0.2,0.1,,0.1"))
    assert any("nothing was measured in line 3" in warning for warning in data.warnings)


# Real measurements


@pytest.mark.skipif(not RIG.is_dir(), reason=f"the rig's measurements are not at {RIG}")
def test_the_rigs_rolling_trials_are_read() -> None:
    data = read_measurements(RIG / "rolling_smooth_wheel.csv")
    assert (len(data), data.runs.size) == (189, 63)
    assert set(data.channels) == {"sinkage", "drawbar_pull"}
    assert set(data.declared_std) == {"drawbar_pull"}
    straight = data.take(data.conditions["slip_angle"] == 0)
    assert len(straight) == 27
    assert not straight.sunk_to_axle.any()
    # At 90 degrees the wheel is dragged sideways, and 27 rows are deeper than the axle.
    sideways = data.conditions["slip_angle"] == np.pi / 2
    assert data.sunk_to_axle.sum() == 27
    assert sideways[data.sunk_to_axle].all()
    assert np.abs(data.conditions["speed"] - 0.01).max() < 1e-4


@pytest.mark.skipif(not RIG.is_dir(), reason=f"the rig's measurements are not at {RIG}")
def test_the_rigs_indentation_trials_are_read() -> None:
    data = read_measurements(RIG / "indentation.csv")
    assert (len(data), data.runs.size) == (4128, 18)
    plate = data.conditions.contact == "plate"
    assert plate.sum() == 2080
    assert np.unique(data.conditions.diameter[plate]).tolist() == pytest.approx([0.06, 0.08, 0.1])
    assert not any("a curve, not repeats" in w for w in data.warnings)  # that is what they are


# Gravity


@pytest.mark.parametrize(
    ("unit", "load"), [("kg", 5 * 1.62), ("kgf", 49.03325), ("N", 5.0), ("lb", 2.26796185 * 1.62)]
)
def test_a_mass_weighs_by_the_gravity_of_its_row(write: Write, unit: str, load: float) -> None:
    """What a load cell shows as kg is kgf; resistance comes from one, whatever the gravity."""
    header = f"load [{unit}],diameter [m],width [m],sinkage [mm],resistance [kg],gravity"
    data = read_measurements(write(header, "5,0.2,0.1,8,0.1,1.62", "5,0.2,0.1,8,0.1,1.62"))
    assert data.conditions.load == pytest.approx([load, load])
    assert data.channels["resistance"] == pytest.approx([0.980665, 0.980665])
    assert data.conditions["gravity"].tolist() == [1.62, 1.62]
    assert any("load cell shows" in line for line in data.understood) == (unit in ("kg", "lb"))


def test_without_a_gravity_a_mass_weighs_as_on_the_earth(write: Write) -> None:
    data = read_measurements(write("load [kg],diameter [m],width [m],sinkage [mm]", "5,0.2,0.1,8"))
    assert data.conditions.load == pytest.approx([49.03325])


@pytest.mark.parametrize("value", ["0", "-1.62", "1000"])
def test_a_gravity_that_there_is_not_is_refused_with_what_to_write(
    write: Write, value: str
) -> None:
    said = fault(write(HEADER + ",gravity", f"{ROW},{value}"))
    assert f"line 2, column 'gravity': gravity is {value}, expected 0.01 to 100 m/s^2" in said
    assert "1.62 on the moon; leave it out for 9.80665" in said
