"""penetration_rate: soil resists fast loading more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter

REFERENCE_SPEED = 0.05  # m/s: k is the modulus at this travel speed
_SLOWEST = 1e-4  # m/s: creep below this is taken as this


def relative_speed(conditions: Conditions) -> Array:
    """Travel speed over the reference speed; 1 where no speed is given (a pressed wheel)."""
    speed = np.where(np.isnan(conditions["speed"]), REFERENCE_SPEED, conditions["speed"])
    return np.asarray(np.maximum(np.abs(speed), _SLOWEST) / REFERENCE_SPEED)


@dataclass(frozen=True)
class PowerLaw(Effect):
    id = "penetration_rate"
    form = "power"
    summary = "Soil that is loaded faster resists more: sinkage falls with speed."
    formula = "k (v/v0)^mu, v0 = 0.05 m/s"
    source = "Pope 1969/71, Grahn 1991 (unverified)"
    needs = ("speed",)
    stage = "modulus_factor"

    mu: float = parameter(0.05, (-0.5, 0.8), "exponent of speed", published=(0.0, 0.2))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(relative_speed(conditions) ** self.mu)


@dataclass(frozen=True)
class Logarithmic(PowerLaw):
    form = "logarithmic"
    formula = "k (1 + a ln(v/v0)), v0 = 0.05 m/s"

    mu: float = parameter(0.05, (-0.15, 0.3), "growth per e-fold of speed", published=(0.0, 0.2))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.maximum(1.0 + self.mu * np.log(relative_speed(conditions)), 0.05)


PenetrationRate = PowerLaw
