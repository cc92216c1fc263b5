# SPDX-License-Identifier: Apache-2.0
"""The base of laws that `smallwheel learn` drafts.

A drafted law is a Python file with an effect, like one that a user writes. It names the table that it was
learnt from, by SHA-256, and the ranges of its settings.
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

VERSION = 1  # of drafted files: rises when an older file would be misread


def continued(function: Callable[[Array], Array], u: ArrayLike, low: float, high: float) -> Array:
    """Evaluate a function of a setting, continued as a straight line outside the measured range.

    The line is the tangent at the end of the range: nothing was measured outside, and this is the simplest
    assumption.

    Parameters
    ----------
    function
        Takes values of the setting within the range, shape (rows,), and returns the same shape.
    u
        Values of the setting, shape (rows,); NaN is passed on to the function.
    low, high
        Ends of the measured range, in the setting's unit.

    Returns
    -------
    ndarray
        Shape (rows,), in the function's unit.
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
    """Base of the effects that `smallwheel learn` writes as Python files (drafts of laws).

    Attributes
    ----------
    version
        Version of the format of these files.
    valid
        Lowest and highest value of each setting in the data that it was learnt from, by name, SI units.

    Raises
    ------
    EffectError
        On definition of a subclass of another version, or with a wrong `valid` or `learnt_from`.
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
        """A sentence on settings outside the ranges that the law was learnt from; empty if none is."""
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
