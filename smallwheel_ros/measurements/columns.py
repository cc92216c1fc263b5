# SPDX-License-Identifier: Apache-2.0
"""The columns that a table of measurements may have: unit, range, meaning; and units as people write them.

Every other list of units in this package comes from here. Ranges are physical limits, wide enough for any
wheel or plate from a toy to a mining truck: a value outside is a typing error or in another unit,
and is not computed with. The second part finds which unit a text means and converts values to SI;
pint knows the units.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.physics.wheel import GRAVITY

if TYPE_CHECKING:
    import pint

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Texts = NDArray[np.str_]

RADIAN, DIMENSIONLESS, TORQUE = "rad", "1", "N m"
WORDS: dict[str, Any] = yaml.load(
    Path(__file__).with_name("words.yaml").read_text(encoding="utf-8"),
    getattr(yaml, "CSafeLoader", yaml.SafeLoader),
)
CHANNELS = ("sinkage", "resistance", "drawbar_pull", "torque")  # what a model predicts
FORCES = ("drawbar_pull", "torque")  # those that rest on the soil's strength, and need slip
TEXTS = ("contact", "soil", "run", "wheel")
GRAVITY_COLUMN = "gravity"
SETTINGS = ("slip", "slip_angle", "slope", "speed", "pass_number", "grouser_height")
_ROUNDING = 1e-9  # a limit may be passed by the rounding of a converted unit


@dataclass(frozen=True)
class ColumnSpec:
    """A column of numbers: its meaning, SI unit and allowed values.

    Attributes
    ----------
    description
        What it is, in words.
    unit
        SI unit: "1" for a pure number, empty if any unit will do.
    low, high
        Smallest and largest allowed value, in that unit.
    usual
        Range beyond which a value is suspicious for a small wheel.
    same
        Two values that differ by no more than this, in SI, are one setting, however narrow the range of
        the column (`settings.settings_of_rows`).
    hint
        Text that is printed with a refused value.
    hint_of_sign
        Text that is printed in its place if all refused values are 0 or less.
    """

    description: str
    unit: str
    low: float
    high: float
    usual: tuple[float, float] = (-np.inf, np.inf)
    same: float = 0.0
    hint: str = ""
    hint_of_sign: str = ""

    def bad(self, values: Array) -> Mask:
        """Whether each value is outside the range, as infinities are and NaN is not; shape of `values`."""
        low = self.low - _ROUNDING * abs(self.low)
        high = self.high + _ROUNDING * abs(self.high)
        return np.asarray((values < low) | (values > high))

    def expected(self) -> str:
        """The allowed range in words, as "0 to 20 m"."""
        unit = "" if self.unit in ("", DIMENSIONLESS) else f" {self.unit}"
        return f"{_limit(self.low)} to {_limit(self.high)}{unit}"


def _limit(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.10g}"


# Loads: 1e-3 N, the weight of a tenth of a gram, is below the resolution of a rig's load cell; a
# wheel of the largest mining truck carries about 1e6 N.
_LOAD = (1e-3, 1e6)
# Sizes: a millimetre is a few grains; the largest wheels ever rolled have under 20 m.
_SIZE = (1e-3, 20.0)
# Forces that a wheel answers with: ten times its load is more than any soil gives back.
_FORCE = (-1e7, 1e7)
_BLANK = "leave the cell blank if unknown"
# A deviation below these, a nanometre and a micronewton, is below every sensor's resolution.
_LENGTH_STD = (1e-9, 20.0)
_FORCE_STD = (1e-6, 1e7)

COLUMNS: dict[str, ColumnSpec] = {
    # The least is the weight of 50 g: less is kilonewtons that were not said.
    "load": ColumnSpec(
        "normal load on the wheel", "N", *_LOAD, usual=(0.5, 1e5),
        hint_of_sign="a load is positive where the wheel presses on the ground: turn the sign of the column",
    ),
    "diameter": ColumnSpec("wheel diameter", "m", *_SIZE, usual=(0.005, 3.0)),
    # Widths are cut to a millimetre or so.
    "width": ColumnSpec("wheel width", "m", *_SIZE, usual=(0.002, 2.0), same=0.002),
    # No deeper than the largest wheel is high.
    "sinkage": ColumnSpec(
        "sinkage", "m", 0.0, 20.0,
        hint_of_sign="sinkage is positive downwards: turn the sign of the column, or, of a few readings near "
        "0, correct the zero of the gauge",
    ),
    "resistance": ColumnSpec("motion resistance", "N", *_FORCE),
    "drawbar_pull": ColumnSpec("drawbar pull", "N", *_FORCE),
    "torque": ColumnSpec("torque on the wheel's axle", TORQUE, *_FORCE),
    "sinkage_std": ColumnSpec("deviation of sinkage", "m", *_LENGTH_STD, hint=_BLANK),
    "resistance_std": ColumnSpec("deviation of resistance", "N", *_FORCE_STD, hint=_BLANK),
    "drawbar_pull_std": ColumnSpec("deviation of drawbar pull", "N", *_FORCE_STD, hint=_BLANK),
    "torque_std": ColumnSpec("deviation of torque", TORQUE, *_FORCE_STD, hint=_BLANK),
    # A rig with separate drives holds slip to one or two hundredths.
    "slip": ColumnSpec(
        "slip", DIMENSIONLESS, -1.0, 1.0, same=0.02, hint="in per cent? then the header is 'slip [%]'"
    ),
    # Angles are set to about a degree.
    "slip_angle": ColumnSpec(
        "slip angle", RADIAN, -np.pi, np.pi, same=np.radians(1.0),
        hint="in degrees? then the header is 'slip_angle [deg]'",
    ),
    "slope": ColumnSpec(
        "slope", RADIAN, -np.pi / 2, np.pi / 2, same=np.radians(1.0),
        hint="in degrees? then the header is 'slope [deg]'",
    ),
    # Three times the speed of sound in air.
    "speed": ColumnSpec(
        "speed of travel", "m/s", 0.0, 1000.0, usual=(0.0, 15.0),
        hint="the speed of travel, without a sign",
    ),
    # More passes than any track test has run; whole numbers, so half of one is no difference.
    "pass_number": ColumnSpec(
        "number of the pass", DIMENSIONLESS, 1.0, 1e6, same=0.5, hint="1 is fresh soil"
    ),
    # From a small moon's to ten times the earth's, in a centrifuge.
    GRAVITY_COLUMN: ColumnSpec(
        "acceleration of free fall", "m/s^2", 0.01, 100.0, same=0.1,
        hint=f"{GRAVITY:g} on the earth, 1.62 on the moon; leave it out for {GRAVITY:g}",
    ),
    # No lug is longer than a metre; half a millimetre is wear.
    "grouser_height": ColumnSpec(
        "height of the grousers", "m", 0.0, 1.0, usual=(0.0, 0.2), same=5e-4
    ),
}  # fmt: skip
# Of plates and shear tests; they are taken up when the table is read (`plates`, `shear`).
# Hard snow crust and dry clay bear a few MPa; steel under a tracked vehicle far less than 10 GPa.
_STRESS = (-1e10, 1e10)
LAB_COLUMNS: dict[str, ColumnSpec] = {
    "pressure": ColumnSpec("pressure under a plate", "Pa", *_STRESS),
    "length": ColumnSpec("longer side of a rectangular plate", "m", *_SIZE),
    "normal_stress": ColumnSpec("normal stress of a shear test", "Pa", *_STRESS),
    "shear_stress": ColumnSpec("shear stress", "Pa", *_STRESS),
    "shear_displacement": ColumnSpec("displacement of a shear test", "m", -20.0, 20.0),
}
# Any other column of numbers, in SI. Seconds since 1970 and pressures of machines are below it, and
# its square and fourth power are far from the largest double.
OTHER = ColumnSpec("a column that is not of the contract", "", -1e12, 1e12)
# Nothing measured in SI is so small without being zero; products of such numbers underflow.
LEAST = 1e-30

CHANNEL_UNITS: dict[str, str] = {name: COLUMNS[name].unit for name in CHANNELS}


def unit_of(name: str) -> str:
    """SI unit of a channel or setting: "1" for a pure number, "" where the name is not known."""
    return COLUMNS[name].unit if name in COLUMNS else ""


# What the wheel answers is not set by anyone: its unit says so, or its name.
_RESPONSE_UNITS = ("N", TORQUE, "Pa", "W", "J")
_RESPONSE_WORDS = {
    "torque", "moment", "force", "forces", "thrust", "traction", "stress", "pressure",
    "power", "energy", "current", "rut", "sinkage", "resistance", "pull",
}  # fmt: skip
# Loads, forces and pressures that are set before the wheel rolls, or are of the soil.
_SET_WORDS = {
    "load", "weight", "ballast", "preload", "inflation", "ambient", "atmospheric", "confining",
    "cone", "penetrometer", "cohesion", "modulus", "strength", "suction", "preconsolidation",
}  # fmt: skip
_TORQUES = {"torque", "moment"}  # which are never settings
_TYRE_PRESSURES = ({"tyre", "pressure"}, {"tire", "pressure"})


def is_response(name: str, unit: str = "") -> bool:
    """Whether a column is a response of the wheel (torque, side force, motor current), not a setting.

    Parameters
    ----------
    name
        Name of the column.
    unit
        SI unit of its values; "" if the table gives none.
    """
    if name in COLUMNS:
        return name in CHANNELS
    words = set(re.findall(r"[a-z]+", name.lower()))
    if words & _TORQUES or unit == TORQUE:
        return True
    if words & _SET_WORDS or any(pair <= words for pair in _TYRE_PRESSURES):
        return False
    return unit in _RESPONSE_UNITS or bool(words & _RESPONSE_WORDS)


_BOOKKEEPING_WORDS = {
    "t", "time", "timestamp", "stamp", "date", "trial", "repeat", "repetition", "replicate",
    "row", "line", "index", "id", "sample", "no", "order", "sequence", "clock", "elapsed",
}  # fmt: skip
# A time that soil or wheel was left for is set: rest_time, drying_time.
_WAITING_WORDS = {
    "rest", "resting", "settling", "wait", "waiting", "drying", "soaking", "curing", "ageing", "aging",
    "storage", "exposure", "dwell", "hold", "holding", "soil", "bed", "box", "bin",
}  # fmt: skip


def is_bookkeeping(name: str) -> bool:
    """Whether a column identifies the row (its time, the number of the trial) rather than a setting."""
    words = re.findall(r"[a-z]+", name.lower())
    if name in COLUMNS or not words or words[-1] not in _BOOKKEEPING_WORDS:
        return False
    set_by = {"index": _SET_WORDS, "time": _WAITING_WORDS}.get(words[-1], set())
    return not set_by & set(words)


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
_STANDARD_WEIGHT = "*g_0"  # of a mass, in pint's words
_NAMED = ("N", "Pa", "J", "W", "Hz")  # SI units with a name: shown by it
_HINTS = {
    "kilogram": f"; a mass is no force: use kgf, or multiply by {GRAVITY:g} and write N",
    "kilogram / meter / second ** 2": "; a pressure: multiply by the area",
}


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry:
    # Made on first use: pint is slow to import, and reads its definitions for a tenth of a second.
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def _unit(text: str) -> pint.Unit:
    if text == DIMENSIONLESS:
        return _registry().Unit("")
    if len(text) > _LONGEST:
        raise UnitsError(f"unknown unit '{text[:_LONGEST]}...', {_EXAMPLES}")
    # superscripts and digits as powers, torques as products
    plain = _SUPERSCRIPT.sub(lambda found: "^" + found[0].translate(_PLAIN_DIGITS), text)
    plain = _POWER.sub(r"\1^\2", plain)
    plain = _HYPHEN.sub("*", _NEWTON_METRE.sub(r"\1*\2", plain))
    if not _UNIT.fullmatch(plain):
        raise UnitsError(f"unknown unit '{text}', {_EXAMPLES}")
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
    """Whether a text is almost certainly a unit, wherever it stands."""
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
    """The unit that a text names, in a spelling that `to_base` takes; None if it names none.

    Parameters
    ----------
    text
        A unit as people write it.
    expected
        The SI unit of the column; None for any. Where that is a force or a pressure, a mass is read as its
        weight under the standard gravity (`physics.wheel.GRAVITY`). The result may still be of another
        dimension, which `fits` checks.
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
        other = (
            f"{unit}{_STANDARD_WEIGHT}"
            if expected in ("N", "Pa")
            else _COMMON.get(text.lower(), unit)
        )
        return other if fits(other, expected) else unit
    return None


def is_mass(unit: str | None) -> bool:
    """Whether a unit, as `spelled` returns it, is that of a mass taken as its weight; False for None."""
    return unit is not None and unit.endswith(_STANDARD_WEIGHT)


def weight_under(weight: Array, gravity: Array | float) -> Array:
    """Weight (N) of masses under another gravity than the standard one, shape (rows,).

    Parameters
    ----------
    weight
        Their weight under the standard gravity, N, shape (rows,).
    gravity
        Acceleration of gravity of the test, m/s^2, one for all or shape (rows,).
    """
    return np.asarray(weight * (gravity / GRAVITY))


def shown_unit(unit: str | None) -> str:
    """The unit as shown to people: "" for a pure number or None; "kg" where a mass stands for its weight."""
    return "" if unit in (None, DIMENSIONLESS) else str(unit).replace(_STANDARD_WEIGHT, "")


def fits(unit: str, expected: str) -> bool:
    """Whether two units have the same dimension. Raises UnitsError if one does not exist.

    Parameters
    ----------
    unit
        A unit as `spelled` returns it.
    expected
        The SI unit.
    """
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
    """Convert values to base SI units, angles to rad; the shape is that of `values`.

    Parameters
    ----------
    values
        In `unit`, any shape.
    unit
        A unit as `spelled` returns it.
    expected
        The SI unit that the column must have (m, N, m/s, rad, 1), or None for any.

    Raises
    ------
    UnitsError
        If the unit does not exist, has another dimension than `expected`, or is no plain factor (a decibel).
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
