# SPDX-License-Identifier: Apache-2.0
"""elastic_rebound: soil comes up again behind the wheel; the rut is shallower than the wheel was.

What the soil that rises gives back to the wheel is not modelled: no source was found for it. Seen
only where a rut and the wheel's own sinkage are both measured: in one channel k absorbs it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions


def mean_pressure(sinkage: Array, conditions: Conditions) -> Array:
    """Load over the contact's area (Pa): b sqrt(D z) for a rolling wheel, twice that if pressed."""
    d, plate = conditions.diameter, conditions.plate
    width = np.where(plate, d, conditions.width)
    area = width * np.sqrt(np.maximum(sinkage, 1e-6) * d)
    area = np.where(conditions.pressed, 2.0 * area, area)
    return np.asarray(conditions.load / np.where(plate, np.pi / 4.0 * d**2, area))


@dataclass(frozen=True)
class _ElasticRebound(Effect):
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
        return sinkage - self.compliance * mean_pressure(sinkage, conditions)


@dataclass(frozen=True)
class Share(_ElasticRebound):
    formula = "rut = (1 - f) z"
    source = "empirical: a share of the depth comes back"
    same_as = "sinkage_gain"

    f: float = parameter(0.1, (0.0, 0.9), "share of the sinkage that comes back")

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 - self.f)
