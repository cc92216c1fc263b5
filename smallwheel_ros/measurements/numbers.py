# SPDX-License-Identifier: Apache-2.0
"""From cells to numbers, whatever the decimal mark; what could be read in two ways is refused.

A cell alone may say what its mark is: 8,5 and 0,008 and 1.234,5 cannot be anything else. But 1.234 is
1234 to one and 1.234 to another. Such a cell is read as the rest of its column is, else as the rest
of the table; where these do not say it, or say both, it is no number.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from smallwheel_ros.measurements.cells import Cell, Percent
from smallwheel_ros.measurements.columns import Array, Mask
from smallwheel_ros.measurements.words import MISSING

TWO_WAYS = (
    "can be read in two ways, with a decimal mark or a mark of thousands: write the column "
    "without marks of thousands"
)
MIXED = "this column has decimal points and decimal commas: write one of them throughout"
_NUMBER = re.compile(
    r"[-+]?(?:(?P<int>[0-9]*)|(?P<groups>[0-9]{1,3}(?:(?P<sep>[ '’.,])[0-9]{3})(?:(?P=sep)[0-9]{3})*))"
    r"(?:(?P<mark>[.,])(?P<part>[0-9]*))?(?:[eE][-+]?[0-9]{1,4})?"
)
_BOTH = {".", ","}
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)
# Minus signs and blanks of other kinds, as spreadsheets and typesetters write them.
_PLAIN = str.maketrans(dict.fromkeys("−‒–", "-") | dict.fromkeys("\u00a0\u202f\u2009\u2007", " "))


class Spelling(NamedTuple):
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


def read_numbers(columns: Sequence[Sequence[Cell]], semicolons: bool) -> list[Numbers]:
    """Numbers of all columns of a table; semicolons: a comma can be nothing but a decimal mark."""
    if not any("," in _text(cells) for cells in columns):
        return [_column(cells, {"."}) for cells in columns]
    texts = [{cell for cell in cells if isinstance(cell, str)} for cells in columns]
    kinds = [{s.kind for s in map(_spelling, column) if s is not None} for column in texts]
    # a column of both marks is wrong already, and says nothing of the others
    all_kinds = set[str]().union(*(k for k in kinds if not k >= _BOTH))
    table = all_kinds & _BOTH
    if not table and "?," not in all_kinds:
        table = {"."}
    elif not table and semicolons and "?." not in all_kinds:
        table = {","}
    pairs = zip(columns, kinds, strict=True)
    return [_column(cells, own & _BOTH or table) for cells, own in pairs]


def _text(cells: Sequence[Cell]) -> str:
    return "".join([cell for cell in cells if isinstance(cell, str)])


def _plain_numbers(cells: Sequence[Cell], mark: str) -> Numbers | None:
    """A column of nothing but finite numbers with that decimal mark, many times quicker; else None."""
    texts = _text(cells)
    if not texts.isascii() or "_" in texts or (mark == "," and "." in texts):
        return None  # Python takes 1_000 and ٣ for numbers, which they are not
    percent = np.array([isinstance(cell, Percent) for cell in cells])
    if mark == ",":
        cells = [cell.replace(",", ".") if isinstance(cell, str) else cell for cell in cells]
    try:
        values = np.array(list(map(float, cells)))
    except ValueError:
        return None
    if not np.isfinite(values).all():
        return None
    return Numbers(values, np.zeros(values.size, bool), percent, comma=mark == "," and "," in texts)


def _column(cells: Sequence[Cell], marks: set[str]) -> Numbers:
    """The numbers of a column. marks: the decimal marks by which it is read."""
    if len(marks) == 1 and (plain := _plain_numbers(cells, *marks)) is not None:
        return plain
    size = len(cells)
    result = Numbers(np.full(size, np.nan), np.zeros(size, bool), np.zeros(size, bool))
    spelled = {cell: _spelling(cell) for cell in cells if isinstance(cell, str)}
    rare = _rare(cells, spelled) if marks == _BOTH else set[str]()
    other = {",": ".", ".": ","}[next(iter(marks))] if len(marks) == 1 else None
    groups = any(s is not None and other and s.sep == other for s in spelled.values())
    for row, cell in enumerate(cells):
        if not isinstance(cell, str):
            result.values[row], result.percent[row] = cell, isinstance(cell, Percent)
            continue
        found = spelled[cell]
        text = cell.strip()
        if not text or cell.replace(" ", "").lower() in MISSING:
            result.blank[row] = True
            result.missing |= {text} if text else set()
        elif _NOT_FINITE.fullmatch(text):
            result.values[row] = float(text)
        elif found is None or found.kind in rare:
            result.faults[row] = "" if found is None else MIXED
        elif (value := _value(found, marks, groups)) is None:
            result.faults[row] = TWO_WAYS
        else:
            result.percent[row] = text.endswith("%")
            result.values[row] = value / 100.0 if text.endswith("%") else value
            result.comma |= found.kind == "," or (found.kind == "?," and marks == {","})
    return result


def _spelling(cell: str) -> Spelling | None:
    text = cell.translate(_PLAIN).strip().removesuffix("%").rstrip()
    found = _NUMBER.fullmatch(text)
    if found is None or not any(found[name] for name in ("int", "groups", "part")):
        return None  # no digit before an exponent
    mark, sep, whole, part = found["mark"], found["sep"], found["int"] or "", found["part"]
    if sep is not None and sep == mark:
        return None
    if sep in (".", ","):
        return Spelling(text, "," if sep == "." else ".", sep)
    either = sep is None and mark and len(part) == 3 and 1 <= len(whole) <= 3 and whole[0] != "0"
    return Spelling(text, f"?{mark}" if either else mark or "", sep)


def _rare(cells: Sequence[Cell], spelled: dict[str, Spelling | None]) -> set[str]:
    """Of the two marks of a column that of fewer cells, most likely the slip; both where they tie."""
    count = Counter(s.kind for cell in cells if (s := spelled.get(str(cell))) is not None)
    return {mark for mark in _BOTH if count[mark] == min(count[m] for m in _BOTH)}


def _value(found: Spelling, marks: set[str], groups: bool) -> float | None:
    text = found.text if found.sep is None else found.text.replace(found.sep, "")
    if found.kind.startswith("?") and marks != {found.kind[1]}:
        return float(text.replace(found.kind[1], "")) if groups and len(marks) == 1 else None
    return float(text.replace(",", "."))
