"""grouser: lugs on the rim reach deeper and dig more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class EffectiveRadius(Effect):
    id = "grouser"
    form = "effective radius"
    summary = "Grousers make the wheel act larger."
    formula = "D = D0 + 2 lambda h"
    source = "effective radius r + lambda h, lambda 0 to 1 (unverified)"
    needs = ("grouser_height",)
    stage = "wheel_diameter"

    share: float = parameter(0.5, (-2.0, 3.0), "lambda, share of the height", published=(0.0, 1.0))

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        height = np.nan_to_num(conditions["grouser_height"])
        return np.asarray(diameter + 2.0 * self.share * height)


@dataclass(frozen=True)
class Digging(EffectiveRadius):
    form = "digging"
    summary = "Grousers dig: sinkage grows with their height."
    formula = "z = z0 (1 + s h/r)"
    stage = "sinkage"

    share: float = parameter(1.0, (-3.0, 30.0), "growth with height over radius")

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        return diameter

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        height = np.nan_to_num(conditions["grouser_height"])
        return np.asarray(sinkage * (1.0 + 2.0 * self.share * height / conditions.diameter))


Grouser = EffectiveRadius
