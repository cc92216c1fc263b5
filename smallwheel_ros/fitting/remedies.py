# SPDX-License-Identifier: Apache-2.0
"""What to measure so that a parameter of the soil becomes known, given what the table has."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.variance import Scatter
from smallwheel_ros.measurements.display import brief, percent

_LOADS, _SIZES = 4.0, 1.5  # ranges that leave of n and m half of what is known without data
_SO_WIDE = 0.95  # of such a range: as wide, but for rounding
_ENOUGH_RUNS = 3  # where a number shows, from which the same measurement is no new advice
_ALIKE = 1.02  # diameters that are one

_REMEDIES = {
    "log_reference_pressure": "measure sinkage at a few loads",
    "friction_angle": "measure drawbar pull at slip over 0.5",
    "log_shear_displacement": "measure drawbar pull at slips from 0.05 to 0.3",
    "cohesion": "measure drawbar pull at high slip under a light and a heavy load",
    "rolling_share": "measure drawbar pull or torque at slips from -0.1 to 0.1",
    "pressure_peak": "measure drawbar pull and torque at slips over 0.4",
    "rim_friction": "measure the same wheel with lugs, or braked, as well as the bare rim driven",
}
_SHOWS_AT = {  # slips, from and to, at which a number shows in pull and torque
    "friction_angle": (0.5, 1.0),
    "log_shear_displacement": (0.05, 0.3),
    "cohesion": (0.5, 1.0),
    "rolling_share": (-0.1, 0.1),
    "pressure_peak": (0.4, 1.0),
}


def remedy_of(number: str, points: Points, scatter: Scatter) -> str:
    """Name the measurement that would determine a parameter of the soil.

    If the table has that measurement, say what limits the parameter instead.

    Parameters
    ----------
    number
        Name of the parameter as in a fit: `n`, `m`, `log_reference_pressure`, or one of the soil's strength
        such as `friction_angle`.
    points
        Measured values, each a mean over rows of one run and setting.
    scatter
        Their variance components.

    Returns
    -------
    str
        A clause in the imperative, without a full stop, such as `measure sinkage at a few loads`.
    """
    if number == "n":
        return _for_n(points, scatter)
    return _for_m(points, scatter) if number == "m" else _for_strength(number, points)


def _for_n(points: Points, scatter: Scatter) -> str:
    wheels = bool(points.conditions.rolling.any())
    could = wheels and "resistance" not in points.channels
    span = _span(points, "load")
    if points.swept.any() and not wheels:  # a curve has all loads
        return _limit(scatter)
    if span >= _SO_WIDE * _LOADS:
        also = ", and so would resistance" if could else ""
        return f"loads span {brief(span)} to 1 already; {_limit(scatter)}{also}"
    also = ", or measure resistance too" if could else ""
    return f"measure over a wider range of loads (4 to 1; here {brief(span)} to 1){also}"


def _for_m(points: Points, scatter: Scatter) -> str:
    body = "wheel" if points.conditions.rolling.any() else "plate"
    span = _span(points, "diameter")
    if span >= _SO_WIDE * _SIZES:
        return f"{body}s span {brief(span)} to 1 already; {_limit(scatter)}"
    if span < _ALIKE:
        return f"measure with a second {body} diameter (1.5 to 1)"
    return f"measure with a larger or smaller {body} (diameters 1.5 to 1; here {brief(span)} to 1)"


def _for_strength(number: str, points: Points) -> str:
    said = _REMEDIES[number]
    if number not in _SHOWS_AT or not points.forces:
        return said
    low, high = _SHOWS_AT[number]
    there = np.isin(points.channel, [points.channels.index(name) for name in points.forces])
    slip, load = points.column("slip"), points.column("load")
    there &= (slip >= low) & (slip <= high)
    runs = np.unique(points.run[there]).size
    if runs < _ENOUGH_RUNS or (
        number == "cohesion" and load[there].max() < _SO_WIDE * _LOADS * load[there].min()
    ):
        return said
    return f"{said}: {runs} runs did, and more of them would determine it better"


def _span(points: Points, column: str) -> float:
    values = points.column(column)
    return float(values.max() / values.min())


def _limit(scatter: Scatter) -> str:
    apart = percent(scatter.deviations["tau"])
    return f"runs differ by {apart} of k: more runs at both ends, or repeats, would show more"
