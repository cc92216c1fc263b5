# SPDX-License-Identifier: Apache-2.0
"""slip_angle_sinkage: a wheel that travels at an angle to its plane ploughs in sideways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, constant, parameter
from smallwheel_ros.effects.digging import partly_dug
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class _SlipAngleSinkage(Effect):
    id = "slip_angle_sinkage"
    summary = "A wheel that travels at an angle to its plane sinks deeper."
    source = "empirical, no standard law; seen at every slip in rig data"
    needs = ("slip_angle",)
    next_step = "Sweep the slip angle from 0 to 20 degrees at one load and one slip."

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        if missing or cls.values_met("slip_angle", conditions).any():
            return missing
        return "no row has a slip angle"

    def growth(self, angle: Array) -> Array:
        raise NotImplementedError

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * self.growth(np.abs(conditions["slip_angle"]))


@dataclass(frozen=True)
class Cosine(_SlipAngleSinkage):
    formula = "z = z0 (1 + a (1 - cos beta))"

    a: float = parameter(2.0, (0.0, 100.0), "growth of sinkage with 1 - cos of the slip angle")

    def growth(self, angle: Array) -> Array:
        return 1.0 + self.a * (1.0 - np.cos(angle))


@dataclass(frozen=True)
class Power(_SlipAngleSinkage):
    formula = "z = z0 (1 + a (|beta| / beta0)^p)"

    a: float = parameter(0.5, (0.0, 20.0), "growth of sinkage from slip angle 0 to beta0")
    p: float = parameter(1.0, (0.2, 4.0), "exponent of the growth", neutral=None)
    beta0: float = constant(0.5, (0.01, 1.6), "slip angle at which the growth is a", unit="rad")

    def growth(self, angle: Array) -> Array:
        return 1.0 + self.a * (angle / self.beta0) ** self.p


@dataclass(frozen=True)
class Exponential(_SlipAngleSinkage):
    formula = "z = z0 exp(a |beta|)"

    a: float = parameter(0.8, (0.0, 20.0), "growth of ln sinkage with the slip angle", unit="1/rad")

    def growth(self, angle: Array) -> Array:
        return np.exp(self.a * angle)


PartlyDugPower = partly_dug(Power)
