# SPDX-License-Identifier: Apache-2.0
"""A table as it was found, a grid of cells, where each row stands, and what is too much."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.measurements.long_text import LongColumn, LongText

_LONGEST_SHOWN = 60  # characters of a cell or header that a message repeats
_MOST_PROBLEMS = 20  # that a message lists: a page of a terminal
_MOST_ROWS = 10  # that one of them lists

# What a table may ask for. A table of steady measurements has up to 1e5 rows and a few tens of
# columns; these limits keep the memory that any file can take to about half a gigabyte.
MOST_BYTES = 64 * 2**20  # of the file: 13 characters in each of the most cells
MOST_CELLS = 5_000_000
MOST_COLUMNS = 20_000  # a sheet of Excel has 16,384
# Rows times the longest cell, summed over the columns: what they take as arrays of text, of which NumPy
# gives each cell the length of the longest (4 bytes a character).
MOST_CHARACTERS = 64_000_000
EXPECTED = "expected a table: CSV text, xlsx, ods or Parquet"
SMALLER = "split the table, or thin out rows of long records"


class Percent(float):
    """A cell that was shown in per cent, as the share that it is: 0.2 for 20 %."""


Cell = str | float  # a text file has texts only; "" is blank


def clipped(text: str) -> str:
    """The text as a message repeats it: on one line, and not all of a long one."""
    text = " ".join(text[: 2 * _LONGEST_SHOWN].split())
    return text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."


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


def all_blank(cells: Sequence[Cell]) -> bool:
    """Whether nothing stands in the column."""
    if isinstance(cells, LongColumn):
        return bool(cells.blank.all())
    return all(is_blank(cell) for cell in cells)


def texts_only(cells: Sequence[Cell]) -> TypeGuard[Sequence[str]]:
    """Whether every cell is a text, as in any text file; the rest can be skipped then."""
    return set(map(type, cells)) <= {str}


@contextmanager
def without_collection() -> Iterator[None]:
    """Without garbage collection: it would walk the rows again and again while they are made."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class MeasurementsError(SmallwheelError):
    """A table of measurements that cannot be used: names file, row, column, found and expected."""


@dataclass
class Grid:
    """The rows of a table as a file or a data frame has them, the header among them or above.

    rows: they may be of different lengths. numbers: of each row, its line or row in the file.
    place: "line" of a text file, "row" of any other. header: column names where the file keeps
    them apart from its rows (Parquet, data frames). comma: whether a comma can only be a decimal
    mark, as cells are separated by something else. said: what was understood on the way.
    long: of a long text file, of which `rows` are the first ones only; `whole` has all of them.
    """

    source: str
    sha256: str
    rows: list[Sequence[Cell]]
    numbers: list[int]
    place: str
    header: list[str] | None = None
    comma: bool = False
    said: list[str] = field(default_factory=list)
    long: LongText | None = None
    whole: Callable[[], Grid] | None = None


@dataclass
class Problems:
    """What is wrong with a table, all of it: said at once, by `raise_any`."""

    source: str
    place: str
    numbers: NDArray[np.intp]
    header: int | None = None  # the header's line
    found: list[str] = field(default_factory=list)

    def add(
        self, message: str, column: str | None = None, rows: Iterable[int] | None = None
    ) -> None:
        """Add a problem of these rows; without rows it is one of the header."""
        where = []
        more = ""
        if rows is not None:
            lines = [int(self.numbers[row]) for row in rows]
            where.append(f"{self.place} {lines[0]}")
            if len(lines) > 1:
                listed = ", ".join(str(line) for line in lines[1 : _MOST_ROWS + 1])
                dots = ", ..." if len(lines) > _MOST_ROWS + 1 else ""
                more = f" (and {len(lines) - 1} more like it: {self.place} {listed}{dots})"
        elif self.header is not None:
            where.append(f"{self.place} {self.header}")
        if column is not None:
            where.append(f"column '{clipped(column)}'")
        self.found.append((f"{', '.join(where)}: " if where else "") + message + more)

    def raise_any(self) -> None:
        """Raise MeasurementsError with all that was found, if anything was."""
        if not self.found:
            return
        if len(self.found) == 1:
            first = self.found[0]
            comma = ", " if first.startswith(("line ", "row ", "column ")) else ": "
            raise MeasurementsError(f"{self.source}{comma}{first}")
        lines = [f"{self.source}: {len(self.found)} problems", *self.found[:_MOST_PROBLEMS]]
        more = len(self.found) - _MOST_PROBLEMS
        if more > 0:
            lines.append(f"and {more} more: these {_MOST_PROBLEMS} first, they may be the cause")
        raise MeasurementsError("\n  ".join(lines))


def refuse_many_cells(source: str, rows: int, columns: int) -> None:
    """Refuse a table of more cells than `MOST_CELLS`, or more columns than `MOST_COLUMNS`."""
    if columns > MOST_COLUMNS:
        raise MeasurementsError(f"{source}: {columns} columns, expected at most {MOST_COLUMNS}")
    if rows * columns > MOST_CELLS:
        raise MeasurementsError(
            f"{source}: {rows} rows of {columns} columns, expected at most {MOST_CELLS} cells: "
            f"{SMALLER}"
        )


def array_of_texts(cells: Sequence[Cell]) -> NDArray[np.str_]:
    """Cells as an array of texts."""
    cells = cells.texts if isinstance(cells, LongColumn) else cells
    if texts_only(cells):
        return np.array(list(map(str.strip, cells)), dtype=np.str_)
    texts = [cell.strip() if isinstance(cell, str) else shown(cell) for cell in cells]
    return np.array(texts, dtype=np.str_)


def refuse_long_texts(columns: Iterable[tuple[str, Sequence[Cell]]], problems: Problems) -> None:
    """Refuse a table of which an array of texts for each of these columns would take too much memory."""
    total = 0
    for header, cells in columns:
        try:
            longest = max(map(len, cells), default=0)  # type: ignore[arg-type]
        except TypeError:  # numbers, which have no length
            longest = max((len(c) for c in cells if isinstance(c, str)), default=0)
        total += longest * len(cells)
        if total > MOST_CHARACTERS:
            row = next(i for i, c in enumerate(cells) if isinstance(c, str) and len(c) == longest)
            problems.add(
                f"a cell of {longest} characters in a table of {len(cells)} rows, expected texts "
                f"that take at most {MOST_CHARACTERS} characters (rows times the longest cell, over "
                "all columns): shorten it, or leave the column out",
                header,
                [row],
            )
            problems.raise_any()
