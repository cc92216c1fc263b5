# SPDX-License-Identifier: Apache-2.0
"""Tables of another shape than one row a measurement: with a row a quantity, or with a row a reading.

The first is turned, where nothing else can be meant. The second is only named: which readings belong
together nobody but who took them knows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import zip_longest

from smallwheel_ros.measurements.cells import SEARCHED, Cell, CellGrid, clipped, is_blank, shown
from smallwheel_ros.measurements.columns import CHANNELS, TEXTS, UnitsError
from smallwheel_ros.measurements.headers import UNKNOWN, Heading, plain, read_heading

_LEAST = 2  # quantities that stand in the first column: one may be a title's
_SHORT = 2  # characters: so short are names of runs, too (b, i, W1)
_WORDS = {"run", "soil", "wheel", "contact"}  # whose cells are texts
_MOST_NAMES = 30  # quantities that a logger has
# What loggers call the column of the names, and that of the values.
_CALLED = {"varname", "tagname", "tag", "variable", "channel", "parameter", "signal", "quantity", "sensor",
           "kanal", "grosse", "messgrosse", "messstelle", "grandeur", "name"}  # fmt: skip


def quantity(cell: Cell) -> str:
    """The quantity that a cell names, by our name; empty where it names none."""
    if not isinstance(cell, str) or not any(c.isalpha() for c in cell):
        return ""
    with suppress(UnitsError):
        found = read_heading(cell.strip())
        return found.name if found.rank < UNKNOWN else ""
    return ""


def upright(grid: CellGrid) -> CellGrid:
    """The grid as it is, or turned where its first column names the quantities, each once.

    Parameters
    ----------
    grid
        The cells of a sheet or a file.
    """
    if grid.header is not None or not _lies(grid.rows):
        return grid
    filled = [row for row in grid.rows if not all(map(is_blank, row))]
    begins = next(i for i, row in enumerate(filled) if _named(row))
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
    if any(len({quantity(cell) for cell in row} - {""}) >= _LEAST for row in first):
        return False
    named = [name for row in first if (name := _named(row))]
    return len({*named} - _WORDS) >= _LEAST and len({*named}) == len(named)


def _named(row: Sequence[Cell]) -> str:
    """The quantity that the first cell of a row names, its other cells being values of it."""
    name = quantity(row[0]) if row and len(str(row[0]).strip()) > _SHORT else ""
    others = [cell for cell in row[1:] if not is_blank(cell)]
    numbers = sum(not isinstance(c, str) or not any(map(str.isalpha, c)) for c in others)
    return name if others and (name in _WORDS or 2 * numbers > len(others)) else ""


def one_row_a_reading(
    headings: Mapping[str, Heading], texts: Mapping[str, Sequence[str]], numeric: Sequence[str]
) -> str:
    """Words on a table whose rows have one reading each, and its name in a column; else empty.

    Parameters
    ----------
    headings
        By our name, the table's headers.
    texts
        By our name, the columns of texts.
    numeric
        Our names of the columns of numbers.
    """
    known = {*CHANNELS, "load"}
    for name, cells in texts.items():
        if name in TEXTS or not numeric:
            continue
        times = Counter(cell for cell in cells if cell)
        if not 1 < len(times) <= min(_MOST_NAMES, len(cells) // 2) or min(times.values()) < 2:
            continue
        if plain(name) not in _CALLED and not any(quantity(cell) in known for cell in times):
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
