# SPDX-License-Identifier: Apache-2.0
"""sinkage_offset: the zero of the instrument that measures sinkage is off."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Constant(Effect):
    id = "sinkage_offset"
    kind = "instrument"
    summary = (
        "The sinkage instrument's zero is off: all sinkages are shown too deep or too shallow."
    )
    formula = "shown z = z + offset"
    source = "instrument, not soil: a zero that was set at another height than touch-down"
    next_step = (
        "Take the zero of sinkage at touch-down under the lightest load, and again after the run."
    )

    offset: float = parameter(0.001, (-0.05, 0.05), "what is shown at zero sinkage", unit="m")

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage + self.offset
