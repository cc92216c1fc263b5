# SPDX-License-Identifier: Apache-2.0
"""Where in a grid of cells the table is: its header, its units, its rows of measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import (
    Cell,
    Grid,
    MeasurementsError,
    is_blank,
    refuse_many_cells,
    shown,
)
from smallwheel_ros.measurements.headers import UNKNOWN, expected_unit, read_heading
from smallwheel_ros.measurements.units import DIMENSIONLESS, UnitsError, fits, spelled
from smallwheel_ros.measurements.words import find

SEARCHED = 40  # rows among which the header is: titles and remarks of a trial fill less than a page
_LONGEST_HEADER = 80
_COMMENTS = ("#", "%", "//")
_BLANK = frozenset(("", " "))


@dataclass
class Layout:
    """The table of a grid.

    headers, columns: as they stand there, all columns of the same length. units: those of a row of
    their own, by column. numbers: each row's line in the file. header_line: None where the file
    keeps headers apart. ragged: rows of another number of cells than the header, and how many.
    """

    headers: list[str]
    columns: list[Sequence[Cell]]
    units: dict[int, str]
    numbers: NDArray[np.intp]
    header_line: int | None
    ragged: dict[int, int]
    said: list[str]


@lru_cache(maxsize=10_000)
def _is_known(text: str) -> bool:
    try:
        return read_heading(text).rank < UNKNOWN
    except UnitsError:
        return False


def known_cells(row: Sequence[Cell]) -> int:
    """How many cells of a row name a quantity."""
    return sum(
        isinstance(cell, str)
        and len(cell) < _LONGEST_HEADER
        and any(c.isalpha() or c == "Ø" for c in cell)
        and _is_known(cell.strip().lstrip("#").strip())
        for cell in row
    )


def find_layout(grid: Grid) -> Layout:
    """Find the table. Raises MeasurementsError where there is none."""
    # The first cell of most rows is filled: look at the others only where it is not.
    rows = [
        i
        for i, row in enumerate(grid.rows)
        if row and (row[0] not in _BLANK or not all(map(is_blank, row)))
    ]
    said = list(grid.said)
    if grid.header is not None:
        headers, header_line = list(grid.header), None
    else:
        if not rows:
            raise MeasurementsError(
                f"{grid.source}: nothing but empty cells, expected a header and rows"
            )
        at = _header(grid, rows)
        if at:
            said.append(f"{at} rows above the header are left out")
        header_line = grid.numbers[rows[at]]
        headers = [shown(cell).strip() for cell in grid.rows[rows[at]]]
        if headers and headers[0].startswith("#"):
            headers[0] = headers[0].lstrip("# ")
        rows = rows[at + 1 :]
    comments = [i for i in rows if str(grid.rows[i][0]).startswith(_COMMENTS)]
    if comments:
        left_out = set(comments)
        rows = [i for i in rows if i not in left_out]
        said.append(f"{len(comments)} lines of comments are left out")
    units, below = _units(grid, rows[:2], headers, said)
    rows = rows[below:]
    if not rows:
        raise MeasurementsError(f"{grid.source}: no rows below the header")
    between = grid.numbers[rows[-1]] - grid.numbers[rows[0]] + 1
    blank = between - len(rows) - sum(rows[0] < i < rows[-1] for i in comments)
    if blank > 0 and rows[-1] - rows[0] + 1 - len(rows) + (grid.place == "row") > 0:
        said.append(f"{blank} blank rows between the others are left out")
    width, ragged = _width(grid, rows, headers)
    refuse_many_cells(grid.source, len(rows) + (grid.header is None), width)
    numbers = np.array([grid.numbers[i] for i in rows], dtype=np.intp)
    columns: list[Sequence[Cell]]
    if grid.long is None:
        body = [grid.rows[i] for i in rows]
        body = [row if len(row) == width else _fitted(row, width) for row in body]
        columns = list(zip(*body, strict=True))
    else:
        columns = [*(grid.long.columns(rows[0]) or [])]
        if len(columns) != width or rows != list(range(rows[0], len(grid.rows))):
            assert grid.whole is not None
            return find_layout(grid.whole())
        numbers = np.arange(numbers[0], numbers[0] + len(columns[0]))
    headers = [*headers[:width], *[""] * (width - len(headers))]
    return Layout(headers, columns, units, numbers, header_line, ragged, said)


def _header(grid: Grid, rows: list[int]) -> int:
    """Position in `rows` of the header: the row with most names of quantities."""
    known = [known_cells(grid.rows[i]) for i in rows[:SEARCHED]]
    first = [grid.rows[i][0] for i in rows[:SEARCHED]]
    if len(rows) <= SEARCHED and known_cells(first) > max(2, *known):
        raise MeasurementsError(
            f"{grid.source}: names of quantities stand in the first column, expected them in one row: "
            "turn the table (in a spreadsheet: copy, paste special, transpose)"
        )
    if max(known) > 0:
        return known.index(max(known))
    filled = [sum(not is_blank(cell) for cell in grid.rows[i]) for i in rows[:SEARCHED]]
    texts = [
        n > 1 and not str(grid.rows[i][0]).startswith(_COMMENTS)
        for i, n in zip(rows, filled, strict=False)
    ]
    return texts.index(True) if any(texts) else 0


def _units(
    grid: Grid, rows: list[int], headers: list[str], said: list[str]
) -> tuple[dict[int, str], int]:
    """Units in a row of their own below the header, and how many rows are no measurements there."""
    below = 0
    units: dict[int, str] = {}
    for i in rows:
        row = grid.rows[i]
        found = _unit_row(row, headers)
        if found:
            units = found
            said.append(f"units in {grid.place} {grid.numbers[i]}")
        elif not _is_symbol_row(row, headers):
            break
        below += 1
    return units, below


def _unit_row(row: Sequence[Cell], headers: list[str]) -> dict[int, str] | None:
    """Units by column, if every cell below the name of a quantity is a unit, and one at least."""
    units: dict[int, str] = {}
    for position, (cell, header) in enumerate(zip(row, headers, strict=False)):
        if is_blank(cell):
            continue
        if not isinstance(cell, str):
            return None
        text = cell.strip()
        if text[0] + text[-1] in ("[]", "()"):
            text = text[1:-1].strip()
        try:
            heading = read_heading(header)
        except UnitsError:
            return None
        expected = expected_unit(heading.name)
        if text in ("", "-", "1", "–", "/"):
            units[position] = DIMENSIONLESS
            continue
        unit = spelled(text, expected)
        if unit is not None and (expected is None or fits(unit, expected)):
            units[position] = unit
        elif expected is not None or _is_number(text):
            return None
    return units if any(unit != DIMENSIONLESS for unit in units.values()) else None


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_symbol_row(row: Sequence[Cell], headers: list[str]) -> bool:
    """Whether a row repeats what the columns are, in other words: W and z below load and sinkage."""
    pairs = [
        (find(cell.strip()), find(header))
        for cell, header in zip(row, headers, strict=False)
        if isinstance(cell, str) and not is_blank(cell)
    ]
    texts = all(isinstance(cell, str) for cell in row)
    same = [a is not None and b is not None and a.name == b.name for a, b in pairs]
    return texts and len(same) > 1 and all(same)


def _width(grid: Grid, rows: list[int], headers: list[str]) -> tuple[int, dict[int, int]]:
    """Columns of the table, and how many cells the rows have that do not fit it, by row.

    Empty columns at the end are none. In a text file every row has as many cells as the header.
    """
    headed = max((i + 1 for i, header in enumerate(headers) if header), default=0)
    lengths = {i: _filled(grid.rows[i]) for i in rows if len(grid.rows[i]) > headed}
    if grid.place == "row":
        return max(headed, *lengths.values(), 0), {}
    width = max((n for n in lengths.values() if n <= len(headers)), default=headed)
    width = max(width, headed)
    ragged = {i: n for i, n in lengths.items() if n > width}
    ragged |= {i: len(grid.rows[i]) for i in rows if len(grid.rows[i]) < headed}
    return width, {p: ragged[i] for p, i in enumerate(rows) if i in ragged}


def _filled(row: Sequence[Cell]) -> int:
    return max((k + 1 for k, cell in enumerate(row) if not is_blank(cell)), default=0)


def _fitted(row: Sequence[Cell], width: int) -> Sequence[Cell]:
    return row[:width] if len(row) > width else [*row, *[""] * (width - len(row))]
