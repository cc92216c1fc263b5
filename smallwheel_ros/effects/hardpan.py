# SPDX-License-Identifier: Apache-2.0
"""hardpan: a hard layer below makes pressure rise faster than the power law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


@dataclass(frozen=True)
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
