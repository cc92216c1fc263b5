"""hardpan: a firm layer below stops the wheel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class SmoothCap(Effect):
    id = "hardpan"
    form = "smooth cap"
    summary = "A firm layer below the loose soil limits sinkage."
    formula = "z = z0 / (1 + (h z0)^4)^(1/4), h = 1/depth of the layer"
    source = "smooth minimum of the sinkage and the layer's depth"
    stage = "sinkage"

    h: float = parameter(
        20.0, (0.0, 300.0), "inverse of the layer's depth", unit="1/m", published=(10.0, 200.0)
    )

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage / (1.0 + (self.h * sinkage) ** 4) ** 0.25)


@dataclass(frozen=True)
class PrestonThomas(SmoothCap):
    form = "preston-thomas"
    formula = "p = k z^n D^m * -ln(1 - h z)/(h z), h = 1/depth of the layer"
    source = "Preston-Thomas 1966: p = -km zm ln(1 - z/zm)"
    stage = "pressure_factor"

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        share = np.minimum(self.h * depth, 1.0 - 1e-12)
        safe = np.where(share > 1e-6, share, 0.5)
        return np.where(share > 1e-6, -np.log1p(-safe) / safe, 1.0 + share / 2.0)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage


Hardpan = SmoothCap
