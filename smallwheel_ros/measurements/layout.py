# SPDX-License-Identifier: Apache-2.0
"""Where in a grid of cells the table is: header, units, rows; and which quantity each column is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import (
    Cell,
    Grid,
    MeasurementsError,
    Problems,
    clipped,
    is_blank,
    refuse_many_cells,
    shown,
)
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.units import DIMENSIONLESS, UnitsError, fits, spelled
from smallwheel_ros.measurements.words import (
    SYMBOLS,
    UNKNOWN,
    Heading,
    expected_unit,
    find,
    mapped_heading,
    meant,
    plain,
    read_heading,
)

SEARCHED = 40  # rows among which the header is: titles and remarks of a trial fill less than a page
_LONGEST_HEADER = 80
_MOST_NAMES = 30  # that a message lists
_COMMENTS = ("#", "%", "//")


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

    def keep(self, rows: NDArray[np.intp]) -> None:
        """Keep these rows."""
        self.columns = [[column[row] for row in rows.tolist()] for column in self.columns]
        self.numbers = self.numbers[rows]


@lru_cache(maxsize=10_000)
def _quantity(text: str) -> str:
    try:
        heading = read_heading(text)
    except UnitsError:
        return ""
    return heading.name if heading.rank < UNKNOWN else ""


def _quantities(row: Sequence[Cell]) -> list[str]:
    """The quantities that cells of a row name."""
    texts = [cell for cell in row if isinstance(cell, str) and len(cell) < _LONGEST_HEADER]
    named = [text for text in texts if any(c.isalpha() or c == "Ø" for c in text)]
    return [name for text in named if (name := _quantity(text.strip().lstrip("#").strip()))]


def known_cells(row: Sequence[Cell]) -> int:
    """How many cells of a row name a quantity."""
    return len(_quantities(row))


def _numbers(row: Sequence[Cell]) -> int:
    """How many cells of a row are numbers: without a letter, with a digit."""
    texts = [str(cell) for cell in row if not is_blank(cell)]
    return sum(
        any(c.isdigit() for c in text) and not any(c.isalpha() for c in text) for text in texts
    )


def _named(cells: Sequence[Cell]) -> tuple[int, int]:
    """How many different quantities cells name by words, and by words or symbols: b, i and s may be runs."""
    words = [cell for cell in cells if str(cell).strip() not in SYMBOLS]
    return len({*_quantities(words)}), len({*_quantities(cells)})


def find_layout(grid: Grid) -> Layout:
    """Find the table. Raises MeasurementsError where there is none."""
    rows = [i for i, row in enumerate(grid.rows) if not all(map(is_blank, row))]
    said = list(grid.said)
    headers, header_line = grid.header, None
    if headers is None:
        if not rows:
            raise MeasurementsError("nothing but empty cells, expected a header and rows")
        at = _header(grid, rows)
        said += [f"{at} rows above the header are left out"] if at else []
        header_line = grid.numbers[rows[at]]
        headers = [shown(cell).strip() for cell in grid.rows[rows[at]]]
        if headers[0].startswith("#"):
            headers[0] = headers[0].lstrip("# ")
        rows = rows[at + 1 :]
    comments = {i for i in rows if str(grid.rows[i][0]).startswith(_COMMENTS)}
    if comments:
        rows = [i for i in rows if i not in comments]
        said.append(f"{len(comments)} lines of comments are left out")
    units: dict[int, str] = {}
    for i in rows[:2]:
        if found := _unit_row(grid.rows[i], headers):
            units = found
            said.append(f"units in {grid.place} {grid.numbers[i]}")
        elif not _is_symbol_row(grid.rows[i], headers):
            break
        rows = rows[1:]
    if not rows:
        raise MeasurementsError("no rows below the header")
    numbers = np.array([grid.numbers[i] for i in rows], dtype=np.intp)
    inner = sum(rows[0] < i < rows[-1] for i in comments)
    blank = int(numbers[-1] - numbers[0]) + 1 - len(rows) - inner
    if blank > 0 and rows[-1] - rows[0] + 1 - len(rows) + (grid.place == "row") > 0:
        said.append(f"{blank} blank rows between the others are left out")
    width, ragged = _width(grid, rows, headers)
    refuse_many_cells(len(rows) + (grid.header is None), width)
    body = [_fitted(grid.rows[i], width) for i in rows]
    headers = [*headers[:width], *[""] * (width - len(headers))]
    columns = list(zip(*body, strict=True))
    return Layout(headers, [*columns], units, numbers, header_line, ragged, said)


def _header(grid: Grid, rows: list[int]) -> int:
    """Position in `rows` of the header: the row with most names of quantities."""
    first = [grid.rows[i] for i in rows[:SEARCHED]]
    # A row of a run called b is no header: most of its cells are numbers.
    known = [names if (names := known_cells(row)) >= _numbers(row) else 0 for row in first]
    turned = _named([row[0] for row in first])
    if len(rows) <= SEARCHED and turned[1] > 2 and turned > max(map(_named, first)):
        raise MeasurementsError(
            "names of quantities stand in the first column, expected them in one row: "
            "turn the table (in a spreadsheet: copy, paste special, transpose)"
        )
    if max(known) > 0:
        return known.index(max(known))
    texts = (
        i
        for i, row in enumerate(first)
        if sum(not is_blank(cell) for cell in row) > 1 and not str(row[0]).startswith(_COMMENTS)
    )
    return next(texts, 0)


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
            expected = None if header in SYMBOLS else expected_unit(read_heading(header).name)
        except UnitsError:
            return None
        if text in ("", "-", "1", "–", "/"):
            units[position] = DIMENSIONLESS
            continue
        unit = spelled(text, expected)
        if unit is not None and (expected is None or fits(unit, expected)):
            units[position] = unit
        elif expected is not None or text.replace(",", ".").lstrip("+-").replace(".", "").isdigit():
            return None
    return units if any(unit != DIMENSIONLESS for unit in units.values()) else None


def _is_symbol_row(row: Sequence[Cell], headers: list[str]) -> bool:
    """Whether a row repeats what the columns are, in other words: W and z below load and sinkage."""
    filled = [(c, h) for c, h in zip(row, headers, strict=False) if not is_blank(c)]
    if len(filled) < 2 or not all(isinstance(cell, str) for cell in row):
        return False
    pairs = [(find(str(cell).strip()), find(header)) for cell, header in filled]
    return all(a is not None and b is not None and a.name == b.name for a, b in pairs)


def _width(grid: Grid, rows: list[int], headers: list[str]) -> tuple[int, dict[int, int]]:
    """Columns of the table, and how many cells the rows have that do not fit it, by row.

    Empty columns at the end are none. In a text file every row has as many cells as the header.
    """
    headed = max((i + 1 for i, header in enumerate(headers) if header), default=0)
    lengths = {p: len(grid.rows[i]) for p, i in enumerate(rows) if len(grid.rows[i]) != headed}
    for p, n in lengths.items():
        row = grid.rows[rows[p]]
        while n > headed and is_blank(row[n - 1]):
            n -= 1
        lengths[p] = n
    if grid.place == "row":
        return max(headed, *lengths.values(), 0), {}
    width = max((n for n in lengths.values() if n <= len(headers)), default=headed)
    width = max(width, headed)
    return width, {p: n for p, n in lengths.items() if n > width or n < headed}


def _fitted(row: Sequence[Cell], width: int) -> Sequence[Cell]:
    return row if len(row) == width else [*row[:width], *[""] * (width - len(row))]


def match_columns(
    layout: Layout, mapping: Mapping[str, str], problems: Problems
) -> dict[int, Heading]:
    """The heading of each column, by its position; what is wrong is added to the problems.

    Of several columns of one quantity the one that the user mapped is it, else the one that has
    our own name; the others stay columns of their own.
    """
    wanted = _mapped(layout, mapping, problems)
    found: dict[int, Heading] = {}
    for position, text in enumerate(layout.headers):
        blank = all(map(is_blank, layout.columns[position]))
        if not text or (text.startswith("Unnamed: ") and blank):
            if not blank:
                hint = " (a pandas index? write with index=False)" if position == 0 else ""
                problems.add(f"column {position + 1} has no name{hint}")
            continue
        try:
            ours = wanted.get(position)
            heading = read_heading(text) if ours is None else mapped_heading(text, ours)
        except UnitsError as error:
            problems.add(f"header '{clipped(text)}': {error}")
            continue
        if not heading.name:
            problems.add(f"column {position + 1} has no name")
            continue
        found[position] = _with_unit(heading, layout.units.get(position), problems)
    _settle(found, problems)
    names = {heading.name for heading in found.values()}
    for heading in found.values():
        near = meant(heading) if heading.rank == UNKNOWN else None
        near = "diameter" if near == "radius" else near
        text = clipped(heading.text)
        if near is not None and near not in names:
            problems.add(
                f"header '{text}' is no known word, but nearly '{near}': correct it or its unit, or say "
                f"what it is with --map {near}='{text}' (or --map '{text}'='{text}')"
            )
    return found


def _mapped(layout: Layout, mapping: Mapping[str, str], problems: Problems) -> dict[int, str]:
    """Our name by the position of the column that the user says it is."""
    headers, wanted = layout.headers, dict[int, str]()
    alike = [plain(text) for text in headers]
    without_unit = [plain(text.partition("[")[0].partition("(")[0]) for text in headers]
    for ours, theirs in mapping.items():
        option = f"--map {clipped(ours)}={clipped(theirs)}"
        try:
            heading = read_heading(ours)
        except UnitsError as error:
            problems.add(f"{option}: {error}")
            continue
        near = meant(heading) if heading.rank == UNKNOWN and ours != theirs else None
        if near is not None:
            problems.add(f"{option}: '{clipped(ours)}' is nearly '{near}'")
            continue
        at = [i for i, text in enumerate(headers) if text == theirs.strip()]
        at = at or [i for i, text in enumerate(alike) if text == plain(theirs)]
        at = at or [i for i, text in enumerate(without_unit) if text == plain(theirs)]
        if len(at) == 1 and at[0] not in wanted:
            wanted[at[0]] = ours
        else:
            what = "no column" if not at else "several columns" if len(at) > 1 else "twice"
            problems.add(f"{option}: {what} '{clipped(theirs)}'. There is: {listed(headers)}")
    return wanted


def _with_unit(heading: Heading, unit: str | None, problems: Problems) -> Heading:
    """The heading with the unit of the unit row, if it has none of its own."""
    if unit is not None and heading.unit is None:
        if heading.text in SYMBOLS and not fits(unit, expected_unit(heading.name) or unit):
            return read_heading(f"{heading.text} [{unit}]")._replace(text=heading.text)
        pure = unit == DIMENSIONLESS and heading.name not in COLUMNS
        return heading if pure else heading._replace(unit=unit)
    if unit is not None and heading.unit != unit:
        problems.add(
            f"header '{clipped(heading.text)}' and the row of units below it ({unit}) differ"
        )
    return heading


def _settle(found: dict[int, Heading], problems: Problems) -> None:
    """Leave one column of each quantity, and give the others their own names."""
    by_name: dict[str, list[int]] = {}
    for position, heading in found.items():
        by_name.setdefault(heading.name, []).append(position)
    for name, positions in by_name.items():
        best = min(found[i].rank for i in positions)
        first, *others = [i for i in positions if found[i].rank == best]
        if others:
            problems.add(
                f"two columns are named '{clipped(name)}' ('{clipped(found[first].text)}' and "
                f"'{clipped(found[others[0]].text)}'), expected one: remove or rename the other, or say "
                f"which with --map {clipped(name)}='{clipped(found[first].text)}'"
            )
        for i in positions:
            if i != first:
                own = found[i].text.partition("[")[0].strip()
                taken = {heading.name for heading in found.values()}
                own = found[i].text if own in taken else own
                found[i] = found[i]._replace(name=own, rank=UNKNOWN, factor=1.0)


def listed(names: list[str]) -> str:
    """Names as a message lists them."""
    shown = ", ".join(clipped(name) for name in names[:_MOST_NAMES])
    more = len(names) - _MOST_NAMES
    return f"{shown} and {more} more" if more > 0 else shown
