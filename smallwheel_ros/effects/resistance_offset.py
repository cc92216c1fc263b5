# SPDX-License-Identifier: Apache-2.0
"""resistance_offset: the zero of the instrument that measures resistance is off."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Constant(Effect):
    id = "resistance_offset"
    kind = "instrument"
    summary = "The force sensor's zero is off: every resistance is shown too large or too small."
    formula = "shown R = R + offset"
    source = "instrument, not soil: a sensor that was not set to zero at rest"
    next_step = "Read the resistance with the wheel at rest and unloaded; it should show zero."

    offset: float = parameter(1.0, (-1e3, 1e3), "what is shown at zero resistance", unit="N")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return resistance + self.offset
