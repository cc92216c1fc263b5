# SPDX-License-Identifier: Apache-2.0
"""Sinkage of one wheel under the law, with the model's effects, and its derivatives by the law and load.

This is what the filter, the predictions and mobility go by. Without effects it is one solution of the
contact integral; with effects that leave pressure a power of depth, that solution between what they
make of load, wheel and soil and what they make of the sinkage; with any others `model.predict` itself
and its differences, a hundred times slower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.point_sinkage import Law, Slopes, WheelSinkage, static_sinkage
from smallwheel_ros.model.model import Model, Prediction, predict
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, Soil

Array = NDArray[np.float64]
Shear = tuple[()] | tuple[float, float, float]

# What comes of a soil in which a wheel has no sinkage, an effect that fails, or a filter that does.
NO_SINKAGE = (ArithmeticError, ValueError, np.linalg.LinAlgError, SmallwheelError)
_STEP = 1e-4  # of the law, ln load and ln sinkage in central differences: error 1e-8
_LOG_DEPTH = math.log(REFERENCE_SINKAGE)


class LoadedWheel(NamedTuple):
    """A wheel under a load: N, m; slip 1 and speed m/s, None where not known."""

    load: float
    diameter: float
    width: float
    contact: str
    slip: float | None = None
    speed: float | None = None

    def conditions(self, loads: Array) -> Conditions:
        """It under each of these loads (N), one row each."""
        rows = loads.size
        known = {"slip": self.slip, "speed": self.speed}
        return Conditions(
            loads,
            np.full(rows, self.diameter),
            np.full(rows, self.width),
            np.broadcast_to(np.array(self.contact), loads.shape),
            None,
            {name: np.full(rows, value) for name, value in known.items() if value is not None},
        )


def wheel_sinkage(law: Law, wheel: LoadedWheel, effects: Sequence[Effect] = ()) -> WheelSinkage:
    """Sinkage of a wheel in a soil.

    Raises one of `NO_SINKAGE` where the model has none.
    """
    if not effects:
        return static_sinkage(law, *wheel[:4])
    # The wheel under a little less and a little more load; then as it is, a little less and more deep.
    loads = wheel.load * np.exp(_STEP * np.array([-1.0, 0.0, 1.0, 0.0, 0.0]))
    stages = Stages(effects, wheel.conditions(loads))
    if stages.layered:
        found = neighbours(law, wheel, effects)
        by_law = slopes(found.sinkage)
        return WheelSinkage(float(found.sinkage[0]), by_law, bool(found.immobilised[0]))
    statics = []
    for load, diameter, modulus, n in np.transpose(stages.loaded(law.k, law.n, law.m))[:3].tolist():
        log_modulus = math.log(modulus) - law.m * math.log(diameter / REFERENCE_DIAMETER)
        acted_on = Law(log_modulus, n, law.m)
        statics.append(static_sinkage(acted_on, load, diameter, wheel.width, wheel.contact))
    static = statics[1]
    around = static.value * (1.0 - _STEP), static.value * (1.0 + _STEP)
    z = np.array([*(one.value for one in statics), *around])
    dug = stages.change_rolling("sinkage", z)
    less, shown, more, before, after = stages.change("measured_sinkage", dug).tolist()
    slope = (after - before) / (2.0 * _STEP * static.value)
    by_modulus, by_n, by_m, _ = static.slopes
    by_law = by_modulus * slope, by_n * slope, by_m * slope, (more - less) / (2.0 * _STEP)
    return WheelSinkage(shown, by_law, static.sunk_to_axle or shown > 0.5 * diameter)


def neighbours(
    law: Law,
    wheel: LoadedWheel,
    effects: Sequence[Effect],
    shear: Shear = (),
) -> Prediction:
    """What `model.predict` says of a wheel, and beside it for `slopes`; nine rows.

    shear: cohesion, friction angle and shear displacement, for the thrust.
    """
    steps = _STEP * np.eye(4)
    steps[1, 0] = -_STEP * _LOG_DEPTH  # n turns about the reference sinkage
    at = np.array([*law, math.log(wheel.load)])
    rows = np.concatenate([at[None], at - steps, at + steps])
    names = [str(i) for i in range(len(rows))]
    soils = [
        Soil(name, Law(log_modulus, n, m).k, n, m, *shear)
        for name, (log_modulus, n, m) in zip(names, rows[:, :3].tolist(), strict=True)
    ]
    conditions = replace(wheel.conditions(np.exp(rows[:, 3])), soil=np.array(names))
    return predict(Model(soils, effects=effects), conditions)


def slopes(column: Array) -> Slopes:
    """Slopes of a column of `neighbours` by the three of `Law` and by ln load."""
    by_modulus, turned, by_m, by_load = ((column[5:] - column[1:5]) / (2.0 * _STEP)).tolist()
    return by_modulus, turned + _LOG_DEPTH * by_modulus, by_m, by_load
