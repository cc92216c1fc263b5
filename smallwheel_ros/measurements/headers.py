# SPDX-License-Identifier: Apache-2.0
"""Understands the header of a column: `sinkage [mm]`, `Einsinkung (mm)`, `z_mm`, `Fz, N`.

The words are in words.yaml. A header is a quantity with its unit, in brackets or after it:

    1. `name [unit]`: the bracket is the unit, whatever the name
    2. the whole text is a known word or symbol
    3. `name` known and `tail` a unit of its kind, split at (), comma, blank, slash or underscore
    4. any other text is a column of the user's own, with the unit in its round brackets, if any
"""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import NamedTuple

from smallwheel_ros.measurements.columns import (
    CHANNELS,
    COLUMNS,
    DIMENSIONLESS,
    LAB_COLUMNS,
    TEXTS,
    WORDS,
    UnitsError,
    fits,
    is_common,
    spelled,
)

_ROUND_BRACKETS = re.compile(r"(.*\S)\s*\(([^()]*)\)")
_WIDE = str.maketrans("（）［］【】％", "()[][]%")  # as Japanese and Chinese keyboards write them
_PURE_NUMBERS = ("", "1", "-", "–", "—", "/")
_AT_THE_END = (
    r"\s*[,;:]\s*",  # load, N
    r"\s+(?:in|en|/)\s+",  # load in N
    r"\s*/\s*",  # load/N
    r"\s*(?=[%°]$)",  # slip%
    r"[\s_]+(?=[^\s_]+$)",  # load_N
    r"[\s_]+(?=[^\s_]+_[^\s_]+$)",  # speed_m_s
)
MAPPED = -1  # rank of a column that the user named with --map: before every other rank
UNKNOWN = 3  # rank of a column whose header is no known word
_NEAR = 0.84  # of difflib: one letter too many or too few in words of five letters or more


class Match(NamedTuple):
    """The quantity that a header names, and how closely the header matches it.

    Attributes
    ----------
    name
        Our name of the quantity, as in `columns.COLUMNS`.
    rank
        0 if the header is that name, 1 if it is another word or symbol for it, 2 if it has other words too.
    """

    name: str
    rank: int


class Heading(NamedTuple):
    """A column's header: which quantity it names, in which unit.

    Attributes
    ----------
    text
        The header as in the file.
    name
        Our name of the quantity; the header without its unit if it is unknown.
    unit
        Unit of the column, in a spelling that `columns.to_base` takes if it is known; None if the header has
        none.
    rank
        How closely the header matches the quantity: as in `Match`, or `MAPPED` or `UNKNOWN`.
    factor
        Factor that converts the column's values to the quantity: 2 for a radius, whose name is diameter.
    """

    text: str
    name: str
    unit: str | None
    rank: int
    factor: float = 1.0


@lru_cache(maxsize=10_000)
def plain(text: str) -> str:
    """The text's letters, digits, % and °, in lower case, without accents; ä, ae and a are the same."""
    letters = unicodedata.normalize("NFKD", text.casefold())
    joined = "".join(c for c in letters if c.isalnum() or c in "%°")
    return re.sub("([aou])e", r"\1", joined)


def _plain_words(words: str) -> frozenset[str]:
    return frozenset(plain(word) for word in words.split(","))


_BY_WORD = {plain(word): name for name, line in WORDS["words"].items() for word in line.split(",")}
_BY_WORD |= {plain(name): name for name in WORDS["words"]}
SYMBOLS = {symbol: name for name, line in WORDS["symbols"].items() for symbol in line.split()}
_QUALIFIERS, _DEVIATIONS = _plain_words(WORDS["qualifiers"]), _plain_words(WORDS["deviations"])
_MEANS = _plain_words(WORDS["means"])
_SUMMARIES = _MEANS | _DEVIATIONS | _plain_words(WORDS["summaries"])
_MEAN_SIGNS = ("Ø", "⌀", "x̄", "MW")  # alone: with a number it is a diameter, or a name
_STARTS = {word[:2] for word in _SUMMARIES}
_CONTACT: dict[str, str] = {
    plain(w): n for n, line in WORDS["contact"].items() for w in (n, *line.split(","))
}


def tokens_of(text: str) -> list[str]:
    """The words of a header, without punctuation and blanks."""
    return [token for token in re.split(r"[\s_,;:/()\[\]'’=±-]+", text) if token]


@lru_cache(maxsize=10_000)
def find(text: str) -> Match | None:
    """The quantity that a header without its unit names; None if it names none that is known."""
    tokens, whole = tokens_of(text), plain(text)
    if text in SYMBOLS:
        return Match(SYMBOLS[text], 1)
    if len(tokens) == 1 and tokens[0] in SYMBOLS:
        return Match(SYMBOLS[tokens[0]], 1)
    if whole in _BY_WORD:
        return Match(_BY_WORD[whole], 0 if whole == plain(_BY_WORD[whole]) else 1)
    for symbol, rest in ((tokens[-1:], tokens[:-1]), (tokens[:1], tokens[1:])):
        match = find(" ".join(rest)) if rest and symbol[0] in SYMBOLS else None
        if match is not None and match.name == SYMBOLS[symbol[0]]:
            return Match(match.name, 1)
    spread = next((w for w in _DEVIATIONS if whole.startswith(w) or whole.endswith(w)), None)
    if spread is not None:
        of = whole.removeprefix(spread) if whole.startswith(spread) else whole.removesuffix(spread)
        channel = _BY_WORD.get(of, SYMBOLS.get(tokens[0], "")) if tokens else ""
        rank = 0 if whole == plain(f"{channel}_std") else 1
        return Match(f"{channel}_std", rank) if channel in CHANNELS else None
    rest = [token for token in tokens if plain(token) not in _QUALIFIERS]
    if rest and len(rest) < len(tokens):
        match = find(" ".join(rest))
        # the pressure of a tyre is not that on the soil, nor a wheel's length that of a plate
        if match is not None and match.name not in ("pressure", "length"):
            return Match(match.name, 2)
    return None


def near_miss(text: str) -> str | None:
    """The quantity whose word a text of five letters or more misspells by one keystroke; None if none."""
    whole = plain(text)
    if whole in _BY_WORD or len(whole) < 5:
        return None
    close = difflib.get_close_matches(whole, _BY_WORD, n=1, cutoff=_NEAR)
    return _BY_WORD[close[0]] if close else None


def meant(heading: Heading) -> str | None:
    """The quantity that an unknown header, as `sinkge_mm` or `sinkage (foo)`, likely means; None if none."""
    brackets = _ROUND_BRACKETS.fullmatch(heading.name)
    match = find(brackets[1]) if brackets else None
    if match is not None:
        return match.name
    names = [heading.name, *(rest for rest, tail in _splits(heading.text) if is_common(tail))]
    return next((near for name in names if (near := near_miss(name)) is not None), None)


def expected_unit(name: str) -> str | None:
    """SI unit that the quantity must have; None if any will do."""
    spec = COLUMNS.get("diameter" if name == "radius" else name) or LAB_COLUMNS.get(name)
    return None if spec is None else spec.unit


@lru_cache(maxsize=10_000)
def read_heading(text: str, known: Match | None = None) -> Heading:
    """Split a header into quantity and unit.

    Parameters
    ----------
    text
        The header as in the table.
    known
        The quantity, where the user has named it; None: it is looked for in the text.

    Raises
    ------
    UnitsError
        If a square bracket is not closed, or text follows it.
    """
    text = " ".join(text.split())
    return _understood(text.translate(_WIDE), known)._replace(text=text)


def _understood(text: str, known: Match | None) -> Heading:
    if "[" in text or "]" in text:
        found = re.fullmatch(r"([^\[\]]*)\[([^\[\]]*)\]", text)
        if found is None:
            raise UnitsError(
                "expected a name and one unit in brackets at its end, like 'sinkage [mm]'"
            )
        name = found[1].strip()
        return _heading(name, known or find(name), found[2].strip())
    # `F_N` alone may be a force F in N: it is the normal force where its unit stands beside or below it
    whole = None if text in SYMBOLS and "_" in text else find(text)
    if whole is not None and known is None and not text.endswith(")"):
        return _heading(text, whole, None)
    whole = known or whole
    if known is not None and text in SYMBOLS:
        return _heading(text, known, None)
    for name, tail in _splits(text):
        match = known or find(name)
        if match is None or match.name in TEXTS:
            continue
        if SYMBOLS.get(tail) == match.name or find(tail) == (match.name, 1):
            return _heading(name, match, None)
        expected = expected_unit(match.name)
        unit = _unit(tail, expected)
        if unit and (is_common(tail) if expected is None else fits(unit, expected)):
            return _heading(name, match, tail)
    if brackets := _ROUND_BRACKETS.fullmatch(text):
        name, tail = brackets.groups()
        match = known or find(name)
        if spelled(tail, None) is not None and (match is not None or is_common(tail)):
            return _heading(name, match, tail)
    return _heading(text, whole, None)


def _splits(text: str) -> Iterator[tuple[str, str]]:
    """Yield each way to split a header into a name and what may be its unit or symbol, the surest first."""
    if brackets := _ROUND_BRACKETS.fullmatch(text):
        yield brackets[1], brackets[2].strip()
    for separator in _AT_THE_END:
        where = [m.span() for m in re.finditer(separator, text) if m.start() > 0]
        for start, end in where[:1] + where[-1:]:
            if text[end:]:
                yield text[:start], text[end:]


def _unit(text: str, expected: str | None) -> str | None:
    """The unit that stands after a name, as `columns.to_base` takes it; None where none is known."""
    if text in _PURE_NUMBERS:
        return DIMENSIONLESS
    return spelled(text, expected) or spelled(text.replace("_", "/"), expected)


def _heading(name: str, match: Match | None, unit: str | None) -> Heading:
    expected = None if match is None else expected_unit(match.name)
    if unit is not None:
        ours = _unit(unit, expected)
        by_symbol = match is not None and match.rank == 1 and name in SYMBOLS
        if by_symbol and ours and expected and not fits(ours, expected):
            match = None  # `s [mm]` is no slip, `i [A]` neither
        unit = ours or unit  # an unknown one is reported with its values
    elif match is not None and match.name == "torque" and name in SYMBOLS:
        match = None  # T and M alone may be a temperature, a mass
    if match is None:
        return Heading(name, name, unit, UNKNOWN)
    if match.name == "radius":
        return Heading(name, "diameter", unit, max(match.rank, 1), 2.0)
    return Heading(name, match.name, unit, match.rank)


def mapped_heading(text: str, ours: str) -> Heading:
    """Heading of a column whose quantity the user has named, as in `--map "load [kN]=F"`.

    Parameters
    ----------
    text
        The table's own header, `F`.
    ours
        Our name of the quantity, `load [kN]`. Its unit, if it has one, replaces that of the header.

    Raises
    ------
    UnitsError
        If a square bracket of either is not closed.
    """
    wanted = read_heading(ours)
    known = Match(wanted.name if wanted.factor == 1.0 else "radius", MAPPED)
    unit = read_heading(text, known).unit if wanted.unit is None else wanted.unit
    return Heading(text, wanted.name, unit, MAPPED, wanted.factor)


def contact_of(text: str) -> str:
    """`rolling`, `pressed` or `plate` for a word that means one of them; any other text unchanged."""
    return _CONTACT.get(plain(text), text)


def is_summary(text: str, names: Collection[str] = ()) -> bool:
    """Whether a cell marks its row as a mean, sum or deviation of the rows around it.

    Parameters
    ----------
    text
        The cell.
    names
        Names of runs in the table: "Mean a" is a summary only if there is a run "a".
    """
    if text.strip() in _MEAN_SIGNS:
        return True
    if plain(text[:4])[:2] not in _STARTS:
        return False  # quick, for many rows
    whole = plain(text)
    if whole in _SUMMARIES:
        return True
    first, *rest = [plain(token) for token in tokens_of(text)] or [""]
    ordinary = ("of", "von", "de", "aus", "n", "value", "values", "wert")
    rest = [r for r in rest if not (r.isdigit() or r in ordinary or r in _BY_WORD)]
    return first in _MEANS | _DEVIATIONS and (not rest or "".join(rest) in map(plain, names))
