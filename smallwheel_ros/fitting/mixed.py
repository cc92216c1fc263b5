"""Measurements of one run share what was special about it: a mixed model of runs and rows.

V = D + U diag(tau^2) U', block by block of a run: D the noise of each observation, U the loadings
of the run's random effects (its soil was a little firmer: `ln k`; its resistance read a little
high: a channel's own). All that a likelihood needs is the sums X' D^-1 X over the rows of each run,
so its cost does not grow with the rows:

    V^-1 = D^-1 - D^-1 U W U' D^-1,  W = T (1 + T A T)^-1 T,  A = U' D^-1 U,  T = diag(tau)
    (Woodbury) ln det V = ln det D + ln det(1 + T A T)

Restricted likelihood: Patterson and Thompson 1971; Harville 1977.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# tau over the noise: under this it is none. A grid of tau^2 that starts at 0.02 doubles false
# alarms.
_LEAST = 1e-2
# All random effects are relative. Prepared soils scatter by 2 to 15 % in k from run to run, and a
# channel by a few per cent of its own (the load was a little off, say). Half-normal priors this
# wide hardly touch that; but a scatter of 50 % is a wrong model, not a soil.
# The law of thrust is cruder than the rest: by tens of per cent of the load.
USUAL = {"ln k": 0.15, "drawbar_pull": 0.4}
USUAL_OWN = 0.06
LEAST = {"drawbar_pull": 0.1}  # and never better than this
_COARSE = (0.03, 0.5, 2.0, 8.0)


@dataclass(frozen=True)
class Padding:
    """Observations laid out run by run: shape (runs, longest run), padded."""

    index: NDArray[np.intp]
    real: NDArray[np.bool_]

    @classmethod
    def of(cls, run: NDArray[np.intp]) -> Padding:
        """The padding for the run of each observation."""
        codes = np.unique(run, return_inverse=True)[1].reshape(-1)
        order = np.argsort(codes, kind="stable")
        count = np.bincount(codes)
        place = np.arange(codes.size) - np.repeat(np.cumsum(count) - count, count)
        index = np.zeros((count.size, count.max()), dtype=np.intp)
        real = np.zeros(index.shape, dtype=bool)
        index[codes[order], place] = order
        real[codes[order], place] = True
        return cls(index, real)


@dataclass(frozen=True)
class RunEffects:
    """Noise variances D (observations,), loadings U (observations, effects) of the random effects."""

    variance: Array
    loadings: Array
    names: tuple[str, ...]
    padding: Padding

    def products(self, left: Array, right: Array) -> Array:
        """Sums of left' D^-1 right in each run, shape (runs, left columns, right columns)."""
        pad = self.padding
        weight = np.where(pad.real, 1.0 / self.variance[pad.index], 0.0)
        a = left[pad.index] * weight[..., None]
        return np.asarray(np.swapaxes(a, 1, 2) @ right[pad.index])

    def scatter(self, tau: Array) -> Array:
        """Variance of each observation by the runs' scatter, shape (observations,)."""
        return np.asarray(np.sum((self.loadings * tau) ** 2, axis=1))

    @property
    def usual(self) -> Array:
        """Standard deviation of the half-normal prior of each effect's tau."""
        return np.array([USUAL.get(name, USUAL_OWN) for name in self.names])

    @property
    def least(self) -> Array:
        """Least tau of each effect."""
        return np.array([LEAST.get(name, 0.0) for name in self.names])

    @property
    def log_noise(self) -> float:
        """Ln det D."""
        return float(np.sum(np.log(self.variance)))


def woodbury(products: Array, tau: Array, log_noise: float) -> tuple[Array, Array]:
    """W and ln det V from the sums U' D^-1 U of each run.

    tau: shape (..., effects); W is then (..., runs, effects, effects) and ln det V (...).
    """
    t = tau[..., None, :]
    scaled = np.eye(tau.shape[-1]) + t[..., :, None] * products * t[..., None, :]
    w = t[..., :, None] * np.linalg.inv(scaled) * t[..., None, :]
    return w, log_noise + np.sum(np.log(np.linalg.det(scaled)), axis=-1)


@dataclass(frozen=True)
class Moments:
    """Everything that a linear mixed model needs of design X and response y; see `moments`."""

    uu: Array  # (runs, q, q)
    ux: Array  # (runs, q, p)
    uy: Array  # (runs, q)
    xx: Array  # (p, p), summed over runs, noise only
    xy: Array  # (p,)
    yy: float
    log_noise: float
    count: int
    usual: Array  # (q,)
    least: Array  # (q,)

    def at(self, tau: Array) -> tuple[Array, Array, Array, Array]:
        """X'V^-1X, X'V^-1y, y'V^-1y and ln det V; tau of shape (..., effects) leads each shape."""
        w, logdet = woodbury(self.uu, tau, self.log_noise)
        joined = np.concatenate([self.ux, self.uy[..., None]], axis=2)  # (runs, q, p + 1)
        lost = np.sum(np.swapaxes(joined, 1, 2) @ (w @ joined), axis=-3)
        xx = self.xx - lost[..., :-1, :-1]
        return xx, self.xy - lost[..., :-1, -1], self.yy - lost[..., -1, -1], logdet


def moments(effects: RunEffects, x: Array, y: Array) -> Moments:
    """The sums for a design X (observations, p) and a response y (observations,)."""
    u = effects.loadings
    weight = 1.0 / effects.variance
    joined = np.column_stack([u, x, y])
    block = effects.products(u, joined)
    q, p = u.shape[1], x.shape[1]
    return Moments(
        block[:, :, :q],
        block[:, :, q : q + p],
        block[:, :, -1],
        x.T @ (x * weight[:, None]),
        x.T @ (y * weight),
        float(y @ (y * weight)),
        effects.log_noise,
        y.size,
        effects.usual,
        effects.least,
    )


@dataclass(frozen=True)
class Scatter:
    """The runs' scatter tau of each random effect, and the common factor on all deviations."""

    tau: Array
    scale: float


def profile(
    m: Moments, precision: Array, tau: Array, scale: float | None, restrict: bool
) -> tuple[Array, Array]:
    """-2 log likelihood (with the prior of tau) and scale^2 at the best linear fit.

    tau: shape (..., effects), which leads the shape of both.

    restrict: the restricted likelihood, which allows for the parameters that were fitted.
    scale: profiled where None.
    """
    xx, xy, yy, logdet = m.at(tau)
    xx = xx + precision
    ridge = 1e-12 * np.einsum("...ii->...i", xx)[..., None] * np.eye(xy.shape[-1])
    factor = np.linalg.cholesky(xx + ridge)
    half = np.linalg.solve(factor, xy[..., None])[..., 0]
    rss = np.maximum(yy - np.sum(half**2, axis=-1), 1e-12)
    freedom = max(m.count - xy.shape[-1], 1) if restrict else m.count
    square = rss / freedom if scale is None else np.full_like(rss, scale**2)
    value = freedom * np.log(square) + rss / square + logdet + np.sum((tau / m.usual) ** 2, axis=-1)
    if restrict:
        value = value + 2.0 * np.sum(np.log(np.einsum("...ii->...i", factor)), axis=-1)
    return value, square


def fit_scatter(
    m: Moments,
    precision: Array,
    typical: Array,
    scale: float | None = None,
    near: Array | None = None,
) -> Scatter:
    """Runs' scatter by restricted likelihood, on grids that close in.

    typical: a tau that equals the noise, of each effect. near: where to look first.
    """
    smallest = np.maximum(_LEAST * typical, m.least)
    if near is None:
        grid = np.maximum(_grid(_COARSE, typical.size) * typical, m.least)
        best = grid[int(np.argmin(profile(m, precision, grid, scale, True)[0]))]
    else:
        best = np.maximum(near, smallest)
    for ratio in (4.0, 2.0, 1.4, 1.15):
        grid = np.maximum(_grid((1.0 / ratio, 1.0, ratio), typical.size) * best, smallest)
        best = grid[int(np.argmin(profile(m, precision, grid, scale, True)[0]))]
    best = np.where((best <= _LEAST * typical * 1.01) & (m.least == 0.0), 0.0, best)
    square = profile(m, precision, best, scale, True)[1]
    return Scatter(best, float(np.sqrt(square)))


@lru_cache(maxsize=16)
def _grid(values: tuple[float, ...], effects: int) -> Array:
    return np.array(list(itertools.product(values, repeat=effects))).reshape(-1, effects)
