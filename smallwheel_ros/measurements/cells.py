# SPDX-License-Identifier: Apache-2.0
"""A table as it was found, a grid of cells, where each row stands, and what is too much."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError

_SHOWN = 60  # characters of a cell or header that a message repeats
_MOST_PROBLEMS, _MOST_ROWS = 20, 10  # that a message lists
# These keep the memory that any file can take to about half a gigabyte.
MOST_BYTES = 64 * 2**20
MOST_CELLS = 5_000_000
MOST_COLUMNS = 20_000  # a sheet of Excel has 16,384
MOST_CHARACTERS = 64_000_000  # rows times the longest cell, summed over the columns of texts
EXPECTED = "expected a table: CSV text, xlsx, ods or Parquet"
SMALLER = "split the table, or thin out rows of long records"
TOO_MANY = f"expected at most {MOST_CELLS} cells: {SMALLER}"


class MeasurementsError(SmallwheelError):
    """A table of measurements that cannot be used: names file, row, column, found and expected."""


class Percent(float):
    """A cell that was shown in per cent, as the share that it is: 0.2 for 20 %."""


Cell = str | float  # a text file has texts only; "" is blank


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


@contextmanager
def naming(source: str) -> Iterator[None]:
    """Say in which table it is what is refused inside."""
    try:
        yield
    except MeasurementsError as error:
        comma = ", " if str(error).startswith(("line ", "row ", "column ")) else ": "
        raise MeasurementsError(f"{source}{comma}{error}") from None


def clipped(text: str) -> str:
    """The text as a message repeats it: on one line, and not all of a long one."""
    text = " ".join(text[: 2 * _SHOWN].split())
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def shown(cell: Cell) -> str:
    """Give a cell as a message and a text show it; whole numbers without a decimal point."""
    if isinstance(cell, str):
        return clipped(cell)
    if isinstance(cell, Percent):
        return f"{100.0 * cell:.10g} %"
    return f"{cell:.0f}" if float(cell).is_integer() else repr(float(cell))


def is_blank(cell: Cell) -> bool:
    """Whether nothing stands in the cell."""
    return isinstance(cell, str) and not cell.strip()


def array_of_texts(cells: Sequence[Cell]) -> NDArray[np.str_]:
    """Cells as an array of texts."""
    return np.array([c.strip() if isinstance(c, str) else shown(c) for c in cells], dtype=np.str_)


@dataclass
class Problems:
    """What is wrong with a table, all of it: said at once, by `raise_any`.

    place, lines: what the lines or rows of the file are called, and that of each row of the table.
    header: the header's line. begins: the first cell of each row, that of column `first`, by which
    people know it.
    """

    source: str
    place: str
    lines: NDArray[np.intp]
    header: int | None = None
    found: list[str] = field(default_factory=list)
    begins: Sequence[Cell] = ()
    first: str = ""

    def add(
        self, message: str, column: str | None = None, rows: Iterable[int] | None = None
    ) -> None:
        """Add a problem of these rows; without rows it is one of the header."""
        rows = [] if rows is None else list(rows)
        lines = [int(self.lines[row]) for row in rows]
        first = lines[0] if lines else self.header
        where = [] if first is None else [f"{self.place} {first}"]
        where += [] if column is None else [f"column '{clipped(column)}'"]
        if len(lines) > 1:
            dots = ", ..." if len(lines) > _MOST_ROWS + 1 else ""
            listed = ", ".join(map(str, lines[1 : _MOST_ROWS + 1]))
            message += f" (and {len(lines) - 1} more like it: {self.place} {listed}{dots})"
        if self.begins and (column is None or column not in self.first):
            texts = dict.fromkeys(shown(self.begins[row]) for row in rows[: _MOST_ROWS + 1])
            if names := ", ".join(f"'{text}'" for text in texts if text.strip()):
                message += f"; the row{'s begin' if len(texts) > 1 else ' begins'} with {names}"
        self.found.append(f"{', '.join(where)}: {message}" if where else message)

    def raise_any(self) -> None:
        """Raise MeasurementsError with all that was found, if anything was."""
        lines = self.found[:_MOST_PROBLEMS]
        if len(self.found) > 1:
            lines.insert(0, f"{len(self.found)} problems")
        if (more := len(self.found) - _MOST_PROBLEMS) > 0:
            lines.append(f"and {more} more: these {_MOST_PROBLEMS} first, they may be the cause")
        with naming(self.source):
            if lines:
                raise MeasurementsError("\n  ".join(lines))


def refuse_many_cells(rows: int, columns: int) -> None:
    """Refuse a table of more cells than `MOST_CELLS`, or more columns than `MOST_COLUMNS`."""
    if columns > MOST_COLUMNS:
        raise MeasurementsError(f"{columns} columns, expected at most {MOST_COLUMNS}")
    if rows * columns > MOST_CELLS:
        raise MeasurementsError(
            f"{rows} rows of {columns} columns, expected at most {MOST_CELLS} cells: {SMALLER}"
        )


def refuse_long_texts(columns: Iterable[tuple[str, Sequence[Cell]]], problems: Problems) -> None:
    """Refuse a table of which an array of texts for each of these columns takes too much memory."""
    total = 0
    for header, cells in columns:
        lengths = [len(c) if isinstance(c, str) else 0 for c in cells]
        total += max(lengths, default=0) * len(cells)
        if total > MOST_CHARACTERS:
            longest = max(lengths)
            problems.add(
                f"a cell of {longest} characters in a table of {len(cells)} rows, expected texts "
                f"that take at most {MOST_CHARACTERS} characters (rows times the longest cell, over "
                "all columns): shorten it, or leave the column out",
                header,
                [lengths.index(longest)],
            )
            problems.raise_any()
