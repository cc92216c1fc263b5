# SPDX-License-Identifier: Apache-2.0
"""How much segments differ by beyond the state and the sensors, learnt from the innovations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.law_model import Shown
from smallwheel_ros.estimator.segment import Segment

Array = NDArray[np.float64]

_MODEL_ERROR = 0.02  # of sinkage: the law against the public single-wheel rig, within one soil
LARGEST = 9.0  # a squared innovation counts at most as so many of its variances


class Innovation(NamedTuple):
    """Shown less expected (m), and variances (m^2): by the state, in all, and of sensors and law alone.

    by_load: slope of what is shown by ln load.
    """

    value: float
    state_variance: float
    variance: float
    base: float
    by_load: float


class Scatter:
    """What segments differ by beyond state and sensors, learnt from innovations.

    A regression of nu^2 - H P H - base on (1, by^2 share): `additive` (m^2) and `soil`, the variance
    of ln k at a place. `share`: of that, what is left in a segment's mean.
    """

    _MEMORY = 150.0  # segments
    _TOLD = 30.0  # segments that what is told of the soil's scatter counts for

    def __init__(self, soil_scatter: float) -> None:
        self._told = soil_scatter**2
        self.additive, self.soil = 0.0, soil_scatter**2
        # Mean over a segment as long as the correlation length of an Ornstein-Uhlenbeck process:
        # its variance, and that of many such means together, over the variance at a point.
        self.share = 2.0 * math.exp(-1.0)
        self.together = 2.0
        self._normal: Array = np.zeros((2, 2))
        self._moment: Array = np.zeros(2)
        self._alike: dict[str, float] = {}
        self._products = np.array([0.0, 1.0])  # of neighbours, and squares

    def noise(self, segment: Segment, shown: Shown) -> tuple[float, float, float]:
        """Variance of a segment alone, of it as it counts among its neighbours, and its base.

        Base: of sensors and law.
        """
        by_load = shown.by_load**2
        base = (
            segment.variance
            + by_load * segment.log_load_variance
            + (_MODEL_ERROR * shown.value) ** 2
            + shown.doubt
        )
        soil = by_load * self.soil
        alone = base + self.share * soil + self.additive
        counts = base + self.together * soil + self.additive_together * self.additive
        return alone, counts, base

    def at_a_place(self, segment: Segment, shown: Shown) -> float:
        """Variance of the sinkage at one place (m^2) by soil, load and what the law misses.

        Whether what is left over is the ground's or the sensor's nobody knows: it counts as the ground's, and
        varies more at a point than in the mean over a segment.
        """
        by_place = shown.by_load**2 * (self.soil + segment.log_load_variance)
        return (
            by_place + (_MODEL_ERROR * shown.value) ** 2 + shown.doubt + self.additive / self.share
        )

    def learn(self, innovation: Innovation, wheel: str) -> None:
        """Take an innovation of a wheel."""
        size = innovation.variance
        square = min(innovation.value**2, LARGEST * size)
        weight = 1.0 / size**2
        features = np.array([1.0, innovation.by_load**2 * self.share])
        keep = 1.0 - 1.0 / self._MEMORY
        self._normal = keep * self._normal + weight * np.outer(features, features)
        excess = square - innovation.state_variance - innovation.base
        self._moment = keep * self._moment + weight * excess * features
        self._solve(weight * features[1] ** 2)
        before = self._alike.get(wheel, 0.0)
        now = innovation.value / math.sqrt(size)
        now = math.copysign(min(abs(now), 3.0), now)
        products = np.array([now * before, 0.5 * (now**2 + before**2)])
        self._products = keep * self._products + products
        # Where an update fails, a copy of this object is gone back to: it keeps its own mapping.
        self._alike = self._alike | {wheel: now}

    @property
    def additive_together(self) -> float:
        """How much more neighbouring errors of the sinkage count, being alike: (1+r)/(1-r)."""
        alike = min(max(self._products[0] / self._products[1], 0.0), 0.8)
        return float((1.0 + alike) / (1.0 - alike))

    def _solve(self, size: float) -> None:
        """Both variances at least 0; the told scatter is worth some segments of this size."""
        normal, moment = self._normal.copy(), self._moment.copy()
        told = self._TOLD * size
        normal[1, 1] += told
        moment[1] += told * self._told
        # No error of the sinkage is expected that the sensor's own noise does not show.
        normal[0, 0] *= 1.0 + self._TOLD / self._MEMORY
        additive, soil = np.linalg.solve(normal, moment)
        if additive < 0.0:
            additive, soil = 0.0, moment[1] / normal[1, 1]
        floor = 0.25 * self._told
        if soil < floor:
            additive, soil = (moment[0] - normal[0, 1] * floor) / normal[0, 0], floor
        self.additive, self.soil = max(float(additive), 0.0), float(soil)
