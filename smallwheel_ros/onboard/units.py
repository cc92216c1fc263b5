# SPDX-License-Identifier: Apache-2.0
"""Which wrong unit would make a quantity so many times too large."""

from __future__ import annotations

import math

# What a number in this unit is over the same in SI units.
_UNITS = {
    "load": {"kg": 1.0 / 9.80665, "kN": 1e-3, "lbf": 0.224809, "mN": 1e3},
    "sinkage": {"mm": 1e3, "cm": 1e2, "inches": 39.3701, "um": 1e6},
    "speed": {"mm/s": 1e3, "cm/s": 1e2, "km/h": 3.6},
    "wheel_speed": {"degrees/s": 57.2958, "rpm": 9.5493, "turns/s": 0.159155},
}


def unit_of(ratio: float, quantity: str, factor: float = 1.05) -> tuple[float, str] | None:
    """What a unit is over that of SI, and its name, where it explains a ratio within a factor.

    quantity: as streams are called.
    """
    units = _UNITS.get(quantity, {})
    if not units or not ratio > 0.0:
        return None
    name, value = min(units.items(), key=lambda unit: abs(math.log(ratio / unit[1])))
    return (value, name) if abs(math.log(ratio / value)) <= math.log(factor) else None
