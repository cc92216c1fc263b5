# SPDX-License-Identifier: Apache-2.0
"""penetration_rate: soil that is loaded faster is stiffer.

Over 0.01 to 0.5 m/s this is 0 to 8 % of the sinkage in sand: often less than data can show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, constant, parameter
from smallwheel_ros.physics.conditions import Conditions

_SLOWEST = 1e-3  # m/s: below, no law of rate has a meaning


def _relative_speed(conditions: Conditions, v0: float) -> Array:
    return np.asarray(np.maximum(np.abs(conditions["speed"]), _SLOWEST) / v0)


@dataclass(frozen=True)
class _PenetrationRate(Effect):
    id = "penetration_rate"
    summary = "Soil that is loaded faster is stiffer: sinkage falls with speed."
    needs = ("speed",)
    next_step = "Drive at speeds a factor of ten or more apart, at one load and one slip."


@dataclass(frozen=True)
class Power(_PenetrationRate):
    formula = "k = k0 (v / v0)^mu"
    source = "after Pope 1969, 1971 (unverified)"

    mu: float = parameter(0.05, (0.0, 0.8), "growth of ln k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.1, (1e-3, 10.0), "speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(_relative_speed(conditions, self.v0) ** self.mu)


@dataclass(frozen=True)
class Logarithmic(_PenetrationRate):
    formula = "k = k0 (1 + a ln(v / v0))"
    source = "after Grahn 1991 (unverified)"

    a: float = parameter(0.05, (0.0, 0.8), "growth of k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.1, (1e-3, 10.0), "speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.maximum(1.0 + self.a * np.log(_relative_speed(conditions, self.v0)), 0.05)


@dataclass(frozen=True)
class PenetrationSpeed(_PenetrationRate):
    formula = "p = k0 z^n D^m (v sqrt(z / D) / v0)^mu"
    source = "as the power law, driven by the speed at which the wheel enters the soil"

    mu: float = parameter(0.05, (0.0, 0.8), "growth of ln k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.03, (1e-4, 10.0), "entry speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        entry = _relative_speed(conditions, self.v0) / np.sqrt(conditions["diameter"])
        return np.asarray(entry**self.mu)

    def exponent_shift(self, conditions: Conditions) -> float:
        return 0.5 * self.mu
