# SPDX-License-Identifier: Apache-2.0
"""Units as people write them, and values in SI units; pint knows the units."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.measurements.columns import DIMENSIONLESS, RADIAN, TORQUE, WORDS, Array

if TYPE_CHECKING:
    import pint


class UnitsError(SmallwheelError):
    """A unit that does not exist, or one of another dimension than the column's."""


# What may stand in brackets: names of units, each with an exponent of one digit, joined by products,
# quotients and brackets. Nothing else reaches pint, which would evaluate it: 9**9**9**9 does not
# end, and pint reads superscript digits (and any other digits of Unicode) as powers too.
_LONGEST = 40  # characters; the longest compound units in use have about half of that
_FACTOR = (
    r"(?:[A-Za-z_°%µμΩÅ℃][A-Za-z0-9_]*"
    r"(?:\s*(?:\*\*|\^)\s*\(?\s*[+-]?[0-9](?:\.[0-9]{1,2})?\s*\)?)?"
    r"|1(?=\s*[*/·⋅]))"
)
_UNIT = re.compile(rf"[\s(]*{_FACTOR}(?:[\s*/·⋅.()]+{_FACTOR})*[\s)]*")
_SUPERSCRIPT = re.compile("([⁺⁻]?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
_PLAIN_DIGITS = str.maketrans("⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+-0123456789")
# Torque as it is written. pint reads Nm as the fineness of a yarn (metres per gram).
_NEWTON_METRE = re.compile(r"(?<![A-Za-z0-9_])([kmMµμ]?N)(mm|cm|m)(?![A-Za-z0-9_])")
_HYPHEN = re.compile(r"(?<=[A-Za-z])-(?=[A-Za-z])")  # N-m and ft-lbf are products
_POWER = re.compile(r"(?<![A-Za-z])([kcdmµμ]?m|in|ft|s)([23])(?![0-9])")  # kg/m3
_EXAMPLES = "expected one like mm, N or m/s"
_NAMED = ("N", "Pa", "J", "W", "Hz")  # SI units with a name: shown by it
_HINTS = {
    "kilogram": "; a mass is no force: use kgf, or multiply by 9.81 and write N",
    "kilogram / meter / second ** 2": "; a pressure: multiply by the area",
}


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry:
    # Made on first use: pint is slow to import, and reads its definitions for a tenth of a second.
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def _as_pint_reads(text: str) -> str:
    """Superscripts as powers, torques as products."""
    powers = _SUPERSCRIPT.sub(lambda found: "^" + found[0].translate(_PLAIN_DIGITS), text)
    powers = _POWER.sub(r"\1^\2", powers)
    return _HYPHEN.sub("*", _NEWTON_METRE.sub(r"\1*\2", powers))


def _unit(text: str) -> pint.Unit:
    if text == DIMENSIONLESS:
        return _registry().Unit("")
    plain = _as_pint_reads(text) if len(text) <= _LONGEST else ""
    if not _UNIT.fullmatch(plain):
        shown = text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
        raise UnitsError(f"unknown unit '{shown}', {_EXAMPLES}")
    if text == "grad":
        raise UnitsError(_GRAD)
    try:
        return _registry().parse_units(plain)
    except Exception:  # pint's parser raises whatever its tokenizer meets
        raise UnitsError(f"unknown unit '{text}', {_EXAMPLES}") from None


_GRAD = "'grad' may be a degree or a gon (100 to the right angle): write deg or gon"


def _plain(text: str) -> str:
    letters = unicodedata.normalize("NFKD", text.strip().lower())
    return "".join(c for c in letters if not unicodedata.combining(c))


def is_common(text: str) -> bool:
    """Whether a text can hardly be anything but a unit, wherever it stands."""
    text = text.strip()
    if len(text) == 1:
        return text in _COMMON.values()
    return text.lower() in _COMMON or _plain(text) in _SPELLINGS


_SPELLINGS = {
    _plain(text): str(unit) for unit, line in WORDS["spellings"].items() for text in line.split(",")
}
_COMMON = {unit.lower(): unit for unit in WORDS["units"].split()}


@lru_cache(maxsize=1000)
def spelled(text: str, expected: str | None) -> str | None:
    """The unit that a text names, as `to_base` takes it; None where it names none.

    expected: the SI unit of the column. Where that is a force or a pressure, a mass is read as the
    weight of it at the surface of the earth (9.80665 m/s^2).
    """
    text = " ".join(text.split())
    plain = _plain(text)
    spelling = "deg" if text == "Grad" else _SPELLINGS.get(plain)
    for unit in (spelling, text, _COMMON.get(text.lower()), _COMMON.get(plain)):
        if unit is None or (plain == "grad" and unit != "deg"):
            continue
        try:
            _unit(unit)
        except UnitsError:
            continue
        if expected is None or fits(unit, expected):
            return unit
        other = f"{unit}*g_0" if expected in ("N", "Pa") else _COMMON.get(text.lower(), unit)
        return other if fits(other, expected) else unit
    return None


def shown_unit(unit: str | None) -> str:
    """The unit as people read it, "" for a pure number or none; a mass that is a weight as the mass."""
    return "" if unit in (None, DIMENSIONLESS) else str(unit).replace("*g_0", "")


def fits(unit: str, expected: str) -> bool:
    """Whether values in the unit are of the kind that the SI unit `expected` measures."""
    return _base(_unit(unit)) == _base(_unit(expected))


def base_unit(unit: str) -> str:
    """Name the SI unit that values in `unit` are converted to; "1" for a pure number.

    A force times a length is a torque, "N m", although its dimension is that of an energy, "J".
    Raises UnitsError where the unit does not exist.
    """
    parsed, registry = _unit(unit), _registry()
    base = _base(parsed)
    force = registry.Unit("N").dimensionality
    parts = [registry.Unit(name) for name, _ in registry.Quantity(1, parsed).unit_items()]
    of_a_force = any(part.dimensionality == force for part in parts)
    return TORQUE if base == "J" and of_a_force else base


def _base(unit: pint.Unit) -> str:
    try:
        root = _registry().get_base_units(unit)[1]
    except Exception:  # a factor that overflows
        raise UnitsError(f"unit '{unit}' cannot be converted to SI") from None
    if root.dimensionless:
        return RADIAN if "radian" in str(root) else DIMENSIONLESS
    named = next((name for name in _NAMED if root == _registry().get_base_units(name)[1]), None)
    return named or f"{root:~C}"


def to_base(values: Array, unit: str, expected: str | None = None) -> Array:
    """Values in `unit` in base SI units; angles in rad.

    expected: the SI unit that the column is held in (m, N, m/s, rad, 1), or None for any.
    Raises UnitsError where the unit does not exist or its dimension is not that of `expected`.
    """
    parsed = _unit(unit)
    if expected is not None and not fits(unit, expected):
        found, wanted = _describe(parsed), _describe(_unit(expected))
        hint = _HINTS.get(str(_registry().get_base_units(parsed)[1]), "")
        if expected == RADIAN and found == "a pure number":
            hint = "; a ratio is no angle: take its arc tangent, or write rad or deg"
        if expected == TORQUE:
            wanted = "a torque"
            hint = "; if the column is no torque on the wheel's axle, give it another name"
        raise UnitsError(f"unit '{unit}' is {found}, expected {wanted} ({expected}){hint}")
    try:
        with np.errstate(over="ignore"):  # an infinity is the caller's to report
            converted = _registry().Quantity(values, parsed).to_base_units().magnitude
    except Exception:  # logarithmic units, and whatever else has no plain factor
        raise UnitsError(f"unit '{unit}' cannot be converted to SI") from None
    return np.asarray(converted, dtype=float)


_KINDS = {
    "m": "a length", "N": "a force", "m/s": "a speed", "kg": "a mass", "s": "a time",
    "Pa": "a pressure", "J": "an energy or a torque", "A": "an electric current",
    RADIAN: "an angle", DIMENSIONLESS: "a pure number",
}  # fmt: skip


def _describe(unit: pint.Unit) -> str:
    base = _base(unit)
    return _KINDS.get(base, f"of dimension {base}")
