# SPDX-License-Identifier: Apache-2.0
"""Rows of a table that are no measurements: what was computed from others, remarks, the header again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from smallwheel_ros.measurements.cells import clipped, is_blank, shown
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.layout import Layout
from smallwheel_ros.measurements.numbers import Numbers
from smallwheel_ros.measurements.summaries import Sheet, computed_rows
from smallwheel_ros.measurements.words import UNKNOWN, Heading, is_summary, may_have_summary

_MOST_FAULTS = 1000  # texts in a column of numbers that are looked at: means and sums are few
_MOSTLY = 0.8  # an extra column with at least this share of numbers is a numeric one
_MOST_SAID, _MOST_LINES = (
    5,
    30,
)  # rows that are said in a line of their own, and those that are listed
_NEEDED = ("load", "diameter", "width")


def rows_not_measured(
    layout: Layout, named: Mapping[int, Heading], parsed: Mapping[int, Numbers]
) -> dict[int, str]:
    """Rows that are no measurements, and what is to say of them.

    Means and sums of others, remarks between and below the measurements, the header once more.
    """
    said = _by_words(layout, named, parsed)
    found = {
        row: f"'{clipped(text.strip())}' is no measurement: left out" for row, text in said.items()
    }
    for row, what in computed_rows(_sheet(layout, named, parsed), said).items():
        cells = (shown(c[row]).strip() for c in layout.columns if not is_blank(c[row]))
        found[row] = f"'{clipped(next(cells, ''))}' is {what}: left out"
    return dict(sorted(found.items()))


def lines_left_out(layout: Layout, rows: Mapping[int, str]) -> list[str]:
    """What is said of the rows that are left out, with the line of each."""
    lines = [f"row {layout.numbers[row]} {what}" for row, what in [*rows.items()][:_MOST_SAID]]
    if more := [str(layout.numbers[row]) for row in rows][_MOST_SAID:]:
        dots = ", ..." if len(more) > _MOST_LINES else ""
        lines.append(f"and {len(more)} more rows like it: {', '.join(more[:_MOST_LINES])}{dots}")
    return lines


def _by_words(
    layout: Layout, named: Mapping[int, Heading], parsed: Mapping[int, Numbers]
) -> dict[int, str]:
    found: dict[int, str] = {}
    for position, heading in named.items():
        cells, rows = layout.columns[position], range(len(layout.numbers))
        texts = [*rows]
        if position in parsed:
            known = heading.name in COLUMNS or position == 0
            numeric = not (known or is_label(heading, parsed[position]))
            texts = [] if numeric else [*parsed[position].faults][:_MOST_FAULTS]
        elif not may_have_summary("\n".join(dict.fromkeys(map(str, cells)))):
            continue
        names = frozenset(map(str, cells)) if heading.name == "run" else frozenset[str]()
        said = {i: c for i in texts if isinstance(c := cells[i], str) and is_summary(c, names)}
        if len(said) < len(cells):  # else each row is the mean of a few, and the column says so
            found |= said
    nothing = np.all([numbers.blank for numbers in parsed.values()], axis=0)
    remarks = {*np.flatnonzero(nothing).tolist()} if parsed else set(range(layout.numbers.size))
    again = [i for i, cell in enumerate(layout.columns[0]) if cell == layout.headers[0]]
    again = [i for i in again if [shown(c[i]) for c in layout.columns] == layout.headers]
    for row in {*layout.ragged, *again}:
        # a remark may have commas: it has texts only where the table has numbers
        if all(row in numbers.faults or numbers.blank[row] for numbers in parsed.values()):
            remarks.add(row)
    for row in remarks:
        filled = (c[row] for c in layout.columns if not is_blank(c[row]))
        found[row] = ", ".join(map(shown, filled))
    return found


def _sheet(layout: Layout, named: Mapping[int, Heading], parsed: Mapping[int, Numbers]) -> Sheet:
    """The table as computed rows are searched in: numbers, and what the rows are called."""
    numeric = {
        i: numbers
        for i, numbers in parsed.items()
        if not numbers.blank.all()
        and not (named[i].rank == UNKNOWN and is_label(named[i], numbers))
    }
    titles = {i: named[i].name for i in numeric}
    texts = {named[i].name: layout.columns[i] for i in named if i not in numeric}
    wanted = [name for name in ("run", *texts) if name in texts]
    names = [texts[name] for name in dict.fromkeys(wanted)]
    needed = frozenset(i for i, name in titles.items() if name in _NEEDED)
    return Sheet(numeric, layout.columns, names, titles, needed, layout.numbers)


def is_label(heading: Heading, parsed: Numbers) -> bool:
    """Whether a column of no known name is one of texts: too few of its cells are numbers."""
    filled = int((~parsed.blank).sum())
    texts = sum(not why for why in parsed.faults.values())
    return heading.unit is None and filled - texts < _MOSTLY * filled
