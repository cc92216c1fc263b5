# SPDX-License-Identifier: Apache-2.0
"""Rows of a table that are no measurements: means and sums of others, remarks, the header once more."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from smallwheel_ros.measurements.cells import clipped, is_blank, shown
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.headers import Heading
from smallwheel_ros.measurements.layout import Layout
from smallwheel_ros.measurements.long_text import only_numbers
from smallwheel_ros.measurements.numbers import Numbers
from smallwheel_ros.measurements.words import is_summary, may_have_summary

_MOST_FAULTS = 1000  # texts in a column of numbers that are looked at: means and sums are few
_MOSTLY = 0.8  # an extra column with at least this share of numbers is a numeric one


def rows_not_measured(
    layout: Layout, named: Mapping[int, Heading], parsed: Mapping[int, Numbers]
) -> dict[int, str]:
    """Rows that were computed from others, headers that are repeated, remarks: by what they say."""
    found: dict[int, str] = {}
    for position, heading in named.items():
        cells = layout.columns[position]
        rows: Iterable[int] = range(len(cells))
        if position in parsed:
            if heading.name in COLUMNS or position == 0 or is_label(heading, parsed[position]):
                rows = [*parsed[position].faults][:_MOST_FAULTS]
            else:
                continue
        elif not may_have_summary("\n".join(dict.fromkeys(map(str, cells)))):
            continue
        others = frozenset(map(str, cells)) if heading.name == "run" else frozenset[str]()
        said = {i: c for i in rows if isinstance(c := cells[i], str) and is_summary(c, others)}
        if len(said) < len(cells):  # else each row is the mean of a few, and the column says so
            found |= said
    return dict(sorted((found | _without_numbers(layout, parsed)).items()))


def _without_numbers(layout: Layout, parsed: Mapping[int, Numbers]) -> dict[int, str]:
    """Rows of texts: remarks between and below the measurements, the header once more."""
    nothing = np.ones(layout.numbers.size, dtype=bool)
    for numbers in parsed.values():
        nothing &= numbers.blank
    rows = {*np.flatnonzero(nothing).tolist()}
    for row in {*layout.ragged, *_repeated_headers(layout)}:
        # a remark may have commas: it has texts only where the table has numbers
        if all(row in numbers.faults or numbers.blank[row] for numbers in parsed.values()):
            rows.add(row)
    found = {}
    for row in rows:
        texts = [shown(column[row]) for column in layout.columns if not is_blank(column[row])]
        found[row] = ", ".join(texts)
    return found


def _repeated_headers(layout: Layout) -> list[int]:
    """Rows in which the header stands again: a second table of the same columns."""
    first = layout.columns[0]
    if only_numbers(first):
        return []
    rows = [row for row, cell in enumerate(first) if cell == layout.headers[0]]
    return [
        row for row in rows
        if all(shown(c[row]) == h for c, h in zip(layout.columns, layout.headers, strict=True))
    ]  # fmt: skip


def say_left_out(layout: Layout, rows: Mapping[int, str]) -> None:
    """Say which rows are left out: the first five, and how many more."""
    for row, text in list(rows.items())[:5]:
        layout.said.append(
            f"row {layout.numbers[row]} '{clipped(text.strip())}' is no measurement: left out"
        )
    if len(rows) > 5:
        layout.said.append(f"and {len(rows) - 5} more rows like it")


def is_label(heading: Heading, parsed: Numbers) -> bool:
    """Whether a column of no known name is one of texts: too few of its cells are numbers."""
    filled = int((~parsed.blank).sum())
    texts = sum(not why for why in parsed.faults.values())
    return heading.unit is None and filled - texts < _MOSTLY * filled
