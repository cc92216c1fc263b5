# SPDX-License-Identifier: Apache-2.0
"""Which column of a table is which quantity: by its header, its unit row, or `--map`."""

from __future__ import annotations

from collections.abc import Mapping

from smallwheel_ros.measurements.cells import Problems, all_blank, clipped
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.headers import (
    UNKNOWN,
    Heading,
    mapped_heading,
    meant,
    read_heading,
)
from smallwheel_ros.measurements.layout import Layout
from smallwheel_ros.measurements.units import DIMENSIONLESS, UnitsError
from smallwheel_ros.measurements.words import plain

_MOST_NAMES = 30  # that a message lists


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
        blank = all_blank(layout.columns[position])
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
    wanted: dict[int, str] = {}
    for ours, theirs in mapping.items():
        near = None
        try:
            heading = read_heading(ours)
            near = meant(heading) if heading.rank == UNKNOWN and ours != theirs else None
        except UnitsError as error:
            problems.add(f"--map {clipped(ours)}={clipped(theirs)}: {error}")
            continue
        if near is not None:
            problems.add(
                f"--map {clipped(ours)}={clipped(theirs)}: '{clipped(ours)}' is nearly '{near}'"
            )
            continue
        at = [i for i, text in enumerate(layout.headers) if text == theirs.strip()]
        at = at or [i for i, text in enumerate(layout.headers) if plain(text) == plain(theirs)]
        at = at or [
            i for i, text in enumerate(layout.headers) if _without_unit(text) == plain(theirs)
        ]
        if len(at) == 1 and at[0] not in wanted:
            wanted[at[0]] = ours
        else:
            what = "no column" if not at else "several columns" if len(at) > 1 else "twice"
            problems.add(
                f"--map {clipped(ours)}={clipped(theirs)}: {what} '{clipped(theirs)}'. "
                f"There is: {listed(layout.headers)}"
            )
    return wanted


def _without_unit(text: str) -> str:
    return plain(text.partition("[")[0].partition("(")[0])


def _with_unit(heading: Heading, unit: str | None, problems: Problems) -> Heading:
    """The heading with the unit of the unit row, if it has none of its own."""
    if unit is None or (
        heading.unit is None and unit == DIMENSIONLESS and heading.name not in COLUMNS
    ):
        return heading
    if heading.unit is None:
        return heading._replace(unit=unit)
    if heading.unit != unit:
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
