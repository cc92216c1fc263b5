# SPDX-License-Identifier: Apache-2.0
"""Rows that a spreadsheet computed from those above them, told by their numbers, whatever the language.

Such a row has one statistic of the rows above in all of its numbers. A measurement may have it too: the
third of three repeats, the centre of a grid. So evidence is weighed, in powers of ten (`_NEEDED`):

    numbers that vary    -log10 p, p the chance that a measurement agrees within the printed digits
    constant columns     a value that the column never has (a deviation of 0, a sum)
    digits               more of them than any measurement above has
    the name             of another kind than the names above; one of their kind speaks against it
    blanks               where every row above has a value

Rows at one end of a block are weighed together, as a mean and its deviation stand together.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import Cell, is_blank, shown
from smallwheel_ros.measurements.columns import Array, Mask, is_response
from smallwheel_ros.measurements.numbers import Numbers

Index = NDArray[np.intp]

_NEEDED = 2.4  # evidence: one measurement in 250 of those that agree with a statistic anyway
_MOST_TOGETHER = 8  # rows of statistics below one block
_MOST_ENDS = 100  # rows that are looked at: a table of more blocks is a log
_LONG = 20_000  # rows of a table of which only the last are looked at
_MOST_DIGITS = 12  # behind the decimal mark: more are rounding of a double
_SAMPLED = 60  # cells of a column whose digits are counted
# Among measurements near the middle of a table: they scatter by a quarter of what the table spans.
_DENSITY = 3.2
_VARYING, _CONSTANT, _DIGITS = (
    1.25,
    1.5,
    0.75,
)  # most from all numbers that vary; each column; digit
_MOST_CONSTANT, _MOST_MORE = 3.0, 3.0
_OTHER_KIND, _NEW_NAME, _OWN_KIND = 2.0, 1.0, -3.0
_OFF_LEVEL = 0.5  # a setting that no row has: a mean, or the centre of a grid
_FEW = {2: -0.5, 3: -0.25}  # rows above
_MOSTLY = 0.8
_SHORT = 2  # letters of a code: a, b1
_TWO_CODES = 3  # names from which their kind is known


class Statistic(NamedTuple):
    """What a spreadsheet computes of columns; values: of each column.

    inside: it lies among the values. rounding: how far that of the values moves it, in units of their
    last digit.
    """

    name: str
    values: Array
    inside: bool
    rounding: float = 0.0


@np.errstate(all="ignore")  # values may be of any size, and a column blank
def statistics(x: Array) -> list[Statistic]:
    """All statistics of an array (rows, columns); NaN is blank."""
    known = np.isfinite(x)
    count = known.sum(axis=0).astype(float)
    total = np.where(known, x, 0.0).sum(axis=0)
    squares = np.where(known, (x - total / count) ** 2, 0.0).sum(axis=0)
    ordered = np.sort(x, axis=0)  # blanks last
    columns, half = np.arange(count.size), np.maximum(count, 1.0) / 2.0
    least, most = ordered[0], np.fmax.reduce(x)
    low, high = (ordered[(r - 1).astype(int), columns] for r in (np.ceil(half), np.floor(half) + 1))
    deviation = np.sqrt(squares / (count - 1.0))
    variation = deviation / np.abs(total / count)
    mean = 1.0 / np.sqrt(len(x))  # roundings of rows are independent
    return [
        Statistic("mean", total / count, True, mean),
        Statistic("median", (low + high) / 2.0, True, mean),
        Statistic("least", least, True),
        Statistic("most", most, True),
        Statistic("standard deviation", deviation, False, mean),
        Statistic("standard deviation", np.sqrt(squares / count), False, mean),
        Statistic("standard error", deviation / np.sqrt(count), False, mean),
        Statistic("variance", squares / (count - 1.0), False, mean),
        Statistic("coefficient of variation", variation, False, mean),
        Statistic("coefficient of variation", 100.0 * variation, False, mean),
        Statistic("range", most - least, False),
        Statistic("sum", total, False, 1.0 / mean),
        Statistic("count", count, False),
    ]


class Sheet(NamedTuple):
    """A table as it is searched. names: the columns that say how the rows are called, the surest first.

    needed: columns without which a row is no measurement. lines: of the file.
    """

    parsed: Mapping[int, Numbers]
    columns: Sequence[Sequence[Cell]]
    names: Sequence[Sequence[Cell]]
    titles: Mapping[int, str]
    needed: frozenset[int]
    lines: Index


@dataclass
class _Block:
    """The rows above a statistic, and what is known of each of their numeric columns."""

    values: Array
    rows: Index
    finest: Array  # digits behind the decimal mark
    answers: Mask
    statistics: list[Statistic]
    table: Array  # of their values


def computed_rows(sheet: Sheet, known: Mapping[int, str]) -> dict[int, str]:
    """Rows that are statistics of those above, and which; known: rows that are no measurements anyway."""
    if not sheet.parsed or len(sheet.lines) < _TWO_CODES:
        return {}
    found: dict[int, str] = {}
    values = np.column_stack([numbers.values for numbers in sheet.parsed.values()])
    gaps = np.flatnonzero(np.diff(sheet.lines) > 1) + 1
    values[np.isinf(values)] = np.nan
    for end in _ends(sheet, known, gaps):
        if end - 1 in found or end - 1 in known:
            continue
        outside = sorted({*found, *known})
        for count in range(min(_MOST_TOGETHER, end - 1), 0, -1):
            tail = np.arange(end - count, end)
            if not np.isin(tail, outside).any() and (
                named := _named(sheet, values, tail, outside, gaps)
            ):
                found |= named
                break
    return found


def _ends(sheet: Sheet, known: Mapping[int, str], gaps: Index) -> list[int]:
    """Rows (one behind them) at which statistics may end: of the table, of blocks, odd names."""
    ends = {len(sheet.lines), *gaps.tolist(), *known}
    if len(sheet.lines) > _LONG:
        return [len(sheet.lines)]
    texts = {row for numbers in sheet.parsed.values() for row in [*numbers.faults][:_MOST_ENDS]}
    ends |= {row + 1 for row in texts if _speaks(sheet, row)}
    for names in sheet.names:
        ends |= {row + 1 for row in _odd_names(names)}
    ordered = sorted(end for end in ends if end > 1)
    return [*ordered[:_MOST_ENDS], *([len(sheet.lines)] if len(ordered) > _MOST_ENDS else [])]


def _named(
    sheet: Sheet, values: Array, tail: Index, outside: list[int], gaps: Index
) -> dict[int, str]:
    """What each of the rows is of the block above or of all rows above; empty where one is not."""
    above = np.setdiff1d(np.arange(tail[0]), outside)
    if above.size < 2:
        return {}
    ends = [gap for gap in gaps.tolist() if gap <= tail[0]]
    ends += [i + 1 for i in outside if i < tail[0]]
    # a block may end at a blank row above its statistics
    starts = {0, *sorted(ends)[-2:]}
    best: tuple[float, dict[int, str]] = (0.0, {})
    for start in sorted(starts, reverse=True):
        rows = above[above >= start]
        if rows.size < 2:
            continue
        block = _block(sheet, values, rows)
        said: list[tuple[float, str]] = []
        for row in tail.tolist():
            evidence, name = _statistic(sheet, values, row, block)
            if not name or name in [other for _, other in said]:
                break  # repeats of the centre have one statistic alike
            said.append((evidence, name))
        if len(said) < len(tail):
            continue
        labels = [_label(sheet, row, block) for row in tail.tolist()]
        numbers = [evidence for evidence, _ in said]
        if min(a + b for a, b in zip(labels, numbers, strict=True)) < _OFF_LEVEL:
            continue  # the last measurement of repeats is like their mean
        # words in several rows say no more than one
        total = max(labels) + sum(numbers) + _FEW.get(rows.size, 0.0)
        if total >= _NEEDED and total > best[0]:
            named = [f"the {name} of the {rows.size} rows above" for _, name in said]
            best = (total, dict(zip(tail.tolist(), named, strict=True)))
    return best[1]


def _block(sheet: Sheet, values: Array, rows: Index) -> _Block:
    finest = [
        max((_digits(column[i], v) for i, v in _sample(values[:, j], rows)), default=0)
        for j, column in enumerate(sheet.columns[i] for i in sheet.parsed)
    ]
    answers = [is_response(sheet.titles[i]) for i in sheet.parsed]
    found = statistics(values[rows])
    table = np.array([statistic.values for statistic in found])
    return _Block(
        values[rows], rows, np.array(finest, dtype=float), np.array(answers), found, table
    )


def _sample(column: Array, rows: Index) -> list[tuple[int, float]]:
    return [(int(i), float(column[i])) for i in rows[-_SAMPLED:] if np.isfinite(column[i])]


@lru_cache(maxsize=10_000)
def _digits(cell: Cell, value: float) -> int:
    """Digits behind the decimal mark of a cell; a text's zeros at the end count."""
    exponent = Decimal(repr(float(value))).normalize().as_tuple().exponent
    least = min(max(-int(exponent), 0), _MOST_DIGITS)
    if isinstance(cell, str):
        part = re.search(r"[.,]([0-9]+)\s*%?\s*$", cell)
        if part is not None:
            n = len(part[1]) + (2 if cell.rstrip().endswith("%") else 0)
            whole = re.sub(r"[^0-9]", "", cell).lstrip("0")
            if whole == str(round(abs(value) * 10.0**n)) or value == 0.0:
                return max(least, min(n, _MOST_DIGITS))
    return least


def _statistic(sheet: Sheet, values: Array, row: int, block: _Block) -> tuple[float, str]:
    """The evidence that a row is a statistic of the block, and of which; "" where it is of none."""
    known = np.isfinite(values[row])
    many = np.isfinite(block.values).sum(axis=0) >= 2
    if not (known & many).any() or (known & ~many).any() or _damaged(sheet, row):
        return 0.0, ""
    at, cells = np.flatnonzero(known), [sheet.columns[i][row] for i in sheet.parsed]
    x, found = block.values[:, at], values[row, at]
    digits = np.array([_digits(cells[j], values[row, j]) for j in at], dtype=float)
    if not any(isinstance(cells[j], str) for j in at):
        digits = np.maximum(digits, block.finest[at])  # a workbook does not store zeros at the end
    best, name = -np.inf, ""
    unit = 10.0 ** -np.minimum(digits, block.finest[at])
    near = np.abs(found - block.table[:, at]) <= 1e-9 * (1.0 + np.abs(found)) + unit * np.sqrt(
        len(x)
    )
    for i in np.flatnonzero(near.all(axis=1)).tolist():
        statistic = block.statistics[i]
        evidence = _evidence(statistic, x, found, digits, block, at)
        if evidence is not None and evidence > best:
            best, name = evidence, statistic.name
    return best, name


@np.errstate(all="ignore")
def _evidence(
    statistic: Statistic, x: Array, found: Array, digits: Array, block: _Block, at: Index
) -> float | None:
    """Powers of ten by which the numbers speak for the statistic; None where they do not agree."""
    expected = statistic.values[at]
    low, high = np.fmin.reduce(x), np.fmax.reduce(x)
    varies = high > low
    exact = 0.5 * 10.0**-digits * (1.0 + 1e-6) + 1e-9 * np.abs(expected) + 1e-12
    rounding = statistic.rounding * 0.5 * 10.0 ** -block.finest[at]
    within = exact + np.where(varies, rounding, 0.0)
    if not (np.abs(found - expected) <= within).all():  # NaN is no agreement
        return None
    numbers = np.where(varies, np.nanstd(x, axis=0), 1.0)
    chance = np.clip(_DENSITY * within / numbers, 0.0, 1.0)
    same = np.mean(np.abs(x - found) <= within, axis=0)  # as often as rows above have that value
    unlikely = -np.log10(np.maximum(chance, same.clip(1e-3)))
    answers, settings = varies & block.answers[at], varies & ~block.answers[at]
    own = varies & (np.abs(found - expected) <= exact)
    more = np.where(own, digits - block.finest[at], 0.0).clip(0.0, _MOST_MORE)
    # a setting between two others may need a digit more
    finer = np.where(settings, more - 1.0, more).max(initial=0.0)
    finer = max(finer, min(float(more[answers].sum()), _MOST_MORE))
    evidence = 0.0
    if statistic.inside:
        evidence += min(float(unlikely[answers].sum()), _VARYING)
        if statistic.name in ("least", "most"):
            again = (np.abs(x - found) <= within).all(axis=1).any()  # a row that was repeated
            return 0.0 if again else min(_OFF_LEVEL, evidence) if varies.sum() > 1 else 0.0
        between = _OFF_LEVEL if (settings & (same == 0.0)).any() else 0.0
        return evidence + max(between, _DIGITS * float(finer))
    outside = ((found < low - within) | (found > high + within)) & ~varies
    evidence += min(float(unlikely[varies].sum()), _VARYING) + _DIGITS * float(finer)
    most = _MOST_CONSTANT if len(x) > 2 else _CONSTANT
    return evidence + min(_CONSTANT * float(outside.sum()), most)


def _label(sheet: Sheet, row: int, block: _Block) -> float:
    """Evidence of what the row is called, beside those above, and of what it leaves blank."""
    blanks = _blanks(sheet, row, block)
    if _speaks(sheet, row):
        return blanks + _OTHER_KIND
    if not sheet.names:
        return blanks
    names = next((names for names in sheet.names if not is_blank(names[row])), sheet.names[0])
    above = [shown(names[i]).strip() for i in block.rows]
    return blanks + name_evidence(shown(names[row]).strip(), above)


def _speaks(sheet: Sheet, row: int) -> bool:
    """Whether the first cell of a row is a word in a column of numbers."""
    first = next((i for i, c in enumerate(sheet.columns) if not is_blank(c[row])), -1)
    in_numbers = first in sheet.parsed and row in sheet.parsed[first].faults
    return in_numbers and shown(sheet.columns[first][row]).strip()[:1].isalpha()


def _damaged(sheet: Sheet, row: int) -> bool:
    """Whether a number of the row has more than digits around it: 8.5 mm, <0.1, a date."""
    texts = (str(sheet.columns[i][row]).strip() for i, n in sheet.parsed.items() if row in n.faults)
    return any(not (t[:1].isalpha() or t.startswith("#")) for t in texts)


def name_evidence(name: str, above: Sequence[str]) -> float:
    """How much a name is of another kind than those above: over 0; of their kind: under 0."""
    filled = [text for text in above if text]
    if not name or not filled:
        return _OFF_LEVEL if filled and len(filled) == len(above) else 0.0
    if name in filled:
        return _OWN_KIND
    if not any(c.isalpha() for c in name):
        computed = re.fullmatch(r"[0-9]+[.,][0-9]+", name) and all(t.isdigit() for t in filled)
        return _NEW_NAME if computed else _OWN_KIND if name[:1].isdigit() else 0.0
    different = set(filled)
    coded = sum(any(c.isdigit() for c in text) for text in different) >= _MOSTLY * len(different)
    if coded:
        stems = {re.sub(r"[0-9]+", "0", text) for text in different}
        digits = any(c.isdigit() for c in name)
        own = digits and (name[0].isdigit() or re.sub(r"[0-9]+", "0", name) in stems)
        return _OWN_KIND if own else _NEW_NAME if digits else _OTHER_KIND
    codes = all(len(text) <= _SHORT and text.isascii() for text in different)
    if codes:
        return _OTHER_KIND if len(name) > _SHORT or not name.isascii() else _OWN_KIND
    # typed once, with blanks below; or of repeats, of which the last may lack some
    alone = sum(filled.count(text) == 1 for text in different)
    repeated = len(above) >= 2 * len(different) or alone <= 1 < len(different)
    return _NEW_NAME if repeated else 0.0


def _odd_names(names: Sequence[Cell]) -> list[int]:
    """Rows inside a table whose name is of another kind than most: no digit, or long among codes."""
    texts = [shown(cell).strip() for cell in names]
    different = sorted({text for text in texts if text})
    if len(different) < 2:
        return []
    digits = [text for text in different if any(c.isdigit() for c in text)]
    short = [text for text in different if len(text) <= _SHORT and text.isascii()]
    for usual in (digits, short):
        if len(usual) == len(different):
            return []
        if 2 * len(usual) >= len(different):
            odd = set(different) - set(usual)
            return [i for i, text in enumerate(texts) if text in odd]
    alone = range(1, len(texts) - 1)
    return [i for i in alone if texts[i] and texts[i - 1] != texts[i] != texts[i + 1]][:_MOST_ENDS]


def _blanks(sheet: Sheet, row: int, block: _Block) -> float:
    """Evidence of cells that are blank where every row above has a value."""
    full = np.flatnonzero(np.isfinite(block.values).all(axis=0))
    columns = [[*sheet.parsed][j] for j in full.tolist()]
    blank = [i for i in columns if is_blank(sheet.columns[i][row])]
    if any(i in sheet.needed for i in blank):
        return 1.0
    return _OFF_LEVEL if blank else 0.0
