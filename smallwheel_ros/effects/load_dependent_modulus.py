"""load_dependent_modulus: the soil seems stiffer or softer under a heavier wheel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter

REFERENCE_LOAD = 50.0  # N: k is the modulus at this load
DECAY_LOAD = 50.0  # N


@dataclass(frozen=True)
class PowerLaw(Effect):
    id = "load_dependent_modulus"
    form = "power"
    summary = "The modulus changes with the load that presses the soil."
    formula = "k (W/W0)^g, W0 = 50 N"
    source = "Richter 2002 as shown by Meirion-Griffith and Spenko 2011, Fig. 3"
    stage = "modulus_factor"

    g: float = parameter(0.1, (-1.0, 1.0), "exponent of load", published=(-0.3, 0.3))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray((conditions.load / REFERENCE_LOAD) ** self.g)


@dataclass(frozen=True)
class Saturating(PowerLaw):
    form = "saturating"
    formula = "k (1 - a exp(-W/Wc)), Wc = 50 N"

    g: float = parameter(0.3, (-5.0, 0.95), "share missing at no load", published=(-1.0, 0.9))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(1.0 - self.g * np.exp(-conditions.load / DECAY_LOAD))


LoadDependentModulus = PowerLaw
