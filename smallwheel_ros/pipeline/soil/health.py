# SPDX-License-Identifier: Apache-2.0
"""Whether innovations of the soil's filter are as large as it expects."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from smallwheel_ros.pipeline.tables import Array

from .stretches import Stretches

_RECENT, _ENOUGH_STRETCHES = 100, 30  # newest stretches that count; least number to report anything
_MANY_LEFT_OUT = 0.2  # share of readings left out, above which it is reported
# Mean of squared normalised innovations above which, and below which, it is reported; 1 is right.
_TOO_SURE, _TOO_MODEST = 2.0, 0.15
_LARGEST = 25.0  # squares are limited to this: at a border some are huge until it is found


class FilterHealth:
    """Consistency of the newest 100 stretches: squared normalised innovations, and readings left out.

    With a right model and right noise parameters the mean of the squares is 1.
    """

    def __init__(self) -> None:
        self._squares: deque[float] = deque(maxlen=_RECENT)
        self._readings: deque[tuple[int, int]] = deque(maxlen=_RECENT)

    def add(self, rows: Stretches, squares: Array) -> None:
        """Add stretches.

        Parameters
        ----------
        rows
            The stretches, of which the numbers of readings are used.
        squares
            Their squared innovations over the variances, shape (rows,); NaN is left out.
        """
        self._readings.extend(zip(rows.count.tolist(), rows.dropped.tolist(), strict=True))
        self._squares.extend(np.minimum(squares[np.isfinite(squares)], _LARGEST).tolist())

    def forget(self) -> None:
        """Drop all stretches, since those before a border misfit the new soil."""
        self._squares.clear()
        self._readings.clear()

    @property
    def count(self) -> int:
        """Number of readings of sinkage in these stretches, those left out included."""
        return sum(map(sum, self._readings))

    @property
    def mean_square(self) -> float | None:
        """Mean of the squared normalised innovations; None where there is none."""
        return sum(self._squares) / len(self._squares) if self._squares else None

    @property
    def outlier_share(self) -> float:
        """Share of these readings that were left out, 0 to 1."""
        return sum(dropped for _, dropped in self._readings) / max(self.count, 1)

    @property
    def concern(self) -> str:
        """What is wrong, and its likely causes, in words; empty if nothing is."""
        mean = self.mean_square
        if len(self._readings) >= _ENOUGH_STRETCHES and self.outlier_share > _MANY_LEFT_OUT:
            return (
                f"{self.outlier_share:.0%} of the newest {self.count} sinkages do not fit: a sensor,"
                " or physics that the model lacks"
            )
        if mean is None or len(self._squares) < _ENOUGH_STRETCHES or not math.isfinite(mean):
            return ""
        if mean > _TOO_SURE:
            return (
                f"innovations are larger than they should be (mean square {mean:.1f}, expected 1):"
                " noise parameters too small, or physics that the model lacks"
            )
        if mean < _TOO_MODEST and len(self._squares) == self._squares.maxlen:
            return (
                f"innovations are smaller than they should be (mean square {mean:.2f}, expected 1):"
                " noise parameters too large, standard deviations too"
            )
        return ""
