# SPDX-License-Identifier: Apache-2.0
"""width_dependent_modulus: the soil's modulus under a narrower wheel is another.

Two-sided: published values of kc are negative, too. For a round plate the width is its radius, as
in Bekker's plate tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, constant, parameter
from smallwheel_ros.physics.conditions import Conditions


def _relative_width(conditions: Conditions, b0: float) -> Array:
    plate = conditions.plate
    return np.where(plate, 0.5 * conditions.diameter, conditions.width) / b0


@dataclass(frozen=True)
class _WidthDependentModulus(Effect):
    id = "width_dependent_modulus"
    summary = "The soil's modulus k depends on the wheel's width."
    drivers = ("width",)
    next_step = "Run wheels of one diameter and two widths or more, at the same loads."


@dataclass(frozen=True)
class Bekker(_WidthDependentModulus):
    formula = "k = k0 (1 - a + a b0 / b): kc/b + kphi with a = (kc/b0) / (kc/b0 + kphi)"
    source = "Bekker 1956 (eq. 5 of Meirion-Griffith and Spenko 2011)"

    a: float = parameter(
        0.2, (-2.0, 2.0), "share of kc/b in the modulus at width b0", published=(-0.5, 0.5)
    )
    b0: float = constant(0.1, (1e-3, 10.0), "width at which k is k0", unit="m")

    def modulus_factor(self, conditions: Conditions) -> Array:
        ratio = 1.0 / _relative_width(conditions, self.b0)
        return np.maximum(1.0 + self.a * (ratio - 1.0), 0.02)


@dataclass(frozen=True)
class Power(_WidthDependentModulus):
    formula = "k = k0 (b / b0)^-d"
    source = "empirical power law of width"

    d: float = parameter(0.2, (-2.0, 2.0), "fall of ln k with ln width", published=(-0.5, 0.5))
    b0: float = constant(0.1, (1e-3, 10.0), "width at which k is k0", unit="m")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(_relative_width(conditions, self.b0) ** -self.d)
