# SPDX-License-Identifier: Apache-2.0
"""Resistance over load against sqrt(sinkage / diameter): a check that is free of k and m."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.physics.conditions import ROLLING, Array
from smallwheel_ros.physics.contact import shape_integral

_EXPONENTS = (0.5, 1.0, 1.5)
_POINTS = 60


@dataclass(frozen=True)
class ResistanceRatio:
    """Measured resistance over load, and the same by compaction alone, which does not depend on k and m.

    Attributes
    ----------
    rows
        Indices of the table's rows that are shown, shape (points,).
    x, y
        sqrt(sinkage / diameter) and resistance over load of these rows, pure numbers, shape (points,).
    soil
        Name of each row's soil, shape (points,).
    line_x, lines
        x of the lines of compaction, shape (x,); y of the line for each n (0.5, 1 and 1.5), shape (x,).
    """

    rows: NDArray[np.intp]
    x: Array
    y: Array
    soil: NDArray[np.str_]
    line_x: Array
    lines: Mapping[float, Array]


def resistance_ratio(measurements: Measurements) -> ResistanceRatio | None:
    """Compare rolling wheels' resistance with that of compaction alone; None if no row has it and sinkage."""
    if not {"sinkage", "resistance"} <= set(measurements.channels):
        return None
    conditions = measurements.conditions
    z, resistance = measurements.channels["sinkage"], measurements.channels["resistance"]
    used = np.isfinite(z) & np.isfinite(resistance) & (conditions.contact == ROLLING) & (z > 0)
    rows = np.flatnonzero(used & ~measurements.sunk_to_axle)
    if not rows.size:
        return None
    ratio = z[rows] / conditions.diameter[rows]
    epsilon = np.linspace(1e-6, min(0.5, 1.15 * float(ratio.max())), _POINTS)
    lines = {
        n: np.sqrt(epsilon) / ((n + 1.0) * shape_integral(n, epsilon).value) for n in _EXPONENTS
    }
    return ResistanceRatio(
        rows,
        np.sqrt(ratio),
        resistance[rows] / conditions.load[rows],
        measurements.soil[rows],
        np.sqrt(epsilon),
        lines,
    )
