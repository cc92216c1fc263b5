# SPDX-License-Identifier: Apache-2.0
"""Numbers as people type them for a setting: `60`, `20:140:10`, `0.1,0.2`, `17 cm`, `30%`.

Each is read like a cell of a table, and its unit like that of a header.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smallwheel_ros.arguments import Levels, Setting, unheard
from smallwheel_ros.common.errors import ArgumentError, SmallwheelError, nearest
from smallwheel_ros.measurements.cells import TWO_WAYS, read_numbers
from smallwheel_ros.measurements.columns import (
    COLUMNS,
    GRAVITY_COLUMN,
    OTHER,
    Array,
    UnitsError,
    is_mass,
    shown_unit,
    spelled,
    to_base,
    unit_of,
    weight_under,
)
from smallwheel_ros.measurements.headers import near_miss

if TYPE_CHECKING:
    from smallwheel_ros.measurements.measurements import Measurements

_MOST = 100_000
_EXPECTED = "a number, start:stop:step or a list a,b,c"
_UNITS = {"compliance": "m/N"}  # of arguments that are no column
# A number as a cell may have it, and what follows it.
_NUMBER = re.compile(
    r"\s*([-+\u2212\u2012\u2013]?[0-9]*(?:[ '\u2019\u00a0\u202f][0-9]{3}(?![0-9]))*[0-9.,]*"
    r"(?:(?<=[0-9.,])[eE][-+]?[0-9]+)?)(.*)",
    re.DOTALL,
)


class RangeError(SmallwheelError):
    """A number or range that cannot be read."""


def check_setting(name: str) -> None:
    """Raise ArgumentError for an unknown setting whose name is one typing error from a known one."""
    near = None if name in COLUMNS else near_miss(name)
    if near is not None:
        raise ArgumentError(f"setting: found '{name}', which is nearly '{near}'")


class Typed(NamedTuple):
    """The values of a setting, read from what the user typed.

    Attributes
    ----------
    values
        SI units, shape (values,).
    said
        Sentence for the user if a mass was taken as its weight or a comma as a decimal mark; else empty.
    mass
        Whether a mass was typed for a force; `values` are its weight, under the standard gravity unless it
        comes from `weighed`.
    """

    values: Array
    said: str = ""
    mass: bool = False


def levels_of(name: str, value: Setting) -> Typed:
    """Values of a setting in SI units, from numbers or a text.

    Parameters
    ----------
    name
        Name of the setting.
    value
        One or several numbers in SI units, or a text that `typed` can read.

    Raises
    ------
    ArgumentError
        If it is neither, or has no value.
    RangeError
        If `typed` cannot read the text.
    """
    if isinstance(value, str):
        return typed(name, value, unit_of(name) or None)
    try:
        levels = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: found {value!r}, expected a number or several") from None
    if not levels.size:
        raise ArgumentError(f"{name}: found no value, expected a number or several")
    return Typed(levels)


def weighed(levels: Mapping[str, Typed]) -> dict[str, Typed]:
    """The settings by name, with a load that was typed as a mass converted under the gravity that was typed.

    Without a setting `gravity` nothing changes. Raises RangeError if a gravity is out of range, or if there
    are several and the load is a mass.
    """
    found = dict(levels)
    if GRAVITY_COLUMN not in levels:
        return found
    load, gravity = levels["load"], levels[GRAVITY_COLUMN].values
    spec = COLUMNS[GRAVITY_COLUMN]
    if spec.bad(gravity).any():
        wrong = gravity[int(np.argmax(spec.bad(gravity)))]
        raise RangeError(f"gravity: found {wrong:g}, expected {spec.expected()}; {spec.hint}")
    if load.mass:
        if gravity.size > 1:
            raise RangeError(
                "load: found a mass and several gravities: give the load in N, or one gravity at a time"
            )
        values = weight_under(load.values, gravity[0])
        shown = " to ".join(dict.fromkeys(f"{v:.4g}" for v in (values.min(), values.max())))
        said = f"load: what masses weigh under {gravity[0]:g} m/s^2, {shown} N"
        found["load"] = Typed(values, said, mass=True)
    return found


def number_of(name: str, given: float | str) -> Typed:
    """Read one number, in SI units: `values` of the result has shape (1,).

    Parameters
    ----------
    name
        Name of the setting, which errors repeat.
    given
        A number in SI units, or a text with a unit.

    Raises
    ------
    RangeError
        If it is not a number, or there are several.
    """
    read = (
        Typed(np.array([given]))
        if isinstance(given, (int, float))
        else typed(name, given, _UNITS.get(name) or unit_of(name), several=False)
    )
    if read.values.size > 1:
        raise RangeError(f"{name}: found '{given}', expected one number")
    return read


def typed(name: str, text: str, unit: str | None, *, several: bool = True) -> Typed:
    """Read the values of a setting that a user typed, in SI units.

    The forms are `a`, `a,b,c`, `start:stop:step` (stop included) and `low..high` (both ends and the middle),
    followed by a unit unless it is SI. A comma separates values; it is a decimal mark only where a list is
    impossible: in a single value, and between semicolons.

    Parameters
    ----------
    name
        Name of the option, which errors repeat.
    text
        What the user typed.
    unit
        The SI unit of the values; None if any unit will do.
    several
        Whether commas may separate values; if not, every comma is a decimal mark.

    Raises
    ------
    RangeError
        If the text has none of these forms, or its unit is unknown or of another dimension.
    """
    text = text.strip()
    if not several:
        return _reading(name, text, unit, ";", "a number")
    if ";" in text or "," not in text:
        return _reading(name, text, unit, ";")
    listed = None
    with suppress(RangeError):
        listed = _reading(name, text, unit, ",")
        if _is_list(name, text, listed.values):
            return listed
    with suppress(RangeError):
        decimal = _reading(name, text, unit, ";")
        if _allowed(name, decimal.values):
            return decimal
    return listed or _reading(name, text, unit, ",")  # which says what is wrong


def _is_list(name: str, text: str, values: Array) -> bool:
    """Whether a text with commas can be a list: values are allowed, and none begins with a 0 as in 0,05."""
    return _allowed(name, values) and re.search(r",0[0-9]", text) is None


def _allowed(name: str, values: Array) -> bool:
    return not bool(COLUMNS.get(name, OTHER).bad(values).any())


def _reading(
    name: str, text: str, unit: str | None, separator: str, expected: str = _EXPECTED
) -> Typed:
    """Values of a text, as `typed` returns them.

    separator: what separates values; where it is no comma, commas are decimal marks. expected: the forms that
    an error names.
    """
    pieces = [re.split(r"(:|\.\.)", piece) for piece in text.split(separator)]
    ends = [_NUMBER.fullmatch(end) for piece in pieces for end in piece[::2]]
    numbers, units = zip(
        *((end[1], end[2].strip()) for end in ends if end is not None), strict=True
    )
    if "" in numbers or not {*units} <= {"", units[-1]}:
        raise RangeError(f"{name}: found '{text}', expected {expected}")
    (read,) = read_numbers([numbers], False)
    if TWO_WAYS in read.faults.values():
        raise RangeError(
            f"{name}: found '{text}', which {TWO_WAYS.partition(':')[0]}: write a decimal point, and no "
            "mark of thousands"
        )
    if read.blank.any() or read.faults:
        raise RangeError(f"{name}: found '{text}', expected {expected}")
    if not np.all(np.isfinite(read.values)):
        raise RangeError(f"{name}: found '{text}', expected finite numbers")
    rest = iter(read.values.tolist())
    values = np.concatenate([_expanded(name, piece, [next(rest) for _ in piece[::2]])
                             for piece in pieces])  # fmt: skip
    given, weight = spelled(units[-1], unit) or units[-1], ""
    mass = is_mass(given)
    if mass:
        weight = ", the weight of that mass"
    try:
        values = to_base(values, given, unit) if given else values
    except UnitsError as error:
        raise RangeError(f"{name}: {error}") from error
    comma = ", a decimal comma" if read.comma else ""
    if not (weight or comma):
        return Typed(values)
    shown = " to ".join(dict.fromkeys(f"{v:.4g}" for v in (values.min(), values.max())))
    return Typed(
        values, f"'{text}' -> {name} {shown} {shown_unit(unit)}".rstrip() + weight + comma, mass
    )


def _expanded(name: str, piece: Sequence[str], ends: Sequence[float]) -> Array:
    """Values of a number, of start:stop:step, or of low..high. piece: its parts, split at the marks."""
    text = "".join(piece)
    if len(ends) == 1:
        return np.array(ends)
    if ".." in piece:
        if len(ends) != 2 or ends[0] > ends[1]:
            raise RangeError(f"{name}: the range '{text}' is empty; expected low..high")
        return np.array([ends[0], 0.5 * (ends[0] + ends[1]), ends[1]])
    if len(ends) != 3:
        raise RangeError(f"{name}: found '{text}', a range is start:stop:step")
    start, stop, step = ends
    if step <= 0 or stop < start:
        raise RangeError(f"{name}: the range '{text}' is empty; start <= stop and step > 0")
    count = int((stop - start) / step + 1e-9) + 1
    if count > _MOST:
        raise RangeError(f"{name}: the range '{text}' has {count} values, at most {_MOST}")
    return np.asarray(start + step * np.arange(count))


def limits_of(
    can: Levels | None, measurements: Measurements, told: Callable[[str], object] = unheard
) -> dict[str, list[float]]:
    """Values that a user can set in the next measurements, in SI units, by name of the setting.

    Parameters
    ----------
    can
        Values by name of the setting, as numbers or as a text for `typed`; None: no settings.
    measurements
        The table, which must have these settings.
    told
        Called for each setting with `Typed.said`, which is empty where nothing was interpreted.

    Raises
    ------
    ArgumentError
        If the table has no such setting, or the levels are not numbers.
    """
    found: dict[str, list[float]] = {}
    known = ("load", "diameter", "width", *measurements.conditions.covariates)
    for name, levels in (can or {}).items():
        if name not in known:
            raise ArgumentError(
                f"can {name}={levels!r}: the table has no setting '{name}': {nearest(name, list(known))}"
            )
        unit = measurements.units.get(name, unit_of(name)) or None
        try:
            read = typed(name, levels, unit) if isinstance(levels, str) else levels_of(name, levels)
        except RangeError as error:
            raise ArgumentError(
                f"can {error}; write numbers as in {name}=0..0.6 or {name}=20,40,60, in SI units or with a "
                "unit after them"
            ) from None
        told(read.said)
        found[name] = [float(v) for v in read.values]
    return found
