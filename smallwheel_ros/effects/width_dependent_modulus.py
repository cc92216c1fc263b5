"""width_dependent_modulus: a narrow wheel meets another modulus than a wide one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter

REFERENCE_WIDTH = 0.1  # m: k is the modulus at this width


def relative_width(conditions: Conditions) -> Array:
    """Width over the reference width; 1 for plates, which have none."""
    width = np.where(conditions.contact == "plate", REFERENCE_WIDTH, conditions.width)
    return np.asarray(width / REFERENCE_WIDTH)


@dataclass(frozen=True)
class PowerLaw(Effect):
    id = "width_dependent_modulus"
    form = "power"
    summary = "The modulus changes with the width of the wheel."
    formula = "k (b/b0)^-d, b0 = 0.1 m"
    source = "empirical; Bekker's kc/b is one case"
    stage = "modulus_factor"

    d: float = parameter(0.1, (-2.0, 2.0), "exponent of width", published=(-0.5, 0.5))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(relative_width(conditions) ** -self.d)


@dataclass(frozen=True)
class Bekker(PowerLaw):
    form = "bekker"
    formula = "k (1 + d (b0/b - 1)), b0 = 0.1 m, with d = (kc/b0)/(kc/b0 + kphi)"
    source = "Bekker 1956, kc/b + kphi (eq. 5)"

    d: float = parameter(0.1, (-1.5, 1.5), "share of kc/b0 in the modulus", published=(-0.5, 1.0))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.maximum(1.0 + self.d * (1.0 / relative_width(conditions) - 1.0), 0.05)


WidthDependentModulus = PowerLaw
