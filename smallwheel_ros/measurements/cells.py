"""A table as its file has it: columns of cells, where each row stands, and what is too much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError

Array = NDArray[np.float64]

_LONGEST_SHOWN = 60  # characters of a cell or header that a message repeats

# What a table may ask for. A table of steady measurements has up to 1e5 rows and a few tens of
# columns; these limits keep the memory that any file can take to about a gigabyte.
MOST_BYTES = 64 * 2**20  # of the file: 13 characters in each of the most cells
MOST_CELLS = 5_000_000
# Rows times the longest cell, summed over the columns: what they take as arrays of text, of which
# NumPy gives each cell the length of the longest (4 bytes a character). The longest way to write a
# double has 24 characters, so a table of numbers stays below.
MOST_CHARACTERS = 128_000_000
SMALLER = "split the table, or thin out rows of long records"


def clipped(text: str) -> str:
    """The text as a message repeats it: on one line, and not all of a long one."""
    text = " ".join(text[: 2 * _LONGEST_SHOWN].split())
    return text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."


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
        return clipped(
            self.text[row] if self.text is not None else repr(float(self._numbers()[row]))
        )

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
            where.append(f"column '{clipped(column)}'")
        return MeasurementsError(f"{', '.join(where)}: {message}")


_NANS = ("nan", "+nan", "-nan")


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def refuse_many_cells(source: str, rows: int, columns: int) -> None:
    """Refuse a table of more cells than `MOST_CELLS`."""
    if rows * columns > MOST_CELLS:
        raise MeasurementsError(
            f"{source}: {rows} rows of {columns} columns, expected at most {MOST_CELLS} cells: "
            f"{SMALLER}"
        )


def refuse_long_texts(table: Table) -> None:
    """Refuse a table of which one array a column would take too much memory."""
    total = 0
    for column in table.columns:
        if column.text is None:
            continue
        lengths = [len(cell) for cell in column.text]
        longest = max(lengths)
        total += longest * len(lengths)
        if total > MOST_CHARACTERS:
            raise table.error(
                f"a cell of {longest} characters in a table of {len(lengths)} rows, expected "
                f"texts that take at most {MOST_CHARACTERS} characters (rows times the longest "
                "cell, over all columns): shorten it, or leave the column out",
                lengths.index(longest),
                column.header,
            )
