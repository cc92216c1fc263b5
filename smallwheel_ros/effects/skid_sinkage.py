# SPDX-License-Identifier: Apache-2.0
"""skid_sinkage: a braked wheel that skids ploughs itself in.

Kept apart from slip_sinkage: that the same law holds for both signs has no evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.effects.digging import dug, partly_dug
from smallwheel_ros.effects.slip_sinkage import FREE_ROLLING
from smallwheel_ros.physics.conditions import Conditions


def skid(conditions: Conditions) -> Array:
    """|slip| where the wheel skids, 0 where it drives."""
    return np.clip(-conditions["slip"], 0.0, 1.0)


@dataclass(frozen=True)
class _SkidSinkage(Effect):
    id = "skid_sinkage"
    summary = "A braked wheel that skids ploughs in: sinkage grows with |slip| below zero."
    source = "empirical, no standard law; on rig data steeper than linear"
    needs: ClassVar[tuple[str, ...]] = ("slip",)
    side = -1
    next_step = "Sweep skid from 0 to -0.6 at one load, on soil that is prepared anew for each run."

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        if missing or (cls.values_met("slip", conditions) < -FREE_ROLLING).any():
            return missing
        return f"no row has a wheel that skids (slip under -{FREE_ROLLING})"

    def growth(self, slip: Array) -> Array:
        raise NotImplementedError

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * self.growth(skid(conditions))


@dataclass(frozen=True)
class Quadratic(_SkidSinkage):
    formula = "z = z0 (1 + s [(1 - q) |i| + q i^2]), i < 0"

    s: float = parameter(
        2.0, (0.0, 20.0), "growth of sinkage from skid 0 to 1", published=(0.3, 12.0)
    )
    q: float = parameter(0.8, (-2.0, 1.5), "curvature of the growth", neutral=None)

    def growth(self, slip: Array) -> Array:
        return 1.0 + self.s * slip * (1.0 - self.q + self.q * slip)


@dataclass(frozen=True)
class Exponential(_SkidSinkage):
    formula = "z = z0 exp(a |i|), i < 0"

    a: float = parameter(1.0, (0.0, 8.0), "growth of ln sinkage with skid", published=(0.3, 5.0))

    def growth(self, slip: Array) -> Array:
        return np.exp(self.a * slip)


@dataclass(frozen=True)
class Linear(_SkidSinkage):
    formula = "z = z0 (1 + s |i|), i < 0"

    s: float = parameter(2.0, (0.0, 30.0), "growth of sinkage with skid", published=(0.3, 12.0))

    def growth(self, slip: Array) -> Array:
        return 1.0 + self.s * slip


DugQuadratic = dug(Quadratic)
PartlyDugQuadratic = partly_dug(Quadratic)


@dataclass(frozen=True)
class FadingQuadratic(Quadratic):
    formula = "z = z0 (1 + s [(1 - q) |i| + q i^2] cos^p beta), i < 0; compaction resistance at z0"
    source = "empirical: at a slip angle, skid along the wheel's plane counts for less"
    needs = ("slip", "slip_angle")
    channels = ("sinkage", "drawbar_pull", "torque")

    p: float = parameter(1.0, (0.0, 12.0), "how fast it fades with the slip angle", neutral=None)

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        fading = np.maximum(np.cos(conditions["slip_angle"]), 1e-6) ** self.p
        grown = self.growth(skid(conditions))
        return np.asarray(sinkage * (1.0 + (grown - 1.0) * fading))
