# SPDX-License-Identifier: Apache-2.0
"""rig_friction: bearings, guides and cables of the rig resist, and the resistance shows it.

It is in what the instrument shows only: what soil and wheel pull (drawbar pull) does not have it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class _RigFriction(Effect):
    id = "rig_friction"
    kind = "instrument"
    summary = "The rig itself resists: bearings and guides add to the measured resistance."
    next_step = "Tow the wheel over a hard, flat plate at two loads: what is left is the rig's own."


@dataclass(frozen=True)
class ShareOfLoad(_RigFriction):
    formula = "shown R = R + f W"
    source = "Coulomb friction in a bearing that carries the load; instrument, not soil"
    drivers = ("load",)

    f: float = parameter(0.05, (0.0, 1.0), "the rig's resistance over the load")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance + self.f * conditions.load)


@dataclass(frozen=True)
class Constant(_RigFriction):
    formula = "shown R = R + F, F >= 0"
    source = "friction of seals and guides, whatever the load; instrument, not soil"
    same_as = "resistance_offset"

    force: float = parameter(1.0, (0.0, 1e3), "the rig's resistance F", unit="N")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return resistance + self.force
