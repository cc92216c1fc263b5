# SPDX-License-Identifier: Apache-2.0
"""A table as it was found, a grid of cells, from a file or a data frame; and the numbers in them.

The kind of a file is known by its content. A cell alone may say what its decimal mark is: 8,5 and 0,008
and 1.234,5 cannot be anything else. But 1.234 is 1234 to one and 1.234 to another: such a cell is read
as the rest of its column is, else as the rest of the table; where these do not say it, it is no number.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
import stat
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError, reason
from smallwheel_ros.measurements.columns import WORDS, Array, Mask

if TYPE_CHECKING:
    import pandas as pd

Cell = str | float  # a text file has texts only; "" is blank
KnownCells = Callable[[Sequence[Cell]], int]  # how many cells of a row name a quantity

MOST_BYTES = 64 * 2**20
MOST_CELLS = 5_000_000
SEARCHED = 40  # rows among which the header is: titles and remarks of a trial fill less than a page
_SHOWN, _SAMPLE = 60, 100_000  # characters that a message repeats; in which the header must stand
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
_EXPECTED = "expected a table: CSV text, xlsx, xls, ods or Parquet"
_SMALLER = "split the table, or thin out rows of long records"
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


class MeasurementsError(SmallwheelError):
    """A table of measurements that cannot be used: names file, row, column, found and expected."""


@dataclass
class Grid:
    """The rows of a table as a file or a data frame has them, the header among them or above.

    numbers: each row's line or row in the file. place: "line" of a text file, "row" of any other.
    header: names that the file keeps apart from its rows. comma: a comma can only be a decimal mark.
    merged: ranges of one column whose first cell stands for all: column from 0, first and last row.
    sheet: its name in a workbook.
    """

    rows: list[Sequence[Cell]]
    numbers: list[int]
    place: str
    header: list[str] | None = None
    comma: bool = False
    said: list[str] = field(default_factory=list)
    source: str = "data frame"
    sha256: str = ""
    merged: list[tuple[int, int, int]] = field(default_factory=list)
    sheet: str = ""


def clipped(text: str) -> str:
    """The text as a message repeats it: on one line, and not all of a long one."""
    text = " ".join(text[: 2 * _SHOWN].split())
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def shown(cell: Cell) -> str:
    """Give a cell as a message and a text show it; whole numbers without a decimal point."""
    if isinstance(cell, str):
        return clipped(cell)
    return f"{cell:.0f}" if float(cell).is_integer() else repr(float(cell))


def is_blank(cell: Cell) -> bool:
    """Whether nothing stands in the cell."""
    return isinstance(cell, str) and not cell.strip()


def read_grid(
    source: str | Path | pd.DataFrame, known_cells: KnownCells, sheet: str | int | None = None
) -> Grid:
    """Read a CSV, Excel (xlsx, xls), OpenDocument (ods) or Parquet file, or take a data frame.

    sheet: of a workbook, by name or number; without it the one sheet that has a table is read.
    Raises MeasurementsError where the file cannot be read, is of another kind, or is no table.
    """
    if not isinstance(source, (str, Path)):
        if not (hasattr(source, "columns") and hasattr(source, "to_numpy")):
            raise MeasurementsError(
                f"a {type(source).__name__} given, expected the path of a file or a pandas data frame"
            )
        return _frame_grid(source)
    try:
        data = _bytes(str(source))
        grid = _file_grid(data, known_cells, sheet)
    except MeasurementsError as error:
        comma = ", " if str(error).startswith("line ") else ": "
        raise MeasurementsError(f"{source}{comma}{error}") from None
    grid.source, grid.sha256 = str(source), hashlib.sha256(data).hexdigest()
    return grid


def _file_grid(data: bytes, known_cells: KnownCells, sheet: str | int | None) -> Grid:
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return _workbook_grid(data, known_cells, None if sheet is None else str(sheet))
    if sheet is not None:
        raise MeasurementsError(f"sheet '{sheet}' asked for, but this is no workbook")
    if kind := next((kind for magic, kind in _OTHERS if data.startswith(magic)), ""):
        raise MeasurementsError(f"this is {kind}, {_EXPECTED}")
    return _parquet_grid(data) if data.startswith(b"PAR1") else _text_grid(data, known_cells)


def _bytes(source: str) -> bytes:
    """Give what is in a regular file, and no more of it than a table may have."""
    try:
        # Without waiting: a pipe that nobody writes to would never open.
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
        raise MeasurementsError(f"more than {limit}, expected at most that: {_SMALLER}")
    return data


def _refuse_many_cells(rows: int, columns: int) -> None:
    if rows * columns > MOST_CELLS:
        raise MeasurementsError(
            f"{rows} rows of {columns} columns, expected at most {MOST_CELLS} cells: {_SMALLER}"
        )


def _text_grid(data: bytes, known_cells: KnownCells) -> Grid:
    """Read comma, semicolon, tab or bar separated text in UTF-8, UTF-16 or Windows-1252."""
    text, said = _decoded(data)
    start = text[:200].lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"looks like {kind}, {_EXPECTED}")
    before = 0  # lines
    if text[:4].lower() == "sep=":  # a line that only Excel knows
        text, before = text.partition("\n")[2], 1
    separator = _separator(text, known_cells)
    if separator != ",":
        said.append(f"cells are separated by {_SEPARATORS[separator]}")
    most = 2 * MOST_CELLS  # before any list is made of them; texts in quotes have separators too
    if len(text) > most and sum(map(text.count, (separator, "\n", "\r"))) > most:
        raise MeasurementsError(f"expected at most {MOST_CELLS} cells: {_SMALLER}")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    grid = Grid([], [], "line", comma=separator != ",", said=said)
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
    try:
        return data.decode("cp1252"), ["text in Windows-1252, as it is not UTF-8"]
    except UnicodeDecodeError:
        line = data.count(b"\n", 0, bad) + 1
        raise MeasurementsError(
            f"line {line}: byte 0x{data[bad]:02x} is neither UTF-8 nor Windows-1252 text, "
            f"{_EXPECTED} (save it as CSV UTF-8)"
        ) from None


def _separator(text: str, known_cells: KnownCells) -> str:
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


def _workbook_grid(data: bytes, known_cells: KnownCells, wanted: str | None) -> Grid:
    """One sheet of a workbook. Formats are not read: a cell shown as 20 % is 0.2."""
    try:
        from python_calamine import CalamineWorkbook, SheetVisibleEnum
    except ImportError:
        raise MeasurementsError("a workbook needs python-calamine: pip install it") from None
    try:
        if data.startswith(b"PK"):
            _refuse_bombs(data)
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = {meta.name: meta for meta in book.sheets_metadata}
        hidden = [n for n, s in sheets.items() if s.visible != SheetVisibleEnum.Visible]
        rows = {
            name: book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            for name in sheets
            if wanted is not None or name not in hidden
        }
        name = _chosen(rows, known_cells, wanted)
        ranges = book.get_sheet_by_name(name).merged_cell_ranges or []
    except MeasurementsError:
        raise
    except Exception as error:  # calamine raises many kinds for a damaged file
        raise MeasurementsError(
            f"a damaged workbook, or one with a password: {reason(error)}"
        ) from None
    cells = [[_cell(value) for value in row] for row in rows[name]]
    grid = Grid([*cells], list(range(1, len(cells) + 1)), "row", sheet=name)
    grid.merged = [(c, r + 1, last + 1) for (r, c), (last, right) in ranges if right == c]
    if hidden and wanted is None:
        grid.said.append(f"hidden sheets are left out: {', '.join(map(repr, hidden[:5]))}")
    if len(sheets) > 1:
        grid.said.append(f"sheet '{clipped(name)}'")
    return grid


def _refuse_bombs(data: bytes) -> None:
    """Refuse a workbook that unpacks to more than a table: calamine makes the whole rectangle."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if (size := sum(part.file_size for part in archive.infolist())) > 2 * MOST_BYTES:
            raise MeasurementsError(
                f"{size} bytes once unpacked, expected at most {2 * MOST_BYTES}"
            )
        for part in archive.namelist():
            if re.fullmatch(r"xl/worksheets/[^/]+\.xml", part):
                found = re.findall(rb'<c\b[^>]*?\br="([A-Z]{1,3})(\d+)"', archive.read(part))
                letters = max((c for c, _ in found), key=lambda c: (len(c), c), default=b"")
                width = sum(26**i * (c - 64) for i, c in enumerate(reversed(letters)))
                _refuse_many_cells(max((int(row) for _, row in found), default=0), width)


def _chosen(rows: dict[str, list[Any]], known_cells: KnownCells, wanted: str | None) -> str:
    """The name of the sheet that was asked for, else of the only one that has a table."""
    listed = ", ".join(f"'{clipped(name)}'" for name in rows)
    called = {str(i): name for i, name in enumerate(rows, start=1)}
    called |= {name.strip().casefold(): name for name in rows}
    if wanted is not None:
        if wanted.strip().casefold() not in called:
            raise MeasurementsError(f"no sheet '{clipped(wanted)}', there is: {listed}")
        return called[wanted.strip().casefold()]
    tables = [n for n in rows if any(known_cells(row) > 1 for row in rows[n][:SEARCHED])]
    tables = tables if len(rows) > 1 else [*rows]
    if len(tables) != 1:
        many = "several sheets have tables" if tables else "no sheet has a header that is known"
        raise MeasurementsError(f"{many}: name one with --sheet, there is: {listed}")
    return tables[0]


def _cell(value: Any) -> Cell:
    number = isinstance(value, (int, float, np.integer, np.floating))
    return (
        float(value) if number and not isinstance(value, (bool, np.bool_)) else str(value).strip()
    )


def _parquet_grid(data: bytes) -> Grid:
    """Read a Parquet file, judged by what its footer states before anything is unpacked."""
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


def _frame_grid(frame: Any) -> Grid:
    """Take a pandas data frame. NaN, None and NaT are blank, as pandas means them."""
    _refuse_many_cells(*frame.shape)
    columns = []
    for position in range(frame.shape[1]):
        column = frame.iloc[:, position]
        blank = column.isna().to_numpy(dtype=bool)
        cells = ["" if none else _cell(v) for none, v in zip(blank, column.tolist(), strict=True)]
        columns.append(cells)
    names = [str(name) for name in frame.columns]
    kept = [i for i, name in enumerate(names) if not name.startswith("__index_level_")]
    if not len(frame):
        raise MeasurementsError("data frame: no rows")
    rows = list(zip(*(columns[i] for i in kept), strict=True))
    return Grid([*rows], list(range(1, len(frame) + 1)), "row", [names[i] for i in kept])


TWO_WAYS = (
    "can be read in two ways, with a decimal mark or a mark of thousands: write the column "
    "without marks of thousands"
)
_MIXED = "this column has decimal points and decimal commas: write one of them throughout"
_NUMBER = re.compile(
    r"[-+]?(?:(?P<int>[0-9]*)|(?P<groups>[0-9]{1,3}(?:(?P<sep>[ '’.,])[0-9]{3})(?:(?P=sep)[0-9]{3})*))"
    r"(?:(?P<mark>[.,])(?P<part>[0-9]*))?(?:[eE][-+]?[0-9]{1,4})?"
)
_BOTH = {".", ","}
_MISSING = frozenset(text.strip() for text in WORDS["missing"].split(","))
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)
# Minus signs and blanks of other kinds, as spreadsheets and typesetters write them.
_PLAIN = str.maketrans(dict.fromkeys("−‒–", "-") | dict.fromkeys("\u00a0\u202f\u2009\u2007", " "))


class _Spelling(NamedTuple):
    """A text that is a number.

    kind: the decimal mark that it shows: ".", ",", "" for none, "?." or "?," for one of two.
    sep: the mark of thousands.
    """

    text: str
    kind: str
    sep: str | None


@dataclass
class Numbers:
    """A column as numbers.

    values: NaN where blank or no number. blank: nothing was measured. percent: shares that the cell
    gives in per cent. faults: by row, why the cell is no number, "" where it is any other text.
    missing: texts that mean blank. comma: whether decimal commas were read.
    """

    values: Array
    blank: Mask
    percent: Mask
    faults: dict[int, str] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    comma: bool = False


def read_numbers(columns: Sequence[Sequence[Cell]], comma: bool) -> list[Numbers]:
    """Numbers of all columns of a table; comma: it can be nothing but a decimal mark."""
    if not any("," in _joined(cells) for cells in columns):
        return [_column(cells, {"."}) for cells in columns]
    spelled = [map(_spelling, {c for c in cells if isinstance(c, str)}) for cells in columns]
    kinds = [{s.kind for s in texts if s is not None} for texts in spelled]
    # a column of both marks is wrong already, and says nothing of the others
    seen = set[str]().union(*(k for k in kinds if not k >= _BOTH))
    table = seen & _BOTH
    if not table and "?," not in seen:
        table = {"."}
    elif not table and comma and "?." not in seen:
        table = {","}
    return [_column(c, own & _BOTH or table) for c, own in zip(columns, kinds, strict=True)]


def _joined(cells: Sequence[Cell]) -> str:
    return "".join([cell for cell in cells if isinstance(cell, str)])


def _quick(cells: Sequence[Cell], mark: str) -> Numbers | None:
    """A column of nothing but finite numbers with that decimal mark, many times quicker; else None."""
    texts = _joined(cells)
    if not texts.isascii() or "_" in texts or (mark == "," and "." in texts):
        return None  # Python takes 1_000 and ٣ for numbers, which they are not
    if mark == ",":
        cells = [cell.replace(",", ".") if isinstance(cell, str) else cell for cell in cells]
    try:
        values = np.array(list(map(float, cells)))
    except ValueError:
        return None
    none = np.zeros(values.size, dtype=bool)
    comma = mark == "," and "," in texts
    return Numbers(values, none, none, comma=comma) if np.isfinite(values).all() else None


def _column(cells: Sequence[Cell], marks: set[str]) -> Numbers:
    """The numbers of a column. marks: the decimal marks by which it is read."""
    if len(marks) == 1 and (plain := _quick(cells, *marks)) is not None:
        return plain
    size = len(cells)
    result = Numbers(np.full(size, np.nan), np.zeros(size, bool), np.zeros(size, bool))
    spelled = {cell: _spelling(cell) for cell in cells if isinstance(cell, str)}
    count = Counter(s.kind for c in cells if isinstance(c, str) and (s := spelled[c]) is not None)
    rare = {m for m in marks if marks == _BOTH and count[m] == min(count["."], count[","])}
    other = {",": ".", ".": ","}[next(iter(marks))] if len(marks) == 1 else None
    groups = any(s is not None and other and s.sep == other for s in spelled.values())
    for row, cell in enumerate(cells):
        if not isinstance(cell, str):
            result.values[row] = cell
            continue
        found, text = spelled[cell], cell.strip()
        if not text or cell.replace(" ", "").lower() in _MISSING:
            result.blank[row] = True
            result.missing |= {text} if text else set()
        elif _NOT_FINITE.fullmatch(text):
            result.values[row] = float(text)
        elif found is None or found.kind in rare:
            result.faults[row] = "" if found is None else _MIXED
        elif (value := _value(found, marks, groups)) is None:
            result.faults[row] = TWO_WAYS
        else:
            result.percent[row] = text.endswith("%")
            result.values[row] = value / 100.0 if text.endswith("%") else value
            result.comma |= found.kind == "," or (found.kind == "?," and marks == {","})
    return result


def _spelling(cell: str) -> _Spelling | None:
    text = cell.translate(_PLAIN).strip().removesuffix("%").rstrip()
    found = _NUMBER.fullmatch(text)
    if found is None or not any(found[name] for name in ("int", "groups", "part")):
        return None  # no digit before an exponent
    mark, sep, whole, part = found["mark"], found["sep"], found["int"] or "", found["part"]
    if sep is not None and sep == mark:
        return None
    if sep in (".", ","):
        return _Spelling(text, "," if sep == "." else ".", sep)
    either = sep is None and mark and len(part) == 3 and 1 <= len(whole) <= 3 and whole[0] != "0"
    return _Spelling(text, f"?{mark}" if either else mark or "", sep)


def _value(found: _Spelling, marks: set[str], groups: bool) -> float | None:
    text = found.text if found.sep is None else found.text.replace(found.sep, "")
    if found.kind.startswith("?") and marks != {found.kind[1]}:
        return float(text.replace(found.kind[1], "")) if groups and len(marks) == 1 else None
    return float(text.replace(",", "."))
