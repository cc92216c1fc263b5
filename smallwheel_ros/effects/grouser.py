"""grouser: lugs of height h dig where they slip, reach deeper, and pull more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, WheelState, parameter
from smallwheel_ros.effects.slip_sinkage import driven_slip
from smallwheel_ros.physics.conditions import Conditions

_LARGEST_SLIP = 0.95


@dataclass(frozen=True)
class _Grouser(Effect):
    id = "grouser"
    summary = "Grousers dig where they slip, reach deeper, and pull more."


@dataclass(frozen=True)
class Digging(_Grouser):
    formula = "z = z0 + a h i, i > 0"
    source = "empirical: soil carried away in proportion to height and slip"
    needs = ("slip", "grouser_height")

    a: float = parameter(1.0, (0.0, 20.0), "sinkage over height at slip 1", published=(0.0, 5.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage + self.a * conditions["grouser_height"] * driven_slip(conditions)


@dataclass(frozen=True)
class LugDigging(_Grouser):
    formula = "z = z0 + a h i / (1 - i), i > 0 (i up to 0.95)"
    source = "Reece 1965-66 with a = 1 (unverified)"
    needs = ("slip", "grouser_height")

    a: float = parameter(0.5, (0.0, 20.0), "strength; Reece's law is 1", published=(0.0, 3.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        i = np.minimum(driven_slip(conditions), _LARGEST_SLIP)
        return np.asarray(sinkage + self.a * conditions["grouser_height"] * i / (1.0 - i))


@dataclass(frozen=True)
class EffectiveRadius(_Grouser):
    formula = "r = r0 + lambda h"
    source = "usual in rover models: the soil between lugs moves with the wheel (unverified)"
    needs = ("grouser_height",)

    share: float = parameter(
        0.5, (-1.0, 2.0), "share lambda of the height that adds to the radius", published=(0.0, 1.0)
    )

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        return diameter + 2.0 * self.share * conditions["grouser_height"]


@dataclass(frozen=True)
class Traction(_Grouser):
    formula = "H = H0 (1 + a h / b)"
    source = "Bekker 1956: 2 h/b on the cohesive part of a track's thrust (unverified)"
    needs = ("grouser_height",)

    a: float = parameter(1.0, (0.0, 10.0), "growth of thrust with h/b", published=(0.0, 2.0))

    def thrust_factor(self, state: WheelState, conditions: Conditions) -> Array:
        return 1.0 + self.a * conditions["grouser_height"] / state.width
