"""sinkage_offset: the instrument does not read zero at touch-down."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class SinkageOffset(Effect):
    id = "sinkage_offset"
    form = "constant"
    summary = "The zero of the sinkage instrument is off by a constant."
    formula = "z shown = z + z_zero"
    source = "instrument"
    channels = ("sinkage",)
    stage = "measured_sinkage"

    zero: float = parameter(
        0.001, (-0.02, 0.02), "reading at touch-down", unit="m", published=(-0.005, 0.005)
    )

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage + self.zero
