# SPDX-License-Identifier: Apache-2.0
"""bulldozing: soil pushed ahead of the wheel resists; sinkage does not show it.

Cohesion and friction angle are those of the model's soil. Published forms differ 10 to 70 times at
the scale of a small wheel, so each has a scale that is fitted; Bekker's form of 1969, the largest,
is left out for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, WheelState, constant, parameter
from smallwheel_ros.physics.conditions import Conditions

_REFERENCE = 0.02  # m


def _passive_root(friction_angle: Array) -> Array:
    """sqrt(Kp) = tan(45 deg + phi/2), Kp the coefficient of passive earth pressure (Rankine)."""
    return np.asarray(np.tan(np.pi / 4.0 + friction_angle / 2.0))


@dataclass(frozen=True)
class _Bulldozing(Effect):
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
class Hegedus(_Bulldozing):
    formula = (
        "R = s b D1 (c z + D2 g z^2 / 2), D1 = cot X + tan(X + phi), "
        "D2 = cot X + cot^2 X / cot phi, X = 45 deg - phi/2"
    )
    source = "Hegedus 1960, bulldozing blade (unverified)"

    def resistance(self, depth: Array, state: WheelState) -> Array:
        phi = state.friction_angle
        x = np.pi / 4.0 - phi / 2.0
        d1 = 1.0 / np.tan(x) + np.tan(x + phi)
        d2 = 1.0 / np.tan(x) + np.tan(phi) / np.tan(x) ** 2
        weight = 0.5 * d2 * self.unit_weight * depth**2
        return np.asarray(state.width * d1 * (state.cohesion * depth + weight))


@dataclass(frozen=True)
class Cohesionless(_Bulldozing):
    formula = "R = s b g z^2 Kp / 2, Kp = tan^2(45 deg + phi/2)"
    source = "passive earth pressure of Rankine without cohesion"

    scale: float = parameter(1.0, (0.0, 100.0), "factor on the published form")

    def resistance(self, depth: Array, state: WheelState) -> Array:
        passive = _passive_root(state.friction_angle) ** 2
        return np.asarray(state.width * 0.5 * self.unit_weight * depth**2 * passive)


@dataclass(frozen=True)
class Power(_Bulldozing):
    formula = "R = s b g h0^2 Kp / 2 (z / h0)^p, h0 = 0.02 m, Kp = tan^2(45 deg + phi/2)"
    source = "empirical, between a wall of friction (p = 2) and one of cohesion (p = 1)"

    scale: float = parameter(1.0, (0.0, 100.0), "factor on the resistance at depth h0")
    p: float = parameter(1.5, (0.7, 3.0), "exponent of the depth", neutral=None)

    def resistance(self, depth: Array, state: WheelState) -> Array:
        passive = _passive_root(state.friction_angle) ** 2
        at_reference = 0.5 * self.unit_weight * _REFERENCE**2 * passive
        return np.asarray(state.width * at_reference * (depth / _REFERENCE) ** self.p)
