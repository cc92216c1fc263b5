"""slip_sinkage: a driven wheel that slips digs itself in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


def driven_slip(conditions: Conditions) -> Array:
    """Slip where the wheel drives, 0 where it skids."""
    return np.asarray(np.clip(conditions["slip"], 0.0, 1.0))


@dataclass(frozen=True)
class Exponential(Effect):
    id = "slip_sinkage"
    form = "exponential"
    summary = "A driven wheel that slips digs: sinkage grows with slip."
    formula = "z = z0 exp(a i), i > 0"
    source = "exponential in slip; range from measured series (Ding et al. 2010; rig data)"
    needs = ("slip",)
    stage = "sinkage"

    a: float = parameter(1.0, (-1.0, 8.0), "growth of ln sinkage with slip", published=(0.2, 5.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * np.exp(self.a * driven_slip(conditions)))


@dataclass(frozen=True)
class Linear(Exponential):
    form = "linear"
    formula = "z = z0 (1 + S i), i > 0"
    source = "linear in slip (Lyasko 2010, to first order)"

    a: float = parameter(2.0, (-0.9, 20.0), "relative growth per slip", published=(0.2, 12.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.a * driven_slip(conditions))


@dataclass(frozen=True)
class Lug(Exponential):
    form = "lug"
    formula = "z = z0 (1 + a i/(1 - i)), i > 0"
    source = "lug digging, Reece 1965-66 (unverified)"

    a: float = parameter(1.0, (-0.5, 10.0), "growth with i/(1 - i)", published=(0.1, 5.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        slip = np.minimum(driven_slip(conditions), 0.98)
        return sinkage * (1.0 + self.a * slip / (1.0 - slip))


@dataclass(frozen=True)
class Digging(Exponential):
    form = "exponential, loosened soil"
    formula = "z = z0 exp(a i), i > 0; the soil dug away is not compacted"
    source = "as exponential; the dug depth adds no work of compaction"

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


@dataclass(frozen=True)
class LinearDigging(Linear):
    form = "linear, loosened soil"
    formula = "z = z0 (1 + S i), i > 0; the soil dug away is not compacted"

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


@dataclass(frozen=True)
class ExponentGrowth(Exponential):
    form = "exponent"
    formula = "n = n0 + n1 i, i > 0"
    source = "Ding et al. 2010/2011 (closed-form convention)"
    stage = "exponent_shift"

    a: float = parameter(0.5, (-0.3, 2.0), "growth of n with slip (n1)", published=(0.1, 1.6))

    def exponent_shift(self, conditions: Conditions) -> Array:
        rolling = conditions.contact == "rolling"
        return np.where(rolling, self.a * driven_slip(conditions), 0.0)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


SlipSinkage = Exponential
