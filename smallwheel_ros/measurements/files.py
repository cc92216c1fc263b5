"""From a file's bytes to columns of cells: CSV and Parquet, nothing known of what they mean."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError

Array = NDArray[np.float64]

_LONGEST_CELL = 60  # characters of a cell that a message repeats


class MeasurementsError(SmallwheelError):
    """A table of measurements that cannot be used: names file, line, column, found and expected."""


@dataclass(frozen=True)
class Column:
    """One column as it stands in the file: cells as text, or numbers where the file has types."""

    header: str
    text: Sequence[str] | None  # stripped; "" where blank
    numbers: Array | None  # NaN where blank, and where the file itself holds NaN
    blank: NDArray[np.bool_]

    def cell(self, row: int) -> str:
        """Give the cell as a message shows it."""
        shown = self.text[row] if self.text is not None else repr(float(self._numbers()[row]))
        return shown if len(shown) <= _LONGEST_CELL else shown[:_LONGEST_CELL] + "..."

    def _numbers(self) -> Array:
        assert self.numbers is not None
        return self.numbers

    def parsed(self) -> tuple[Array, NDArray[np.bool_]]:
        """Numbers (NaN where blank) and which cells are neither blank nor a number."""
        if self.numbers is not None:
            return self.numbers, np.zeros(self.numbers.size, dtype=bool)
        assert self.text is not None
        filled = [cell or "nan" for cell in self.text]
        try:
            values = np.array(filled, dtype=np.str_).astype(float)
            bad = np.zeros(values.size, dtype=bool)
        except ValueError:
            values = np.array([_number(cell) for cell in filled])
            bad = np.isnan(values) & ~np.array([cell.lower() in _NANS for cell in filled])
        # Python reads 1_000 as a number; in a table it is a slip of the keyboard.
        bad |= np.array(["_" in cell for cell in filled])
        return values, bad

    def as_text(self) -> NDArray[np.str_]:
        """Give the cells as text; whole numbers without a decimal point."""
        if self.text is not None:
            return np.array(self.text, dtype=np.str_)
        numbers = self._numbers()
        shown = [f"{v:.0f}" if v == round(v) else repr(v) for v in np.nan_to_num(numbers).tolist()]
        return np.where(self.blank, "", np.array(shown, dtype=np.str_))


@dataclass(frozen=True)
class Table:
    """The columns of a file, and where each row stands in it."""

    source: str
    sha256: str
    columns: list[Column]
    line: NDArray[np.intp]
    place: str  # "line" of a text file, "row" of a Parquet file
    header_line: int | None = None  # None where the file has no lines

    def error(self, message: str, row: int | None = None, column: str | None = None) -> Exception:
        """Make a MeasurementsError with the place before the message; no row means the header."""
        where = [self.source]
        if row is not None:
            where.append(f"{self.place} {self.line[row]}")
        elif self.header_line is not None:
            where.append(f"line {self.header_line}")
        if column is not None:
            where.append(f"column '{column}'")
        return MeasurementsError(f"{', '.join(where)}: {message}")


_NANS = ("nan", "+nan", "-nan")


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def read_table(path: str | Path) -> Table:
    """Read a CSV or Parquet file, told apart by its content.

    Raises MeasurementsError where the file cannot be read, is of another kind, or is no table.
    """
    path = Path(path)
    source = str(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise MeasurementsError(f"{source}: no such file") from None
    except IsADirectoryError:
        raise MeasurementsError(f"{source}: a folder, expected a CSV or Parquet file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise MeasurementsError(f"{source}: cannot be read: {reason}") from None
    digest = hashlib.sha256(data).hexdigest()
    if data.startswith(b"PAR1"):
        return _parquet(data, source, digest)
    return _csv(_text(data, source), source, digest)


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


def _parquet(data: bytes, source: str, digest: str) -> Table:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MeasurementsError(
            f"{source}: reading Parquet needs pyarrow: pip install 'smallwheel_ros[parquet]'"
        ) from None
    try:
        table = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
        columns = [
            _parquet_column(pyarrow, str(name), column)
            for name, column in zip(table.column_names, table.columns, strict=True)
            if not str(name).startswith("__index_level_")
        ]
    except MeasurementsError:
        raise
    except Exception as error:  # pyarrow raises many kinds for a damaged file
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise MeasurementsError(f"{source}: a damaged Parquet file: {reason}") from None
    if not columns or not table.num_rows:
        raise MeasurementsError(f"{source}: no rows")
    return Table(source, digest, columns, np.arange(1, table.num_rows + 1, dtype=np.intp), "row")


def _parquet_column(pyarrow: Any, name: str, column: Any) -> Column:
    blank = np.asarray(column.is_null().to_numpy(), dtype=bool)
    kind = column.type
    number = pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)
    if number or pyarrow.types.is_decimal(kind):
        values = column.cast(pyarrow.float64()).to_numpy()
        return Column(name, None, np.asarray(values, dtype=float), blank)
    cells = ["" if cell is None else str(cell).strip() for cell in column.to_pylist()]
    return Column(name, cells, None, np.array([not cell for cell in cells]))
