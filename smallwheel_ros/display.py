"""Numbers as people read them: millimetres, degrees, three digits. Files and JSON stay in SI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.units import DIMENSIONLESS, to_base


class Display(NamedTuple):
    """Value in SI times scale is the number shown; label names the quantity and its unit."""

    scale: float
    label: str
    unit: str


_WORDS = {"drawbar_pull": "drawbar pull", "pass_number": "pass number"}
_SLOW = 0.2  # m/s, below which millimetres are said
_SCALES = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg")}


def words(name: str) -> str:
    """Turn a column's name into words: `drawbar_pull` is drawbar pull."""
    return _WORDS.get(name, name.replace("_", " "))


def effect_words(name: str) -> str:
    """An effect in words; `unknown:slip@sinkage` is a curve without a name."""
    if not name.startswith("unknown:"):
        return "nothing more" if name == "none" else words(name)
    setting, _, stage = name.removeprefix("unknown:").partition("@")
    return f"something that follows {words(setting)}" + (f" (at the {stage})" if stage else "")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Join names in words: `a, b and c`; "" for none."""
    shown = [effect_words(name) for name in names]
    return "".join(shown) if len(shown) < 2 else f"{', '.join(shown[:-1])} {last} {shown[-1]}"


def display(name: str, unit: str) -> Display:
    """How values of that column, held in that SI unit ("" if unknown), are shown."""
    scale, shown = _SCALES.get(unit, (1.0, unit if unit not in ("", "1") else ""))
    return Display(scale, f"{words(name)} [{shown}]" if shown else words(name), shown)


def column_display(measurements: Measurements, name: str) -> Display:
    """How values of that column of a table are shown: in the unit of its header, where it has one."""
    written = measurements.written_units.get(name)
    if written is not None:
        zero, one = to_base(np.array([0.0, 1.0]), written)
        if zero == 0.0:  # no degrees Celsius
            # A mass that was given for a load stands for its weight.
            shown = "" if written == DIMENSIONLESS else written.replace("*g_0", "")
            return Display(1.0 / one, f"{words(name)} [{shown}]" if shown else words(name), shown)
    unit = measurements.units.get(name, unit_of(name))
    if unit == "m/s" and np.nanmax(np.abs(measurements.conditions[name])) < _SLOW:
        return Display(1e3, f"{words(name)} [mm/s]", "mm/s")
    return display(name, unit)


def brief(value: float) -> str:
    """A setting as people say it: 0.5, 20, 1.23e-05."""
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.6g}"


def sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?")) else ".")


def number(value: ArrayLike | None, digits: int = 3) -> str:
    """A number with that many digits, "-" for none: 0.00123, 12.3, 4130."""
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
    """Show a value of a channel with its unit, "-" for none."""
    if value is None:
        return "-"
    shown = display(channel, unit_of(channel))
    return f"{number(value * shown.scale)} {shown.unit}".rstrip()
