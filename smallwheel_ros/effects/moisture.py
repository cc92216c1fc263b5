# SPDX-License-Identifier: Apache-2.0
"""moisture: the soil's modulus depends on its water content.

A covariate of the run rather than the row: it takes at least 8 runs with different values.
"""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import constant, parameter
from smallwheel_ros.effects.column_law import ExponentialLaw, PowerLaw

_NEXT_STEP = "Prepare beds of at least three water contents and run each at one load and one slip."


@dataclass(frozen=True)
class Exponential(ExponentialLaw):
    id = "moisture"
    form = "exponential"
    summary = "The soil's modulus k depends on its water content."
    formula = "k = k0 exp(a (w - reference) / scale)"
    source = "empirical"
    needs = ("moisture",)
    next_step = _NEXT_STEP

    a: float = parameter(0.2, (-6.0, 6.0), "growth of ln k over one scale of moisture")
    reference: float = constant(0.10, (-1e6, 1e6), "moisture at which k is k0")
    scale: float = constant(0.05, (1e-12, 1e6), "difference in moisture that changes ln k by a")


@dataclass(frozen=True)
class Power(PowerLaw):
    id = "moisture"
    form = "power"
    summary = "The soil's modulus k depends on its water content."
    needs = ("moisture",)
    next_step = _NEXT_STEP

    p: float = parameter(0.2, (-30.0, 30.0), "growth of ln k with ln moisture")
    reference: float = constant(0.10, (1e-12, 1e6), "moisture at which k is k0")
