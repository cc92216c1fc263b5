# SPDX-License-Identifier: Apache-2.0
"""What a column is, from what stands above it: `sinkage [mm]`, `Einsinkung (mm)`, `z_mm`, `Fz, N`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from smallwheel_ros.measurements.columns import COLUMNS, LAB_COLUMNS, TEXTS
from smallwheel_ros.measurements.units import (
    DIMENSIONLESS,
    TORQUE,
    UnitsError,
    fits,
    is_common,
    spelled,
)
from smallwheel_ros.measurements.words import SYMBOLS, Match, find, near_miss

MAPPED = -1  # rank of a column that the user named, before all that was understood
UNKNOWN = 3  # rank of a column that no word is known for
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
    if name == "torque":
        return TORQUE
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
    round_brackets = re.fullmatch(r"(.*\S)\s*\(([^()]*)\)", text)
    if round_brackets:
        rest, tail = round_brackets.groups()
        match = known or find(rest)
        unit = spelled(tail, None)
        if unit is not None and (match is not None or is_common(tail)):
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
    found = re.fullmatch(r"(.*\S)\s*\(([^()]*)\)", text)
    if found:
        yield found[1], found[2].strip()
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
    brackets = re.fullmatch(r"(.*\S)\s*\([^()]*\)", heading.name)
    match = find(brackets[1]) if brackets else None
    if match is not None:
        return match.name
    names = [heading.name, *(rest for rest, tail in _splits(heading.text) if is_common(tail))]
    return next((near for name in names if (near := near_miss(name)) is not None), None)
