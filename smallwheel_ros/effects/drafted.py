# SPDX-License-Identifier: Apache-2.0
"""The base of laws that `smallwheel learn` drafts.

A drafted law is a file of its own, an effect like any other user's. It stores the data that it was
learnt from and the range of that data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.effects.base import Effect, EffectError
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

VERSION = 1  # of drafted files: rises when an older one would mean something else


def continued(function: Callable[[Array], Array], u: ArrayLike, low: float, high: float) -> Array:
    """Evaluate a function of a driver, which continues as a straight line outside its measured range.

    The line is the tangent at the end of the range.

    Nothing was measured outside, and a straight line is the simplest assumption.

    Parameters
    ----------
    function
        Takes values of the driver, shape (rows,), and returns the same shape.
    u
        The driver's values, shape (rows,).
    low, high
        Ends of the measured range, in the driver's unit.
    """
    values = np.asarray(u, dtype=float)
    inside = np.clip(values, low, high)
    found = np.asarray(function(inside), dtype=float)
    if np.array_equal(inside, values, equal_nan=True):
        return found
    step = 1e-4 * (high - low)
    inward = np.where(values < low, step, -step)
    slope = (np.asarray(function(inside + inward)) - found) / inward
    return np.asarray(found + slope * (values - inside))


class Drafted(Effect):
    """Base of a drafted law.

    Attributes
    ----------
    version
        The format of its file.
    valid
        Range of the data that it was learnt from, by setting, SI units.
    """

    version: ClassVar[int] = 0
    valid: ClassVar[Mapping[str, tuple[float, float]]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.version != VERSION:
            raise EffectError(
                f"law '{cls.id}' is a file of version {cls.version!r}, expected {VERSION}: learn it "
                "again with `smallwheel learn`"
            )
        if not isinstance(cls.learnt_from, str):
            raise EffectError(
                f"law '{cls.id}': learnt_from is {cls.learnt_from!r}, expected the table's SHA-256"
            )
        if not isinstance(cls.valid, Mapping) or not all(map(_is_range, cls.valid.values())):
            raise EffectError(
                f"law '{cls.id}': valid is {cls.valid!r}, expected a lowest and a highest value for "
                'each setting, like {"slip": (0.0, 0.5)}'
            )

    def caution(self, conditions: Conditions) -> str:
        """Where these rows are outside the range that the law was learnt in; empty if they are not."""
        beyond = []
        for name, (low, high) in self.valid.items():
            if name not in conditions:
                continue
            room = 1e-6 * (high - low)
            values = conditions[name]
            outside = values[(values < low - room) | (values > high + room)]
            if outside.size:
                furthest = outside[np.argmax(np.maximum(low - outside, outside - high))]
                beyond.append(f"{name} {furthest:.3g} (learnt from {low:.3g} to {high:.3g})")
        if not beyond:
            return ""
        return (
            f"{self.id} is used beyond where it was learnt: {', '.join(beyond)}; it goes on in a "
            "straight line there, and that is a guess"
        )


def _is_range(given: Any) -> bool:
    try:
        low, high = given
        return math.isfinite(low) and math.isfinite(high) and low <= high
    except (TypeError, ValueError):
        return False
