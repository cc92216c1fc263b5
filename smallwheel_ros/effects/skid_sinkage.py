"""skid_sinkage: a braked or towed wheel that skids ploughs itself in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


def skid(conditions: Conditions) -> Array:
    """Size of the slip where the wheel skids, 0 where it drives."""
    return np.asarray(np.clip(-conditions["slip"], 0.0, 1.0))


@dataclass(frozen=True)
class Quadratic(Effect):
    id = "skid_sinkage"
    form = "quadratic"
    summary = "A wheel that skids ploughs: sinkage grows with the size of negative slip."
    formula = "z = z0 (1 + a i^2), i < 0"
    source = "steeper than linear on measured rig data; no standard law found"
    needs = ("slip",)
    stage = "sinkage"

    a: float = parameter(2.0, (-0.9, 30.0), "relative growth with the square of skid")

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.a * skid(conditions) ** 2)


@dataclass(frozen=True)
class Linear(Quadratic):
    form = "linear"
    formula = "z = z0 (1 + a |i|), i < 0"

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.a * skid(conditions))


@dataclass(frozen=True)
class Exponential(Quadratic):
    form = "exponential"
    formula = "z = z0 exp(a |i|), i < 0"

    a: float = parameter(1.0, (-1.0, 8.0), "growth of ln sinkage with skid")

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * np.exp(self.a * skid(conditions)))


SkidSinkage = Quadratic
