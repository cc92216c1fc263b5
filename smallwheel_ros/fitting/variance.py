# SPDX-License-Identifier: Apache-2.0
"""The variance components: how measured values differ from the right model's predictions.

    y = f(theta) + e,   e ~ N(0, V),
    V = pure / count                                   rows within a point (repeatability)
      + tau^2 j j'          within a run               the soil is a little firmer; j = df / d ln k
      + own^2 L L'          within a run and channel   the run's touch-down, tare and mounting
      + zero^2 med(L)^2     within a run and channel   the same, of a size that does not grow with y
      + fit^2 L L'          within a setting           lack of fit of the law over settings
      + declared^2 diag(s^2)                           stated deviations, by one factor

and for swept runs

      + along^2 L L' exp(-|d path| / l)   within a run         what neighbours along a curve share

Two laws are wrong by an amount that is given, not fitted: where it is fitted, any effect gains by
shrinking it. A curve strays from a power of depth, over all runs and once more within each body (plate
or wheel), and no law of size is a power either:

      + shape^2 L L' [(1 + same body) exp(-|d ln L|) + same body]

Drawbar pull has (0.3 W)^2 exp(-|d slip| / 0.3) within each wheel. L is the size
of each value (`levels`). phi = (tau, own, ...) have log-normal priors; ln phi is found by maximising

    ln N(e; 0, V + J P^-1 J') + ln p(ln phi)

(restricted likelihood with the parameters' prior) by Newton steps with the average information
(Gilmour, Thompson and Cullis 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.points import Points

Array = NDArray[np.float64]

_STEPS = 15
_TOLERANCE = 0.01  # nats
_RESOLUTION = 1e-3  # of the level: no instrument shows more than three digits
_LENGTHS = np.log([0.1, 0.25, 0.6])  # correlation length along a curve, of its length


@dataclass(frozen=True)
class Scatter:
    """The components' deviations, as ln. length: of what is correlated along a curve, ln of a share."""

    names: tuple[str, ...]
    log_deviation: Array
    log_length: float

    def as_dict(self, model: VarianceModel) -> dict[str, float]:
        """Deviation by name."""
        return dict(zip(model.names, np.exp(self.log_deviation).tolist(), strict=True))


class VarianceModel:
    """The components of one set of points. level: L, shape (values,). pure: variance of the values' rows."""

    def __init__(self, points: Points, level: Array, pure: Array, stated: Array) -> None:
        self.points, self.level = points, level
        self.base = np.diag(pure + (_RESOLUTION * level) ** 2) + _thrust_law(points, level)
        self.names: list[str] = []
        self.medians: list[float] = []
        self._kernels: list[Array | None] = []
        self._same_run = points.run[:, None] == points.run[None, :]
        self._same_channel = points.channel[:, None] == points.channel[None, :]
        self._sizes = np.outer(level, level)
        self._add("tau", None, constants.SOIL_SCATTER)
        for c, name in enumerate(points.channels):
            self._add_channel(c, name, stated)
        self.swept = bool(points.swept.any())
        if self.swept:
            self._add_curves()

    def _add(self, name: str, kernel: Array | None, median: float) -> None:
        self.names.append(name)
        self._kernels.append(kernel)
        self.medians.append(median)

    def _add_channel(self, c: int, name: str, stated: Array) -> None:
        points = self.points
        mine = points.channel == c
        here = np.outer(mine, mine)
        together = here & self._same_run
        self._add(f"own:{name}", np.where(together, self._sizes, 0.0), constants.CHANNEL_SCATTER)
        if name != "drawbar_pull":
            middle = float(np.median(self.level[mine])) ** 2
            self._add(f"zero:{name}", np.where(together, middle, 0.0), constants.ZERO_SCATTER)
        if settings_repeated(points):
            same = here & (points.setting[:, None] == points.setting[None, :])
            self._add(f"fit:{name}", np.where(same, self._sizes, 0.0), constants.LACK_OF_FIT)
        if stated[mine].any():
            self._add(f"declared:{name}", np.diag(np.where(mine, stated, 0.0)), 1.0)

    def _add_curves(self) -> None:
        points = self.points
        swept = points.swept
        self._gap = np.abs(points.path[:, None] - points.path[None, :])
        self._along = np.where(
            self._same_run & self._same_channel & np.outer(swept, swept), self._sizes, 0.0
        )
        self._add("along", None, constants.CURVE_CORRELATED)
        depth = np.log(np.maximum(self.level, 1e-12))
        both = self._same_channel & np.outer(swept, swept)
        body = np.round(np.column_stack([points.column("diameter"), points.column("width")]), 4)
        code = np.unique(body, axis=0, return_inverse=True)[1].reshape(-1)
        same = code[:, None] == code[None, :]
        near = np.exp(-np.abs(depth[:, None] - depth[None, :]))
        law = (1.0 + same) * near + (same if code.max() > 0 else 0.0)
        self.base += constants.CURVE_SHAPE**2 * np.where(both, self._sizes * law, 0.0)

    @property
    def start(self) -> Scatter:
        """The priors' medians."""
        return Scatter(tuple(self.names), np.log(np.array(self.medians)), float(_LENGTHS[1]))

    def suited(self, scatter: Scatter) -> Scatter:
        """The components that these points have, where a scatter of other points knows them.

        Some runs of a table may repeat no setting though the whole does, and have no lack of fit then.
        """
        if scatter.names == tuple(self.names):
            return scatter
        known = dict(zip(scatter.names, scatter.log_deviation.tolist(), strict=True))
        middle = zip(self.names, np.log(np.array(self.medians)).tolist(), strict=True)
        values = np.array([known.get(name, value) for name, value in middle])
        return Scatter(tuple(self.names), values, scatter.log_length)

    def kernels(self, stiffness: Array, log_length: float) -> list[Array]:
        """Covariance of each component at unit deviation. stiffness: df / d ln k, shape (values,)."""
        found = []
        for name, kernel in zip(self.names, self._kernels, strict=True):
            if name == "tau":
                found.append(np.where(self._same_run, np.outer(stiffness, stiffness), 0.0))
            elif name == "along":
                found.append(self._along * np.exp(-self._gap / np.exp(log_length)))
            else:
                assert kernel is not None
                found.append(kernel)
        return found

    def covariance(self, scatter: Scatter, kernels: list[Array]) -> Array:
        """V, shape (values, values)."""
        total = self.base.copy()
        for ln, kernel in zip(scatter.log_deviation, kernels, strict=True):
            total += np.exp(2.0 * ln) * kernel
        return total

    def log_prior(self, scatter: Scatter) -> float:
        """Logarithm of the priors' densities, less constants."""
        away = (scatter.log_deviation - np.log(np.array(self.medians))) / constants.SPREAD
        return -0.5 * float(away @ away)

    def fit(self, error: Array, spread: Array, stiffness: Array, start: Scatter) -> Scatter:
        """The components that suit the errors best. spread: J P^-1 J', what parameters can take up."""
        best = None
        lengths = _LENGTHS if self.swept else _LENGTHS[1:2]
        for length in lengths:
            kernels = self.kernels(stiffness, float(length))
            found, value = self._climb(error, spread, kernels, start.log_deviation)
            if best is None or value > best[0]:
                best = value, Scatter(tuple(self.names), found, float(length))
        assert best is not None
        return best[1]

    def _climb(
        self, error: Array, spread: Array, kernels: list[Array], start: Array
    ) -> tuple[Array, float]:
        medians = np.log(np.array(self.medians))
        curvature = np.eye(start.size) / constants.SPREAD**2
        base = self.base + spread

        def total(ln: Array) -> Array:
            found = base.copy()
            for value, kernel in zip(ln, kernels, strict=True):
                found += np.exp(2.0 * value) * kernel
            return found

        def objective(ln: Array) -> tuple[float, Array]:
            try:
                factor: Array = np.asarray(np.linalg.cholesky(total(ln)), dtype=float)
            except np.linalg.LinAlgError:
                return -np.inf, np.zeros((0, 0))
            white = solve_triangular(factor, error, lower=True, check_finite=False)
            away = (ln - medians) / constants.SPREAD
            value = -np.log(np.diag(factor)).sum() - 0.5 * white @ white - 0.5 * away @ away
            return float(value), factor

        ln = start.copy()
        value, factor = objective(ln)
        for _ in range(_STEPS):
            inverse = cho_solve((factor, True), np.eye(error.size), check_finite=False)
            pulled = inverse @ error
            sizes = 2.0 * np.exp(2.0 * ln)
            moved = np.column_stack([s * (k @ pulled) for s, k in zip(sizes, kernels, strict=True)])
            traces = [s * np.sum(inverse * k) for s, k in zip(sizes, kernels, strict=True)]
            gradient = (
                0.5 * (pulled @ moved - np.array(traces)) - (ln - medians) / constants.SPREAD**2
            )
            information = 0.5 * moved.T @ inverse @ moved + curvature
            step = np.clip(np.linalg.solve(information, gradient), -1.5, 1.5)
            share = 1.0
            while share > 0.03:
                tried, tried_factor = objective(ln + share * step)
                if tried > value:
                    break
                share *= 0.4
            else:
                break
            gain = tried - value
            ln, value, factor = ln + share * step, tried, tried_factor
            if gain < _TOLERANCE:
                break
        return ln, value

    def uncertainty(self, error: Array, spread: Array, stiffness: Array, scatter: Scatter) -> Array:
        """Covariance of ln phi (average information and prior), shape (components,) * 2."""
        kernels = self.kernels(stiffness, scatter.log_length)
        factor = cho_factor(self.covariance(scatter, kernels) + spread, lower=True)
        pulled = cho_solve(factor, error)
        moved = np.column_stack(
            [2.0 * np.exp(2.0 * v) * k @ pulled
             for v, k in zip(scatter.log_deviation, kernels, strict=True)]
        )  # fmt: skip
        information = 0.5 * moved.T @ cho_solve(factor, moved)
        return np.asarray(np.linalg.inv(information + np.eye(len(kernels)) / constants.SPREAD**2))


def settings_repeated(points: Points) -> bool:
    """Whether several runs were made of one setting: only then is lack of fit told from scatter."""
    if points.swept.any():
        return False
    pairs = np.unique(np.column_stack([points.setting, points.run]), axis=0)
    return bool(np.bincount(pairs[:, 0]).max(initial=0) > 1)


def _thrust_law(points: Points, level: Array) -> Array:
    """Covariance of what a law of thrust gets wrong: smooth in slip, each wheel in its own way."""
    found = np.zeros((len(points), len(points)))
    if "drawbar_pull" not in points.channels:
        return found
    pull = points.of_channel("drawbar_pull")
    slip = points.column("slip")
    parts = [points.column("diameter"), points.column("width")]
    if "grouser_height" in points.conditions:
        parts.append(points.column("grouser_height"))
    wheel = np.unique(np.round(np.column_stack(parts), 4), axis=0, return_inverse=True)[1]
    wheel = wheel.reshape(-1)
    same = np.outer(pull, pull) & (wheel[:, None] == wheel[None, :])
    near = np.exp(-np.abs(slip[:, None] - slip[None, :]) / constants.THRUST_SLIP)
    return np.where(same, constants.THRUST_LAW**2 * np.outer(level, level) * near, 0.0)
