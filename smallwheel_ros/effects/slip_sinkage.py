"""slip_sinkage: a driven wheel that slips digs itself in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


def driven_slip(conditions: Conditions) -> Array:
    """Slip where the wheel drives, 0 where it skids."""
    return np.clip(conditions["slip"], 0.0, 1.0)


@dataclass(frozen=True)
class Exponential(Effect):
    id = "slip_sinkage"
    form = "exponential"
    summary = "A driven wheel that slips digs: sinkage grows with slip."
    formula = "z = z0 exp(a i), i > 0"
    source = "exponential law over slip; range from digitised rig series (Ding et al. 2010)"
    needs = ("slip",)
    stage = "sinkage"

    a: float = parameter(1.0, (0.0, 8.0), "growth of ln sinkage with slip", published=(0.5, 5.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * np.exp(self.a * driven_slip(conditions))
