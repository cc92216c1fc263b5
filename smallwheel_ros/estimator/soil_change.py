# SPDX-License-Identifier: Apache-2.0
"""Is this another soil? Judged on the mean of several segments, abrupt or gradual.

Where the soil ends, all that comes after it is off by one and the same factor of k. Segments wait for
0.6 m before they are used for the soil. With each that comes, those of leading wheels (no other runs
ahead of them) that are furthest along the way are compared with the law, for each border that there
may be: the shift of ln k that explains them best, over its standard deviation,

    shift = sum(nu / by / v) / sum(1 / v),   v = var(nu by segment alone) / by^2
    variance = alike(rows) / sum(1 / v) + H P H / by^2

alike: how much more the mean of neighbours varies than that of independent ones, by the exponential
correlation over the segment's length.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.law_filter import LawFilter
from smallwheel_ros.estimator.law_model import Shown
from smallwheel_ros.estimator.scatter import Innovation
from smallwheel_ros.estimator.segment import Segment

Array = NDArray[np.float64]

WAIT = 3.0  # segment lengths that a segment waits: the rows that are looked at
_MOST = 8  # segments of a wheel that wait: one that turns on the spot travels, the vehicle does not
_SETTLED = 20  # segments of a soil before another is looked for
_LEAST_SHIFT = math.log(1.25)  # of ln k: less is the soil's own drift
# 24 tests a metre with four wheels: one false alarm in 1000 m at 4.75 for sums of many rows, whose
# errors are near normal; one row alone has the tails of single places.
_LEAST_SIGMA, _ONE_ROW = 4.75, 1.5
_SHARE = 0.3  # of the shift that each wheel shows: else it is that wheel or its sensor
_WILD = 5.0  # deviations to which an innovation is cut


@dataclass(frozen=True)
class Waiting:
    """A segment that waits, and what it should show, as linearised when it came."""

    segment: Segment
    about: tuple[Array, Shown]


@dataclass(frozen=True)
class Shift:
    """A change of ln k from `place` (m along the vehicle's path) on, and how sure it is."""

    place: float
    size: float
    sigma: float


class ChangeTest:
    """Holds segments back, and finds a change among them. length: m, of a segment."""

    def __init__(self, length: float) -> None:
        self._length = length
        self.waiting: deque[Waiting] = deque()

    def drop_stuck(self, wheel: str) -> None:
        """Forget the waiting segments of a sensor that turns out to be stuck."""
        self.waiting = deque(one for one in self.waiting if one.segment.wheel != wheel)

    def ready(self, distance: float) -> list[Waiting]:
        """Take out what has waited long enough at this travel (m)."""
        found = []
        counts = Counter(one.segment.wheel for one in self.waiting)
        while self.waiting:
            first = self.waiting[0].segment
            waited = first.distance < distance - WAIT * self._length
            if not waited and counts[first.wheel] <= _MOST:
                break
            counts[first.wheel] -= 1
            found.append(self.waiting.popleft())
        return found

    def find(self, law: LawFilter) -> Shift | None:
        """Look for a border: everything ahead of it is off by one factor of k."""
        if law.used < _SETTLED:
            return None
        rows = sorted(
            (one for one in self.waiting if one.segment.position.leads),
            key=lambda one: -one.segment.place,
        )
        best: Shift | None = None
        total = weights = state = 0.0
        wheels: dict[str, list[float]] = {}
        for one in rows:
            found = law.innovation(one.segment, one.about)
            if not found.by_load > 0.0:
                return best
            shift = -_cut(found) / found.by_load
            weight = found.by_load**2 / (found.variance - found.state_variance)
            total += weight * shift
            weights += weight
            state = max(state, found.state_variance / found.by_load**2)
            wheels.setdefault(one.segment.wheel, []).append(shift)
            most = max(map(len, wheels.values()))
            size = total / weights
            sigma = abs(size) / math.sqrt(_alike(most) / weights + state)
            if abs(size) < _LEAST_SHIFT or sigma < _LEAST_SIGMA + (_ONE_ROW if most == 1 else 0.0):
                continue
            if self._agree(wheels, size) and (best is None or sigma > best.sigma):
                best = Shift(one.segment.place, size, sigma)
        return best

    def _agree(self, wheels: dict[str, list[float]], size: float) -> bool:
        """Whether every wheel that is ahead of the border shows it; two at least, where there are."""
        leading = {one.segment.wheel for one in self.waiting if one.segment.position.leads}
        if len(wheels) < min(2, len(leading)):
            return False
        return all(sum(shifts) / len(shifts) / size > _SHARE for shifts in wheels.values())


def _cut(found: Innovation) -> float:
    most = _WILD * math.sqrt(found.variance)
    return min(max(found.value, -most), most)


def _alike(lengths: int) -> float:
    """Variance of the mean over so many lengths, over that of independent single lengths."""

    def mean_variance(u: float) -> float:
        return 2.0 / u**2 * (u - 1.0 + math.exp(-u))

    return lengths * mean_variance(float(lengths)) / mean_variance(1.0)
