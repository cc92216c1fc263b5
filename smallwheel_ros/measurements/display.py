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
    """How a quantity is shown: a value in SI times `scale`, in `unit`; `label` names quantity and unit."""

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
    return f"something that follows {words(setting)}" + (f" (at the {stage})" if stage else "")


def to_tell(names: Sequence[str]) -> str:
    """Say what runs are to tell: one effect from another, or whether one is missing; "none" is no effect."""
    effects = [name for name in names if name != "none"]
    if len(effects) == 1:
        return f"whether {effect_words(effects[0])} is missing"
    return listed(effects, "from")


def percent(share: float | None, *, signed: bool = False) -> str:
    """A share in whole per cent, "-" for none; never "-0 %".

    Parameters
    ----------
    share
        1 is all; None: not known.
    signed
        Whether a + stands before what is over 0.
    """
    if share is None or not np.isfinite(share):
        return "-"
    whole = round(100 * share)
    return f"{whole:+d} %" if signed and whole else f"{whole} %"


def probability_text(probability: float | None) -> str:
    """A probability with two digits, "-" for none; at the ends `over 0.99` and `under 0.01`: none is sure."""
    if probability is None:
        return "-"
    if not 0.01 <= probability <= 0.99:
        return "under 0.01" if probability < 0.01 else "over 0.99"
    return f"{probability:.2f}"


def p_text(p: float | None) -> str:
    """A p value with two digits: it is a count of simulations, and has no more."""
    return "-" if p is None else f"{p:.2g}"


def setting_words(name: str, value: object) -> str:
    """A setting with its unit, in degrees and millimetres: 28.6 deg; a range by its ends.

    Parameters
    ----------
    name
        Name of the setting.
    value
        In SI units; two values are a range.
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
    """`slip_angle > 0.5` as people say it: slip angle > 28.6 deg."""
    found = re.fullmatch(r"(\|?)(.+?)(\|?) ([<>]) (\S+)", text)
    if found is None:
        return text
    before, name, after, sign, value = found.groups()
    return f"{before}{words(name)}{after} {sign} {setting_words(name, float(value))}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Join names in words: `a, b and c`; "" for none.

    Parameters
    ----------
    names
        Names of effects or columns.
    last
        The word before the last one.
    """
    shown = [effect_words(name) for name in names]
    return "".join(shown) if len(shown) < 2 else f"{', '.join(shown[:-1])} {last} {shown[-1]}"


def display(name: str, unit: str) -> Display:
    """Unit and scale in which values of a column are shown.

    Parameters
    ----------
    name
        Name of the column.
    unit
        The SI unit that it is held in, "" where none is known.
    """
    return _in_unit(name, *_SCALES.get(unit, (1.0, shown_unit(unit))))


def _in_unit(name: str, scale: float, unit: str) -> Display:
    return Display(scale, f"{words(name)} [{unit}]" if unit else words(name), unit)


def column_display(measurements: Measurements, name: str) -> Display:
    """Unit and scale in which values of a table's column are shown: its header's unit if it has one.

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
    """A setting in short form: 0.5, 20, 1.23e-05."""
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.6g}"


def sentence(text: str) -> str:
    """The text with a capital and a full stop; one that begins with a name keeps its small letter."""
    name = any(mark in text.split(" ")[0] for mark in "_.:")
    first = text[:1] if name else text[:1].upper()
    return first + text[1:] + ("" if text.endswith((".", "?")) else ".")


def number(value: ArrayLike | None, digits: int = 3) -> str:
    """A number as text, "-" for none: 0.00123, 12.3, 4130.

    Parameters
    ----------
    value
        None and what is not finite are none.
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
    """A value of a channel with its unit, "-" for none.

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
