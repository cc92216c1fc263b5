# SPDX-License-Identifier: Apache-2.0
"""From a file or a data frame to a grid of cells; the kind of a file is known by its content."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
import stat
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.measurements.cells import (
    EXPECTED,
    MOST_BYTES,
    MOST_CELLS,
    MOST_CHARACTERS,
    SMALLER,
    TOO_MANY,
    Cell,
    Grid,
    MeasurementsError,
    clipped,
    naming,
    refuse_many_cells,
)
from smallwheel_ros.measurements.layout import SEARCHED, known_cells

if TYPE_CHECKING:
    import pandas as pd

_SAMPLE = 100_000  # characters in which the header must stand
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
_KANA = re.compile("[\u3041-\u30fe]{2}")
_MARKS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))
_MOST_UNPACKED = 4 * MOST_CHARACTERS  # bytes of all columns, as the footer states them
_TEXTS = ("string", "large_string", "string_view", "binary", "large_binary", "binary_view")
_OTHERS = (
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF", "a PDF document"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook, or one with a password (save it as xlsx)"),
    (b"\x1f\x8b", "a gzip archive (unpack it first)"),
    (b"SQLite format 3", "a rosbag2 or SQLite file (for a bag: smallwheel replay)"),
    (b"#ROSBAG", "a ROS 1 bag (use smallwheel replay)"),
    (b"\x89MCAP", "an MCAP bag (use smallwheel replay)"),
    (b"\x89HDF", "an HDF5 file"),
)


def read_grid(source: str | Path | pd.DataFrame, sheet: str | int | None = None) -> Grid:
    """Read a CSV, Excel (xlsx), OpenDocument (ods) or Parquet file, or take a data frame.

    sheet: of a workbook, by name or number; without it the one sheet that has a table is read.
    Raises MeasurementsError where the file cannot be read, is of another kind, or is no table.
    """
    if isinstance(source, (str, Path)):
        with naming(str(source)):
            data = _bytes(str(source))
            grid = _file_grid(data, sheet)
        grid.source, grid.sha256 = str(source), hashlib.sha256(data).hexdigest()
        return grid
    if not (hasattr(source, "columns") and hasattr(source, "to_numpy")):
        raise MeasurementsError(
            f"a {type(source).__name__} given, expected the path of a file or a pandas data frame"
        )
    with naming("data frame"):
        return frame_grid(source)


def _file_grid(data: bytes, sheet: str | int | None) -> Grid:
    if data.startswith(b"PK\x03\x04"):
        from smallwheel_ros.measurements.workbook import workbook_grid

        return workbook_grid(data, None if sheet is None else str(sheet))
    if sheet is not None:
        raise MeasurementsError(f"sheet '{sheet}' asked for, but this is no workbook")
    if kind := next((kind for magic, kind in _OTHERS if data.startswith(magic)), ""):
        raise MeasurementsError(f"this is {kind}, {EXPECTED}")
    return parquet_grid(data) if data.startswith(b"PAR1") else text_grid(data)


def _bytes(source: str) -> bytes:
    """Give what is in a regular file, and no more of it than a table may have."""
    try:
        # Without waiting: a pipe that nobody writes to would never open.
        descriptor = os.open(source, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(descriptor, "rb") as file:
            mode = os.fstat(descriptor).st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise MeasurementsError(
                    f"a pipe or device, {EXPECTED}: save the table to a file first"
                )
            data = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise MeasurementsError("no such file") from None
    except IsADirectoryError:
        raise MeasurementsError(f"a folder, {EXPECTED}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise MeasurementsError(f"cannot be read: {reason}") from None
    if len(data) > MOST_BYTES:
        limit = f"{MOST_BYTES // 2**20} MiB"
        raise MeasurementsError(f"more than {limit}, expected at most that: {SMALLER}")
    return data


def text_grid(data: bytes) -> Grid:
    """Read comma, semicolon, tab or bar separated text in UTF-8, UTF-16, Windows-1252 or Shift-JIS."""
    text, said = _decoded(data)
    start = text[:200].lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"looks like {kind}, {EXPECTED}")
    before = 0  # lines
    if text[:4].lower() == "sep=":  # a line that only Excel knows
        text, before = text.partition("\n")[2], 1
    separator = _separator(text)
    if separator != ",":
        said.append(f"cells are separated by {_SEPARATORS[separator]}")
    # Before any list is made of them. Twice the cells: texts in quotes have separators too.
    most = 2 * MOST_CELLS
    if len(text) > most and sum(map(text.count, (separator, "\n", "\r"))) > most:
        raise MeasurementsError(TOO_MANY)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    grid = Grid([], [], "line", comma=separator != ",", said=said)
    line = before + 1
    try:
        for row in reader:  # a text in quotes may have several lines
            grid.rows.append(row)
            grid.numbers.append(line)
            line = before + reader.line_num + 1
    except csv.Error as error:
        line = before + reader.line_num
        raise MeasurementsError(f"line {line}: not CSV: {error}") from None
    if sum(map(len, grid.rows)) > MOST_CELLS:
        raise MeasurementsError(TOO_MANY)
    return grid


def _decoded(data: bytes) -> tuple[str, list[str]]:
    if not data.strip(b" \t\r\n\x00"):
        raise MeasurementsError(f"the file is empty, {EXPECTED}")
    for code in (c for mark, c in _MARKS if data.startswith(mark)):
        try:
            return data.decode(code), ["text in UTF-16"] if code == "utf-16" else []
        except UnicodeDecodeError as error:
            raise MeasurementsError(
                f"not {code.upper()} text as its first bytes say ({error.reason}): "
                "save it as CSV UTF-8"
            ) from None
    if b"\x00" in data:
        # UTF-16 of Latin letters has zeros in every second byte; any other zeros are no text.
        for code, zeros in (("utf-16-le", data[1:2000:2]), ("utf-16-be", data[0:2000:2])):
            with suppress(UnicodeDecodeError):
                if zeros.count(0) > 0.9 * len(zeros):
                    return data.decode(code), ["text in UTF-16, without the mark of it"]
        raise MeasurementsError(f"a binary file, {EXPECTED}")
    try:
        return data.decode("utf-8"), []
    except UnicodeDecodeError as error:
        bad = error.start
    with suppress(UnicodeDecodeError):
        # nearly any bytes are Windows-1252: two kana in a row, or words that are known, are Shift-JIS
        japanese = data.decode("cp932")
        western = data.decode("cp1252", errors="replace")
        if _KANA.search(japanese) or _known(japanese) > _known(western):
            return japanese, ["text in Shift-JIS, as it is not UTF-8"]
    with suppress(UnicodeDecodeError):
        return data.decode("cp1252"), ["text in Windows-1252, as it is not UTF-8"]
    line = data.count(b"\n", 0, bad) + 1
    raise MeasurementsError(
        f"line {line}: byte 0x{data[bad]:02x} is neither UTF-8 nor Windows-1252 text, "
        f"{EXPECTED} (save it as CSV UTF-8)"
    )


def _known(text: str) -> int:
    """Most cells of a row that name a quantity, in a text whose separator is not known yet."""
    lines = text[:_SAMPLE].splitlines()[:SEARCHED]
    return max((known_cells(re.split("[,;\\t|]", line)) for line in lines), default=0)


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
    return best


def parquet_grid(data: bytes) -> Grid:
    """Read a Parquet file; MeasurementsError where it is damaged, too large or no table."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MeasurementsError(
            "reading Parquet needs pyarrow: pip install 'smallwheel_ros[parquet]'"
        ) from None
    try:
        names, columns = _parquet_columns(pyarrow, data)
    except MeasurementsError:
        raise
    except Exception as error:  # pyarrow raises many kinds for a damaged file
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise MeasurementsError(f"a damaged Parquet file: {reason}") from None
    return _grid(names, columns)


def frame_grid(frame: Any) -> Grid:
    """Take a pandas data frame. NaN, None and NaT are blank, as pandas means them."""
    refuse_many_cells(*frame.shape)
    columns: list[list[Cell]] = []
    for position in range(frame.shape[1]):
        column = frame.iloc[:, position]
        blank = column.isna().to_numpy(dtype=bool)
        if column.dtype.kind in "iuf":
            cells: list[Cell] = column.to_numpy(dtype=float, na_value=np.nan).tolist()
        else:
            cells = [float(v) if _is_number(v) else str(v) for v in column.tolist()]
        for row in np.flatnonzero(blank).tolist():
            cells[row] = ""
        columns.append(cells)
    return _grid([str(name) for name in frame.columns], columns)


def _is_number(value: Any) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating))
    return number and not isinstance(value, (bool, np.bool_))


def _grid(names: list[str], columns: list[list[Cell]]) -> Grid:
    rows = len(columns[0]) if columns else 0
    if not rows:
        raise MeasurementsError("no rows")
    lines = list(range(1, rows + 1))
    return Grid(list(zip(*columns, strict=True)), lines, "row", names)


def _parquet_columns(pyarrow: Any, data: bytes) -> tuple[list[str], list[list[Cell]]]:
    """Columns of the file, judged by what its footer states before anything is unpacked."""
    buffer = pyarrow.BufferReader(data)
    footer = pyarrow.parquet.read_metadata(buffer)
    schema = footer.schema.to_arrow_schema()
    groups = [footer.row_group(i) for i in range(footer.num_row_groups)]
    rows = max(footer.num_rows, sum(group.num_rows for group in groups))
    refuse_many_cells(rows, footer.num_columns)
    for field in schema:
        _refuse_kind(pyarrow, field)
    unpacked = sum(group.total_byte_size for group in groups)
    if unpacked > _MOST_UNPACKED:
        raise MeasurementsError(
            f"{unpacked} bytes once unpacked, expected at most {_MOST_UNPACKED}: {SMALLER}"
        )
    # Texts stay indices into their different values: a value may stand in each of many rows.
    texts = [field.name for field in schema if str(field.type) in _TEXTS]
    table = pyarrow.parquet.ParquetFile(buffer, read_dictionary=texts).read()
    kept = [i for i, n in enumerate(table.column_names) if not str(n).startswith("__index_level_")]
    names = [str(table.column_names[i]) for i in kept]
    return names, [_parquet_cells(pyarrow, table.column(i)) for i in kept]


def _parquet_cells(pyarrow: Any, column: Any) -> list[Cell]:
    kind = column.type
    number = pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)
    if number or pyarrow.types.is_decimal(kind):
        values = column.cast(pyarrow.float64()).to_pylist()
        return ["" if value is None else value for value in values]
    if not pyarrow.types.is_dictionary(kind):
        column = column.dictionary_encode()
    cells: list[Cell] = []
    for chunk in column.chunks:
        # One text for all the rows that it stands in.
        texts = ["" if v is None else str(v).strip() for v in chunk.dictionary.to_pylist()]
        cells += ["" if i is None else texts[i] for i in chunk.indices.to_pylist()]
    return cells


def _refuse_kind(pyarrow: Any, field: Any) -> None:
    """Refuse a column of anything but numbers, texts and times: one cell may be of any size."""
    kind, types = field.type, pyarrow.types
    known = (types.is_primitive, types.is_decimal, types.is_dictionary, types.is_null)
    if str(kind) not in _TEXTS and not any(is_one(kind) for is_one in known):
        raise MeasurementsError(
            f"column '{clipped(field.name)}': its cells are of the kind "
            f"{clipped(str(kind))}, expected numbers or texts"
        )
