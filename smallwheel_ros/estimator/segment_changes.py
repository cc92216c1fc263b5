# SPDX-License-Identifier: Apache-2.0
"""Changes of ln sinkage from segment to segment of each wheel: what the watch for effects looks at."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.physics.conditions import ROLLING, Conditions

Array = NDArray[np.float64]

_LEAST_SINKAGE = 2e-4  # m: the logarithm of less is noise
_SCATTER = 0.04  # of ln sinkage from segment to segment, besides the instrument's noise


class Changes(NamedTuple):
    """All segments, and the pairs of neighbours among them.

    log_sinkage: ln m, shape (segments,). wheels: the segments' loads, sizes, slip and speed, these two NaN
    where not known. later, earlier: indices of each pair, shape (pairs,); deviation: of the change in ln
    sinkage, known up to a factor common to all.
    """

    log_sinkage: Array
    wheels: Conditions
    later: NDArray[np.intp]
    earlier: NDArray[np.intp]
    deviation: Array

    def of(self, column: Array) -> Array:
        """Changes of a column of the segments, over their deviation; shape (pairs,)."""
        return (column[self.later] - column[self.earlier]) / self.deviation

    def where(self, usable: NDArray[np.bool_]) -> Changes:
        """Only some of the pairs, by a mask of shape (pairs,)."""
        later, earlier, deviation = self.later[usable], self.earlier[usable], self.deviation[usable]
        return self._replace(later=later, earlier=earlier, deviation=deviation)


class SegmentChanges:
    """Keeps the segments (of `length`, m) of the last `window` (m)."""

    def __init__(self, length: float, window: float) -> None:
        self._length, self._window = length, window
        self._kept: dict[str, deque[Segment]] = {}

    def add(self, segment: Segment) -> None:
        """Take a segment; one without measurable sinkage has no logarithm, and is left out."""
        if segment.sinkage < _LEAST_SINKAGE:
            return
        kept = self._kept.setdefault(segment.wheel, deque())
        kept.append(segment)
        while segment.distance - kept[0].distance > self._window:
            kept.popleft()

    def changes(self) -> Changes | None:
        """Give what is kept; None while there is nothing."""
        segments = [segment for kept in self._kept.values() for segment in kept]
        near = [
            i
            for i in range(1, len(segments))
            if segments[i].wheel == segments[i - 1].wheel
            # Over a gap the soil may be any other.
            and segments[i].distance - segments[i - 1].distance < 4.0 * self._length
        ]
        if not near:
            return None
        later = np.array(near, dtype=np.intp)
        earlier = later - 1
        names = ("sinkage", "variance", "load", "diameter", "width", "slip", "speed")
        rows = [[getattr(segment, name) for name in names] for segment in segments]
        # None becomes NaN
        sinkage, noise, load, diameter, width, slip, speed = np.array(rows, dtype=float).T
        rolling = np.broadcast_to(np.array(ROLLING), sinkage.shape)
        covariates = {"slip": slip, "speed": speed}
        wheels = Conditions(load, diameter, width, rolling, None, covariates)
        variance = noise / sinkage**2
        deviation = np.sqrt(variance[later] + variance[earlier] + _SCATTER**2)
        return Changes(np.log(sinkage), wheels, later, earlier, deviation)
