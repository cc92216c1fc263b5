# SPDX-License-Identifier: Apache-2.0
"""sinkage_gain: the instrument that measures sinkage shows a constant share too much or too little."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class Share(Effect):
    id = "sinkage_gain"
    kind = "instrument"
    summary = (
        "The sinkage instrument is out of scale: every sinkage is shown too deep by one share."
    )
    formula = "shown z = z (1 + g)"
    source = "instrument, not soil: an error of scale"
    next_step = "Move the wheel's carriage by a gauge block of known height and read the sinkage."

    g: float = parameter(0.05, (-0.6, 1.0), "share by which too much is shown")

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.g)
