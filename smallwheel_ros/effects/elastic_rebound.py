"""elastic_rebound: the rut springs back behind the wheel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class Rebound(Effect):
    id = "elastic_rebound"
    form = "linear"
    summary = "The soil springs back: the rut left behind is shallower than the wheel sank."
    formula = "z_r = z - u p, p = W / (b sqrt(D z)), u = 1/ku"
    source = "linear unloading; ku 5 to 50 MPa/m"
    channels = ("sinkage",)
    stage = "measured_sinkage"

    u: float = parameter(
        5e-8, (-1e-6, 1e-6), "compliance of unloading", unit="m/Pa", published=(2e-8, 2e-7)
    )

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        length = np.sqrt(conditions.diameter * np.maximum(sinkage, 1e-6))
        rebound = self.u * conditions.load / (conditions.width * length)
        return np.where(conditions.contact == "rolling", sinkage - rebound, sinkage)


ElasticRebound = Rebound
