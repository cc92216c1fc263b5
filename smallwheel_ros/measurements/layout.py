# SPDX-License-Identifier: Apache-2.0
"""Where in a grid of cells the table is: header, units, rows; and which rows were not measured.

The header is the row, of the first forty, in which most cells name a quantity; units may stand in a row
below it. A row is not a measurement if it is blank, is a comment, has no number, repeats the
header, begins with a word for a summary (Mittelwert), is exactly the mean of the rows above under a
name of another kind, or is another statistic of the same rows below such a mean. A table with one
row for each quantity is transposed. One with one row for each reading is only reported, since only
its author knows which readings belong together.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby, pairwise, zip_longest

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import (
    SEARCHED,
    Cell,
    CellGrid,
    MeasurementsError,
    Numbers,
    clipped,
    is_blank,
    map_option,
    shown,
)
from smallwheel_ros.measurements.columns import (
    CHANNELS,
    COLUMNS,
    DIMENSIONLESS,
    TEXTS,
    Array,
    UnitsError,
    fits,
    shown_unit,
    spelled,
)
from smallwheel_ros.measurements.headers import (
    SYMBOLS,
    UNKNOWN,
    Heading,
    expected_unit,
    find,
    is_summary,
    plain,
    read_heading,
)

_LONGEST_HEADER = 80
_MOST_READ = 1000  # characters of a header: a paragraph
_COMMENTS = ("#", "%", "//")
_EXPONENT = re.compile(r"(?<=[\d.,])[eE](?=[-+]?\d)")
_MOSTLY = 0.8  # a column of the user's own with at least this share of numbers is a numeric one
_MOST_SAID = 5  # rows that are reported in a line of their own
_NAMES = ("run", "soil", "wheel")  # that may be typed once, with blanks below
_SUMMARY, _REMARK = "is no measurement", "is a remark"
_MOST_MEANS = 1000  # rows that are looked at
_FEW = 0.25  # share of rows at most that have an odd name
# For tables with one row for each quantity, or for each reading.
_LEAST_QUANTITIES = 2  # quantities that stand in the first column: one may be a title's
_SHORT = 2  # characters: so short are names of runs, too (b, i, W1)
_OF_TEXTS = {"run", "soil", "wheel", "contact"}  # whose cells are texts
_MOST_QUANTITIES = 30  # quantities that a logger has
# What loggers call the column of the names, and that of the values.
_NAMES_CALLED = {
    "varname", "tagname", "tag", "variable", "channel", "parameter", "signal", "quantity", "sensor",
    "kanal", "grosse", "messgrosse", "messstelle", "grandeur", "name",
}  # fmt: skip


# What spreadsheets compute below a mean.
_STATISTICS: dict[str, Callable[[Array], float]] = {
    "the standard deviation": lambda x: float(np.std(x, ddof=min(1, x.size - 1))),
    "the standard deviation (of all)": lambda x: float(np.std(x)),
    "the standard error": lambda x: float(np.std(x, ddof=min(1, x.size - 1)) / np.sqrt(x.size)),
    "the variance": lambda x: float(np.var(x, ddof=min(1, x.size - 1))),
    "the coefficient of variation": lambda x: _variation(x),
    "the coefficient of variation (%)": lambda x: 100.0 * _variation(x),
    "the median": lambda x: float(np.median(x)),
    "the least": lambda x: float(np.min(x)),
    "the largest": lambda x: float(np.max(x)),
    "the range": lambda x: float(np.ptp(x)),
    "the number": lambda x: float(x.size),
    "the sum": lambda x: float(np.sum(x)),
}


def _variation(x: Array) -> float:
    """Standard deviation over the mean."""
    return float(np.std(x, ddof=min(1, x.size - 1)) / np.mean(x)) if np.mean(x) else np.nan


# What `row_names` returns: the positions of the columns of texts, that of the runs first; and for each row
# two flags for its cell in the first of these columns: whether it has a digit (R9), and whether it is a short
# code, one or two bytes without a digit (a, ii). Any other cell is a word, or blank: (False, False).
RowNames = tuple[list[int], list[tuple[bool, bool]]]


@dataclass
class Layout:
    """The table within a grid of cells: headers, columns of cells, and the place of each row in the file.

    Attributes
    ----------
    headers, columns
        Texts of the headers, and the cells of each column below its header; all have the same length.
    units
        Unit by position of the column, from the row of units; empty if the table has none.
    numbers
        Number of each row in the file, shape (rows,).
    header_line
        Number of the header's row in the file; None if the file keeps headers apart from the rows.
    ragged
        Number of cells, by index of the row, of each row of a text file that does not fit the header.
    said
        Sentences for the user about how the table was found.
    """

    headers: list[str]
    columns: list[Sequence[Cell]]
    units: dict[int, str]
    numbers: NDArray[np.intp]
    header_line: int | None
    ragged: dict[int, int]
    said: list[str]

    def drop(self, rows: Sequence[int]) -> None:
        """Remove the rows of these indices; `ragged` keeps the indices from before."""
        kept = np.delete(np.arange(self.numbers.size), rows)
        self.columns = [[column[row] for row in kept.tolist()] for column in self.columns]
        self.numbers = self.numbers[kept]


def known_cells(row: Sequence[Cell]) -> int:
    """Number of cells of a row that name a known quantity."""
    count = 0
    for cell in row:
        if not isinstance(cell, str) or len(cell) >= _LONGEST_HEADER:
            continue
        if any(c.isalpha() or c == "Ø" for c in cell):
            with suppress(UnitsError):
                count += read_heading(cell.strip().lstrip("#%").strip()).rank < UNKNOWN
    return count


def _is_number(cell: Cell) -> bool:
    """Whether a cell is a number, or a text of digits and marks; an exponent's e is no letter."""
    if not isinstance(cell, str):
        return not np.isnan(cell)
    text = _EXPONENT.sub("", cell)
    return any(map(str.isdigit, text)) and not any(map(str.isalpha, text))


def find_layout(grid: CellGrid) -> Layout:
    """Find the table in a grid: header, row of units, rows. Raises MeasurementsError if there is none."""
    rows = [i for i, row in enumerate(grid.rows) if not all(map(is_blank, row))]
    said, headers, header_line = list(grid.said), grid.header, None
    if headers is None:
        if not rows:
            raise MeasurementsError("nothing but empty cells, expected a header and rows")
        at = _header(grid, rows)
        if _nothing_but_numbers(grid.rows[rows[at]]):
            raise MeasurementsError(
                f"{grid.place} {grid.numbers[rows[at]]}: nothing but numbers, expected a header: write one"
                " above, a name and unit for each column, as load [N]"
            )
        said += [f"{at} rows above the header are left out"] if at else []
        header_line = grid.numbers[rows[at]]
        headers = [_header_text(cell) for cell in grid.rows[rows[at]]]
        headers[0] = headers[0].lstrip("#% ")
        rows = rows[at + 1 :]
    comments = [i for i in rows if str(grid.rows[i][0]).startswith(_COMMENTS)]
    if comments:
        rows = [i for i in rows if i not in set(comments)]
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
    width, ragged = _width(grid, rows, headers)
    body = [row if len(row := grid.rows[i]) == width else _fitted(row, width) for i in rows]
    headers = [*headers[:width], *[""] * (width - len(headers))]
    numbers = np.array([grid.numbers[i] for i in rows], dtype=np.intp)
    return Layout(headers, [*zip(*body, strict=True)], units, numbers, header_line, ragged, said)


def _header(grid: CellGrid, rows: list[int]) -> int:
    """Position in `rows` of the header: the row with most names of quantities."""
    first = [grid.rows[i] for i in rows[:SEARCHED]]
    # A row of a run called b is no header: most of its cells are numbers.
    known = list(map(_names, first))
    if max(known) > 0:
        return known.index(max(known))
    texts = (
        i
        for i, row in enumerate(first)
        if sum(not is_blank(cell) for cell in row) > 1 and not str(row[0]).startswith(_COMMENTS)
    )
    return next(texts, 0)


def _header_text(cell: Cell) -> str:
    """A header on one line, with the unit at its end; only messages shorten it."""
    return " ".join(cell[:_MOST_READ].split()) if isinstance(cell, str) else shown(cell)


def _nothing_but_numbers(row: Sequence[Cell]) -> bool:
    """Whether a row has several numbers and nothing else, be they between blanks."""
    parts = [part for cell in row for part in (cell.split() if isinstance(cell, str) else [cell])]
    return len(parts) > 1 and all(map(_is_number, parts))


def _names(row: Sequence[Cell]) -> int:
    """How many cells of a row name a quantity; 0 where more of them are numbers."""
    known = known_cells(row)
    return known if known >= sum(map(_is_number, row)) else 0


def _unit_row(row: Sequence[Cell], headers: list[str]) -> dict[int, str] | None:
    """Units by position of the column, if the cells below names of quantities are units; None if not."""
    units: dict[int, str] = {}
    for position, (cell, header) in enumerate(zip(row, headers, strict=False)):
        if is_blank(cell):
            continue
        if not isinstance(cell, str) or (_is_number(cell) and cell.strip() != "1"):
            return None
        text = cell.strip().strip("[]()").strip()
        try:
            expected = None if header in SYMBOLS else expected_unit(read_heading(header).name)
        except UnitsError:
            return None
        unit = DIMENSIONLESS if text in ("", "-", "1", "–", "/") else spelled(text, expected)
        known = unit == DIMENSIONLESS or expected is None or (unit and fits(unit, expected))
        if unit and known:
            units[position] = unit
        elif expected is not None:
            return None
    return units if any(unit != DIMENSIONLESS for unit in units.values()) else None


def _is_symbol_row(row: Sequence[Cell], headers: list[str]) -> bool:
    """Whether a row names the quantities of the headers once more: W and z below load and sinkage."""
    pairs = [(str(c), h) for c, h in zip(row, headers, strict=False) if not is_blank(c)]
    found = [(find(cell.strip()), find(header)) for cell, header in pairs]
    return len(found) > 1 and all(a and b and a.name == b.name for a, b in found)


def _width(grid: CellGrid, rows: list[int], headers: list[str]) -> tuple[int, dict[int, int]]:
    """Number of columns of the table; and by position in `rows` the number of cells of rows that do not fit.

    Empty columns at the end do not count. Only in a text file must rows have as many cells as the header.
    """
    headed = max((i + 1 for i, header in enumerate(headers) if header), default=0)
    lengths = {p: len(grid.rows[i]) for p, i in enumerate(rows) if len(grid.rows[i]) != headed}
    for p, n in lengths.items():
        while n > headed and is_blank(grid.rows[rows[p]][n - 1]):
            n -= 1
        lengths[p] = n
    if grid.place == "row":
        return max(headed, *lengths.values(), 0), {}
    width = max((n for n in lengths.values() if n <= len(headers)), default=headed)
    width = max(width, headed)
    return width, {p: n for p, n in lengths.items() if n > width or n < headed}


def _fitted(row: Sequence[Cell], width: int) -> Sequence[Cell]:
    return [*row[:width], *[""] * (width - len(row))]


def is_label(heading: Heading, numbers: Numbers) -> bool:
    """Whether a column is one of texts: its name is unknown, it has no unit, and few cells are numbers.

    Parameters
    ----------
    heading
        The column's heading.
    numbers
        The column's cells, read as numbers.
    """
    filled = int((~numbers.blank).sum())
    texts = sum(not why for why in numbers.faults.values())
    unknown = heading.rank == UNKNOWN and heading.unit is None
    return unknown and filled - texts < _MOSTLY * filled


def rows_not_measured(
    layout: Layout,
    named: Mapping[int, Heading],
    parsed: Mapping[int, Numbers],
    names: RowNames,
) -> dict[int, str]:
    """Rows that are not measurements (remarks, headers, computed values): the reason by index of the row.

    Parameters
    ----------
    layout
        The table.
    named
        Headings by position of the column.
    parsed
        Cells read as numbers, by position of the column; columns that are texts by definition (run, soil,
        wheel, contact) are absent.
    names
        As returned by `row_names`.
    """
    found = dict.fromkeys(_summaries(layout, named, parsed), _SUMMARY)
    nothing = np.all([n.blank for n in parsed.values()], axis=0) if parsed else []
    signed = _signed(layout, parsed)
    again = [i for i, cell in enumerate(layout.columns[0]) if cell == layout.headers[0]]
    for row in {*np.flatnonzero(nothing).tolist(), *again, *layout.ragged, *signed}:
        # a remark has texts only where the table has numbers
        texts = (row in numbers.faults or numbers.blank[row] for numbers in parsed.values())
        if row in signed or all(texts):
            found[row] = _REMARK
    return dict(sorted((_means(layout, parsed, names, found) | found).items()))


def _signed(layout: Layout, parsed: Mapping[int, Numbers]) -> set[int]:
    """Rows without any digit in the columns of numbers: a signature, a mark of the table's end."""
    found: set[int] | None = None
    for position, numbers in parsed.items():
        if not np.isfinite(numbers.values).any():
            continue
        cells = layout.columns[position]
        words = {row for row in numbers.faults if not any(map(str.isdigit, str(cells[row])))}
        here = words | {*np.flatnonzero(numbers.blank).tolist()}
        found = here if found is None else found & here
    return found or set()


def _summaries(
    layout: Layout, named: Mapping[int, Heading], parsed: Mapping[int, Numbers]
) -> set[int]:
    """Rows in which a cell is the word of a mean, a sum or a deviation."""
    found: set[int] = set()
    for position, heading in named.items():
        cells = layout.columns[position]
        texts = range(len(cells)) if position not in parsed else parsed[position].faults
        names = {str(cell) for cell in cells} if heading.name == "run" else set[str]()
        said = {text: is_summary(str(text), names) for text in {cells[i] for i in texts}}
        rows = {i for i in texts if said[cells[i]]}
        if len(rows) < len(cells):  # else each row is the mean of a few, and the column says so
            found |= rows
    return found


def _means(
    layout: Layout,
    parsed: Mapping[int, Numbers],
    names: RowNames,
    left_out: Mapping[int, str],
) -> dict[int, str]:
    """Rows that are the mean of rows above, and those below such a mean that are another statistic of them.

    The name of such a row must be of another kind than the first row's, a word where that has digits; or it
    must recur below other names.
    """
    texts, kinds = names
    numeric = {i: n for i, n in parsed.items() if i not in texts and not n.blank.all()}
    if not texts or not numeric:
        return {}
    cells = layout.columns[texts[0]]
    apart = Counter(cell for cell, other in pairwise([*cells, None]) if cell != other)
    others = [
        row
        for row in range(2, len(kinds))
        if row in left_out or kinds[row] != kinds[0] or (apart[cells[row]] > 1 and len(apart) > 2)
    ]
    measured = np.ones(len(kinds), dtype=bool)
    measured[[*left_out, *layout.ragged]] = False
    found: dict[int, str] = {}
    begins = 0
    of: tuple[NDArray[np.intp], ...] = ()
    for row in others:
        above = np.flatnonzero(measured[:row])
        below = row - 1 in found or left_out.get(row - 1) == _SUMMARY
        if not below:
            of = above, above[above >= begins]
        for rows in of if row not in left_out else ():
            if rows.size >= 2 and _is(np.nanmean, layout, numeric, rows, row):
                found[row] = f"is the mean of the {rows.size} rows above"
            elif below and rows.size >= 2:
                words = (w for w, f in _STATISTICS.items() if _is(f, layout, numeric, rows, row))
                if name := next(words, ""):
                    found[row] = f"is {name} of the {rows.size} rows above"
            if row in found:
                break
        if row in found or row in left_out:
            measured[row], begins = False, row + 1
    return found


def odd_names(layout: Layout, names: RowNames, left_out: Mapping[int, str]) -> list[str]:
    """Warnings on rows named by a word where most names are numbers or codes: they may be statistics.

    Parameters
    ----------
    layout
        The table.
    names
        As returned by `row_names`.
    left_out
        Rows that are not measurements, as returned by `rows_not_measured`: no warning is needed for them.
    """
    texts, kinds = names
    if not texts:
        return []
    cells = layout.columns[texts[0]]
    rows = [i for i in range(len(kinds)) if kinds[i] == (False, False) and i not in left_out]
    if not 0 < len(rows) <= _FEW * len(kinds) or any(is_blank(cells[i]) for i in rows):
        return []
    return [
        f"row {layout.numbers[i]} has the name '{clipped(shown(cells[i]))}', others have numbers or codes: "
        "read as a measurement. If it was computed from the rows above, delete it"
        for i in rows[:_MOST_SAID]
    ]


def row_names(
    layout: Layout, named: Mapping[int, Heading], parsed: Mapping[int, Numbers]
) -> RowNames:
    """Find the columns of texts, and whether each row's name is a number, a short code or a word.

    A row's name is its cell in the first column of texts. A computed row, such as a mean, is often named by
    a word where measured rows have numbers.

    Parameters
    ----------
    layout
        The table.
    named
        Headings by position of the column.
    parsed
        Cells read as numbers, by position of the column; columns that are texts by definition (run, soil,
        wheel, contact) are absent.

    Returns
    -------
    columns : list of int
        Positions of the columns of texts, that of the runs first.
    kinds : list of (bool, bool)
        For each row, whether its name has a digit, as "R9", and whether it is a short code: one or two bytes
        without a digit, as "a". Both are False for a word or a blank. Empty if there is no column of texts.
    """
    texts = [i for i in named if i not in parsed or is_label(named[i], parsed[i])]
    texts.sort(key=lambda i: named[i].name != "run")
    names = layout.columns[texts[0]] if texts else []
    kind = {}
    for name in {*names}:
        text = shown(name).strip()
        numbered = any(map(str.isdigit, text))  # R9 and R10 are of one kind
        kind[name] = numbered, not numbered and 0 < len(text.encode()) < 3
    return texts, [kind[name] for name in names]


def _is(
    statistic: Callable[[Array], float],
    layout: Layout,
    numeric: Mapping[int, Numbers],
    rows: NDArray[np.intp],
    row: int,
) -> bool:
    """Whether each number of `row` is that statistic of the same column's numbers in `rows`.

    At least one column must vary over `rows`: in a column with one value throughout, a further measurement
    has that value, too, as a statistic has.
    """
    varies = False
    for position, numbers in numeric.items():
        value, above = numbers.values[row], numbers.values[rows]
        above = above[np.isfinite(above)]
        if np.isnan(value):
            continue
        cell = layout.columns[position][row]
        places = (
            len(cell.replace(",", ".").strip().partition(".")[2]) if isinstance(cell, str) else 9
        )
        expected = float(statistic(above)) if above.size else np.nan
        alike = above.size > 0 and float(np.ptp(above)) <= 10.0**-places
        near = 1.01 * 10.0**-places + 1e-9 * abs(expected)
        if not (abs(value - expected) <= near or (alike and abs(value - above[0]) <= near)):
            return False
        varies |= not alike
    return varies


def lines_left_out(layout: Layout, rows: Mapping[int, str]) -> list[str]:
    """Sentences about the rows that are left out, with the line of each.

    Parameters
    ----------
    layout
        The table.
    rows
        The reason by index of the row, as returned by `rows_not_measured`.
    """
    lines = []
    for row in [*rows][:_MOST_SAID]:
        cells = ", ".join(shown(c[row]).strip() for c in layout.columns if not is_blank(c[row]))
        text = cells if rows[row] == _REMARK else cells.partition(",")[0]
        lines.append(f"row {layout.numbers[row]} '{clipped(text)}' {rows[row]}: left out")
    if more := [str(layout.numbers[row]) for row in rows][_MOST_SAID:]:
        lines.append(f"and {len(more)} more rows like it: {', '.join(more[:30])}")
    return lines


def fill_down(
    layout: Layout, named: Mapping[int, Heading], merged: Sequence[tuple[int, int, int]]
) -> list[str]:
    """Fill blanks below a merged cell, or below a name typed once for several rows.

    Measured values are never filled. A name is typed once if it begins each group of rows, blanks
    follow at least half of the names, and no name follows itself.

    Parameters
    ----------
    layout
        The table; its cells are changed.
    named
        Headings by position of the column.
    merged
        Merged cells, as in `CellGrid.merged`.

    Returns
    -------
    list of str
        A sentence for each column that was filled.
    """
    said = []
    lines = layout.numbers.tolist()
    for position, heading in named.items():
        cells = [*layout.columns[position]]
        if heading.name.removesuffix("_std") in CHANNELS or not any(map(is_blank, {*cells})):
            continue
        within = {n: first for column, first, last in merged if column == position
                  for n in range(first, last + 1)}  # fmt: skip
        once = heading.name in _NAMES and _is_typed_once(cells)
        rows = []
        for i in range(1, len(cells)):
            same = within.get(lines[i], -1) == within.get(lines[i - 1], -2)
            if is_blank(cells[i]) and not is_blank(cells[i - 1]) and (once or same):
                cells[i] = cells[i - 1]
                rows.append(i)
        if rows:
            layout.columns[position] = cells
            said.append(
                f"'{clipped(heading.text)}' is blank below a value in {len(rows)} rows (first in row "
                f"{lines[rows[0]]}): filled from above"
            )
    return said


def _is_typed_once(cells: Sequence[Cell]) -> bool:
    names = [shown(cell).strip() for cell in cells if not is_blank(cell)]
    followed = sum(blank for blank, _ in groupby(map(is_blank, cells)))
    alike = any(a == b for a, b in pairwise(names))
    return not is_blank(cells[0]) and not alike and followed >= 0.5 * len(names) > 0.0


def with_unit(heading: Heading, unit: str | None) -> Heading:
    """Give a heading that has no unit the one from the row of units.

    Parameters
    ----------
    heading
        The column's heading.
    unit
        Unit of the column in the row of units; None if there is none.

    Raises
    ------
    UnitsError
        If the heading has another unit.
    """
    if unit is None or heading.unit == unit:
        return heading
    if heading.unit is not None:
        below = shown_unit(unit)
        raise UnitsError(
            f"the row of units below it ({below}) differ: say which with "
            f"{map_option(f'{heading.name} [{below}]', heading.text)}"
        )
    odd = heading.text in SYMBOLS and not fits(unit, expected_unit(heading.name) or unit)
    if odd or (heading.rank == UNKNOWN and find(heading.text) is not None):
        return read_heading(f"{heading.text} [{unit}]")._replace(text=heading.text)
    pure = unit == DIMENSIONLESS and heading.name not in COLUMNS
    return heading if pure else heading._replace(unit=unit)


# --- Tables of another shape


def quantity(cell: Cell) -> str:
    """The quantity that a cell names, by our name; empty where it names none."""
    if not isinstance(cell, str) or not any(c.isalpha() for c in cell):
        return ""
    with suppress(UnitsError):
        found = read_heading(cell.strip())
        return found.name if found.rank < UNKNOWN else ""
    return ""


def upright(grid: CellGrid) -> CellGrid:
    """The grid with one column for each quantity: transposed if its first column names them, each once."""
    if grid.header is not None or not _lies(grid.rows):
        return grid
    filled = [row for row in grid.rows if not all(map(is_blank, row))]
    begins = next(i for i, row in enumerate(filled) if _quantity_of(row))
    # Rows above the first name: those of numbers, of runs perhaps, or of words in each column.
    above = [row for row in filled[:begins] if sum(not is_blank(cell) for cell in row) > 1]
    turned = [list(row) for row in zip_longest(*above, *filled[begins:], fillvalue="")]
    units = all(
        isinstance(c, str) and not any(map(str.isdigit, c)) for c in turned[1][len(above) :]
    )
    for i in range(len(above)):
        turned[1][i] = "" if units else turned[1][i]  # what is above them says that they are units
        if is_blank(turned[0][i]):
            turned[0][i] = "run" if i == 0 and "run" not in map(quantity, turned[0]) else ""
    return replace(
        grid,
        rows=list(turned),
        numbers=list(range(1, len(turned) + 1)),
        place="column",
        merged=[],
        said=[*grid.said, "the first column names the quantities: read as a table that is turned"],
    )


def _lies(rows: Sequence[Sequence[Cell]]) -> bool:
    """Whether the first column names the quantities, and no row does."""
    first = rows[:SEARCHED]
    if any(len({quantity(cell) for cell in row} - {""}) >= _LEAST_QUANTITIES for row in first):
        return False
    named = [name for row in first if (name := _quantity_of(row))]
    return len({*named} - _OF_TEXTS) >= _LEAST_QUANTITIES and len({*named}) == len(named)


def _quantity_of(row: Sequence[Cell]) -> str:
    """The quantity that a row's first cell names; empty if none, or if the other cells are not its values."""
    name = quantity(row[0]) if row and len(str(row[0]).strip()) > _SHORT else ""
    others = [cell for cell in row[1:] if not is_blank(cell) and str(cell).strip("-– ")]
    numbers = sum(map(_is_number, others))
    return name if others and (name in _OF_TEXTS or 2 * numbers > len(others)) else ""


def one_row_a_reading(
    headings: Mapping[str, Heading], texts: Mapping[str, Sequence[str]], numeric: Sequence[str]
) -> str:
    """Describe how to rearrange a table in which each row is one reading and a column names its quantity.

    Returns a text for the user; empty for any other table.

    Parameters
    ----------
    headings
        Headings of the table, by our name of the column.
    texts
        Cells of each column of texts, by our name of the column.
    numeric
        Our names of the columns of numbers.
    """
    known = {*CHANNELS, "load"}
    for name, cells in texts.items():
        if name in TEXTS or not numeric:
            continue
        times = Counter(cell for cell in cells if cell)
        if not 1 < len(times) <= min(_MOST_QUANTITIES, len(cells) // 2) or min(times.values()) < 2:
            continue
        if plain(name) not in _NAMES_CALLED and not any(quantity(cell) in known for cell in times):
            continue
        values = next((n for n in numeric if "val" in plain(n) or "wert" in plain(n)), numeric[0])
        of = clipped(headings[name].text)
        listed = ", ".join(f"'{clipped(shown(cell))}'" for cell in [*times][:5])
        return (
            f"it has one row a reading: column '{of}' says what each is of ({listed}). Expected one row a"
            " measurement, with a column for each quantity: pivot it first (in a spreadsheet a pivot table"
            f" with '{of}' as columns, in pandas df.pivot_table(index=TIME, columns='{of}',"
            f" values='{clipped(headings[values].text)}')), and bring readings of one instant into one row"
        )
    return ""
