# SPDX-License-Identifier: Apache-2.0
"""What a wheel makes of the soil about it: pushed ahead, pressed by the wheels before, rising behind.

bulldozing, multipass, elastic_rebound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import (
    Array,
    Effect,
    WheelState,
    constant,
    parameter,
    partly_dug,
)
from smallwheel_ros.physics.conditions import Conditions


def _passive_root(friction_angle: Array) -> Array:
    """sqrt(Kp) = tan(45 deg + phi/2), Kp the coefficient of passive earth pressure (Rankine)."""
    return np.asarray(np.tan(np.pi / 4.0 + friction_angle / 2.0))


@dataclass(frozen=True)
class _Bulldozing(Effect):
    """Cohesion and friction angle are those of the model's soil.

    Published forms differ 10 to 70 times at the scale of a small wheel, so each has a scale that is
    fitted; Bekker's form of 1969, the largest, is left out for that.
    """

    id = "bulldozing"
    summary = "Soil pushed ahead of the wheel adds resistance; sinkage does not show it."
    next_step = "Measure the towing force of the undriven wheel beside its sinkage, at two widths."

    scale: float = parameter(1.0, (0.0, 10.0), "factor on the published form")
    # Dry to moist sand: 14 to 17 kN/m^3. What is fitted is the scale, so its error goes there.
    unit_weight: float = constant(15.5e3, (1e3, 30e3), "weight of the soil", unit="N/m^3")

    def resistance(self, depth: Array, state: WheelState) -> Array:
        """Resistance (N) at scale 1 of soil pushed up over a depth (m, 0 or more)."""
        raise NotImplementedError

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        # An effect may lift the wheel out of the soil; then it pushes none.
        return self.scale * self.resistance(np.maximum(state.sinkage, 0.0), state)


@dataclass(frozen=True)
class Rankine(_Bulldozing):
    formula = "R = s b (g z^2 Kp / 2 + 2 c z sqrt(Kp)), Kp = tan^2(45 deg + phi/2)"
    source = "passive earth pressure of Rankine; for wheels Bekker 1956 (unverified)"

    def resistance(self, depth: Array, state: WheelState) -> Array:
        root = _passive_root(state.friction_angle)
        weight = 0.5 * self.unit_weight * depth**2 * root**2
        return np.asarray(state.width * (weight + 2.0 * state.cohesion * depth * root))


@dataclass(frozen=True)
class Cohesionless(_Bulldozing):
    formula = "R = s b g z^2 Kp / 2, Kp = tan^2(45 deg + phi/2)"
    source = "passive earth pressure of Rankine without cohesion"

    scale: float = parameter(1.0, (0.0, 100.0), "factor on the published form")

    def resistance(self, depth: Array, state: WheelState) -> Array:
        passive = _passive_root(state.friction_angle) ** 2
        return np.asarray(state.width * 0.5 * self.unit_weight * depth**2 * passive)


def passes(conditions: Conditions) -> Array:
    """Pass number, 1 on fresh soil."""
    return np.maximum(conditions["pass_number"], 1.0)


class _Multipass(Effect):
    """Wheels that follow in a rut meet soil that others have changed.

    In the first forms sinkage is the depth of the rut below the untouched surface after pass N; in
    `Hardening` it is what that pass itself adds, in soil that the passes before have firmed (p > 0) or
    loosened (p < 0).
    """

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
class PassPower(_Multipass):
    form = "power"
    formula = "z = z1 N^p"
    source = "Abebe 1989 (unverified), p = 1/a: a 2 to 3 loose, 3 to 4 medium, 4 to 5 firm soil"

    p: float = parameter(
        0.3, (0.0, 2.0), "growth of ln rut depth with ln pass", published=(0.1, 0.6)
    )

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * passes(conditions) ** self.p)


@dataclass(frozen=True)
class Hardening(_Multipass):
    formula = "k = k1 N^p"
    source = "empirical; sinkage is that of the pass itself"

    p: float = parameter(0.2, (-3.0, 3.0), "growth of ln k with ln pass", published=(-1.5, 1.5))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(passes(conditions) ** self.p)


PartlyDugPassPower = partly_dug(PassPower)


class _ElasticRebound(Effect):
    """What the soil that rises gives back to the wheel is not modelled: no source was found for it.

    Seen only where a rut and the wheel's own sinkage are both measured: in one channel k absorbs it.
    """

    id = "elastic_rebound"
    summary = "Soil comes up again behind the wheel: the rut is shallower than the wheel was."
    next_step = "Measure both the depth of the rut behind the wheel and the wheel's own sinkage."


@dataclass(frozen=True)
class Compliance(_ElasticRebound):
    formula = "rut = z - W / (b sqrt(D z) ku), parameter 1 / ku"
    source = "linear unloading; ku 5 to 50 MPa/m (unverified)"

    compliance: float = parameter(
        5e-8, (0.0, 2e-6), "rise by pressure, 1 / ku", unit="m/Pa", published=(2e-8, 2e-7)
    )

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        d, plate = conditions.diameter, conditions.plate
        width = np.where(plate, d, conditions.width)
        area = width * np.sqrt(np.maximum(sinkage, 1e-6) * d)
        area = np.where(conditions.pressed, 2.0 * area, area)  # on both sides of its lowest point
        pressure = conditions.load / np.where(plate, np.pi / 4.0 * d**2, area)
        return np.asarray(sinkage - self.compliance * pressure)
