"""slip_angle_sinkage: a wheel that runs sideways sinks deeper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class Cosine(Effect):
    id = "slip_angle_sinkage"
    form = "cosine"
    summary = "A wheel that runs at an angle to its plane sinks deeper."
    formula = "z = z0 (1 + a (1 - cos(beta)))"
    source = "no standard law found; form of the rig data"
    needs = ("slip_angle",)
    stage = "sinkage"

    a: float = parameter(1.0, (-0.9, 20.0), "relative growth at a right angle")

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.a * (1.0 - np.cos(conditions["slip_angle"])))


@dataclass(frozen=True)
class Linear(Cosine):
    form = "linear"
    formula = "z = z0 (1 + a |beta|)"

    a: float = parameter(1.0, (-0.5, 10.0), "relative growth with the angle", unit="1/rad")

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.a * np.abs(conditions["slip_angle"]))


SlipAngleSinkage = Cosine
