# SPDX-License-Identifier: Apache-2.0
"""What an effect does to a typical wheel, over what drives it: the numbers behind its picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model.model import Model, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import SOILS

Array = NDArray[np.float64]

_LOAD, _DIAMETER, _WIDTH, _SLIP = 60.0, 0.2, 0.1, 0.2
_SPANS = {
    "slip": np.linspace(0.0, 0.8, 60),
    "speed": np.geomspace(0.01, 1.0, 60),
    "pass_number": np.arange(1.0, 11.0),
    "slip_angle": np.linspace(0.0, np.pi / 2, 60),
    "slope": np.linspace(0.0, np.radians(20.0), 60),
    "grouser_height": np.linspace(0.0, 0.02, 60),
    "moisture": np.linspace(0.02, 0.3, 60),
    "width": np.linspace(0.03, 0.3, 60),
    "load": np.linspace(10.0, 150.0, 60),
}
_UNITS = {
    "load": "N",
    "width": "m",
    "speed": "m/s",
    "slip_angle": "rad",
    "slope": "rad",
    "grouser_height": "m",
}
CHANNELS = {
    "sinkage": ("mm", 1e3),
    "resistance": ("N", 1.0),
    "drawbar_pull": ("N", 1.0),
    "torque": ("N m", 1.0),
}


@dataclass(frozen=True)
class EffectCurves:
    """A channel over an effect's driver, without it and with each form at its start.

    x and each curve: shape (points,), the curves in `unit`. axis: the driver with its unit.
    setting: wheel and soil, in words. predictions: all channels, by the same names.
    """

    axis: str
    x: Array
    channel: str
    unit: str
    without: Array
    forms: Mapping[str, Array]
    setting: str
    predictions: Mapping[str, Prediction]


def effect_curves(family: tuple[type[Effect], ...]) -> EffectCurves:
    """Predict a typical wheel on dry sand over what drives an effect."""
    first = family[0]
    driver = (*first.drivers, "load")[0]
    span = _SPANS.get(driver, np.linspace(0.1, 2.0, 60))
    if first.side < 0:
        span = -span[::-1]
    settings: dict[str, ArrayLike] = {
        "load": _LOAD,
        "diameter": _DIAMETER,
        "width": _WIDTH,
        "slip": _SLIP,
    }
    settings |= {name: 0.1 for form in family for name in form.needs if name not in settings}
    conditions = Conditions.of(**(settings | {driver: span}))
    # Gravity acts by itself where there is a slope: without it, the slope must be none.
    bare = settings | {driver: np.zeros_like(span) if first.known_physics else span}
    base = Model(SOILS["dry_sand"], "closed_form" if first.geometry else "contact_integral")
    without = predict(base, Conditions.of(**bare))
    predictions = {
        form.form: predict(base + form.suited_to(conditions), conditions) for form in family
    }
    channel = first.channels[0]
    unit, factor = CHANNELS[channel]
    given = {"load": f"W {_LOAD:g} N", "diameter": f"D {_DIAMETER:g} m", "width": f"b {_WIDTH:g} m"}
    if driver != "slip":
        given["slip"] = f"slip {_SLIP:g}"
    given.pop(driver, None)
    axis = driver.replace("_", " ") + (f" [{_UNITS[driver]}]" if driver in _UNITS else "")
    return EffectCurves(
        axis,
        np.asarray(span, dtype=np.float64),
        channel,
        unit,
        factor * getattr(without, channel),
        {name: factor * getattr(p, channel) for name, p in predictions.items()},
        f"dry sand, {', '.join(given.values())}",
        {"": without, **predictions},
    )
