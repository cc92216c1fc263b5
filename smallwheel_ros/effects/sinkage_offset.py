"""sinkage_offset: the zero of the instrument that measures sinkage is off."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Constant(Effect):
    id = "sinkage_offset"
    summary = "The instrument's zero is off: every sinkage is shown deeper or shallower by as much."
    formula = "measured z = z + offset"
    source = "instrument, not soil"

    offset: float = parameter(
        0.001, (-0.02, 0.02), "what is shown at zero sinkage", unit="m", published=(-0.005, 0.005)
    )

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage + self.offset
