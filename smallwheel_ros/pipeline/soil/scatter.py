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
# m: initial deviation of a stretch's sinkage besides load and soil, as on rough ground. With none, a fit of
# the first four stretches to 0.3 mm moved n to the end of its range, with a deviation 1.75 times the prior's.
_ROUGH = 1e-3
# Relative error of a predicted sinkage: the law against the public single-wheel rig, within one soil.
MODEL_ERROR = 0.02


class SoilScatter:
    """Scatter of stretches beyond what state and sensors explain, learnt from innovations nu (m).

    It is a regression of nu^2 - H P H' - base on (1, by^2 share), with H P H' the variance due to the state
    (`soil/model.py`), `by` = d sinkage / d ln k (m), and base the variance due to sensors and the law's form.
    Wheels that run in one track cross the same places, so that together they tell no more than one of them.

    Parameters
    ----------
    soil_scatter
        Standard deviation of ln k from place to place until it is learnt, 1.
    wheels
        All wheels.

    Attributes
    ----------
    additive
        Variance of sinkage that does not scale with `by`, m^2.
    soil
        Variance of ln k from place to place.
    share
        Variance of the mean of ln k over one stretch of path, over `soil`, 1.
    together
        Variance of the mean of ln k over many successive stretches, times their number, over `soil`, 1; it
        is larger than `share`, since neighbouring stretches are correlated.
    """

    _MEMORY = 150.0  # stretches over which the regression is taken
    _TOLD, _TOLD_ROUGH = 30.0, 10.0  # stretches that `soil_scatter` and `_ROUGH` count for

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
        self._newest = np.zeros(len(wheels))  # newest normalised innovation of each wheel
        self._products: Array = np.array([0.0, 1.0])  # sums: products of neighbours, squares

    def copy(self) -> SoilScatter:
        """Return a copy that is independent of this one."""
        own = copy(self)
        own._newest = self._newest.copy()
        return own

    @property
    def places(self) -> tuple[float, float]:
        """Variances at one place: of ln k, and of the sinkage in addition (m^2).

        The latter may be due to the ground or to the sensor; it is counted as the ground's.
        """
        return self.soil, self.additive / self.share

    def noise(self, rows: Stretches, shown: Shown) -> tuple[Array, Array, Array]:
        """Compute the variance of the measured sinkage of each stretch about the prediction for a known law.

        Parameters
        ----------
        rows
            The stretches.
        shown
            Sinkages of the stretches by the model, and their derivatives.

        Returns
        -------
        alone : ndarray
            Variance of one stretch, to judge its innovation, shape (rows,), m^2.
        counts : ndarray
            The larger variance by which it is weighted in an update, as if stretches were independent:
            neighbours, and wheels in one track, are correlated, shape (rows,), m^2.
        base : ndarray
            The part of both that is not scatter of the ground, shape (rows,), m^2: noise of sinkage and load,
            error of the law's form, and uncertain effects of ruts and slip.
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
        """Factor by which the correlation r of neighbours raises the variance of a mean: (1 + r)/(1 - r).

        r is that of successive normalised innovations of a wheel, limited to 0 to 0.8.
        """
        alike = min(max(self._products[0] / self._products[1], 0.0), 0.8)
        return float((1.0 + alike) / (1.0 - alike))

    def learn(
        self, wheel: int, miss: float, state: float, variance: float, base: float, by: float
    ) -> None:
        """Update the scatter with the innovation of one stretch.

        Parameters
        ----------
        wheel
            Number of the wheel.
        miss
            Innovation: measured less predicted sinkage, m.
        state
            Part of its variance due to the filter's state, m^2.
        variance
            Its variance in all, m^2.
        base
            Part of its variance due to sensors and law, m^2.
        by
            d sinkage / d ln k (its sign does not matter), m.
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
        # The prior of the additive variance is 0, but for `_ROUGH`.
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
