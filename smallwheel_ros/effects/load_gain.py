# SPDX-License-Identifier: Apache-2.0
"""load_gain: the load cell shows a constant share too much or too little."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Share(Effect):
    id = "load_gain"
    kind = "instrument"
    summary = "The load cell is out of scale: every load is shown too large by one share."
    formula = "shown W = W (1 + g)"
    source = "instrument, not soil: an error of scale"
    next_step = "Weigh two known masses on the load cell, one light and one as heavy as the wheel."

    g: float = parameter(0.05, (-0.6, 1.0), "share by which too much is shown")

    def corrected_load(self, load: Array, conditions: Conditions) -> Array:
        return load / (1.0 + self.g)
