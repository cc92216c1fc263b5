# SPDX-License-Identifier: Apache-2.0
"""load_dependent_modulus: the soil's modulus under a heavier wheel is another.

With sinkage alone this is exactly aliased with n and with a law of width; resistance, or a plate
test, tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, constant, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
class _LoadDependentModulus(Effect):
    id = "load_dependent_modulus"
    summary = "The soil's modulus k depends on the load."
    drivers = ("load",)
    next_step = (
        "Measure the towing force as well as the sinkage, over loads a factor of three apart; or press "
        "plates of one diameter into the same soil."
    )


@dataclass(frozen=True)
class Power(_LoadDependentModulus):
    formula = "k = k0 (W / W0)^g"
    source = "empirical; Meirion-Griffith and Spenko 2011, fig. 3 (after Richter 2002) shows it"

    g: float = parameter(0.1, (-1.5, 1.5), "growth of ln k with ln load", published=(-0.3, 0.3))
    w0: float = constant(60.0, (1e-2, 1e5), "load at which k is k0", unit="N")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray((conditions.load / self.w0) ** self.g)


@dataclass(frozen=True)
class Saturating(_LoadDependentModulus):
    formula = "k = k0 (1 - a exp(-W / Wc))"
    source = "as the power law, levelling off at high loads"

    a: float = parameter(0.4, (-5.0, 0.99), "share of k that light loads lack")
    wc: float = parameter(
        50.0, (5.0, 1000.0), "load scale", unit="N", published=(10.0, 200.0), neutral=None
    )

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(1.0 - self.a * np.exp(-conditions.load / self.wc))
