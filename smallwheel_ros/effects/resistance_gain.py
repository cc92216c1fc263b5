# SPDX-License-Identifier: Apache-2.0
"""resistance_gain: the instrument that measures resistance shows a constant share too much."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Share(Effect):
    id = "resistance_gain"
    kind = "instrument"
    summary = "The force sensor is out of scale: every resistance is shown too large by one share."
    formula = "shown R = R (1 + g)"
    source = "instrument, not soil: an error of scale"
    next_step = "Pull the carriage with a known weight over a pulley and read the resistance."

    g: float = parameter(0.05, (-0.6, 1.0), "share by which too much is shown")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return resistance * (1.0 + self.g)
