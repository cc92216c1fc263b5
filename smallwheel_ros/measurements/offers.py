# SPDX-License-Identifier: Apache-2.0
"""What is offered where headers are not understood: a `--map` line to paste, and the reason of each guess."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.measurements.cells import Cell, Grid, MeasurementsError, clipped, shown
from smallwheel_ros.measurements.columns import CHANNELS
from smallwheel_ros.measurements.display import brief
from smallwheel_ros.measurements.guesses import (
    NEEDED,
    PLATE,
    SHEAR,
    WHEEL,
    Column,
    Guess,
    column_of,
    options_of,
    shared_out,
)
from smallwheel_ros.measurements.nearness import nearness
from smallwheel_ros.measurements.numbers import Numbers, read_numbers
from smallwheel_ros.measurements.reading import Columns, read_columns
from smallwheel_ros.measurements.settings import LOAD_TOLERANCE, ends_of_runs
from smallwheel_ros.measurements.table import codes_of
from smallwheel_ros.measurements.units import UnitsError, fits
from smallwheel_ros.measurements.words import (
    MAPPED,
    UNKNOWN,
    Heading,
    expected_unit,
    meant,
    plain,
)

_LONGEST = 80  # characters of a header that goes on a line
_MOST_ROWS = 2000  # that evidence is taken from
_GIVEN_FOR_ALL = {"diameter", "width"}  # by options


@dataclass
class Offer:
    """Our names and their headers, with those that the user gave; the reason of each, in words."""

    mapping: dict[str, str]
    said: list[str] = field(default_factory=list)

    def add(self, ours: str, header: str, why: Iterable[str]) -> None:
        """Put a column on the line."""
        self.mapping[ours] = header
        self.said.append(f"{ours}: '{clipped(header)}', {'; '.join(why)}")

    def text(self) -> str:
        """The options, quoted for a shell, and the reasons."""
        pairs = [f"{ours}={header}" for ours, header in self.mapping.items()]
        line = shlex.join([word for pair in pairs for word in ("--map", pair)])
        return "\n    ".join([line, *self.said])


def offer_of(grid: Grid, mapping: Mapping[str, str], given: Collection[str]) -> Offer | None:
    """What the columns that no word is known for may be; None where nothing is lacking.

    given: quantities that were given for all rows.
    """
    try:
        columns = read_columns(grid, mapping)
    except MeasurementsError:
        return None  # no table at all
    unknown = _to_be_mapped(columns)
    there = {
        name for name, h in columns.headings.items() if h.rank != UNKNOWN and name not in unknown
    }
    there |= {*given}
    wanted = [name for name in _kind(columns) if name not in there]
    nearly = {meant(heading) for heading in unknown.values()} - {None}
    wrong = any(heading.rank != UNKNOWN for heading in unknown.values())
    channel = any(name in there for name in CHANNELS)
    if not unknown or not (nearly - there or wrong or NEEDED & {*wanted} or not channel):
        return None
    rows = np.unique(np.linspace(0, columns.lines.size - 1, _MOST_ROWS).astype(np.intp))
    cells = {name: [of[row] for row in rows.tolist()] for name, of in columns.cells.items()}
    parsed = dict(zip(cells, read_numbers([*cells.values()], grid.comma), strict=True))
    counts = {name for name, h in unknown.items() if h.rank == UNKNOWN and _is_count(parsed[name])}
    numeric = {name: parsed[name] for name in unknown if name not in counts}
    known = {
        name: column_of(values[rows], parsed[name].values)
        for name, values in columns.numbers.items()
        if name in there and name in parsed and np.isfinite(values[rows]).any()
    }
    early = wanted[:1] == ["pressure"]
    options = {name: options_of(name, unknown, numeric, early=early) for name in wanted}
    guesses = shared_out(options, known)
    known |= {guess.option.quantity: guess.option.column for guess in guesses}
    lacking = NEEDED & {*wanted} - {*known}
    if lacking - _GIVEN_FOR_ALL:
        return None  # of the rest nothing is known
    found = Offer(dict(mapping))
    channels = [guess for guess in guesses if guess.option.quantity in CHANNELS]
    channel |= any(guess.decided for guess in channels)
    one = channels[:1] if not channel else []  # a table has one at least
    for guess in guesses:
        _take(found, guess, needed=guess.option.quantity in NEEDED or guess in one)
    found.said += [f"{name}: no column can be it, give --{name}" for name in sorted(lacking)]
    names = {name: cells[name] for name in unknown if name in counts or name in columns.texts}
    _take_names(found, names, unknown, known, there)
    ours = there | {name.partition(" [")[0] for name in found.mapping}
    for heading in unknown.values():
        near = meant(heading)
        if near and near not in ours and heading.text not in found.mapping.values():
            found.add(heading.text, heading.text, ["kept as a column of your own"])
    return found if len(found.mapping) > len(mapping) else None


def _to_be_mapped(columns: Columns) -> dict[str, Heading]:
    """Columns of no known word, and those without a unit in which SI does not fit, that `--map` can name."""
    headings = columns.headings
    alike = [plain(heading.text) for heading in headings.values()]
    wrong = (name for name in headings if name in WHEEL and _is_of_another_unit(columns, name))
    units = {expected_unit(name) for name in wrong}
    return {
        name: heading
        for name, heading in headings.items()
        if (heading.rank == UNKNOWN or (_has_no_unit(heading) and expected_unit(name) in units))
        and len(heading.text) <= _LONGEST
        and heading.text.isprintable()
        and alike.count(plain(heading.text)) == 1
    }


def _has_no_unit(heading: Heading) -> bool:
    return heading.unit is None and heading.rank not in (MAPPED, UNKNOWN)


def _is_of_another_unit(columns: Columns, name: str) -> bool:
    """Whether a known header without a unit stands above values that are all wrong, but for zeros."""
    values = columns.numbers.get(name)
    if not _has_no_unit(columns.headings[name]) or values is None:
        return False
    return bool((np.isnan(values) | (values == 0.0)).all() and (~columns.sound(name)).any())


def _kind(columns: Columns) -> tuple[str, ...]:
    """Quantities of a table of wheels, of plates or of shear tests, by the units of its columns."""

    def count(unit: str) -> int:
        return sum(_is_of(heading.unit, unit) for heading in columns.headings.values())

    if count("N") or "load" in columns.headings:
        return WHEEL
    return (WHEEL, PLATE, SHEAR)[min(count("Pa"), 2)]


def _is_of(unit: str | None, kind: str) -> bool:
    try:
        return unit is not None and fits(unit, kind)
    except UnitsError:
        return False


def _take(found: Offer, guess: Guess, *, needed: bool) -> None:
    """Put a guess on the line; one that is not needed and may be another quantity is only said."""
    option = guess.option
    low, high = np.nanmin(option.column.values), np.nanmax(option.column.values)
    ends = " to ".join(dict.fromkeys(brief(float(value)) for value in (low, high)))
    why = [f"{ends} {expected_unit(option.quantity)}".removesuffix(" 1"), *guess.why]
    rivals = [f"'{clipped(name)}'" for name in guess.columns] + [*guess.quantities]
    if rivals and not needed:
        what = f"'{clipped(option.header)}': {option.quantity} or {', '.join(rivals)}"
        found.said.append(f"left out, as nothing decides it: {what}")
        return
    if rivals or guess.unused:
        why.insert(0, f"NOT DECIDED, or {', '.join(rivals) or 'a column of your own'}")
    elif not guess.decided:
        why.insert(0, "NOT DECIDED, by its values alone")
    if plain(option.ours) != plain(option.header):  # else it is read so already
        found.add(option.ours, option.header, why)


def _is_count(numbers: Numbers) -> bool:
    """Whether a column numbers its rows: whole numbers in steps of one."""
    values = np.unique(numbers.values[np.isfinite(numbers.values)])
    whole = values.size > 1 and not numbers.faults and (values == np.round(values)).all()
    return bool(whole and (np.diff(values) == 1.0).all() and values[0] >= 1.0)


def _take_names(
    found: Offer,
    names: Mapping[str, Sequence[Cell]],
    headings: Mapping[str, Heading],
    known: Mapping[str, Column],
    there: Collection[str],
) -> None:
    """As the run a column in which each name is of one setting; what a near word says of the others."""
    near = {name: nearness(headings[name].text) for name in names}
    left = [name for name in names if headings[name].rank == UNKNOWN]
    runs = {name: count for name in left if (count := _runs(names[name], known)) > 1}
    if runs and "run" not in there:
        # a word that is near, else the most names
        evidence = {n: (near[n].get("run", (0.0,))[0], count) for n, count in runs.items()}
        run = max(runs, key=evidence.__getitem__)
        rivals = [f"'{clipped(n)}'" for n in runs if n != run and evidence[n] == evidence[run]]
        why = [f"NOT DECIDED, or {', '.join(rivals)}"] if rivals else []
        why += [f"near to '{near[run]['run'][1]}'"] if "run" in near[run] else []
        found.add("run", headings[run].text, [*why, f"{runs[run]} names, each of one setting"])
        left.remove(run)
    for ours in (name for name in ("soil", "wheel") if name not in there):
        nearest = max(left, key=lambda name: near[name].get(ours, (0.0, "")), default=None)
        if nearest is not None and ours in near[nearest]:
            found.add(ours, headings[nearest].text, [f"near to '{near[nearest][ours][1]}'"])
            left.remove(nearest)


def _runs(cells: Sequence[Cell], known: Mapping[str, Column]) -> int:
    """How many names there are; 0 where most of them stand at several loads or sizes."""
    names, code = codes_of(np.array([shown(cell) for cell in cells]))
    if "" in names:
        return 0
    same = np.ones(len(names), dtype=bool)
    for setting in ("load", "diameter", "width", "normal_stress"):
        if setting in known:
            low, high = ends_of_runs(known[setting].values, code, len(names))
            same &= high <= (1.0 + LOAD_TOLERANCE) * low
    return len(names) if 2 * int(same.sum()) > len(names) else 0
