# SPDX-License-Identifier: Apache-2.0
"""What a column is, from what stands above it: `sinkage [mm]`, `Einsinkung (mm)`, `z_mm`, `Fz, N`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from smallwheel_ros.measurements.cells import Problems, clipped, is_blank
from smallwheel_ros.measurements.columns import COLUMNS, LAB_COLUMNS, TEXTS
from smallwheel_ros.measurements.units import (
    DIMENSIONLESS,
    UnitsError,
    fits,
    is_common,
    spelled,
)
from smallwheel_ros.measurements.words import SYMBOLS, Match, find, near_miss, plain

if TYPE_CHECKING:
    from smallwheel_ros.measurements.layout import Layout

_MOST_NAMES = 30  # that a message lists
MAPPED = -1  # rank of a column that the user named, before all that was understood
UNKNOWN = 3  # rank of a column that no word is known for
_ROUND_BRACKETS = re.compile(r"(.*\S)\s*\(([^()]*)\)")
_PURE_NUMBERS = ("", "1", "-", "–", "—", "/")
_AT_THE_END = (
    r"\s*[,;:]\s*",  # load, N
    r"\s+(?:in|en|/)\s+",  # load in N
    r"\s*/\s*",  # load/N
    r"\s*(?=[%°]$)",  # slip%
    r"[\s_]+(?=[^\s_]+$)",  # load_N
    r"[\s_]+(?=[^\s_]+_[^\s_]+$)",  # speed_m_s
)


class Heading(NamedTuple):
    """A column's header, understood.

    text: as it stands in the file. name: our word for the quantity, or theirs where none is known.
    unit: as `units.to_base` takes it, None where the header has none. rank: of `words.Match`,
    `MAPPED` or `UNKNOWN`. factor: of the values, 2 for a radius.
    """

    text: str
    name: str
    unit: str | None
    rank: int
    factor: float = 1.0


def expected_unit(name: str) -> str | None:
    """SI unit that the quantity must have; None where any will do."""
    if name == "radius":
        return "m"
    spec = COLUMNS.get(name) or LAB_COLUMNS.get(name)
    return None if spec is None else spec.unit


def read_heading(text: str, known: Match | None = None) -> Heading:
    """Understand a header; `known` where the user has said which quantity it is.

    Raises UnitsError where a bracket is not closed or text follows it.
    """
    text = " ".join(text.split())
    rest, unit = _in_square_brackets(text)
    if unit is not None:
        return _heading(text, rest, known or find(rest), unit)
    whole = None if known else find(text)
    if whole is not None and not text.endswith(")"):
        return _heading(text, text, whole, None)
    for rest, tail in _splits(text):
        match = known or find(rest)
        if match is None or match.name in TEXTS:
            continue
        if SYMBOLS.get(tail) == match.name or find(tail) == (match.name, 1):
            return _heading(text, rest, match, None)
        if _fits(tail, expected_unit(match.name)):
            return _heading(text, rest, match, tail)
    if brackets := _ROUND_BRACKETS.fullmatch(text):
        rest, tail = brackets.groups()
        match = known or find(rest)
        if spelled(tail, None) is not None and (match is not None or is_common(tail)):
            return _heading(text, rest, match, tail)
    return _heading(text, text, known or whole, None)


def _in_square_brackets(text: str) -> tuple[str, str | None]:
    if "[" not in text and "]" not in text:
        return text, None
    found = re.fullmatch(r"([^\[\]]*)\[([^\[\]]*)\]", text)
    if found is None:
        raise UnitsError("expected a name and one unit in brackets at its end, like 'sinkage [mm]'")
    return found[1].strip(), found[2].strip()


def _splits(text: str) -> Iterator[tuple[str, str]]:
    """Name and what may be its unit or symbol, the surest way of writing first."""
    if brackets := _ROUND_BRACKETS.fullmatch(text):
        yield brackets[1], brackets[2].strip()
    for separator in _AT_THE_END:
        parts = re.split(separator, text)
        if len(parts) > 1 and all(parts):
            where = [m.span() for m in re.finditer(separator, text)]
            for start, end in (where[0], where[-1]):
                yield text[:start], text[end:]


def _fits(tail: str, expected: str | None) -> bool:
    if tail in _PURE_NUMBERS:
        return expected == DIMENSIONLESS
    unit = spelled(tail.replace("_", "/"), expected)
    if unit is None:
        return False
    return is_common(tail) if expected is None else fits(unit, expected)


def _heading(text: str, name: str, match: Match | None, unit: str | None) -> Heading:
    expected = None if match is None else expected_unit(match.name)
    if unit is not None:
        plain = DIMENSIONLESS if unit in _PURE_NUMBERS else spelled(unit, expected)
        if plain is None and "_" in unit:
            plain = spelled(unit.replace("_", "/"), expected)
        unit = unit if plain is None else plain  # one that nobody knows is said with its values
        by_symbol = match is not None and match.rank == 1 and name in SYMBOLS
        if by_symbol and plain is not None and expected and not fits(plain, expected):
            match = None  # `s [mm]` is no slip, `i [A]` neither
    if match is None:
        return Heading(text, name, unit, UNKNOWN)
    if match.name == "radius":
        return Heading(text, "diameter", unit, max(match.rank, 1), 2.0)
    return Heading(text, match.name, unit, match.rank)


def mapped_heading(text: str, ours: str) -> Heading:
    """The heading of a column that the user named, `--map "load [kN]=F"`.

    Raises UnitsError where a bracket of either is not closed.
    """
    wanted = read_heading(ours)
    known = Match(wanted.name, MAPPED) if wanted.factor == 1.0 else Match("radius", MAPPED)
    heading = read_heading(text, known)
    unit = heading.unit if wanted.unit is None else wanted.unit
    return Heading(text, wanted.name, unit, MAPPED, wanted.factor)


def meant(heading: Heading) -> str | None:
    """The quantity that a header of none nearly names: `sinkge_mm` or `sinkage (foo)`."""
    brackets = _ROUND_BRACKETS.fullmatch(heading.name)
    match = find(brackets[1]) if brackets else None
    if match is not None:
        return match.name
    names = [heading.name, *(rest for rest, tail in _splits(heading.text) if is_common(tail))]
    return next((near for name in names if (near := near_miss(name)) is not None), None)


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
