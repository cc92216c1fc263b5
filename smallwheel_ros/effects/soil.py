# SPDX-License-Identifier: Apache-2.0
"""What the soil answers with: its modulus under other loads, widths and speeds, and layers below.

load_dependent_modulus, width_dependent_modulus, penetration_rate, hardpan; beside them what load and
outline of the wheel it meets: slope, contact_geometry. Laws of its water content are in `column`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, WheelState, constant, parameter
from smallwheel_ros.physics.conditions import Conditions

_SLOWEST = 1e-3  # m/s: below, no law of rate has a meaning


class _LoadDependentModulus(Effect):
    """With sinkage alone exactly aliased with n and with a law of width.

    Resistance, or a plate test, tells them apart.
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
    form = "power"
    formula = "k = k0 (W / W0)^g"
    source = "empirical; Meirion-Griffith and Spenko 2011, fig. 3 (after Richter 2002) shows it"

    g: float = parameter(0.1, (-1.5, 1.5), "growth of ln k with ln load", published=(-0.3, 0.3))
    w0: float = constant(60.0, (1e-2, 1e5), "load at which k is k0", unit="N")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray((conditions.load / self.w0) ** self.g)


class _WidthDependentModulus(Effect):
    """Two-sided: published values of kc are negative, too."""

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
        # Of a round plate the radius is the width, as in Bekker's plate tests.
        width = np.where(conditions.plate, 0.5 * conditions.diameter, conditions.width)
        return np.maximum(1.0 + self.a * (self.b0 / width - 1.0), 0.02)


def _relative_speed(conditions: Conditions, v0: float) -> Array:
    return np.asarray(np.maximum(np.abs(conditions["speed"]), _SLOWEST) / v0)


class _PenetrationRate(Effect):
    """Over 0.01 to 0.5 m/s this is 0 to 8 % of the sinkage in sand: often less than data can show."""

    id = "penetration_rate"
    summary = "Soil that is loaded faster is stiffer: sinkage falls with speed."
    needs = ("speed",)
    next_step = "Drive at speeds a factor of ten or more apart, at one load and one slip."


@dataclass(frozen=True)
class SpeedPower(_PenetrationRate):
    form = "power"
    formula = "k = k0 (v / v0)^mu"
    source = "after Pope 1969, 1971 (unverified)"

    mu: float = parameter(0.05, (0.0, 0.8), "growth of ln k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.1, (1e-3, 10.0), "speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        return np.asarray(_relative_speed(conditions, self.v0) ** self.mu)


@dataclass(frozen=True)
class PenetrationSpeed(_PenetrationRate):
    formula = "p = k0 z^n D^m (v sqrt(z / D) / v0)^mu"
    source = "as the power law, driven by the speed at which the wheel enters the soil"

    mu: float = parameter(0.05, (0.0, 0.8), "growth of ln k with ln speed", published=(0.0, 0.15))
    v0: float = constant(0.03, (1e-4, 10.0), "entry speed at which k is k0", unit="m/s")

    def modulus_factor(self, conditions: Conditions) -> Array:
        entry = _relative_speed(conditions, self.v0) / np.sqrt(conditions["diameter"])
        return np.asarray(entry**self.mu)

    def exponent_shift(self, conditions: Conditions) -> float:
        return 0.5 * self.mu


class _Hardpan(Effect):
    id = "hardpan"
    summary = "A hard layer below: pressure rises faster with depth than a power law."
    next_step = "Press a plate to twice the wheel's sinkage, and repeat the runs on a deeper bed."


@dataclass(frozen=True)
class PrestonThomas(_Hardpan):
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
    formula = "p = k z^n D^m exp(c z)"
    source = "empirical: soil that firms steadily with depth"

    c: float = parameter(
        20.0, (0.0, 300.0), "growth of ln pressure with depth", unit="1/m", published=(3.0, 200.0)
    )

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        return np.asarray(np.exp(np.minimum(self.c * depth, 50.0)))


@dataclass(frozen=True)
class Gravity(Effect):
    """Known physics: a model applies it wherever the conditions have a slope."""

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
    """A rule, not a number: adding it to a model sets the model's geometry."""

    id = "contact_geometry"
    summary = "The wheel's true outline carries the load, not eq. 10's parabola and two terms."
    formula = "W = b r int p(z(theta)) cos(theta) d(theta), z = r (cos(theta) - cos(theta0))"
    source = "Bekker 1956; Wong 2008, ch. 2"
    channels = ("sinkage", "resistance", "drawbar_pull", "torque")
    stage = "geometry"
    next_step = "Compare both rules on the same data: smallwheel compare."
    geometry = "contact_integral"
