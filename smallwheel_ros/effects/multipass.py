# SPDX-License-Identifier: Apache-2.0
"""multipass: wheels that follow in a rut meet soil that others have changed.

In the first forms sinkage is the depth of the rut below the untouched surface after pass N; in
`hardening` it is what that pass itself adds, in soil that the passes before have firmed (p > 0) or
loosened (p < 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.effects.digging import partly_dug
from smallwheel_ros.physics.conditions import Conditions


def passes(conditions: Conditions) -> Array:
    """Pass number, 1 on fresh soil."""
    return np.maximum(conditions["pass_number"], 1.0)


@dataclass(frozen=True)
class _Multipass(Effect):
    id = "multipass"
    summary = "A rut deepens with each wheel that passes."
    needs = ("pass_number",)
    next_step = "Send the wheel through its own rut five times at one load and one slip."

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        if missing or (cls.values_met("pass_number", conditions) >= 2.0).any():
            return missing
        return "no row is of a second pass"


@dataclass(frozen=True)
class Power(_Multipass):
    formula = "z = z1 N^p"
    source = "Abebe 1989 (unverified), p = 1/a: a 2 to 3 loose, 3 to 4 medium, 4 to 5 firm soil"

    p: float = parameter(
        0.3, (0.0, 2.0), "growth of ln rut depth with ln pass", published=(0.1, 0.6)
    )

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * passes(conditions) ** self.p)


@dataclass(frozen=True)
class Logarithmic(_Multipass):
    formula = "z = z1 (1 + a ln N)"
    source = "empirical, as in settlement under repeated load"

    a: float = parameter(0.3, (0.0, 4.0), "growth of rut depth with ln pass", published=(0.1, 0.9))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.a * np.log(passes(conditions)))


@dataclass(frozen=True)
class RutPower(Power):
    formula = "z = z1 N^p; compaction resistance as on fresh soil"
    channels = ("sinkage", "drawbar_pull", "torque")

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


@dataclass(frozen=True)
class Hardening(_Multipass):
    formula = "k = k1 N^p"
    source = "empirical; sinkage is that of the pass itself"

    p: float = parameter(0.2, (-3.0, 3.0), "growth of ln k with ln pass", published=(-1.5, 1.5))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(passes(conditions) ** self.p)


PartlyDugPower = partly_dug(Power)
