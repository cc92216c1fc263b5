# SPDX-License-Identifier: Apache-2.0
"""slope: on a slope less load presses on the soil, and the rest pulls downhill.

Known physics: a model applies it wherever the conditions have a slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, WheelState
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Gravity(Effect):
    id = "slope"
    summary = "On a slope, W cos(slope) presses on the soil and W sin(slope) adds to resistance."
    formula = "normal load = W cos(slope); R = R0 + W sin(slope), slope > 0 uphill"
    source = "statics"
    needs = ("slope",)
    known_physics = True
    next_step = "Measure the slope of the bed with an inclinometer and give it as a column 'slope'."

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        if missing or cls.values_met("slope", conditions).any():
            return missing
        return "no row is on a slope"

    def objection(self, conditions: Conditions) -> str:
        slope = np.abs(conditions["slope"])
        steep = np.flatnonzero(slope >= np.pi / 2)
        if steep.size:
            return (
                f"slope in row {steep[0] + 1} is {conditions['slope'][steep[0]]:.4g} rad, "
                "expected between -pi/2 and pi/2"
            )
        return ""

    def normal_load(self, load: Array, conditions: Conditions) -> Array:
        return np.asarray(load * np.cos(conditions["slope"]))

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        return np.asarray(conditions.load * np.sin(conditions["slope"]))
