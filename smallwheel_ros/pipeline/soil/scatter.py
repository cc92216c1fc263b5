# SPDX-License-Identifier: Apache-2.0
"""Scatter of stretches beyond law and sensors, learnt from innovations of the soil's filter."""

from __future__ import annotations

import math
from copy import copy

import numpy as np

from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.rows.motion import ahead_of
from smallwheel_ros.pipeline.tables import Array

from .model import Shown
from .stretches import Stretches

LARGEST = 9.0  # a squared innovation counts at most as so many of its variances
# m, that sinkages of single stretches differ by beyond load and soil, until they show how much they do: a
# stretch of rough ground. With none, the first four fitted to 0.3 mm made n the end of its range, and the
# deviation 1.75 times the prior's.
_ROUGH = 1e-3
MODEL_ERROR = 0.02  # of sinkage: the law against the public single-wheel rig, within one soil


class SoilScatter:
    """Scatter of stretches beyond state and sensors, learnt from innovations.

    By a regression of nu^2 - H P H - base on (1, by^2 share): `additive` (m^2), and `soil`, the
    variance of ln k at a place. `share` is the part of that variance left in the mean over a stretch.
    Wheels that run in one track meet the same places: so many of them measure the law as one does.
    """

    _MEMORY = 150.0  # stretches
    _TOLD, _TOLD_ROUGH = 30.0, 10.0  # that the soil's scatter, and `_ROUGH`, count for

    def __init__(self, soil_scatter: float, wheels: tuple[Wheel, ...]) -> None:
        self._told = soil_scatter**2
        self.additive, self.soil = _ROUGH**2, soil_scatter**2
        # Mean over a length as long as the correlation of an Ornstein-Uhlenbeck process: its variance, and
        # that of many such means together, over the variance at a point.
        self.share, self.together = 2.0 * math.exp(-1.0), 2.0
        self._track = np.array(
            [1.0 + sum(len(ahead_of(wheels, w, way)) for way in (-1, 1)) for w in wheels]
        )
        self._normal: Array = np.zeros((2, 2))
        self._moment: Array = np.zeros(2)
        self._newest = np.zeros(len(wheels))  # normalised innovations
        self._products: Array = np.array([0.0, 1.0])  # of neighbours, and squares

    def copy(self) -> SoilScatter:
        """Copy of the present state."""
        own = copy(self)
        own._newest = self._newest.copy()
        return own

    @property
    def places(self) -> tuple[float, float]:
        """Variances at one place: of ln k, and of the sinkage in addition (m^2).

        The remaining scatter may be the ground's or the sensor's; it is counted as the ground's.
        """
        return self.soil, self.additive / self.share

    def noise(self, rows: Stretches, shown: Shown) -> tuple[Array, Array, Array]:
        """Variances of the sinkages of stretches.

        Parameters
        ----------
        rows
            The stretches.
        shown
            Sinkages of the stretches by the model.

        Returns
        -------
        alone, counts, base : ndarray
            Shape (rows,), m^2: of a stretch alone; of a stretch among its neighbours; of sensors and law
            only.
        """
        by_load = shown.by_load**2
        base = rows.variance + by_load * rows.load_variance
        base = base + (MODEL_ERROR * shown.value) ** 2 + shown.doubt
        alone = base + self.share * by_load * self.soil + self.additive
        places = self.together * self._track[rows.wheel] * by_load * self.soil
        counts = base + places + self.alike * self.additive
        return alone, counts, base

    @property
    def alike(self) -> float:
        """Factor by which correlation r of neighbours raises the variance of a mean: (1 + r)/(1 - r)."""
        alike = min(max(self._products[0] / self._products[1], 0.0), 0.8)
        return float((1.0 + alike) / (1.0 - alike))

    def learn(
        self, wheel: int, miss: float, state: float, variance: float, base: float, by: float
    ) -> None:
        """Use an innovation.

        Parameters
        ----------
        wheel
            Number of the wheel.
        miss
            Shown minus expected sinkage, m.
        state
            Variance due to the state, m^2.
        variance
            Variance in all, m^2.
        base
            Variance due to sensors and law, m^2.
        by
            Slope of sinkage by ln k, m.
        """
        keep = 1.0 - 1.0 / self._MEMORY
        features = np.array([1.0, by**2 * self.share])
        square = min(miss**2, LARGEST * variance)
        self._normal = keep * self._normal + np.outer(features, features) / variance**2
        self._moment = keep * self._moment + features * (square - state - base) / variance**2
        normal, moment = self._normal.copy(), self._moment.copy()
        told = self._TOLD * features[1] ** 2 / variance**2
        normal[1, 1] += told
        moment[1] += told * self._told
        # None is expected that the noise does not show.
        normal[0, 0] *= 1.0 + self._TOLD / self._MEMORY
        rough = self._TOLD_ROUGH / variance**2
        normal[0, 0] += rough
        moment[0] += rough * _ROUGH**2
        additive, soil = np.linalg.solve(normal, moment)
        if additive < 0.0:
            additive, soil = 0.0, moment[1] / normal[1, 1]
        floor = 0.25 * self._told
        if soil < floor:
            additive, soil = (moment[0] - normal[0, 1] * floor) / normal[0, 0], floor
        self.additive, self.soil = max(float(additive), 0.0), float(soil)
        now = min(max(miss / math.sqrt(variance), -3.0), 3.0)
        before, self._newest[wheel] = self._newest[wheel], now
        self._products = keep * self._products + [now * before, 0.5 * (now**2 + before**2)]
