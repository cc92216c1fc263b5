# SPDX-License-Identifier: Apache-2.0
"""Files that ask for more than a table needs: refused by name, and before the memory is taken.

Tests `files.py`.
"""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path
from typing import Any

import messy_tables as messy
import pytest

from smallwheel_ros.measurements import cells, files, reading
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import MeasurementsError

HEADER = "load,diameter,width,sinkage"
ROW = "60,0.2,0.1,0.01"


def fault(path: Path | str) -> str:
    with pytest.raises(MeasurementsError) as caught:
        read_measurements(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    assert "a pipe or device" in fault(tmp_path / "pipe.csv")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="this system has no /dev/zero")
def test_a_device_is_not_read() -> None:
    assert "a pipe or device" in fault("/dev/zero")


def test_a_link_to_a_table_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{HEADER}\n{ROW}\n")
    (tmp_path / "b.csv").symlink_to(tmp_path / "a.csv")
    assert len(read_measurements(tmp_path / "b.csv")) == 1


def test_a_file_is_not_read_further_than_a_table_may_reach(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with path.open("wb") as file:
        file.truncate(50 * cells.MOST_BYTES)  # takes no room on the disk
    tracemalloc.start()
    try:
        message = fault(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert "expected at most that: split the table" in message
    assert peak < 3 * cells.MOST_BYTES


def test_one_long_cell_in_many_rows_is_refused_with_its_place(tmp_path: Path) -> None:
    """NumPy gives each cell of a column of texts the length of the longest: here 29 GiB."""
    path = tmp_path / "a.csv"
    rows = [f"{ROW},dry"] * 60_000
    rows[4] = f"{ROW},{'x' * 131_000}"
    path.write_text("\n".join([f"{HEADER},note", *rows]))
    message = fault(path)
    assert ", line 6, column 'note': a cell of 131000 characters in a table of 60000" in message


def test_one_long_name_of_digits_is_refused_too(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{ROW},1"] * 60_000
    rows[4] = f"{ROW},{'0' * 131_000}1"
    path.write_text("\n".join([f"{HEADER},run", *rows]))
    assert ", line 6, column 'run': a cell of 131001 characters" in fault(path)


def test_many_columns_of_long_texts_are_refused_together(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    names = [f"note{i}" for i in range(30)]
    texts = ",".join(["y" * 1000] + ["x" * 1000] * 29)
    path.write_text("\n".join([",".join([HEADER, *names]), *[f"{ROW},{texts}"] * 200]))
    assert len(read_measurements(path)) == 200
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, "MOST_CHARACTERS", 200 * 1000 * 29)
        assert "a cell of 1000 characters in a table of 200 rows" in fault(path)


@pytest.mark.parametrize("separator", [",", "\n", "\r"])
def test_a_file_of_nothing_but_separators_is_refused(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"load" + separator.encode() * (2 * cells.MOST_CELLS + 1))
    assert f"expected at most {cells.MOST_CELLS} cells" in fault(path)


def test_too_many_cells_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *[ROW] * 9]))
    monkeypatch.setattr(files, "MOST_CELLS", 40)
    assert len(read_measurements(tmp_path / "a.csv")) == 9
    monkeypatch.setattr(files, "MOST_CELLS", 39)
    assert "10 rows of 4 columns, expected at most 39 cells" in fault(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "header", [HEADER + ',"a\nb"', HEADER + "," + "x" * 100_000 + " [m", HEADER + ',"q [a\nb]"']
)
def test_a_message_stays_short_and_on_one_line(tmp_path: Path, header: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header}\n{ROW},inf\n")
    found = read_measurements(path)  # the column is nobody's
    (warning,) = [text for text in found.warnings if "left out" in text]
    assert len(warning) < 500
    assert "\n" not in warning


# Parquet, where a small file may unpack to anything


def parquet(path: Path, columns: dict[str, Any], **how: Any) -> Path:
    pyarrow = pytest.importorskip("pyarrow")
    writer = pytest.importorskip("pyarrow.parquet")
    table = pyarrow.table(columns)
    plain = {
        name: [0.01 if name == "sinkage" else 0.1] * table.num_rows for name in HEADER.split(",")
    }
    for name, values in plain.items():
        table = table.append_column(name, pyarrow.array(values))
    writer.write_table(table, path, **how)
    return path


def test_a_million_equal_rows_in_a_small_file_are_refused_unread(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    writer = pytest.importorskip("pyarrow.parquet")
    row = pyarrow.table({name: pyarrow.repeat(0.1, 1_500_000) for name in HEADER.split(",")})
    path = tmp_path / "a.parquet"
    writer.write_table(row, path, compression="zstd")
    assert path.stat().st_size < 500_000
    before = pyarrow.default_memory_pool().max_memory()
    assert "1500000 rows of 4 columns, expected at most 5000000 cells" in fault(path)
    assert pyarrow.default_memory_pool().max_memory() == before


def test_a_text_that_stands_in_many_rows_is_refused_with_its_row(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    rows = 60_000
    indices = pyarrow.array([0] * 4 + [1] + [0] * (rows - 5), type=pyarrow.int32())
    texts = pyarrow.DictionaryArray.from_arrays(indices, pyarrow.array(["dry", "x" * 131_000]))
    path = parquet(tmp_path / "a.parquet", {"note": texts}, compression="zstd")
    assert path.stat().st_size < 500_000
    assert ", row 5, column 'note': a cell of 131000 characters" in fault(path)


@pytest.mark.parametrize("kind", ["string", "large_string", "binary", "string_view"])
def test_a_text_in_every_row_takes_no_memory_of_its_own(tmp_path: Path, kind: str) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    value = b"x" * 100_000 if kind == "binary" else "x" * 100_000
    note = pyarrow.array([value] * 2000, type=getattr(pyarrow, kind)())
    path = parquet(tmp_path / "a.parquet", {"note": note}, compression="zstd")
    before = pyarrow.total_allocated_bytes()
    assert "a cell of 100" in fault(path)
    del note
    assert pyarrow.total_allocated_bytes() <= before


def test_what_unpacks_to_more_than_a_table_is_refused_unread(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    text = pyarrow.array([chr(97 + i % 26) * 4_000_000 + str(i) for i in range(70)])
    path = parquet(tmp_path / "a.parquet", {"note": text}, compression="zstd")
    del text
    assert path.stat().st_size < 500_000
    assert "bytes once unpacked, expected at most" in fault(path)


def test_blank_boolean_and_time_columns_are_read(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    columns = {
        "nothing": pyarrow.nulls(3),
        "wet": [True, None, False],
        "day": pyarrow.array([0, 1, None], type=pyarrow.date32()),
        "note": ["a", None, " b "],
    }
    path = parquet(tmp_path / "a.parquet", columns)
    labels = read_measurements(path).labels
    assert labels["wet"].tolist() == ["True", "", "False"]
    assert labels["day"].tolist() == ["1970-01-01", "1970-01-02", ""]
    assert labels["note"].tolist() == ["a", "", "b"]


# Workbooks


XLSX = messy.xlsx(A=[messy.ENGLISH, *map(list, messy.TRUTH)])
ODS = messy.ods(A=[messy.ENGLISH, *map(list, messy.TRUTH)])
_REPEATED = (
    b'<table:table-row table:number-rows-repeated="%d"><table:table-cell office:value-type="float" '
    b'office:value="1" table:number-columns-repeated="%d"/></table:table-row><table:table-row>'
)


@pytest.mark.parametrize(
    ("book", "part", "old", "new", "words"),
    [
        (XLSX, "sheet1.xml", b"</sheetData>", b" " * (2**27 + 1) + b"</sheetData>", "bytes once unpacked"),
        (XLSX, "sheet1.xml", b"</sheetData>", b"<row/>" * 11_000_000 + b"</sheetData>", "cells: split"),
        (XLSX, "sheet1.xml", b"<worksheet", b"<!DOCTYPE a><worksheet", "declares entities"),
        (ODS, "content.xml", b"<table:table-row>", _REPEATED % (1_000_000, 16_384), "at most 5000000 cells"),
        (ODS, "content.xml", b"<table:table-row>", _REPEATED % (1, 10**9), "a row of 1000000000 cells"),
        (ODS, "content.xml", b"<table:table-row>", b"<a>" * 100_000, "is not closed"),
    ],
)  # fmt: skip
def test_a_workbook_that_unpacks_to_anything_is_refused(
    tmp_path: Path, book: bytes, part: str, old: bytes, new: bytes, words: str
) -> None:
    path = tmp_path / "a"
    path.write_bytes(messy.changed(book, part, old, new))
    assert words in fault(path)


def test_a_stray_cell_in_the_last_corner_takes_no_memory(tmp_path: Path) -> None:
    """A reader that makes the whole rectangle asks for 550 GB here."""
    corner = b'<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
    path = tmp_path / "a.xlsx"
    path.write_bytes(messy.changed(XLSX, "sheet1.xml", b"</sheetData>", corner))
    with pytest.raises(MeasurementsError, match="column 16384 has no name"):
        read_measurements(path)
