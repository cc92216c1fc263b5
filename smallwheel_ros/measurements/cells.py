# SPDX-License-Identifier: Apache-2.0
"""The cells of a table as read, and the numbers in them, whatever the decimal mark.

Some cells show their decimal mark themselves: 8,5 and 0,008 and 1.234,5 have only one reading. But
1.234 may mean 1234 or a little over 1: such a cell is read like the rest of its column, else like
the rest of the table; if these are ambiguous too, it is not a number.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.measurements.columns import WORDS, Array, Mask

SEARCHED = 40  # rows among which the header is: titles and remarks of a trial fill less than a page
MOST_BYTES = (
    64 * 2**20
)  # of a file; this and the next keep the memory of any table below a gigabyte
MOST_CELLS = 5_000_000
SMALLER = "split the table, or thin out rows of long records"
_SHOWN = 60  # characters that a message repeats


class MeasurementsError(SmallwheelError):
    """A table of measurements that cannot be used: names file, row, column, found and expected."""


class Percent(float):
    """A cell shown in per cent, as a fraction: 0.2 for 20 %."""


Cell = str | float  # a text file has texts only; "" is blank


@dataclass
class CellGrid:
    """The cells of a file, of one sheet of a workbook, or of a data frame, before a table is looked for.

    Attributes
    ----------
    rows
        The cells of each row; rows may differ in length, and one of them may be the header.
    numbers
        Each row's number in the file, from 1.
    place
        What `numbers` count, for messages: "line" of a text file, "row" of any other, "column" of a table
        that was transposed.
    header
        Column names, where the file keeps them apart from its rows; else None.
    comma
        Whether commas do not separate cells in this file: an ambiguous 1,234 is then a decimal number.
    said
        Sentences for the user about how the file was read.
    source, sha256
        Path of the file, and the hash of its content.
    merged
        Merged cells within one column, whose first cell stands for all: column from 0, first and last row.
    sheet
        Name of the sheet; empty if the file is no workbook.
    shares
        Whether the file keeps percentages as plain fractions, so that they cannot be recognised.
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
    shares: bool = False


def clipped(text: str) -> str:
    """The text as quoted in a message: on one line, and shortened if long."""
    text = " ".join(text[: 2 * _SHOWN].split())
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def map_option(name: str, header: str) -> str:
    """Write out the option --map for a header, as it has to be typed: whole, and quoted for a shell.

    Parameters
    ----------
    name
        What the column is, with a unit or without: `sinkage`, `load [kg]`.
    header
        The header's text, as in the table.
    """
    return f"--map {shlex.quote(f'{name}=' + ' '.join(header.split()))}"


def shown(cell: Cell) -> str:
    """A cell as text for messages and pages; whole numbers without a decimal point."""
    if isinstance(cell, str):
        return clipped(cell)
    return f"{cell:.0f}" if float(cell).is_integer() else repr(float(cell))


def is_blank(cell: Cell) -> bool:
    """Whether the cell is empty."""
    return isinstance(cell, str) and not cell.strip()


def cell_of(value: Any) -> Cell:
    """Convert a value that another library has read to a cell: a number, or the text of anything else."""
    number = isinstance(value, (int, float, np.integer, np.floating))
    return (
        float(value) if number and not isinstance(value, (bool, np.bool_)) else str(value).strip()
    )


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
    """A text that is a number, and the marks in it.

    kind: its decimal mark, "." or ","; "" if it has none; "?." or "?," if that mark may be one of thousands.
    sep: the mark of thousands; None if it has none.
    """

    text: str
    kind: str
    sep: str | None


@dataclass
class Numbers:
    """The cells of one column, read as numbers. Arrays have shape (rows,).

    Attributes
    ----------
    values
        The numbers, in the column's own unit; NaN where the cell is blank or not a number.
    blank
        Whether the cell is empty, or has a text that means it.
    percent
        Whether the cell is in per cent; its value is then a fraction, 0.2 for 20 %.
    faults
        Why a cell is not a number, by index of the row; an empty reason for a plain text.
    missing
        The texts in this column that mean a blank cell, as n/a.
    comma
        Whether decimal commas were read.
    """

    values: Array
    blank: Mask
    percent: Mask
    faults: dict[int, str] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    comma: bool = False


def read_numbers(columns: Sequence[Sequence[Cell]], comma: bool) -> list[Numbers]:
    """Read the cells of all columns of a table as numbers; one result for each column.

    Parameters
    ----------
    columns
        Cells of each column; all columns have the same length.
    comma
        Whether commas do not separate cells: where no cell decides, 1,234 is then a decimal number. Without
        it such a cell is a fault.
    """
    # the texts of each column, as one, in which a sign is looked for quickly
    joined = ["".join([c for c in cells if isinstance(c, str)]) for cells in columns]
    if not any("," in texts for texts in joined):
        return [_column(cells, t, {"."}) for cells, t in zip(columns, joined, strict=True)]
    spelled = [map(_spelling, {c for c in cells if isinstance(c, str)}) for cells in columns]
    kinds = [{s.kind for s in texts if s is not None} for texts in spelled]
    # a column with both marks is wrong in any case, and is no evidence for the other columns
    seen = set[str]().union(*(k for k in kinds if not k >= _BOTH))
    table = seen & _BOTH
    if not table and "?," not in seen:
        table = {"."}
    elif not table and comma and "?." not in seen:
        table = {","}
    return [
        _column(cells, texts, own & _BOTH or table)
        for cells, texts, own in zip(columns, joined, kinds, strict=True)
    ]


def _quick(cells: Sequence[Cell], texts: str, mark: str) -> Numbers | None:
    """Read a column of nothing but finite numbers with that decimal mark, many times quicker; else None."""
    if not texts.isascii() or "_" in texts or (mark == "," and "." in texts):
        return None  # Python takes 1_000 and ٣ for numbers, which they are not
    if mark == ",":
        cells = [cell.replace(",", ".") if isinstance(cell, str) else cell for cell in cells]
    try:
        values = np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        return None
    if not np.isfinite(values).all():
        return None
    blank, percent = np.zeros(values.size, dtype=bool), np.zeros(values.size, dtype=bool)
    if Percent in set(map(type, cells)):
        percent[:] = [isinstance(cell, Percent) for cell in cells]
    return Numbers(values, blank, percent, comma=mark == "," and "," in texts)


def _column(cells: Sequence[Cell], texts: str, marks: set[str]) -> Numbers:
    """Read one column. texts: the texts of its cells, joined. marks: the decimal marks that it may have."""
    if len(marks) == 1 and (plain := _quick(cells, texts, *marks)) is not None:
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
            result.values[row], result.percent[row] = cell, isinstance(cell, Percent)
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
