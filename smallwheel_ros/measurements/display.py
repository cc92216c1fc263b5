# SPDX-License-Identifier: Apache-2.0
"""Numbers as people read them: millimetres, degrees, three digits. Files and JSON stay in SI."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from smallwheel_ros.measurements.columns import shown_unit, to_base, unit_of

if TYPE_CHECKING:
    from smallwheel_ros.measurements.measurements import Measurements


class Display(NamedTuple):
    """How the values of a quantity are shown.

    Attributes
    ----------
    scale
        Factor from SI to the unit that is shown: 1000 for mm.
    label
        Quantity and unit in words, as "drawbar pull [N]".
    unit
        The unit that is shown; empty for a pure number.
    """

    scale: float
    label: str
    unit: str


_WORDS = {
    "bekker": "Bekker",
    "partly_dug_quadratic": "quadratic in slip, soil partly dug away",
    "meirion_griffith_spenko": "Meirion-Griffith & Spenko",
    "wong_reece": "Wong & Reece",
    "log_log_regression": "log-log regression",
}
# What a curve without a name adds at stages that are no factors.
ADDED = {
    "height": "length added to the shown sinkage",
    "force": "force added to the resistance",
    "drag": "share of the load added to the resistance",
}
_SLOW = 0.2  # m/s, below which millimetres are shown
# Said once by what prints k, n or m.
LAW = (
    "The law: pressure p = k z^n D^m under a wheel of diameter D at sinkage z (m). k is in Pa/m^(n+m), n and "
    "m have no unit. log_reference_pressure is ln of p (Pa) at 10 mm under a wheel of 0.2 m."
)
_SCALES = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg")}


def words(name: str) -> str:
    """Turn a column's name into words: `drawbar_pull` is drawbar pull."""
    return _WORDS.get(name, name.replace("_", " "))


def effect_words(name: str) -> str:
    """An effect in words; `unknown:slip@sinkage` is a curve without a name."""
    if not name.startswith("unknown:"):
        return words(name)
    setting, _, stage = name.removeprefix("unknown:").partition("@")
    place = f" (a {ADDED[stage]})" if stage in ADDED else f" (at the {stage})" if stage else ""
    return f"something that follows {words(setting)}{place}"


def to_tell(names: Sequence[str]) -> str:
    """Say in words what further runs are to find out about effects; the name "none" stands for no effect.

    One effect gives "whether slip sinkage is missing", several give "bulldozing from slip sinkage", which
    completes "to tell".
    """
    effects = [name for name in names if name != "none"]
    if len(effects) == 1:
        return f"whether {effect_words(effects[0])} is missing"
    return listed(effects, "from")


def percent(share: float | None, *, signed: bool = False) -> str:
    """A share in whole per cent, as "12 %"; "-" if it is unknown, never "-0 %".

    Parameters
    ----------
    share
        1 is 100 %; None or not finite: unknown.
    signed
        Whether a positive share begins with a +.
    """
    if share is None or not np.isfinite(share):
        return "-"
    whole = round(100 * share)
    return f"{whole:+d} %" if signed and whole else f"{whole} %"


def probability_text(probability: float | None) -> str:
    """A probability with two decimals, "over 0.99" or "under 0.01" near the ends, "-" for None."""
    if probability is None:
        return "-"
    if not 0.01 <= probability <= 0.99:
        return "under 0.01" if probability < 0.01 else "over 0.99"
    return f"{probability:.2f}"


def p_text(p: float | None) -> str:
    """A p value with two digits, "-" for None: it is a share of simulations, too few for more digits."""
    return "-" if p is None else f"{p:.2g}"


def setting_words(name: str, value: object) -> str:
    """A setting's value with its unit, in degrees and millimetres: "28.6 deg"; a range as "20 mm to 35 mm".

    Parameters
    ----------
    name
        Name of the setting.
    value
        A number in SI units; a list or tuple of two is a range. Anything else is returned as text.
    """
    if isinstance(value, (list, tuple)):
        return " to ".join(dict.fromkeys(setting_words(name, v) for v in value))
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    shown = display(name, unit_of(name))
    if shown.unit == "m/s" and abs(value) < _SLOW:
        return f"{brief(1e3 * value)} mm/s"
    return f"{brief(value * shown.scale)} {shown.unit}".rstrip()


def region_words(text: str) -> str:
    """A region in words: `slip_angle > 0.5` is slip angle > 28.6 deg; a text of another form is unchanged."""
    found = re.fullmatch(r"(\|?)(.+?)(\|?) ([<>]) (\S+)", text)
    if found is None:
        return text
    before, name, after, sign, value = found.groups()
    return f"{before}{words(name)}{after} {sign} {setting_words(name, float(value))}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Join names, each in words: "slip sinkage, grouser and multipass"; "" for none.

    Parameters
    ----------
    names
        Names of effects or columns.
    last
        The word before the last name.
    """
    shown = [effect_words(name) for name in names]
    return "".join(shown) if len(shown) < 2 else f"{', '.join(shown[:-1])} {last} {shown[-1]}"


def display(name: str, unit: str) -> Display:
    """Unit and scale in which values of a column are shown: mm for m, degrees for rad, else its SI unit.

    Parameters
    ----------
    name
        Name of the column.
    unit
        SI unit of its values; "" if none is known.
    """
    return _in_unit(name, *_SCALES.get(unit, (1.0, shown_unit(unit))))


def _in_unit(name: str, scale: float, unit: str) -> Display:
    return Display(scale, f"{words(name)} [{unit}]" if unit else words(name), unit)


def column_display(measurements: Measurements, name: str) -> Display:
    """Unit and scale in which values of a table's column are shown: the unit of its header if it has one.

    Else they are those of `display`; speeds that are all under 0.2 m/s are in mm/s.

    Parameters
    ----------
    measurements
        The table.
    name
        Name of the column.
    """
    written = measurements.written_units.get(name)
    if written is not None:
        zero, one = to_base(np.array([0.0, 1.0]), written)
        if zero == 0.0:  # no degrees Celsius
            return _in_unit(name, 1.0 / one, shown_unit(written))
    unit = measurements.units.get(name, unit_of(name))
    if unit == "m/s" and np.nanmax(np.abs(measurements.conditions[name])) < _SLOW:
        return _in_unit(name, 1e3, "mm/s")
    return display(name, unit)


def brief(value: float) -> str:
    """A number with three significant digits, from 1000 on with six: 0.5, 20, 1.23e-05, 12345.6."""
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.6g}"


def sentence(text: str) -> str:
    """The text with a capital and a full stop; one that begins with a name keeps its small letter."""
    name = any(mark in text.split(" ")[0] for mark in "_.:")
    first = text[:1] if name else text[:1].upper()
    return first + text[1:] + ("" if text.endswith((".", "?")) else ".")


def number(value: ArrayLike | None, digits: int = 3) -> str:
    """A number as text, rounded: 0.00123, 12.3, 4130; "-" if there is none.

    Parameters
    ----------
    value
        The number; None or not finite: none.
    digits
        Number of significant digits.
    """
    if value is None or not np.isfinite(value):
        return "-"
    value = float(value)  # type: ignore[arg-type]  # finite, so a scalar
    if value == 0.0:
        return "0"
    scientific = f"{value:.{digits - 1}e}"
    places = digits - 1 - int(scientific.split("e")[1])
    if places < -3 or places > 8:
        return scientific
    return f"{float(scientific):.{max(places, 0)}f}"


def shown_value(channel: str, value: float | None) -> str:
    """A value of a channel with its unit, as "8.50 mm"; "-" for None.

    Parameters
    ----------
    channel
        sinkage, resistance, drawbar_pull or torque.
    value
        In the channel's SI unit.
    """
    if value is None:
        return "-"
    shown = display(channel, unit_of(channel))
    return f"{number(value * shown.scale)} {shown.unit}".rstrip()
