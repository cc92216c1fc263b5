"""slope: known physics, applied by default where the column is there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, WheelState


@dataclass(frozen=True)
class Slope(Effect):
    id = "slope"
    form = "rigid body"
    summary = "On a slope less load reaches the soil, and weight pulls downhill."
    formula = "normal load W cos(slope); resistance + W sin(slope)"
    source = "statics"
    needs = ("slope",)
    stage = "normal_load"

    def normal_load(self, load: Array, conditions: Conditions) -> Array:
        return np.asarray(load * np.cos(np.nan_to_num(conditions["slope"])))

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        return np.asarray(conditions.load * np.sin(np.nan_to_num(conditions["slope"])))
