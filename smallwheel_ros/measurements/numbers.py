# SPDX-License-Identifier: Apache-2.0
"""From cells to numbers, whatever the decimal mark; what could be read in two ways is refused.

A cell alone may say what its mark is: 8,5 and 0,008 and 1.234,5 cannot be anything else. But 1.234 is
1234 to one and 1.234 to another. Such a cell is read as the rest of its column is, else as the rest
of the table; where these do not say it, or say both, it is no number.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import Cell, Percent, is_blank
from smallwheel_ros.measurements.long_text import LongColumn
from smallwheel_ros.measurements.words import MISSING

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TWO_WAYS = (
    "can be read in two ways, with a decimal mark or a mark of thousands: write the column "
    "without marks of thousands"
)
MIXED = "this column has decimal points and decimal commas: write one of them throughout"
_NUMBER = re.compile(
    r"[-+]?(?:(?P<int>[0-9]*)|(?P<groups>[0-9]{1,3}(?:(?P<sep>[ '’.,])[0-9]{3})(?:(?P=sep)[0-9]{3})*))"
    r"(?:(?P<mark>[.,])(?P<part>[0-9]*))?(?:[eE][-+]?[0-9]{1,4})?"
)
_MARKS = {".", ","}
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)
# Minus signs and blanks of other kinds, as spreadsheets and typesetters write them.
_PLAIN = str.maketrans(dict.fromkeys("−‒–", "-") | dict.fromkeys("\u00a0\u202f\u2009\u2007", " "))


class Spelling(NamedTuple):
    """A text that is a number.

    kind: the decimal mark that it shows: ".", ",", "" for none, "?." or "?," for one of two.
    """

    match: re.Match[str]
    kind: str


Spellings = Mapping[str, Spelling | None]  # by text; None where it is no number


@dataclass
class Numbers:
    """A column as numbers.

    values: NaN where blank or no number. blank: nothing was measured. percent: shares that the cell
    gives in per cent. faults: by row, why the cell is no number, "" where it is any other text.
    missing: texts that mean blank. comma, point: whether decimal commas, points were read.
    """

    values: Array
    blank: Mask
    percent: Mask
    faults: dict[int, str] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    comma: bool = False
    point: bool = False


def read_numbers(columns: Sequence[Sequence[Cell]], semicolons: bool) -> list[Numbers]:
    """Numbers of all columns of a table; semicolons: a comma can be nothing but a decimal mark."""
    found = []
    spelled: list[Spellings] = []
    left: list[list[int]] = []  # rows to be read cell by cell
    for cells in columns:
        numbers, rows = _plain_numbers(cells)
        found.append(numbers)
        left.append(rows)
        spelled.append(_spellings(cells, rows))
    kinds = _kinds(spelled)
    commas = any(numbers.comma for numbers in found) or bool(kinds & {",", "?,"})
    points = any(numbers.point for numbers in found) or "." in kinds
    only_commas = commas and not points and (semicolons or _has_sure_comma(columns))
    if commas and not only_commas:
        # Only in such a table a point may be no decimal point, and a comma no decimal comma.
        for i, cells in enumerate(columns):
            if found[i].comma or found[i].point:
                left[i] = [row for row, cell in enumerate(cells) if isinstance(cell, str)]
                spelled[i] = _spellings(cells, left[i])
        # a column of both is wrong already, and says nothing of the others
        kinds = _kinds([texts for texts in spelled if not _kinds([texts]) >= _MARKS])
    table = kinds & _MARKS or ({","} if only_commas else set() if commas else {"."})
    for cells, numbers, rows, texts in zip(columns, found, left, spelled, strict=True):
        _read_cells(numbers, cells, rows, texts, table)
    return found


def _kinds(spelled: Sequence[Spellings]) -> set[str]:
    """Kinds of the marks in these columns."""
    return {found.kind for texts in spelled for found in texts.values() if found is not None}


def _has_sure_comma(columns: Sequence[Sequence[Cell]]) -> bool:
    """Whether a cell shows a decimal comma beyond doubt."""
    texts = (cell for cells in columns for cell in cells if isinstance(cell, str) and "," in cell)
    return any((found := _spelling(text)) is not None and found.kind == "," for text in texts)


def _plain_numbers(cells: Sequence[Cell]) -> tuple[Numbers, list[int]]:
    """The column's cells that are numbers or blank beyond doubt, and the rows of all others."""
    if isinstance(cells, LongColumn):
        none = np.zeros(len(cells), dtype=bool)
        numbers = Numbers(cells.values.copy(), cells.blank.copy(), none, comma=cells.comma)
        return numbers, np.flatnonzero(cells.left).tolist()
    values = [_plain_number(cell) for cell in cells]
    blank = np.array([is_blank(cell) for cell in cells])
    percent = np.array([isinstance(cell, Percent) for cell in cells])
    left = [row for row, value in enumerate(values) if value is None and not blank[row]]
    known = np.array([np.nan if value is None else value for value in values])
    point = any(isinstance(cell, str) and "." in cell for cell in cells)
    return Numbers(known, blank, percent, point=point), left


def _plain_number(cell: Cell) -> float | None:
    """A number with a decimal point, or None. Python takes 1_000 and ٣ for numbers, which they are not."""
    if not isinstance(cell, str):
        return cell
    if not cell.isascii() or "_" in cell:
        return None
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _spellings(cells: Sequence[Cell], rows: Sequence[int]) -> Spellings:
    """How the texts of these rows are written."""
    texts = {cell for row in rows if isinstance(cell := cells[row], str)}
    return {text: _spelling(text) for text in texts}


def _spelling(cell: str) -> Spelling | None:
    text = cell.translate(_PLAIN).strip().removesuffix("%").rstrip()
    found = _NUMBER.fullmatch(text)
    if found is None or not any(found[name] for name in ("int", "groups", "part")):
        return None  # no digit before an exponent
    if found["sep"] is not None and found["sep"] == found["mark"]:
        return None
    return Spelling(found, _kind(found))


def _kind(found: re.Match[str]) -> str:
    """The decimal mark that the cell shows: ".", ",", "" for none, "?." or "?," for one of two."""
    mark, sep = found["mark"], found["sep"]
    if sep in (".", ","):
        return "," if sep == "." else "."
    if mark is None:
        return ""
    whole, part = found["int"] or "", found["part"]
    if sep is None and len(part) == 3 and 1 <= len(whole) <= 3 and not whole.startswith("0"):
        return f"?{mark}"
    return str(mark)


def _read_cells(
    result: Numbers, cells: Sequence[Cell], rows: Sequence[int], texts: Spellings, table: set[str]
) -> None:
    """Read these rows cell by cell. table: the marks by which a column is read that does not show one."""
    shown = _kinds([texts]) & _MARKS
    marks = shown or table
    rare = _rare_marks(cells, rows, texts) if shown == _MARKS else set()
    groups = _has_groups(texts, marks)
    for row in rows:
        cell = cells[row]
        if not isinstance(cell, str):
            continue
        found = texts[cell]
        result.values[row] = np.nan
        if is_blank(cell):
            result.blank[row] = True
        elif cell.replace(" ", "").lower() in MISSING:
            result.blank[row] = True
            result.missing.add(cell.strip())
        elif _NOT_FINITE.fullmatch(cell.strip()):
            result.values[row] = float(cell)
        elif found is None:
            result.faults[row] = ""
        elif found.kind in rare:
            result.faults[row] = MIXED
        else:
            value = _value(found, marks, groups)
            if value is None:
                result.faults[row] = TWO_WAYS
                continue
            share = cell.rstrip().endswith("%")
            result.percent[row] = share
            result.values[row] = value / 100.0 if share else value
            result.comma |= found.kind == "," or (found.kind == "?," and marks == {","})


def _rare_marks(cells: Sequence[Cell], rows: Sequence[int], texts: Spellings) -> set[str]:
    """Of the two marks of a column that of fewer cells, most likely the slip; both where they tie."""
    kinds = Counter(found.kind for row in rows if (found := texts.get(str(cells[row]))) is not None)
    fewest = min(kinds[mark] for mark in _MARKS)
    return {mark for mark in _MARKS if kinds[mark] == fewest}


def _has_groups(texts: Spellings, marks: set[str]) -> bool:
    """Whether marks of thousands are shown beyond doubt: 1.234,5 or 1.234.567 by its decimal comma."""
    other = {",": ".", ".": ","}.get(next(iter(marks), "")) if len(marks) == 1 else None
    return any(
        found is not None and other and found.match["sep"] == other for found in texts.values()
    )


def _value(found: Spelling, marks: set[str], groups: bool) -> float | None:
    text, kind = found.match[0], found.kind
    if kind.startswith("?"):
        mark = kind[1]
        if marks == {mark}:
            return float(text.replace(mark, "."))
        return float(text.replace(mark, "")) if groups and len(marks) == 1 else None
    if found.match["sep"] is not None:
        text = text.replace(found.match["sep"], "")
    return float(text.replace(",", "."))
