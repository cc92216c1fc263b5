"""Measurements of one run share what was special about it: a mixed model of runs and rows.

V = D + U diag(tau^2) U', block by block of a run: D the noise of each observation, U the loadings of the
run's random effects (its soil was a little firmer: `ln k`; its resistance read a little high: a channel's own).
All that a likelihood needs is the sums X' D^-1 X over the rows of each run, so its cost does
not grow with the rows:

    V^-1 = D^-1 - D^-1 U W U' D^-1,  W = T (1 + T A T)^-1 T,  A = U' D^-1 U,  T = diag(tau)    (Woodbury)
    ln det V = ln det D + ln det(1 + T A T)

Restricted likelihood: Patterson and Thompson 1971; Harville 1977.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[np.float64]

# tau^2 over the noise variance may go down to this: a grid that starts at 0.02 doubles false alarms.
_LEAST = 1e-3


@dataclass(frozen=True)
class Padding:
    """Observations laid out run by run: shape (runs, longest run), padded."""

    index: NDArray[np.intp]
    real: NDArray[np.bool_]

    @classmethod
    def of(cls, run: NDArray[np.intp]) -> Padding:
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
    """Noise variances D (observations,) and loadings U (observations, effects) of the runs' random effects."""

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

    def inner(self, tau: Array) -> tuple[Array, float]:
        """W of each run, shape (runs, effects, effects), and ln det V."""
        return woodbury(self.products(self.loadings, self.loadings), tau, self.log_noise)

    @property
    def log_noise(self) -> float:
        """Ln det D."""
        return float(np.sum(np.log(self.variance)))


def woodbury(products: Array, tau: Array, log_noise: float) -> tuple[Array, float]:
    """W and ln det V from the sums U' D^-1 U of each run."""
    scaled = np.eye(tau.size) + tau[:, None] * products * tau[None, :]
    inverse = np.linalg.inv(scaled)
    w = tau[:, None] * inverse * tau[None, :]
    return w, log_noise + float(np.sum(np.linalg.slogdet(scaled)[1]))


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

    def at(self, tau: Array) -> tuple[Array, Array, float, float]:
        """X'V^-1X, X'V^-1y, y'V^-1y and ln det V."""
        w, logdet = woodbury(self.uu, tau, self.log_noise)
        wx = w @ self.ux
        xx = self.xx - np.einsum("gqp,gqr->pr", self.ux, wx)
        xy = self.xy - np.einsum("gqp,gq->p", wx, self.uy)
        yy = self.yy - float(np.einsum("gq,gqr,gr->", self.uy, w, self.uy))
        return xx, xy, yy, logdet


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
    )


@dataclass(frozen=True)
class Scatter:
    """The runs' scatter tau (of each random effect) and the common factor on all standard deviations."""

    tau: Array
    scale: float
    minus_two_log_likelihood: float


def restricted(
    m: Moments, precision: Array, tau: Array, scale: float | None
) -> tuple[float, float]:
    """-2 log restricted likelihood and the scale^2 at which it stands (profiled where scale is None)."""
    xx, xy, yy, logdet = m.at(tau)
    xx = xx + precision
    factor = np.linalg.cholesky(xx + 1e-12 * np.diag(np.diag(xx)))
    half = np.linalg.solve(factor, xy)
    rss = max(yy - float(half @ half), 1e-12)
    penalty = 2.0 * float(np.sum(np.log(np.diag(factor))))
    freedom = max(m.count - xy.size, 1)
    square = rss / freedom if scale is None else scale**2
    return freedom * np.log(square) + rss / square + logdet + penalty, square


def fit_scatter(
    m: Moments, precision: Array, typical: Array, scale: float | None = None
) -> Scatter:
    """Runs' scatter by restricted likelihood. typical: a tau that equals the noise, of each effect.

    scale: common factor on all standard deviations; None fits it too.
    """
    if typical.size == 0:
        value, square = restricted(m, precision, typical, scale)
        return Scatter(typical, float(np.sqrt(square)), value)
    low, high = np.log(_LEAST), np.log(1e3)

    def objective(x: Array) -> float:
        return restricted(m, precision, np.exp(x) * typical, scale)[0]

    starts = [np.full(typical.size, np.log(s)) for s in (0.05, 1.0)]
    start = min(starts, key=objective)
    found = minimize(
        objective,
        start,
        method="L-BFGS-B",
        bounds=[(low, high)] * typical.size,
        options={"maxiter": 40, "ftol": 1e-8},
    )
    tau = np.exp(found.x) * typical
    value, square = restricted(m, precision, tau, scale)
    return Scatter(tau, float(np.sqrt(square)), value)
