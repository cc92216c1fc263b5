"""bulldozing: the wheel pushes a wedge of soil before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, WheelState, parameter

UNIT_WEIGHT = 15500.0  # N/m3, dry to moist sand; the fitted scale takes up the difference
FRICTION_ANGLE = np.radians(33.0)
COHESION = 500.0  # Pa
_PASSIVE = np.tan(np.pi / 4 + FRICTION_ANGLE / 2) ** 2


@dataclass(frozen=True)
class Rankine(Effect):
    id = "bulldozing"
    form = "rankine"
    summary = "The wheel pushes a wedge of soil before it, which adds resistance."
    formula = "R = s b (g z^2 Kp / 2 + 2 c z sqrt(Kp)), Kp = tan^2(45 deg + phi/2)"
    source = "passive earth pressure, Rankine (Bekker 1956); scale fitted: forms differ 10-fold"
    channels = ("resistance", "drawbar_pull")
    stage = "added_resistance"

    scale: float = parameter(1.0, (-1.0, 20.0), "scale of the nominal wedge", published=(0.0, 10.0))

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        z = state.sinkage
        wedge = 0.5 * UNIT_WEIGHT * z**2 * _PASSIVE + 2.0 * COHESION * z * np.sqrt(_PASSIVE)
        return np.asarray(self.scale * state.width * wedge)


@dataclass(frozen=True)
class Frictional(Rankine):
    form = "frictional"
    formula = "R = s b g z^2 Kp / 2 (no cohesion)"

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        return np.asarray(
            self.scale * state.width * 0.5 * UNIT_WEIGHT * state.sinkage**2 * _PASSIVE
        )


@dataclass(frozen=True)
class Hegedus(Rankine):
    form = "hegedus"
    formula = (
        "R = s b D1 (c z + D2 g z^2 / 2), D1 = cot X + tan(X + phi), "
        "D2 = cot X + cot^2 X / cot phi, X = 45 deg - phi/2"
    )
    source = "Hegedus blade (unverified); scale fitted"

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        x = np.pi / 4 - FRICTION_ANGLE / 2
        cot = 1.0 / np.tan(x)
        first = cot + np.tan(x + FRICTION_ANGLE)
        second = cot + cot**2 * np.tan(FRICTION_ANGLE)
        z = state.sinkage
        blade = COHESION * z + second * UNIT_WEIGHT * z**2 / 2.0
        return np.asarray(self.scale * state.width * first * blade)


Bulldozing = Rankine
