# SPDX-License-Identifier: Apache-2.0
"""Pull and torque: what they are measured by, what their law is off by, and what to say of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting import constants
from smallwheel_ros.measurements.display import percent
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

_FURTHEST = 0.95  # |slip| up to which the law is held to be so good: a locked wheel is another case
_FAR_OFF = 2.0  # of what the law is usually off by, from which it is wrong where it was measured


def of_load(conditions: Conditions, channel: str) -> Array:
    """What a pull (N) is measured by, the load, and a torque (N m), the load times the radius, (rows,)."""
    return conditions.load * (0.5 * conditions.diameter if channel == "torque" else 1.0)


def wheel_discrepancy(conditions: Conditions) -> Array:
    """What the law of pull and torque is off by for a wheel at all slips, of the load, shape (rows,)."""
    if "grouser_height" not in conditions:
        return np.full(len(conditions), constants.FORCE_WHEEL)
    high = conditions["grouser_height"] >= 0.05 * conditions.diameter
    return np.where(high, constants.FORCE_LUGS, constants.FORCE_WHEEL)


def off_by(error: Array, conditions: Conditions, channel: str) -> tuple[str, bool]:
    """How far off pull or torque is, in words, and whether that is more than its law is known to.

    error: measured less predicted, shape (rows,), NaN where not measured.
    """
    share = error / of_load(conditions, channel)
    known = np.isfinite(error)
    beyond = known & (np.abs(conditions["slip"]) > _FURTHEST)
    if not (known & ~beyond).any():
        beyond = np.zeros_like(known)
    judged = known & ~beyond
    law = constants.FORCE_LAW**2 + wheel_discrepancy(conditions)[judged] ** 2
    usual, off = float(np.sqrt(np.mean(law))), _rms(share[judged])
    said = f"off by {percent(off)} of the load"
    if beyond.any():
        said += f" ({percent(_rms(share[beyond]))} at slips over {_FURTHEST:g})"
    if off <= _FAR_OFF * usual:
        return f"{said}, about what its law is known to ({percent(usual)})", False
    return (
        f"{said}, where its law is usually off by {percent(usual)}: look at its sign and zero, at the zero "
        "of sinkage, and at what else pulls"
    ), True


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
