# SPDX-License-Identifier: Apache-2.0
"""Turns a file or a data frame into a grid of cells; the kind of a file is recognised by its content."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
import stat
from collections import Counter
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.errors import reason
from smallwheel_ros.measurements.cells import (
    MOST_BYTES,
    MOST_CELLS,
    SEARCHED,
    SMALLER,
    CellGrid,
    MeasurementsError,
    cell_of,
)
from smallwheel_ros.measurements.layout import known_cells
from smallwheel_ros.measurements.workbooks import workbook_grid

if TYPE_CHECKING:
    import pandas as pd

_SAMPLE = 100_000  # characters in which the header must stand
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
_BLANKS = " "
_EASTERN = ("gb18030", "shift_jis")
_EXPECTED = "expected a table: CSV text, xlsx, xls, ods or Parquet"
_ENCODINGS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))
_OTHERS = (
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF", "a PDF document"),
    (b"\x1f\x8b", "a gzip archive (unpack it first)"),
    (b"SQLite format 3", "a rosbag2 or SQLite file (for a bag: smallwheel replay)"),
    (b"#ROSBAG", "a ROS 1 bag (use smallwheel replay)"),
    (b"\x89MCAP", "an MCAP bag (use smallwheel replay)"),
    (b"\x89HDF", "an HDF5 file"),
)


def read_grid(source: str | Path | pd.DataFrame, sheet: str | int | None = None) -> CellGrid:
    """Read a CSV, Excel (xlsx, xls), OpenDocument (ods) or Parquet file, or take a data frame.

    Parameters
    ----------
    source
        Path of the file, or the pandas data frame.
    sheet
        Sheet of a workbook, by name or number from 1; None: the only sheet that has a table.

    Raises
    ------
    MeasurementsError
        If the file cannot be read, is of another kind, is too large, or has no such sheet.
    """
    if not isinstance(source, (str, Path)):
        if not (hasattr(source, "columns") and hasattr(source, "to_numpy")):
            raise MeasurementsError(
                f"a {type(source).__name__} given, expected the path of a file or a pandas data frame"
            )
        return _frame_grid(source)
    try:
        data = _bytes(str(source))
        grid = _file_grid(data, sheet)
    except MeasurementsError as error:
        comma = ", " if str(error).startswith("line ") else ": "
        raise MeasurementsError(f"{source}{comma}{error}") from None
    grid.source, grid.sha256 = str(source), hashlib.sha256(data).hexdigest()
    return grid


def _file_grid(data: bytes, sheet: str | int | None) -> CellGrid:
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return workbook_grid(data, None if sheet is None else str(sheet))
    if sheet is not None:
        raise MeasurementsError(f"sheet '{sheet}' asked for, but this is no workbook")
    if kind := next((kind for magic, kind in _OTHERS if data.startswith(magic)), ""):
        raise MeasurementsError(f"this is {kind}, {_EXPECTED}")
    return _parquet_grid(data) if data.startswith(b"PAR1") else _text_grid(data)


def _bytes(source: str) -> bytes:
    """Read a regular file that is no larger than a table may be."""
    try:
        # Without waiting: a pipe without a writer would never open.
        descriptor = os.open(source, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise MeasurementsError(f"a pipe or device, {_EXPECTED}: save it to a file first")
            data = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise MeasurementsError("no such file") from None
    except IsADirectoryError:
        raise MeasurementsError(f"a folder, {_EXPECTED}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise MeasurementsError(f"cannot be read: {reason(error)}") from None
    if len(data) > MOST_BYTES:
        limit = f"{MOST_BYTES // 2**20} MiB"
        raise MeasurementsError(f"more than {limit}, expected at most that: {SMALLER}")
    return data


def _refuse_many_cells(rows: int, columns: int) -> None:
    if rows * columns > MOST_CELLS:
        raise MeasurementsError(
            f"{rows} rows of {columns} columns, expected at most {MOST_CELLS} cells: {SMALLER}"
        )


def _text_grid(data: bytes) -> CellGrid:
    """Read text between commas, semicolons, tabs, bars or blanks, in any code that `_decoded` knows."""
    text, said = _decoded(data)
    start = text[:200].lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"looks like {kind}, {_EXPECTED}")
    before = 0  # lines
    if text[:4].lower() == "sep=":  # a line that only Excel knows
        text, before = text.partition("\n")[2], 1
    separator = _separator(text)
    if separator == _BLANKS:
        said.append("cells are separated by blanks")
        rows = [_by_blanks(line) for line in text.splitlines()]
        _refuse_many_cells(len(rows), max(map(len, rows), default=0))
        numbers = [before + 1 + i for i in range(len(rows))]
        return CellGrid([*rows], numbers, "line", comma=True, said=said)
    if separator != ",":
        said.append(f"cells are separated by {_SEPARATORS[separator]}")
    most = 2 * MOST_CELLS  # before any list is made of them; texts in quotes have separators too
    if len(text) > most and sum(map(text.count, (separator, "\n", "\r"))) > most:
        raise MeasurementsError(f"expected at most {MOST_CELLS} cells: {SMALLER}")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    grid = CellGrid([], [], "line", comma=separator != ",", said=said)
    line = before + 1
    try:
        for row in reader:  # a text in quotes may have several lines
            grid.rows.append(row)
            grid.numbers.append(line)
            line = before + reader.line_num + 1
    except csv.Error as error:
        raise MeasurementsError(f"line {before + reader.line_num}: not CSV: {error}") from None
    _refuse_many_cells(len(grid.rows), max(map(len, grid.rows), default=0))
    return grid


def _decoded(data: bytes) -> tuple[str, list[str]]:
    if not data.strip(b" \t\r\n\x00"):
        raise MeasurementsError(f"the file is empty, {_EXPECTED}")
    code = next((code for mark, code in _ENCODINGS if data.startswith(mark)), "")
    if not code and b"\x00" in data:
        # UTF-16 of Latin letters has zeros in every second byte; any other zeros are no text.
        halves = {"utf-16-le": data[1:2000:2], "utf-16-be": data[0:2000:2]}
        code = next((c for c, half in halves.items() if half.count(0) > 0.9 * len(half)), "")
        if not code:
            raise MeasurementsError(f"a binary file, {_EXPECTED}")
    try:
        return data.decode(code or "utf-8"), ["text in UTF-16"] if code.startswith("utf-16") else []
    except UnicodeDecodeError as error:
        if code:
            raise MeasurementsError(
                f"not {code.upper()} text as its first bytes say ({error.reason}): "
                "save it as CSV UTF-8"
            ) from None
        bad = error.start
    if code := _eastern(data):
        return data.decode(code), [f"text in {code.upper()}, as it is not UTF-8"]
    try:
        return data.decode("cp1252"), ["text in Windows-1252, as it is not UTF-8"]
    except UnicodeDecodeError:
        line = data.count(b"\n", 0, bad) + 1
        raise MeasurementsError(
            f"line {line}: byte 0x{data[bad]:02x} is neither UTF-8 nor Windows-1252 text, "
            f"{_EXPECTED} (save it as CSV UTF-8)"
        ) from None


def _eastern(data: bytes) -> str:
    """Encoding of a Chinese or Japanese file: the one in which most headers are known; empty for others."""
    best, most = "", max(1, _known(data, "cp1252"))
    for code in _EASTERN:
        with suppress(UnicodeDecodeError):
            data.decode(code)
            if (known := _known(data, code)) > most:
                best, most = code, known
    return best


def _known(data: bytes, code: str) -> int:
    """The largest number of names of quantities in one of the first lines. code: encoding of the bytes."""
    lines = data[:_SAMPLE].decode(code, "ignore").splitlines()[:SEARCHED]
    return max((known_cells(re.split(r"[,;\t|]", line)) for line in lines), default=0)


def _separator(text: str) -> str:
    """The separator by which most headers are understood, else the one that makes most columns."""
    best, most = ",", (0, 0)
    for separator in _SEPARATORS:
        try:
            reader = csv.reader(io.StringIO(text[:_SAMPLE], newline=""), delimiter=separator)
            rows = list(islice(reader, SEARCHED))
        except csv.Error:
            continue
        score = max(map(known_cells, rows), default=0), max(map(len, rows), default=0)
        if separator in text[:_SAMPLE] and score > most:
            best, most = separator, score
    lines = [_by_blanks(line) for line in text[:_SAMPLE].splitlines()[:SEARCHED]]
    return _BLANKS if _known_by_blanks([line for line in lines if line]) > max(most[0], 1) else best


def _known_by_blanks(lines: list[list[str]]) -> int:
    """Number of quantities that the header names, split at blanks; 0 if most rows have other counts of cells.

    Where tabs separate the cells, a header with names of several words has more words than its rows.
    """
    header = max(lines, key=known_cells, default=[])
    usual = Counter(map(len, lines)).most_common(1)
    return known_cells(header) if usual and usual[0][0] == len(header) else 0


def _by_blanks(line: str) -> list[str]:
    """Split a line at blanks; a unit in brackets and the mark of a comment stay with the word beside them."""
    return re.sub(r"\s+(?=[\[(])|(?<=^[#%])\s+", "", line.strip()).split()


def _parquet_grid(data: bytes) -> CellGrid:
    """Read a Parquet file; one that its footer states to be too large is refused before it is unpacked."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MeasurementsError(
            "reading Parquet needs pyarrow: pip install 'smallwheel_ros[parquet]'"
        ) from None
    try:
        file = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(data))
        _refuse_many_cells(file.metadata.num_rows, file.metadata.num_columns)
        groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
        if (size := sum(group.total_byte_size for group in groups)) > 4 * MOST_BYTES:
            raise MeasurementsError(
                f"{size} bytes once unpacked, expected at most {4 * MOST_BYTES}"
            )
        return _frame_grid(file.read().to_pandas(ignore_metadata=True))
    except MeasurementsError:
        raise
    except Exception as error:  # pyarrow raises many kinds for a damaged file
        raise MeasurementsError(f"a damaged Parquet file: {reason(error)[:200]}") from None


def _frame_grid(frame: Any) -> CellGrid:
    """Take a pandas data frame. NaN, None and NaT are blank, as pandas means them."""
    _refuse_many_cells(*frame.shape)
    columns = []
    for position in range(frame.shape[1]):
        column = frame.iloc[:, position]
        blank = column.isna().to_numpy(dtype=bool)
        cells = ["" if none else cell_of(v) for none, v in zip(blank, column.tolist(), strict=True)]
        columns.append(cells)
    names = [str(name) for name in frame.columns]
    kept = [i for i, name in enumerate(names) if not name.startswith("__index_level_")]
    if not len(frame):
        raise MeasurementsError("data frame: no rows")
    rows = list(zip(*(columns[i] for i in kept), strict=True))
    return CellGrid([*rows], list(range(1, len(frame) + 1)), "row", [names[i] for i in kept])
