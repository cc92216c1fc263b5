"""From a file's bytes to columns of cells: CSV and Parquet, nothing known of what they mean."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import stat
from pathlib import Path

import numpy as np

from smallwheel_ros.measurements.cells import (
    MOST_BYTES,
    MOST_CELLS,
    SMALLER,
    Column,
    MeasurementsError,
    Table,
    refuse_long_texts,
    refuse_many_cells,
)
from smallwheel_ros.measurements.parquet import parquet_table


def read_table(path: str | Path) -> Table:
    """Read a CSV or Parquet file, told apart by its content.

    Raises MeasurementsError where the file cannot be read, is of another kind, or is no table.
    """
    source = str(path)
    data = _bytes(source)
    digest = hashlib.sha256(data).hexdigest()
    if data.startswith(b"PAR1"):
        table = parquet_table(data, source, digest)
    else:
        # Before any list is made of them. Twice the cells: texts in quotes have commas too.
        if data.count(b",") + data.count(b"\n") + data.count(b"\r") > 2 * MOST_CELLS:
            raise MeasurementsError(f"{source}: expected at most {MOST_CELLS} cells: {SMALLER}")
        table = _csv(_text(data, source), source, digest)
    refuse_long_texts(table)
    return table


def _bytes(source: str) -> bytes:
    """Give what is in a regular file, and no more of it than a table may have."""
    try:
        # Without waiting: a pipe that nobody writes to would never open.
        descriptor = os.open(source, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(descriptor, "rb") as file:
            mode = os.fstat(descriptor).st_mode
            if stat.S_ISDIR(mode):
                raise IsADirectoryError
            if not stat.S_ISREG(mode):
                raise MeasurementsError(
                    f"{source}: a pipe or device, expected a CSV or Parquet file: save the table "
                    "to a file first"
                )
            data = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise MeasurementsError(f"{source}: no such file") from None
    except IsADirectoryError:
        raise MeasurementsError(f"{source}: a folder, expected a CSV or Parquet file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise MeasurementsError(f"{source}: cannot be read: {reason}") from None
    if len(data) > MOST_BYTES:
        raise MeasurementsError(
            f"{source}: more than {MOST_BYTES // 2**20} MiB, expected at most that: {SMALLER}"
        )
    return data


_KINDS = (
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive or Excel workbook (in Excel: save as CSV UTF-8)"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook (save it as CSV UTF-8)"),
    (b"\x1f\x8b", "a gzip archive (unpack it first)"),
    (b"SQLite format 3", "a rosbag2 or SQLite file (for a bag: smallwheel replay)"),
    (b"#ROSBAG", "a ROS 1 bag (use smallwheel replay)"),
    (b"\x89MCAP", "an MCAP bag (use smallwheel replay)"),
    (b"\x89HDF", "an HDF5 file"),
    (b"\xff\xfe", "text in UTF-16 (save it as CSV UTF-8)"),
    (b"\xfe\xff", "text in UTF-16 (save it as CSV UTF-8)"),
)


def _text(data: bytes, source: str) -> str:
    """Decode the file, or raise MeasurementsError that says what else it is."""
    expected = "expected CSV text or Parquet"
    if not data.strip():
        raise MeasurementsError(f"{source}: the file is empty, {expected}")
    for magic, kind in _KINDS:
        if data.startswith(magic):
            raise MeasurementsError(f"{source}: this is {kind}, {expected}")
    if b"\x00" in data:
        raise MeasurementsError(f"{source}: a binary file, {expected}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise MeasurementsError(
            f"{source}, line {line}: byte 0x{data[error.start]:02x} is not UTF-8 text, {expected} "
            "(save it as CSV UTF-8)"
        ) from None
    start = text.lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"{source}: looks like {kind}, {expected}")
    return text


def _csv(text: str, source: str, digest: str) -> Table:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    before = 0
    try:
        for cells in reader:
            start, before = before + 1, reader.line_num
            stripped = [cell.strip() for cell in cells]
            if not any(stripped):
                continue  # blank lines, and rows of empty cells that spreadsheets leave behind
            if not rows:
                _refuse_other_separators(stripped, source, start)
            elif len(stripped) != len(rows[0]):
                raise MeasurementsError(
                    f"{source}, line {start}: {len(stripped)} cells, expected {len(rows[0])} as in "
                    f"the header{_ragged_hint(stripped, rows[0])}"
                )
            rows.append(stripped)
            lines.append(start)
            refuse_many_cells(source, len(rows), len(stripped))
    except csv.Error as error:
        raise MeasurementsError(f"{source}, line {before + 1}: not CSV: {error}") from None
    if not rows:
        raise MeasurementsError(f"{source}: nothing but empty cells, expected a header and rows")
    if len(rows) == 1:
        raise MeasurementsError(f"{source}: no rows below the header")
    columns = [
        Column(name, cells, None, np.array([not cell for cell in cells]))
        for name, *cells in zip(*rows, strict=True)
    ]
    return Table(source, digest, columns, np.array(lines[1:], dtype=np.intp), "line", lines[0])


def _ragged_hint(cells: list[str], header: list[str]) -> str:
    if len(cells) > len(header):
        return " (a decimal comma, or a comma in a text? write 1.5, and texts in quotes)"
    return ""


def _refuse_other_separators(header: list[str], source: str, line: int) -> None:
    if len(header) > 2:
        return
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if any(separator in cell for cell in header):
            raise MeasurementsError(
                f"{source}, line {line}: cells are separated by {name}, expected commas, and "
                "decimal points rather than decimal commas: save it as such a CSV"
            )
