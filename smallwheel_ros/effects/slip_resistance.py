# SPDX-License-Identifier: Apache-2.0
"""slip_resistance: the measured resistance follows slip, while the sinkage does not.

No law of soil does that: what digs shows in the sinkage. A rig does where part of the wheel's
thrust reaches the force sensor, as through a motor's cable, a tilted guide, or a resistance that is
worked out from the motor's torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class _SlipResistance(Effect):
    id = "slip_resistance"
    kind = "instrument"
    summary = "The measured resistance follows slip, though sinkage does not."
    source = "instrument, not soil; empirical, the first order in slip"
    needs = ("slip",)
    next_step = (
        "Sweep slip at one load on a hard, flat plate, where no soil is dug: the force sensor should "
        "show the same resistance at every slip."
    )

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        if missing or cls.values_met("slip", conditions).any():
            return missing
        return "no row has slip"


@dataclass(frozen=True)
class Magnitude(_SlipResistance):
    formula = "shown R = R (1 + s |i|)"

    s: float = parameter(0.2, (-0.9, 10.0), "growth of the shown resistance to slip 1 or -1")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance * (1.0 + self.s * np.abs(conditions["slip"])))


@dataclass(frozen=True)
class Signed(_SlipResistance):
    formula = "shown R = R (1 + s i)"

    s: float = parameter(0.2, (-0.9, 0.9), "growth of the shown resistance to slip 1, fall to -1")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance * (1.0 + self.s * conditions["slip"]))
