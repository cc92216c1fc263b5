# SPDX-License-Identifier: Apache-2.0
"""slip_sinkage, skid_sinkage, slip_angle_sinkage: a wheel that does not roll freely digs itself in.

Slip of a driven wheel (over 0) and skid of a braked one (under 0) have laws of the same form, but separate
parameters, as there is no evidence that the same values hold for both signs. Linear and square growth,
and Lyasko's and Reece's laws, are special cases of the quadratic one. In its variant that is partly dug, c is
the share of the dug depth that costs compaction work.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, constant, parameter, partly_dug
from smallwheel_ros.physics.conditions import Conditions

# A wheel that rolls freely shows about this much slip of either sign: its radius is known to a
# few per cent at best, since lugs, sand on the rim and sinkage all change it.
_FREE_ROLLING = 0.02


class BySlip(Effect):
    """Base of effects that act at slip of one sign: `side` is 1 for driven wheels, -1 for braked ones."""

    needs: ClassVar[tuple[str, ...]] = ("slip",)
    side: ClassVar[Literal[-1, 0, 1]] = 1

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        missing = super().never_acts(conditions)
        if missing or (cls.side * cls.values_met("slip", conditions) > _FREE_ROLLING).any():
            return missing
        if cls.side > 0:
            return f"no row has a driven wheel that slips (slip over {_FREE_ROLLING})"
        return f"no row has a wheel that skids (slip under -{_FREE_ROLLING})"

    def slip(self, conditions: Conditions) -> Array:
        """Magnitude of the slip, 0 to 1, shape (rows,); 0 in rows where it has the other sign."""
        return np.clip(self.side * conditions["slip"], 0.0, 1.0)


class _SlipSinkage(BySlip):
    id = "slip_sinkage"
    summary = "A driven wheel that slips digs: sinkage grows with slip."
    next_step = "Sweep slip from 0 to 0.6 at one load, on soil that is prepared anew for each run."


@dataclass(frozen=True)
class Exponential(_SlipSinkage):
    """Sinkage that grows exponentially with the slip of a driven wheel."""

    formula = "z = z0 exp(a i), i > 0"
    source = "empirical; Ding et al. 2010: 3 to 7 times the static sinkage at slip 0.6"

    a: float = parameter(1.0, (0.0, 8.0), "growth of ln sinkage with slip", published=(0.3, 5.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * np.exp(self.a * self.slip(conditions)))


@dataclass(frozen=True)
class Quadratic(_SlipSinkage):
    """Sinkage that grows by a share of itself, a quadratic function of the slip of a driven wheel."""

    formula = "z = z0 (1 + s [(1 - q) i + q i^2]), i > 0"
    source = "empirical; q = 0 is linear, q = 1 a pure square"

    s: float = parameter(
        2.0, (0.0, 20.0), "growth of sinkage from slip 0 to 1", published=(0.3, 12.0)
    )
    q: float = parameter(0.5, (-2.0, 1.5), "curvature of the growth", neutral=None)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        slip = self.slip(conditions)
        return np.asarray(sinkage * (1.0 + self.s * slip * (1.0 - self.q + self.q * slip)))


@dataclass(frozen=True)
class AddedDepth(_SlipSinkage):
    """A driven wheel digs a depth that depends on slip and diameter, not on the load."""

    formula = "z = z0 + a D [(1 - q) i + q i^2], i > 0"
    source = (
        "empirical: a slipping rim carries soil away, whatever the load; three sands 0.09 to 0.13 D"
    )

    a: float = parameter(
        0.05, (0.0, 0.5), "depth dug at slip 1, over the diameter", published=(0.05, 0.15)
    )
    q: float = parameter(0.0, (-2.0, 1.5), "curvature of the growth", neutral=None)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        slip = self.slip(conditions)
        depth = self.a * conditions.diameter * slip * (1.0 - self.q + self.q * slip)
        return np.asarray(sinkage + depth)


@dataclass(frozen=True)
class FadingQuadratic(Quadratic):
    """Growth of sinkage that is quadratic in slip, and less at a slip angle beta."""

    formula = "z = z0 (1 + s [(1 - q) i + q i^2] cos^p beta), i > 0"
    source = "empirical: at a slip angle, slip along the wheel's plane counts for less"
    needs = ("slip", "slip_angle")

    p: float = parameter(1.0, (0.0, 12.0), "how fast it fades with the slip angle", neutral=None)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        fading = np.maximum(np.cos(conditions["slip_angle"]), 1e-6) ** self.p
        return np.asarray(sinkage + (super().sinkage(sinkage, conditions) - sinkage) * fading)


PartlyDugQuadratic = partly_dug(Quadratic)


@dataclass(frozen=True)
class Softening(_SlipSinkage):
    """Soil that gets softer with the slip of a driven wheel."""

    formula = "k = k0 exp(-a i), i > 0"
    source = "after Ding et al. 2010: soil that is sheared carries less, so the wheel floats deeper"

    a: float = parameter(1.0, (0.0, 8.0), "fall of ln k with slip", published=(0.3, 5.0))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.exp(-self.a * self.slip(conditions))


class _SkidSinkage(BySlip):
    id = "skid_sinkage"
    summary = "A braked wheel that skids ploughs in: sinkage grows with |slip| below zero."
    source = "empirical, no standard law; on rig data steeper than linear"
    side = -1
    next_step = "Sweep skid from 0 to -0.6 at one load, on soil that is prepared anew for each run."


@dataclass(frozen=True)
class SkidQuadratic(_SkidSinkage, Quadratic):
    """Sinkage that grows by a share of itself, a quadratic function of the skid of a braked wheel."""

    form = "quadratic"
    formula = "z = z0 (1 + s [(1 - q) |i| + q i^2]), i < 0"

    s: float = parameter(
        2.0, (0.0, 20.0), "growth of sinkage from skid 0 to 1", published=(0.3, 12.0)
    )
    q: float = parameter(0.8, (-2.0, 1.5), "curvature of the growth", neutral=None)


PartlyDugSkidQuadratic = partly_dug(SkidQuadratic)


@dataclass(frozen=True)
class SkidSoftening(_SkidSinkage, Softening):
    """Soil that gets softer with the skid of a braked wheel."""

    form = "softening"
    formula = "k = k0 exp(-a |i|), i < 0"

    a: float = parameter(1.0, (0.0, 8.0), "fall of ln k with skid", published=(0.3, 5.0))


@dataclass(frozen=True)
class SkidFadingQuadratic(SkidQuadratic, FadingQuadratic):
    """Growth of sinkage that is quadratic in skid, and less at a slip angle beta."""

    form = "fading_quadratic"
    formula = "z = z0 (1 + s [(1 - q) |i| + q i^2] cos^p beta), i < 0; compaction resistance at z0"
    source = "empirical: at a slip angle, skid along the wheel's plane counts for less"
    channels = ("sinkage", "drawbar_pull", "torque")

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


class _SlipAngleSinkage(Effect):
    id = "slip_angle_sinkage"
    summary = "A wheel that travels at an angle to its plane sinks deeper."
    source = "empirical, no standard law; seen at every slip in rig data"
    needs = ("slip_angle",)
    idle = "no row has a slip angle"
    next_step = "Sweep the slip angle from 0 to 20 degrees at one load and one slip."


@dataclass(frozen=True)
class AngleCosine(_SlipAngleSinkage):
    """Sinkage that grows with 1 - cos of the slip angle beta."""

    form = "cosine"
    formula = "z = z0 (1 + a (1 - cos beta))"

    a: float = parameter(2.0, (0.0, 100.0), "growth of sinkage with 1 - cos of the slip angle")

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * (1.0 + self.a * (1.0 - np.cos(conditions["slip_angle"]))))


@dataclass(frozen=True)
class AnglePower(_SlipAngleSinkage):
    """Sinkage that grows with a power of the slip angle beta."""

    form = "power"
    formula = "z = z0 (1 + a (|beta| / beta0)^p)"

    a: float = parameter(0.5, (0.0, 20.0), "growth of sinkage from slip angle 0 to beta0")
    p: float = parameter(1.0, (0.2, 4.0), "exponent of the growth", neutral=None)
    beta0: float = constant(0.5, (0.01, 1.6), "slip angle at which the growth is a", unit="rad")

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(
            sinkage * (1.0 + self.a * np.abs(conditions["slip_angle"] / self.beta0) ** self.p)
        )


PartlyDugAnglePower = partly_dug(AnglePower)


@dataclass(frozen=True)
class AngleSoftening(_SlipAngleSinkage):
    """Soil that gets softer with the slip angle beta."""

    form = "softening"
    formula = "k = k0 exp(-a |beta|)"

    a: float = parameter(1.0, (0.0, 20.0), "fall of ln k with the slip angle", unit="1/rad")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.exp(-self.a * np.abs(conditions["slip_angle"]))
