"""From cells to numbers, whatever the decimal mark; what could be read in two ways is refused.

A cell alone may say what its mark is: 8,5 and 0,008 and 1.234,5 cannot be anything else. But 1.234 is
1234 to one and 1.234 to another. Such a cell is read as the rest of its column is, else as the rest
of the table; where these do not say it, or say both, it is no number.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import Cell, Percent, is_blank
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
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)
# Minus signs and blanks of other kinds, as spreadsheets and typesetters write them.
_PLAIN = str.maketrans(dict.fromkeys("−‒–", "-") | dict.fromkeys("\u00a0\u202f\u2009\u2007", " "))
_A_MARK = re.compile(r"[.,]")


@dataclass
class Numbers:
    """A column as numbers.

    values: NaN where blank or no number. blank: nothing was measured. percent: shares that the cell
    gives in per cent. faults: by row, why the cell is no number, "" where it is any other text.
    missing: texts that mean blank. comma: whether decimal commas were read.
    """

    values: Array
    blank: Mask
    percent: Mask | None = None
    faults: dict[int, str] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    comma: bool = False


def read_numbers(columns: list[Sequence[Cell]], semicolons: bool) -> list[Numbers]:
    """Numbers of all columns of a table; semicolons: a comma can be nothing but a decimal mark."""
    quick = [_plain_numbers(cells) for cells in columns]
    left = [i for i, found in enumerate(quick) if found is None]
    evidence = [_evidence(columns[i]) if quick[i] is None else set() for i in range(len(columns))]
    commas = any("," in kinds or "?," in kinds for kinds in evidence)
    if commas:  # only then a point may be anything but a decimal point
        evidence = [_evidence(cells) for cells in columns]
        left = [i for i in range(len(columns)) if quick[i] is None or evidence[i] == {"?."}]
    table = set().union(*evidence) & {".", ","}
    if not table:
        table = {","} if semicolons and commas else {"."} if not commas else set()
    for i in left:
        own = evidence[i] & {".", ","}
        quick[i] = _any_numbers(columns[i], own or table, evidence[i])
    return [found for found in quick if found is not None]


def _plain_numbers(cells: Sequence[Cell]) -> Numbers | None:
    """The fast way: numbers with a decimal point and blanks, nothing else."""
    if type(cells[0]) is float and set(map(type, cells)) == {float}:
        return Numbers(np.array(cells, dtype=float), np.zeros(len(cells), dtype=bool))
    try:
        joined = "".join(cells)  # type: ignore[arg-type]
    except TypeError:  # texts and numbers
        return None
    texts: Sequence[str] = cells  # type: ignore[assignment]
    if "_" in joined or not joined.isascii():  # Python takes 1_000 and ٣ for numbers
        return None
    blank: Mask = np.zeros(len(texts), dtype=bool)
    values: Array
    try:
        values = np.fromiter(map(float, texts), float, len(texts))
    except ValueError:
        blank = np.array([not cell or cell.isspace() for cell in texts])
        try:
            values = np.array([float(c) if c and not c.isspace() else np.nan for c in texts])
        except ValueError:
            return None
    if not np.isfinite(values[~blank]).all():
        return None
    return Numbers(values, blank)


def _parts(cell: str) -> re.Match[str] | None:
    text = cell.translate(_PLAIN).strip().removesuffix("%").rstrip()
    found = _NUMBER.fullmatch(text)
    if found is None or not re.search("[0-9]", text) or (
        found["sep"] is not None and found["sep"] == found["mark"]
    ):  # fmt: skip
        return None
    return found


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


def _evidence(cells: Sequence[Cell]) -> set[str]:
    """Kinds of marks among the column's texts that are numbers."""
    kinds: set[str] = set()
    for cell in cells:
        if isinstance(cell, str) and _A_MARK.search(cell):
            found = _parts(cell)
            if found is not None:
                kinds.add(_kind(found))
    return kinds


def _any_numbers(cells: Sequence[Cell], marks: set[str], evidence: set[str]) -> Numbers:
    """The column cell by cell. marks: the decimal marks that ambiguous cells may be read by."""
    count = len(cells)
    result = Numbers(np.full(count, np.nan), np.zeros(count, dtype=bool))
    percent = np.zeros(count, dtype=bool)
    groups = _has_groups(cells, marks)
    mixed = {".", ","} <= evidence
    for row, cell in enumerate(cells):
        if not isinstance(cell, str):
            result.values[row] = cell
            percent[row] = isinstance(cell, Percent)
        elif is_blank(cell):
            result.blank[row] = True
        elif cell.strip().lower() in MISSING:
            result.blank[row] = True
            result.missing.add(cell.strip())
        elif _NOT_FINITE.fullmatch(cell.strip()):
            result.values[row] = float(cell)
        else:
            found = _parts(cell)
            if found is None:
                result.faults[row] = ""
                continue
            kind = _kind(found)
            if mixed and kind:
                result.faults[row] = MIXED
                continue
            value = _value(found, kind, marks, groups)
            if value is None:
                result.faults[row] = TWO_WAYS
                continue
            share = cell.rstrip().endswith("%")
            percent[row] = share
            result.values[row] = value / 100.0 if share else value
            result.comma |= kind == "," or (kind == "?," and marks == {","})
    result.percent = percent if percent.any() else None
    return result


def _has_groups(cells: Sequence[Cell], marks: set[str]) -> bool:
    """Whether marks of thousands are shown beyond doubt: 1.234,5 or 1.234.567 by its decimal comma."""
    other = {",": ".", ".": ","}.get(next(iter(marks), "")) if len(marks) == 1 else None
    return other is not None and any(
        isinstance(cell, str) and other in cell and (f := _parts(cell)) is not None and f["sep"] == other
        for cell in cells
    )  # fmt: skip


def _value(found: re.Match[str], kind: str, marks: set[str], groups: bool) -> float | None:
    text = found[0]
    if kind.startswith("?"):
        mark = kind[1]
        if marks == {mark}:
            return float(text.replace(mark, "."))
        return float(text.replace(mark, "")) if groups and len(marks) == 1 else None
    if found["sep"] is not None:
        text = text.replace(found["sep"], "")
    return float(text.replace(",", "."))
