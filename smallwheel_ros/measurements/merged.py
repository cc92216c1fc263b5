# SPDX-License-Identifier: Apache-2.0
"""Cells that stand for those below them: merged ranges of a sheet, and names that are typed once.

A name is typed once where it begins each stretch of rows and blanks follow. Blanks elsewhere are names
that are missing, and stay so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby, pairwise

from smallwheel_ros.measurements.cells import Cell, clipped, is_blank, shown
from smallwheel_ros.measurements.columns import CHANNELS
from smallwheel_ros.measurements.layout import Layout
from smallwheel_ros.measurements.words import Heading

_NAMES = ("run", "soil", "wheel")
# Names with blanks below them, of all names: fewer are names that somebody forgot.
_MOSTLY = 0.5

Merged = Sequence[tuple[int, int, int]]  # column from 0, first and last row of the sheet


def fill_down(layout: Layout, named: Mapping[int, Heading], merged: Merged) -> list[str]:
    """Fill blanks that a cell above stands for, but for what was measured; say in which columns."""
    said = []
    for position, heading in named.items():
        cells = [*layout.columns[position]]
        if heading.name.removesuffix("_std") in CHANNELS or not any(map(is_blank, cells)):
            continue
        filled = _in_ranges(cells, layout, [m for m in merged if m[0] == position])
        if heading.name in _NAMES and _is_typed_once(filled):
            filled = _from_above(filled)
        rows = [i for i, cell in enumerate(cells) if is_blank(cell) and not is_blank(filled[i])]
        if rows:
            layout.columns[position] = filled
            said.append(
                f"'{clipped(heading.text)}' is blank below a value in {len(rows)} rows (first in row "
                f"{layout.numbers[rows[0]]}): filled from above"
            )
    return said


def _in_ranges(cells: Sequence[Cell], layout: Layout, ranges: Merged) -> list[Cell]:
    """The cells of a column, those of a merged range filled with the range's value."""
    filled, numbers = [*cells], layout.numbers.tolist()
    at = {number: i for i, number in enumerate(numbers)}
    for _, first, last in ranges:
        if first not in at:
            continue  # of the header
        for i in range(at[first], len(numbers)):
            if numbers[i] > last:
                break
            filled[i] = cells[at[first]] if is_blank(filled[i]) else filled[i]
    return filled


def _is_typed_once(cells: Sequence[Cell]) -> bool:
    """Whether blanks follow most names, and no name follows itself."""
    if is_blank(cells[0]) or not any(map(is_blank, cells)):
        return False
    names = [shown(cell).strip() for cell in cells if not is_blank(cell)]
    if any(a == b for a, b in pairwise(names)):
        return False
    followed = sum(blank for blank, _ in groupby(map(is_blank, cells)))
    return followed >= _MOSTLY * len(names)


def _from_above(cells: Iterable[Cell]) -> list[Cell]:
    filled: list[Cell] = []
    for cell in cells:
        filled.append(filled[-1] if is_blank(cell) else cell)
    return filled
