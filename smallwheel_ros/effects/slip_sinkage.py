# SPDX-License-Identifier: Apache-2.0
"""slip_sinkage: a driven wheel that slips digs itself in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.effects.digging import dug, partly_dug
from smallwheel_ros.physics.conditions import Conditions

_LARGEST_SLIP = 0.95  # for laws that have a pole at slip 1
# A wheel that rolls freely shows about this much slip of either sign: its radius is known to a
# few per cent at best, since lugs, sand on the rim and sinkage all change it.
FREE_ROLLING = 0.02


def driven_slip(conditions: Conditions) -> Array:
    """Slip where the wheel drives, 0 where it skids."""
    return np.clip(conditions["slip"], 0.0, 1.0)


def lacks_driven_slip(slip: Array) -> str:
    """Say that no wheel is driven and slips, "" where one is. slip: values without blanks."""
    if (slip > FREE_ROLLING).any():
        return ""
    return f"no row has a driven wheel that slips (slip over {FREE_ROLLING})"


@dataclass(frozen=True)
class _DrivenSlip(Effect):
    id = "slip_sinkage"
    summary = "A driven wheel that slips digs: sinkage grows with slip."
    needs: ClassVar[tuple[str, ...]] = ("slip",)
    side = 1
    next_step = "Sweep slip from 0 to 0.6 at one load, on soil that is prepared anew for each run."

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        return missing or lacks_driven_slip(cls.values_met("slip", conditions))


@dataclass(frozen=True)
class _SlipSinkage(_DrivenSlip):
    def growth(self, slip: Array) -> Array:
        raise NotImplementedError

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * self.growth(driven_slip(conditions))


@dataclass(frozen=True)
class Exponential(_SlipSinkage):
    formula = "z = z0 exp(a i), i > 0"
    source = "empirical; Ding et al. 2010: 3 to 7 times the static sinkage at slip 0.6"

    a: float = parameter(1.0, (0.0, 8.0), "growth of ln sinkage with slip", published=(0.3, 5.0))

    def growth(self, slip: Array) -> Array:
        return np.exp(self.a * slip)


@dataclass(frozen=True)
class Linear(_SlipSinkage):
    formula = "z = z0 (1 + s i), i > 0"
    source = "empirical; range from digitised rig series"

    s: float = parameter(2.0, (0.0, 30.0), "growth of sinkage with slip", published=(0.3, 12.0))

    def growth(self, slip: Array) -> Array:
        return 1.0 + self.s * slip


@dataclass(frozen=True)
class Quadratic(_SlipSinkage):
    formula = "z = z0 (1 + s [(1 - q) i + q i^2]), i > 0"
    source = "empirical; q = 0 is linear, q = 1 a pure square"

    s: float = parameter(
        2.0, (0.0, 20.0), "growth of sinkage from slip 0 to 1", published=(0.3, 12.0)
    )
    q: float = parameter(0.5, (-2.0, 1.5), "curvature of the growth", neutral=None)

    def growth(self, slip: Array) -> Array:
        return 1.0 + self.s * slip * (1.0 - self.q + self.q * slip)


@dataclass(frozen=True)
class Lyasko(_SlipSinkage):
    formula = "z = z0 [(1 + i) / (1 - 0.5 i)]^a, i > 0"
    source = "Lyasko 2010, J. Terramechanics 47, with a = 1 (formula unverified); a is fitted here"

    a: float = parameter(1.0, (0.0, 6.0), "strength; Lyasko's own law is 1", published=(0.3, 4.0))

    def growth(self, slip: Array) -> Array:
        return ((1.0 + slip) / (1.0 - 0.5 * slip)) ** self.a


@dataclass(frozen=True)
class LugDigging(_SlipSinkage):
    formula = "z = z0 (1 + a i / (1 - i)), i > 0 (i up to 0.95)"
    source = "after Reece 1965-66, soil carried away by lugs (unverified)"

    a: float = parameter(0.5, (0.0, 10.0), "digging strength", published=(0.1, 5.0))

    def growth(self, slip: Array) -> Array:
        i = np.minimum(slip, _LARGEST_SLIP)
        return 1.0 + self.a * i / (1.0 - i)


@dataclass(frozen=True)
class AddedDepth(_SlipSinkage):
    formula = "z = z0 + a D [(1 - q) i + q i^2], i > 0"
    source = (
        "empirical: a slipping rim carries soil away, whatever the load; three sands 0.09 to 0.13 D"
    )

    a: float = parameter(
        0.05, (0.0, 0.5), "depth dug at slip 1, over the diameter", published=(0.05, 0.15)
    )
    q: float = parameter(0.0, (-2.0, 1.5), "curvature of the growth", neutral=None)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        slip = driven_slip(conditions)
        depth = self.a * conditions.diameter * slip * (1.0 - self.q + self.q * slip)
        return np.asarray(sinkage + depth)


@dataclass(frozen=True)
class ExponentShift(_DrivenSlip):
    formula = "n = n0 + n1 i, i > 0"
    source = "Ding et al. 2010; range for a law without slip stress (n1 unverified)"

    n1: float = parameter(0.6, (0.0, 3.0), "growth of n with slip", published=(0.2, 1.6))

    def exponent_shift(self, conditions: Conditions) -> Array:
        return self.n1 * driven_slip(conditions)


@dataclass(frozen=True)
class FadingQuadratic(Quadratic):
    formula = "z = z0 (1 + s [(1 - q) i + q i^2] cos^p beta), i > 0"
    source = "empirical: at a slip angle, slip along the wheel's plane counts for less"
    needs = ("slip", "slip_angle")

    p: float = parameter(1.0, (0.0, 12.0), "how fast it fades with the slip angle", neutral=None)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        fading = np.maximum(np.cos(conditions["slip_angle"]), 1e-6) ** self.p
        grown = self.growth(driven_slip(conditions))
        return np.asarray(sinkage * (1.0 + (grown - 1.0) * fading))


DugExponential = dug(Exponential)
DugQuadratic = dug(Quadratic)
PartlyDugQuadratic = partly_dug(Quadratic)
