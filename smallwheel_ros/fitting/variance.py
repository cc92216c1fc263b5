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

Drawbar pull and torque have L^2 [law^2 exp(-|d slip| / 0.3) + wheel^2] within each wheel (`FORCE_LAW`). L
is the size of each value, of pull the load W, of torque W r (`levels`). phi = (tau, own, ...) have
log-normal priors; ln phi is found by maximising

    ln N(e; 0, V + J P^-1 J') + ln p(ln phi)

(restricted likelihood with the parameters' prior) by Newton steps with the average information
(Gilmour, Thompson and Cullis 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.covariance import Covariance, blocks_of
from smallwheel_ros.fitting.noise import wheel_discrepancy
from smallwheel_ros.fitting.points import Index, Points
from smallwheel_ros.measurements.columns import FORCES

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

    @property
    def deviations(self) -> dict[str, float]:
        """Deviation by name."""
        return dict(zip(self.names, np.exp(self.log_deviation).tolist(), strict=True))


class VarianceModel:
    """The components of one set of points.

    level: L, shape (values,). pure: variance of the values' rows. working: see `Fitter`.
    """

    def __init__(
        self,
        points: Points,
        level: Array,
        pure: Array,
        stated: Array,
        *,
        working: bool = False,
    ) -> None:
        self.points, self.level, self._working = points, level, working
        self.swept = bool(points.swept.any())
        repeated = settings_repeated(points)
        medians = {"tau": constants.SOIL_SCATTER}
        for name in points.channels:
            medians[f"own:{name}"] = constants.CHANNEL_SCATTER
            if name not in FORCES:
                medians[f"zero:{name}"] = constants.ZERO_SCATTER
            if repeated:
                medians[f"fit:{name}"] = constants.LACK_OF_FIT
            if stated[points.of_channel(name)].any():
                medians[f"declared:{name}"] = 1.0
        if self.swept:
            medians["along"] = constants.CURVE_CORRELATED
        self.names, self.log_median = tuple(medians), np.log(list(medians.values()))
        links = [points.run, np.where(points.swept, points.channel, -1)]
        links += [points.setting] if repeated else []
        wheels = _wheels(points)
        for name in () if working else points.forces:
            links.append(np.where(points.of_channel(name), wheels, -1))
        self.blocks = blocks_of(links)
        pairs = [_Pairs(index) for index in self.blocks]
        pure = pure + (_RESOLUTION * level) ** 2
        self._base = [
            np.eye(p.size) * pure[p.index][:, :, None] + self._laws(p, wheels) for p in pairs
        ]
        self._parts = [np.array([self._kernel(n, p, stated) for n in self.names]) for p in pairs]
        self._gap = [p.apart(points.path) for p in pairs]

    def _laws(self, pairs: _Pairs, wheels: Index) -> Array:
        """Covariance of what a law of thrust and a curve's power of depth get wrong.

        wheels: code of each value's wheel, shape (values,).
        """
        points, sizes = self.points, pairs.product(self.level)
        found = np.zeros_like(sizes)
        for name in () if self._working else points.forces:
            mine = pairs.product(points.of_channel(name)) * pairs.same(wheels)
            near = np.exp(-pairs.apart(points.column("slip")) / constants.FORCE_SLIP)
            own = pairs.product(wheel_discrepancy(points.conditions)[points.row])
            found += sizes * mine * (constants.FORCE_LAW**2 * near + own)
        if self.swept:
            bodies = _codes([points.column("diameter"), points.column("width")])
            same = pairs.same(bodies)
            near = np.exp(-pairs.apart(np.log(np.maximum(self.level, 1e-12))))
            law = (1.0 + same) * near + (same if bodies.max() > 0 else 0.0)
            curve = pairs.product(points.swept) * pairs.same(points.channel)
            found += constants.CURVE_SHAPE**2 * sizes * curve * law
        return found

    def _kernel(self, name: str, pairs: _Pairs, stated: Array) -> Array:
        """Covariance of one component at unit deviation, less what `kernels` knows."""
        component, _, channel = name.partition(":")
        points, run, sizes = self.points, pairs.same(self.points.run), pairs.product(self.level)
        if component == "tau":
            return run
        if component == "along":
            return pairs.product(points.swept) * pairs.same(points.channel) * run * sizes
        here = points.of_channel(channel)
        mine = pairs.product(here)
        if component == "own":
            return mine * run * sizes
        if component == "zero":
            return mine * run * float(np.median(self.level[here])) ** 2
        if component == "fit":
            return mine * pairs.same(points.setting) * sizes
        return np.eye(pairs.size) * mine * stated[pairs.index][:, :, None]  # declared

    @property
    def start(self) -> Scatter:
        """The priors' medians."""
        return Scatter(self.names, self.log_median, float(_LENGTHS[1]))

    def suited(self, scatter: Scatter) -> Scatter:
        """The components that these points have, where a scatter of other points knows them.

        Some runs of a table may repeat no setting though the whole does, and have no lack of fit then.
        """
        known = dict(zip(scatter.names, scatter.log_deviation, strict=True))
        middle = zip(self.names, self.log_median, strict=True)
        values = np.array([known.get(name, value) for name, value in middle])
        return Scatter(self.names, values, scatter.log_length)

    def kernels(self, stiffness: Array, log_length: float) -> list[Array]:
        """Covariance of each component at unit deviation, by blocks: (components, blocks, m, m).

        stiffness: df / d ln k, shape (values,).
        """
        found = []
        for index, part, gap in zip(self.blocks, self._parts, self._gap, strict=True):
            kernels = part.copy()
            kernels[0] *= stiffness[index][:, :, None] * stiffness[index][:, None, :]
            if self.swept:
                kernels[-1] *= np.exp(-gap / np.exp(log_length))
            found.append(kernels)
        return found

    def total(
        self, log_deviation: Array, kernels: Sequence[Array], spread: Array | None = None
    ) -> Covariance:
        """V, and with it what parameters can take up. spread: U, shape (values, columns)."""
        squares = np.exp(2.0 * log_deviation)
        parts = [
            base + np.einsum("k,kbij->bij", squares, kernel)
            for base, kernel in zip(self._base, kernels, strict=True)
        ]
        return Covariance(self.blocks, parts, spread)

    def covariance(
        self, scatter: Scatter, stiffness: Array, spread: Array | None = None
    ) -> Covariance:
        """V of a scatter; see `total`."""
        kernels = self.kernels(stiffness, scatter.log_length)
        return self.total(scatter.log_deviation, kernels, spread)

    def log_prior(self, scatter: Scatter) -> float:
        """Logarithm of the priors' densities, less constants."""
        away = (scatter.log_deviation - self.log_median) / constants.SPREAD
        return -0.5 * float(away @ away)

    def fit(self, error: Array, spread: Array, stiffness: Array, start: Scatter) -> Scatter:
        """The components that suit the errors best. spread: U, what parameters can take up."""
        best = None
        lengths = _LENGTHS if self.swept else _LENGTHS[1:2]
        for length in lengths:
            kernels = self.kernels(stiffness, float(length))
            found, value = self._climb(error, spread, kernels, start.log_deviation)
            if best is None or value > best[0]:
                best = value, Scatter(self.names, found, float(length))
        assert best is not None
        return best[1]

    def _climb(
        self, error: Array, spread: Array, kernels: list[Array], start: Array
    ) -> tuple[Array, float]:
        curvature = np.eye(start.size) / constants.SPREAD**2

        def objective(ln: Array) -> tuple[float, Covariance | None]:
            try:
                covariance = self.total(ln, kernels, spread)
            except np.linalg.LinAlgError:
                return -np.inf, None
            white, away = covariance.whiten(error), (ln - self.log_median) / constants.SPREAD
            return -covariance.log_root - 0.5 * float(white @ white + away @ away), covariance

        ln = start.copy()
        value, covariance = objective(ln)
        for _ in range(_STEPS):
            assert covariance is not None
            pulled, moved = self._moved(covariance, error, ln, kernels)
            sizes, traces = 2.0 * np.exp(2.0 * ln), np.zeros(ln.size)
            for part, kernel in zip(covariance.inverse_parts(), kernels, strict=True):
                traces += np.einsum("bij,kbij->k", part, kernel)
            gradient = 0.5 * (pulled @ moved - sizes * traces)
            gradient -= (ln - self.log_median) / constants.SPREAD**2
            white = covariance.whiten(moved)
            step = np.linalg.solve(0.5 * white.T @ white + curvature, gradient)
            step, share = np.clip(step, -1.5, 1.5), 1.0
            while share > 0.03:
                tried, tried_covariance = objective(ln + share * step)
                if tried > value:
                    break
                share *= 0.4
            else:
                break
            gain = tried - value
            ln, value, covariance = ln + share * step, tried, tried_covariance
            if gain < _TOLERANCE:
                break
        return ln, value

    def _moved(
        self, covariance: Covariance, error: Array, ln: Array, kernels: list[Array]
    ) -> tuple[Array, Array]:
        """S^-1 e, and of each component dS / d ln phi S^-1 e, shape (values, components)."""
        pulled = covariance.solve(error)
        moved = np.empty((error.size, ln.size))
        for index, kernel in zip(self.blocks, kernels, strict=True):
            moved[index] = np.einsum("kbij,bj->bik", kernel, pulled[index])
        return pulled, moved * (2.0 * np.exp(2.0 * ln))

    def uncertainty(self, error: Array, spread: Array, stiffness: Array, scatter: Scatter) -> Array:
        """Covariance of ln phi (average information and prior), shape (components,) * 2."""
        kernels = self.kernels(stiffness, scatter.log_length)
        covariance = self.total(scatter.log_deviation, kernels, spread)
        white = covariance.whiten(self._moved(covariance, error, scatter.log_deviation, kernels)[1])
        prior = np.eye(len(self.names)) / constants.SPREAD**2
        return np.asarray(np.linalg.inv(0.5 * white.T @ white + prior))


def settings_repeated(points: Points) -> bool:
    """Whether several runs were made of one setting: only then is lack of fit told from scatter."""
    if points.swept.any():
        return False
    pairs = np.unique(np.column_stack([points.setting, points.run]), axis=0)
    return bool(np.bincount(pairs[:, 0]).max(initial=0) > 1)


class _Pairs:
    """All pairs of values in blocks of one size. index: values, shape (blocks, size)."""

    def __init__(self, index: Index) -> None:
        self.index, self.size = index, index.shape[1]

    def same(self, codes: Index) -> Array:
        """1 where both have the same code, else 0."""
        there = codes[self.index]
        return np.asarray(there[:, :, None] == there[:, None, :], dtype=float)

    def product(self, values: NDArray[Any]) -> Array:
        """The two values' product; of a mask 1 where both are in it."""
        there = values.astype(float)[self.index]
        return np.asarray(there[:, :, None] * there[:, None, :])

    def apart(self, values: Array) -> Array:
        """How far the two values are from each other."""
        return np.abs(values[self.index][:, :, None] - values[self.index][:, None, :])


def _wheels(points: Points) -> Index:
    """Codes of the wheels, which differ by size or lugs."""
    parts = [points.column("diameter"), points.column("width")]
    if "grouser_height" in points.conditions:
        parts.append(points.column("grouser_height"))
    return _codes(parts)


def _codes(columns: Sequence[Array]) -> Index:
    rounded = np.round(np.column_stack(columns), 4)
    return np.asarray(np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1))
