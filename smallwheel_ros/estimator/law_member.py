# SPDX-License-Identifier: Apache-2.0
"""One iterated extended Kalman filter of the soil's law: what `law_filter`'s bank is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from smallwheel_ros.estimator.law_model import (
    EACH,
    LAW,
    LEAST_SHARE,
    LOAD_SCALE,
    LOAD_ZERO,
    SIDE,
    SIDE_STD,
    WHEELS,
    LawModel,
    U,
)
from smallwheel_ros.estimator.scatter import LARGEST, Innovation, Scatter
from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]
State = tuple[Array, Array, float]  # x - x0, P, and to where it has travelled (m)

TEMPER = 0.5  # power of the likelihood
_SIDE_FADE = 100.0  # m, over which the sides come to differ by something else
_HUBER = 2.5  # deviations from which on a segment counts less and less
_ITERATIONS = 4
_SETTLED = 0.01  # of u: what is left of the curvature is 1e-4 of the sinkage
# Of ln: neither load cells nor a weighed mass are 10 % off.
CONTRADICTION = math.log(1.1)
UNSETTLED = 1.0  # m behind a border on which the soil may go on changing as it has begun to


@dataclass(frozen=True)
class Border:
    """Behind a change of soil: the soil may go on changing by `size` (of u) until there (m)."""

    size: float = 0.0
    until: float = -math.inf


class Member:
    """Its state is x - x0 and P of filterpy's filter.

    fade: m over which the law fades to its prior. wide: the deviations of passes and zeros are as
    told; else `tight` (a factor) of them. log_prior, log_weight: of it in the bank.
    """

    def __init__(
        self, model: LawModel, fade: float, wide: bool, tight: float, log_prior: float
    ) -> None:
        self.model, self.fade, self.wide = model, fade, wide
        self._scale = 1.0 if wide else tight
        self.log_prior = self.log_weight = log_prior
        self.kalman = ExtendedKalmanFilter(WHEELS, 1)
        self.kalman.x, self.kalman.P = np.zeros(WHEELS), model.prior(self._scale)
        self.travelled = math.nan

    @property
    def state(self) -> State:
        """What it is at now."""
        return self.kalman.x.copy(), self.kalman.P.copy(), self.travelled

    def begin(self, state: State) -> None:
        """Go back to a state."""
        x, covariance, self.travelled = state
        self.kalman.x, self.kalman.P = x.copy(), covariance.copy()

    def with_wheel(self, state: State) -> State:
        """A state with a place for one more wheel."""
        x, covariance, travelled = state
        size = len(x)
        whole = np.zeros((size + EACH, size + EACH))
        whole[:size, :size] = covariance
        whole[size:, size:] = np.diag(np.square(self.model.wheel_deviations * [self._scale, 1.0]))
        return np.append(x, np.zeros(EACH)), whole, travelled

    def add_wheel(self) -> None:
        """Give a wheel a place in the state."""
        state = self.with_wheel(self.state)
        self.kalman = ExtendedKalmanFilter(len(state[0]), 1)
        self.begin(state)

    def travel(self, distance: float, border: Border) -> None:
        """Predict to a distance (m)."""
        kalman = self.kalman
        if distance > self.travelled:
            keep = math.exp(-(distance - self.travelled) / self.fade)
            factors = np.ones(len(kalman.x))
            factors[:LAW] = keep
            factors[SIDE] = math.exp(-(distance - self.travelled) / _SIDE_FADE)
            kalman.F = np.diag(factors)
            kalman.Q = np.zeros_like(kalman.P)
            kalman.Q[SIDE, SIDE] = (1.0 - factors[SIDE] ** 2) * SIDE_STD**2
            kalman.Q[:LAW, :LAW] = (1.0 - keep * keep) * self.model.soil_covariance[:LAW, :LAW]
            unsettled = min(distance, border.until) - self.travelled
            if unsettled > 0.0:
                kalman.Q[U, U] += border.size**2 * unsettled / UNSETTLED
            kalman.predict()
        if not distance < self.travelled:
            self.travelled = distance

    def update(self, segment: Segment, scatter: Scatter, about: Array | None = None) -> Innovation:
        """Use a segment; return its innovation.

        about: where to linearise instead of at the newest x.
        """
        kalman, model = self.kalman, self.model
        mean = model.mean + kalman.x
        x = mean if about is None else about
        for step in range(_ITERATIONS if about is None else 1):
            shown = model.h(x, segment)
            miss = segment.sinkage - shown.value - float(shown.row @ (mean - x))
            state = shown.variance(kalman.P)
            if step == 0:
                alone, counts, base = scatter.noise(segment, shown)
                first = Innovation(miss, state, state + alone, base, shown.by_load)
                square = miss * miss / first.variance
                counts *= _huber(square)
                self.log_weight -= 0.5 * TEMPER * (min(square, LARGEST) + math.log(first.variance))
            new = model.bounded(mean + kalman.P @ shown.row * (miss / (state + counts)))
            settled = abs(new[U] - x[U]) < _SETTLED
            x = new
            if settled:
                break
        row = shown.row[None, :]
        kalman.update(
            np.array([miss]), lambda _: row, lambda _: np.zeros(1), R=np.array([[counts]])
        )
        kalman.x = model.bounded(model.mean + kalman.x) - model.mean
        kalman.P = 0.5 * (kalman.P + kalman.P.T)
        return first

    def weighed(
        self, state: State, loads: Sequence[tuple[int | None, float]], weight: Quantity
    ) -> State:
        """A state with the sum of all loads measured (see `LawFilter.weigh`)."""
        x, covariance, travelled = state
        row, total = np.zeros(len(x)), 0.0
        reference = self.model.reference[0]
        for index, load in loads:
            net = max(load - x[LOAD_ZERO] * reference, LEAST_SHARE * load)
            own = None if index is None else WHEELS + EACH * index + 1
            net *= math.exp(-x[LOAD_SCALE] - (0.0 if own is None else x[own]))
            total += net
            row[LOAD_SCALE] -= net
            row[LOAD_ZERO] -= reference * net / load
            if own is not None:
                row[own] -= net
        row /= total
        off = math.log(weight.value / total)
        noise, wider = (weight.standard_deviation / weight.value) ** 2, covariance.copy()
        if abs(off) > CONTRADICTION:
            wider[LOAD_SCALE, LOAD_SCALE] += off * off
        gain = wider @ row / (float(row @ wider @ row) + noise)
        return x + gain * off, wider - np.outer(gain, row @ wider), travelled

    def with_law(self, law: tuple[Array, Array] | None) -> tuple[Array, Array]:
        """Its x - x0 and P with another law, None: the prior's; the nuisances stay.

        law: mean (3,) and covariance (3, 3) of (ln z_ref, n, m).
        """
        model = self.model
        y, jacobian = model.soil(model.mean + self.kalman.x)
        whole = jacobian @ self.kalman.P @ jacobian.T
        whole[:LAW, :] = 0.0
        whole[:, :LAW] = 0.0
        whole[:LAW, :LAW] = model.soil_covariance[:LAW, :LAW] if law is None else law[1]
        y[:LAW] = model.mean[:LAW] if law is None else law[0]
        x = model.shown(y)
        back = np.linalg.inv(model.soil(x)[1])
        return x - model.mean, back @ whole @ back.T


def _huber(square: float) -> float:
    """Factor on R for a squared normalised innovation: less and less weight beyond `_HUBER`."""
    size = max(1.0, math.sqrt(square) / _HUBER)
    return size if size < 2.0 else 0.5 * size * size
