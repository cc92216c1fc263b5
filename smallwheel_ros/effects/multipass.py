"""multipass: soil that was rolled before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


def passes(conditions: Conditions) -> Array:
    """Number of the pass, 1 where none is given (fresh soil)."""
    number = conditions["pass_number"]
    return np.asarray(np.where(np.isnan(number), 1.0, np.maximum(number, 1.0)))


@dataclass(frozen=True)
class RutGrowth(Effect):
    id = "multipass"
    form = "rut depth"
    summary = "Each further pass deepens the rut."
    formula = "z_N = z1 N^p, p = 1/a; z is the depth of the rut below the fresh surface"
    source = "Abebe 1989 (unverified): a 2-3 loose, 3-4 medium, 4-5 firm soil"
    needs = ("pass_number",)
    stage = "sinkage"

    p: float = parameter(0.2, (-1.0, 1.5), "exponent of the pass number", published=(-0.6, 0.6))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * passes(conditions) ** self.p)


@dataclass(frozen=True)
class RutGrowthFirstPassWork(RutGrowth):
    form = "rut depth, work of the first pass"
    formula = "z_N = z1 N^p; the work of compaction stays that of the first pass"

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


@dataclass(frozen=True)
class Hardening(RutGrowth):
    form = "modulus"
    formula = "k N^p; z is the pass's own sinkage"
    source = "hardening (or, p < 0, loosening) by rolling"
    stage = "modulus_factor"

    p: float = parameter(0.2, (-2.0, 2.0), "exponent of the pass number", published=(-1.0, 1.0))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(passes(conditions) ** self.p)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


Multipass = RutGrowth
