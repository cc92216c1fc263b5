# SPDX-License-Identifier: Apache-2.0
"""Which quantity each column of an unknown header may be, by its unit, its values and words that are near.

Of all ways to share out the columns that one is taken that costs least:

    cost = sum over relations of the share of rows that break it
           + what is lacking - nearness of the headers to known words (0.6 to 1)

Relations hold of any wheel, plate or shear test. A guess is decided where each other way costs more by
half a relation or more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.columns import (
    CHANNELS,
    COLUMNS,
    LAB_COLUMNS,
    Array,
    ColumnSpec,
    Mask,
)
from smallwheel_ros.measurements.nearness import nearness
from smallwheel_ros.measurements.numbers import Numbers
from smallwheel_ros.measurements.units import DIMENSIONLESS, UnitsError, fits, to_base
from smallwheel_ros.measurements.words import Heading, mapped_heading

WHEEL = (
    "load", "diameter", "width", "sinkage", "resistance", "drawbar_pull", "torque", "slip",
    "slip_angle", "slope",
)  # fmt: skip
PLATE = ("pressure", "diameter", "sinkage")
SHEAR = ("normal_stress", "shear_stress", "shear_displacement")
NEEDED = frozenset({"load", "diameter", "width", *PLATE, *SHEAR} - {"sinkage"})
# Where no unit is given: SI, as the reader takes it, then what labs write, the likeliest first.
_UNITS = {"m": ("", "mm", "cm"), DIMENSIONLESS: ("", "%")}
_LACKING = 10.0  # cost of a needed quantity without a column: more than all relations together
_NEVER_BY_VALUES = WHEEL[4:7] + WHEEL[8:]  # any number may be one
# What a resistance is not: it is against the way of travel; and a slope: no soil stands so steep.
_ODD: dict[str, Callable[[Array], Mask]] = {
    "resistance": lambda values: values < 0.0,
    "slope": lambda values: np.abs(values) > np.pi / 4,
}
# Of another one: so little that values alone do not decide it; more where a column has its unit.
_UNUSED, _UNUSED_UNIT = 0.4, 1.0
DECIDED = 0.5  # of a relation: a smaller difference of costs is no evidence
_LESS_LIKELY = 0.2  # of each further unit in which the values are possible: under what decides
_MOST_WAYS = 20_000  # that are followed, the cheapest first: some megabytes
_MOST_OPTIONS = 12  # columns of one quantity: tables have fewer


class Column(NamedTuple):
    """Values of a column in SI, and as they stand in the file; how many are different, their decimals."""

    values: Array
    written: Array
    different: int
    decimals: int


def column_of(values: Array, written: Array) -> Column:
    """What is to be known of a column. Rounding of a double is no decimal."""
    different = np.unique(written[np.isfinite(written)])
    decimals = (len(f"{v:.9f}".rstrip("0").partition(".")[2]) for v in different.tolist())
    return Column(values, written, different.size, max(decimals, default=0))


class Option(NamedTuple):
    """A column as a quantity. ours: as --map names it, with a unit where the header has none.

    cost: without relations to other columns. why: what speaks for it. by_unit: its unit does.
    """

    quantity: str
    header: str
    ours: str
    column: Column
    cost: float
    why: tuple[str, ...]
    by_unit: bool


class Guess(NamedTuple):
    """The option of the cheapest way, and what of another way that costs hardly more is there instead.

    columns: which may be the quantity too. quantities: which the column may be too. unused: whether the
    column may be none of them. All are empty where the guess is decided.
    """

    option: Option
    why: tuple[str, ...]
    columns: tuple[str, ...]
    quantities: tuple[str, ...]
    unused: bool

    @property
    def decided(self) -> bool:
        """Whether a unit or word speaks for it, and no other way is nearly as good."""
        return bool(self.option.why) and not (self.columns or self.quantities or self.unused)


def _larger(one: Column, other: Column) -> float:
    """Share of rows in which the other is larger."""
    return float(np.mean(np.abs(other.values) > np.abs(one.values)))


def _twice(one: Column, other: Column) -> float:
    return float(np.mean(2.0 * other.values > one.values))


def _other_unit(one: Column, other: Column) -> float:
    """Whether both were converted from different units."""
    return float(not np.allclose(one.values * other.written, other.values * one.written))


def _repeats(one: Column, other: Column) -> float:
    """Share of its values by which the other repeats more often; half where both have as many."""
    return (
        0.5 if one.different == other.different else max(0.0, 1.0 - other.different / one.different)
    )


def _set_again(one: Column, other: Column) -> float:
    """As `_repeats`, and nothing where both have as many."""
    found = _repeats(one, other)
    return 0.0 if found == 0.5 else found


def _rounder(one: Column, other: Column) -> float:
    """Whether the other has fewer decimals, or as many and repeats more often."""
    if one.decimals == other.decimals:
        return _set_again(one, other)
    return float(one.decimals > other.decimals)


Relation = tuple[str, str, str, Callable[[Column, Column], float]]
_SIZE, _SET = "repeats as a size does", "rounder than what is measured"
RELATIONS: tuple[Relation, ...] = (
    # A wheel that is wider than it is high is a roller.
    ("diameter", "width", "larger than the width", _larger),
    ("diameter", "width", "", _other_unit),
    # A wheel carries by its lower half (`wheels._check_heights`).
    ("diameter", "sinkage", "more than twice the sinkage", _twice),
    # A wheel on soil pulls, and is held back, with less than it carries.
    ("load", "resistance", "the largest force", _larger),
    ("load", "drawbar_pull", "the largest force", _larger),
    # Sizes change with the wheel only.
    *(("diameter", other, _SIZE, _repeats) for other in ("load", "slip", "sinkage", "pressure")),
    *(("width", other, _SIZE, _repeats) for other in ("load", "slip", "sinkage")),
    # What is set is set again, and a load is a round number.
    *(("load", answer, _SET, _rounder) for answer in CHANNELS),
    *(("slip", answer, "set again", _set_again) for answer in CHANNELS),
    ("normal_stress", "shear_stress", _SET, _rounder),
)


def options_of(
    quantity: str, headings: Mapping[str, Heading], parsed: Mapping[str, Numbers], *, early: bool
) -> list[Option]:
    """Columns that the quantity may be; those that have its unit, or are near to a word of it, if there are.

    early: whether sinkage may be under 0, before a plate touches the soil.
    """
    spec = COLUMNS.get(quantity) or LAB_COLUMNS[quantity]
    spec = replace(spec, low=-spec.high) if early and quantity == "sinkage" else spec
    bare = spec.unit != DIMENSIONLESS and any(map(has_unit, headings.values()))
    found: list[Option] = []
    for name, numbers in parsed.items():
        known = np.isfinite(numbers.values)
        wrong = bool(numbers.faults) or np.isinf(numbers.values).any() or not known.any()
        if not wrong and (known.all() or quantity not in NEEDED):
            found += _as(quantity, spec, headings[name], numbers, bare)
    told = [option for option in found if option.why]
    return (told if any(option.by_unit for option in told) else found)[:_MOST_OPTIONS]


def has_unit(heading: Heading) -> bool:
    """Whether a header gives a unit, but of a pure number."""
    return heading.unit not in (None, "%", DIMENSIONLESS) or bool(_unit_at_its_end(heading))


def _unit_at_its_end(heading: Heading) -> str:
    """The unit of `belasting_N`, which is one only behind a quantity."""
    units = (mapped_heading(heading.text, name).unit for name in ("load", "sinkage", "torque"))
    return next((unit for unit in units if unit not in (None, "%", DIMENSIONLESS)), "")


def _as(
    quantity: str, spec: ColumnSpec, heading: Heading, numbers: Numbers, bare: bool
) -> Iterator[Option]:
    """The column as this quantity: in its unit, else in each unit in which its values are possible."""
    near = nearness(heading.text)
    radius = quantity == "diameter" and near.get("radius", (0.0,)) > near.get("diameter", (0.0,))
    ours = "radius" if radius else quantity
    closeness, word = near.get(ours, (0.0, ""))
    why = (f"near to '{word}'",) if word else ()
    unit = mapped_heading(heading.text, ours).unit or heading.unit
    try:
        given = unit is not None and fits(unit, spec.unit)
    except UnitsError:  # one that nobody knows
        unit = None
        given = False
    by_values_alone = unit is None and not word
    if (unit is not None and not given) or (
        by_values_alone and (bare or quantity in _NEVER_BY_VALUES)
    ):
        return
    possible = 0
    for other in [unit] if unit is not None else _UNITS.get(spec.unit, ("",)):
        shares = numbers.percent & (other == "%")
        values = np.where(shares, 100.0, 1.0) * numbers.values * (2.0 if radius else 1.0)
        values = values if not other else to_base(values, other, spec.unit)
        if not _possible(values, spec):
            continue
        possible += 1
        said = [f"[{unit}]".replace("*g_0", "")] if given else []
        odd = _ODD.get(quantity, np.isinf)(values)
        cost = _LESS_LIKELY * (possible - 1) - closeness + float(np.mean(odd))
        named = ours if given or not other else f"{ours} [{other}]"
        column = column_of(values, numbers.values)
        yield Option(quantity, heading.text, named, column, cost, (*said, *why), given)


def _possible(values: Array, spec: ColumnSpec) -> bool:
    low, high = max(spec.low, spec.usual[0]), min(spec.high, spec.usual[1])
    known = values[np.isfinite(values)]
    return bool(((known >= low) & (known <= high)).all() and (known != 0.0).any())


def shared_out(options: Mapping[str, Sequence[Option]], known: Mapping[str, Column]) -> list[Guess]:
    """The cheapest way to give each quantity a column or none; known: values of those that are there."""
    quantities = [name for name, of in options.items() if of]
    headers = sorted({option.header for of in options.values() for option in of})
    # option of each quantity, the last: none
    ways: NDArray[np.intp] = np.zeros((1, 0), dtype=np.intp)
    used: Mask = np.zeros((1, len(headers)), dtype=bool)
    cost: Array = np.zeros(1)
    for at, name in enumerate(quantities):
        of = options[name]
        parts: list[tuple[NDArray[np.intp], Mask, Array]] = []
        for i, option in enumerate(of):
            column = headers.index(option.header)
            rows = np.flatnonzero(~used[:, column])
            add = option.cost + _against(option, known)
            for earlier, other in enumerate(quantities[:at]):
                pairs = [_between(option, rival) for rival in options[other]]
                add = add + np.array([*pairs, 0.0])[ways[rows, earlier]]
            taken = used[rows].copy()
            taken[:, column] = True
            parts.append(
                (np.column_stack([ways[rows], np.full(rows.size, i)]), taken, cost[rows] + add)
            )
        by_unit = any(option.by_unit for option in of)
        lack = _LACKING if name in NEEDED else _UNUSED_UNIT if by_unit else _UNUSED
        none = np.full(cost.size, len(of))
        parts.append((np.column_stack([ways, none]), used, cost + lack))
        ways, used, cost = (np.concatenate(part) for part in zip(*parts, strict=True))
        cheapest = np.argsort(cost, kind="stable")[:_MOST_WAYS]
        ways, used, cost = ways[cheapest], used[cheapest], cost[cheapest]
    if not any(name in known for name in CHANNELS):
        answers = [i for i, name in enumerate(quantities) if name in CHANNELS]
        size = [len(options[quantities[i]]) for i in answers]
        cost = cost + _LACKING * (ways[:, answers] == size).all(axis=1)
        cheapest = np.argsort(cost, kind="stable")
        ways, cost = ways[cheapest], cost[cheapest]
    return _guesses(quantities, options, ways, cost, known)


def _against(option: Option, known: Mapping[str, Column]) -> float:
    return sum(_broken(option.quantity, option.column, *other) for other in known.items())


def _between(one: Option, other: Option) -> float:
    return _broken(one.quantity, one.column, other.quantity, other.column)


def _broken(one: str, column: Column, other: str, rival: Column) -> float:
    """Cost of the relations between two quantities."""
    first = (broken(column, rival) for a, b, _, broken in RELATIONS if (a, b) == (one, other))
    second = (broken(rival, column) for a, b, _, broken in RELATIONS if (a, b) == (other, one))
    return sum(first) + sum(second)


def _guesses(
    quantities: Sequence[str],
    options: Mapping[str, Sequence[Option]],
    ways: NDArray[np.intp],
    cost: Array,
    known: Mapping[str, Column],
) -> list[Guess]:
    """What the cheapest way says, and the others that are nearly as good."""
    near = [_taken(quantities, options, way) for way in ways[cost < cost[0] + DECIDED]]
    best = near[0]
    there = {**known, **{name: option.column for name, option in best.items()}}
    found = []
    for name, option in best.items():
        others = [way for way in near[1:] if name not in way or way[name].header != option.header]
        columns = [way[name].header for way in others if name in way]
        takers = [[o.quantity for o in way.values() if o.header == option.header] for way in others]
        holds = (
            words
            for a, b, words, broken in RELATIONS
            if a == name and words and b in there and broken(option.column, there[b]) < DECIDED
        )
        why = (*option.why, *dict.fromkeys(holds))
        unused = any(not (taker or name in way) for taker, way in zip(takers, others, strict=True))
        taken = dict.fromkeys(quantity for taker in takers for quantity in taker)
        found.append(Guess(option, why, tuple(dict.fromkeys(columns)), tuple(taken), unused))
    return found


def _taken(
    quantities: Sequence[str], options: Mapping[str, Sequence[Option]], way: NDArray[np.intp]
) -> dict[str, Option]:
    pairs = zip(quantities, way.tolist(), strict=True)
    return {name: options[name][i] for name, i in pairs if i < len(options[name])}
