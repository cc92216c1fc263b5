# SPDX-License-Identifier: Apache-2.0
"""Effects of soil and wheel: stiffness by load, width, speed and layers, and what the wheel does to the soil.

load_dependent_modulus, width_dependent_modulus, penetration_rate, hardpan; bulldozing (soil that the wheel
pushes ahead), multipass (soil that earlier wheels pressed), elastic_rebound (soil that rises after the
wheel); slope (the part of the load that presses on the soil), contact_geometry (the outline that carries it).
Water content is in `column_laws`.
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

_SLOWEST = 1e-3  # m/s: at lower speeds no law of rate has a meaning


class _LoadDependentModulus(Effect):
    """k that depends on the load.

    From sinkage alone it cannot be told from another n or from k that depends on the width; resistance, or a
    plate test, tells them apart.
    """

    id = "load_dependent_modulus"
    summary = "The soil's modulus k depends on the load."
    drivers = ("load",)
    next_step = (
        "Measure the towing force as well as the sinkage, over loads a factor of three apart; or press "
        "plates of one diameter into the same soil."
    )


@dataclass(frozen=True)
class LoadPower(_LoadDependentModulus):
    """k that is proportional to a power of the load W."""

    form = "power"
    formula = "k = k0 (W / W0)^g"
    source = "empirical; Meirion-Griffith and Spenko 2011, fig. 3 (after Richter 2002) shows it"

    g: float = parameter(0.1, (-1.5, 1.5), "growth of ln k with ln load", published=(-0.3, 0.3))
    w0: float = constant(60.0, (1e-2, 1e5), "load at which k is k0", unit="N")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray((conditions.load / self.w0) ** self.g)


class _WidthDependentModulus(Effect):
    """k that depends on the width, in either direction: published values of kc are negative, too."""

    id = "width_dependent_modulus"
    summary = "The soil's modulus k depends on the wheel's width."
    drivers = ("width",)
    next_step = "Run wheels of one diameter and two widths or more, at the same loads."


@dataclass(frozen=True)
class Bekker(_WidthDependentModulus):
    """Bekker's modulus kc/b + kphi, in terms of its value at a reference width b0."""

    formula = "k = k0 (1 - a + a b0 / b): kc/b + kphi with a = (kc/b0) / (kc/b0 + kphi)"
    source = "Bekker 1956 (eq. 5 of Meirion-Griffith and Spenko 2011)"

    a: float = parameter(
        0.2, (-2.0, 2.0), "share of kc/b in the modulus at width b0", published=(-0.5, 0.5)
    )
    b0: float = constant(0.1, (1e-3, 10.0), "width at which k is k0", unit="m")

    def modulus_factor(self, conditions: Conditions) -> Array:
        # Of a round plate the radius is the width, as in Bekker's plate tests.
        width = np.where(conditions.plate, 0.5 * conditions.diameter, conditions.width)
        return np.maximum(1.0 + self.a * (self.b0 / width - 1.0), 0.02)


class _PenetrationRate(Effect):
    """k that grows with speed.

    From 0.01 to 0.5 m/s the sinkage in sand changes by 0 to 8 %, often less than data can show.
    """

    id = "penetration_rate"
    summary = "Soil that is loaded faster is stiffer: sinkage falls with speed."
    needs = ("speed",)
    next_step = "Drive at speeds a factor of ten or more apart, at one load and one slip."


@dataclass(frozen=True)
class SpeedPower(_PenetrationRate):
    """k that is proportional to a power of the speed of travel v."""

    form = "power"
    formula = "k = k0 (v / v0)^mu"
    source = "after Pope 1969, 1971 (unverified)"

    mu: float = parameter(0.05, (0.0, 0.8), "growth of ln k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.1, (1e-3, 10.0), "speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        speed = np.maximum(np.abs(conditions["speed"]), _SLOWEST)
        return np.asarray((speed / self.v0) ** self.mu)


@dataclass(frozen=True)
class PenetrationSpeed(_PenetrationRate):
    """k that is proportional to a power of the vertical speed at which the rim enters the soil."""

    formula = "p = k0 z^n D^m (v sqrt(z / D) / v0)^mu"
    source = "as the power law, driven by the speed at which the wheel enters the soil"

    mu: float = parameter(0.05, (0.0, 0.8), "growth of ln k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.03, (1e-4, 10.0), "entry speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        speed = np.maximum(np.abs(conditions["speed"]), _SLOWEST)
        entry = speed / np.sqrt(conditions["diameter"])
        return np.asarray((entry / self.v0) ** self.mu)

    def exponent_shift(self, conditions: Conditions) -> float:
        return 0.5 * self.mu


class _Hardpan(Effect):
    id = "hardpan"
    summary = "A hard layer below: pressure rises faster with depth than a power law."
    next_step = "Press a plate to twice the wheel's sinkage, and repeat the runs on a deeper bed."


@dataclass(frozen=True)
class PrestonThomas(_Hardpan):
    """Pressure that rises without bound towards a rigid layer at depth 1/c."""

    formula = "p = k z^n D^m (-ln(1 - c z) / (c z)), c = 1 / (depth of the layer)"
    source = "Preston-Thomas: p = -km zm ln(1 - z/zm) (unverified), as a factor on the power law"

    c: float = parameter(
        20.0, (0.0, 300.0), "inverse of the layer's depth", unit="1/m", published=(10.0, 200.0)
    )

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        x = np.minimum(self.c * depth, 1.0 - 1e-9)
        safe = np.where(x > 1e-5, x, 0.5)  # below, the quotient loses its digits
        return np.where(x > 1e-5, -np.log1p(-safe) / safe, 1.0 + x / 2.0 + x**2 / 3.0)


@dataclass(frozen=True)
class TwoLayer(_Hardpan):
    """A soil whose stiffness changes smoothly, about depth h, from an upper to a lower layer."""

    formula = "p = k z^n D^m (1 + s z^2 / (z^2 + h^2))"
    source = "two layers with a smooth change over the depth h"

    s: float = parameter(5.0, (0.0, 1000.0), "how much stiffer the lower layer is")
    h: float = parameter(
        0.03, (0.003, 0.3), "depth of the change", unit="m", published=(0.005, 0.1), neutral=None
    )

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        square = depth**2
        return np.asarray(1.0 + self.s * square / (square + self.h**2))


@dataclass(frozen=True)
class Exponential(_Hardpan):
    """A soil that gets firmer exponentially with depth."""

    formula = "p = k z^n D^m exp(c z)"
    source = "empirical: soil that firms steadily with depth"

    c: float = parameter(
        20.0, (0.0, 300.0), "growth of ln pressure with depth", unit="1/m", published=(3.0, 200.0)
    )

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        return np.asarray(np.exp(np.minimum(self.c * depth, 50.0)))


@dataclass(frozen=True)
class _Bulldozing(Effect):
    """Resistance of soil pushed ahead, with cohesion and friction angle of the model's soil.

    For a small wheel published forms differ by a factor of 10 to 70, so each has a scale that is fitted;
    Bekker's form of 1969, which gives the largest resistance, is left out.
    """

    id = "bulldozing"
    summary = "Soil pushed ahead of the wheel adds resistance; sinkage does not show it."
    next_step = (
        "Measure the towing force of the undriven wheel as well as its sinkage, at two widths."
    )

    scale: float = parameter(1.0, (0.0, 10.0), "factor on the published form")
    # Dry to moist sand: 14 to 17 kN/m^3. What is fitted is the scale, so its error goes there.
    unit_weight: float = constant(15.5e3, (1e3, 30e3), "weight of the soil", unit="N/m^3")


@dataclass(frozen=True)
class Rankine(_Bulldozing):
    """Rankine's passive earth pressure on soil of unit weight g, from its weight and its cohesion c."""

    formula = "R = s b (g z^2 Kp / 2 + 2 c z sqrt(Kp)), Kp = tan^2(45 deg + phi/2)"
    source = "passive earth pressure of Rankine; for wheels Bekker 1956 (unverified)"

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        root = np.tan(np.pi / 4.0 + state.friction_angle / 2.0)
        depth = np.maximum(state.sinkage, 0.0)  # what an effect lifts out of the soil pushes none
        weight = 0.5 * self.unit_weight * depth**2 * root**2
        pushed = state.width * (weight + 2.0 * state.cohesion * depth * root)
        return np.asarray(self.scale * pushed)


@dataclass(frozen=True)
class Cohesionless(_Bulldozing):
    """Rankine's passive earth pressure on soil of unit weight g, from its weight alone."""

    formula = "R = s b g z^2 Kp / 2, Kp = tan^2(45 deg + phi/2)"
    source = "passive earth pressure of Rankine without cohesion"

    scale: float = parameter(1.0, (0.0, 100.0), "factor on the published form")

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        passive = np.tan(np.pi / 4.0 + state.friction_angle / 2.0) ** 2
        depth = np.maximum(state.sinkage, 0.0)
        weight = 0.5 * self.unit_weight * depth**2 * passive
        return np.asarray(self.scale * state.width * weight)


class _Multipass(Effect):
    """Wheels that follow in a rut meet soil that earlier passes have changed.

    In `PassPower` sinkage is the depth of the rut below the untouched surface after pass N; in `Hardening` it
    is what that pass itself adds, in soil that the passes before have firmed (p > 0) or loosened (p < 0).
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
    """Depth of the rut that is proportional to a power of the pass number N."""

    form = "power"
    formula = "z = z1 N^p"
    source = "Abebe 1989 (unverified), p = 1/a: a 2 to 3 loose, 3 to 4 medium, 4 to 5 firm soil"

    p: float = parameter(
        0.3, (0.0, 2.0), "growth of ln rut depth with ln pass", published=(0.1, 0.6)
    )

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * np.maximum(conditions["pass_number"], 1.0) ** self.p)


@dataclass(frozen=True)
class Hardening(_Multipass):
    """k that is proportional to a power of the pass number N."""

    formula = "k = k1 N^p"
    source = "empirical; sinkage is that of the pass itself"

    p: float = parameter(0.2, (-3.0, 3.0), "growth of ln k with ln pass", published=(-1.5, 1.5))

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(np.maximum(conditions["pass_number"], 1.0) ** self.p)


PartlyDugPassPower = partly_dug(PassPower)


class _ElasticRebound(Effect):
    """Soil that rises after the wheel, so that the measured rut is shallower than the wheel's sinkage.

    The force of that soil on the wheel is not modelled: no source was found for it. The effect can be found
    only where rut and sinkage are both measured; otherwise another k describes the data as well.
    """

    id = "elastic_rebound"
    summary = "Soil comes up again behind the wheel: the rut is shallower than the wheel was."
    next_step = "Measure both the depth of the rut behind the wheel and the wheel's own sinkage."


@dataclass(frozen=True)
class Compliance(_ElasticRebound):
    """A rut that rises after the wheel in proportion to the mean pressure under it."""

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


@dataclass(frozen=True)
class Gravity(Effect):
    """Gravity on a slope, which every model applies if the conditions have a slope."""

    id = "slope"
    summary = "On a slope, W cos(slope) presses on the soil and W sin(slope) adds to resistance."
    formula = "normal load = W cos(slope); R = R0 + W sin(slope), slope > 0 uphill"
    source = "statics"
    needs = ("slope",)
    idle = "no row is on a slope"
    known_physics = True
    next_step = "Measure the slope of the bed with an inclinometer and give it as a column 'slope'."

    def objection(self, conditions: Conditions) -> str:
        slope = np.abs(conditions["slope"])
        steep = np.flatnonzero(slope >= np.pi / 2)
        if steep.size:
            return (
                f"slope in row {steep[0] + 1} is {conditions['slope'][steep[0]]:.4g} rad, "
                "expected between -pi/2 and pi/2"
            )
        return ""

    def normal_load(self, load: Array, conditions: Conditions) -> Array:
        return np.asarray(load * np.cos(conditions["slope"]))

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        return np.asarray(conditions.load * np.sin(conditions["slope"]))


@dataclass(frozen=True)
class ContactIntegral(Effect):
    """The contact integral as an effect: adding it to a model sets the model's geometry."""

    id = "contact_geometry"
    summary = "The wheel's true outline carries the load, not eq. 10's parabola and two terms."
    formula = "W = b r int p(z(theta)) cos(theta) d(theta), z = r (cos(theta) - cos(theta0))"
    source = "Bekker 1956; Wong 2008, ch. 2"
    channels = ("sinkage", "resistance", "drawbar_pull", "torque")
    stage = "geometry"
    next_step = "Compare both rules on the same data: smallwheel compare."
    geometry = "contact_integral"
