# SPDX-License-Identifier: Apache-2.0
"""A log-log regression of what was measured on the settings: no physics, and what any law has to beat.

    ln value = own of its soil + b . (ln load, ln diameter, ln width, slip, slip^2, pass, speed)

by least squares, of the settings that were varied. It is the size of each value (`noise.levels_of`) and a
row of `smallwheel compare`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_VALUES_A_COLUMN = 2  # at least: a line with fewer would follow single values
_VARIED = 1e-6  # range of a column, below which it was not varied


def _columns(conditions: Conditions) -> Array:
    """What a value may depend on, the most likely first, shape (rows, columns); NaN of what has no logarithm.

    A plate has no width.
    """
    sizes = [conditions[name] for name in ("load", "diameter", "width")]
    columns = [np.log(np.where(size > 0.0, size, np.nan)) for size in sizes]
    for name in ("slip", "pass_number", "speed"):
        if name in conditions:
            column = conditions[name]
            columns += [column, column**2] if name == "slip" else [column]
    return np.column_stack(columns)


@dataclass(frozen=True)
class Line:
    """A fitted regression. own: ln value of each soil at zero. used: columns, slopes: of each."""

    soils: tuple[str, ...]
    own: Array
    used: Index
    slopes: Array

    @classmethod
    def through(cls, value: Array, row: Index, conditions: Conditions) -> Line:
        """Fit it. value: positive, at a row of the conditions each, shape (values,)."""
        columns = _columns(conditions)
        known = np.isfinite(columns).all(axis=0)
        columns = columns[row]
        varied = np.flatnonzero(known & (np.ptp(np.where(known, columns, 0.0), axis=0) > _VARIED))
        named = conditions.soil
        mine = np.full(row.size, "") if named is None else named[row]
        soils, code = np.unique(mine, return_inverse=True)
        used = varied[: max(value.size // _VALUES_A_COLUMN - len(soils), 0)]
        line = np.hstack([np.eye(len(soils))[code.reshape(-1)], columns[:, used]])
        # Of small values the logarithm is uncertain, and their size matters least.
        weight = np.sqrt(np.minimum(value / np.median(value), 1.0))[:, None]
        target = np.log(value)[:, None] * weight
        found = np.linalg.lstsq(line * weight, target, rcond=1e-8)[0][:, 0]
        return cls(tuple(soils.tolist()), found[: len(soils)], used, found[len(soils) :])

    def at(self, conditions: Conditions) -> Array:
        """The value there, shape (rows,); in a soil that it never met, that of the middle of its own."""
        own = np.full(len(conditions), self.own.mean())
        if conditions.soil is not None:
            for name, level in zip(self.soils, self.own, strict=True):
                own[conditions.soil == name] = level
        return np.asarray(np.exp(own + _columns(conditions)[:, self.used] @ self.slopes))
