# SPDX-License-Identifier: Apache-2.0
"""A smooth curve through scattered points; its band knows that rows of a run belong together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.conditions import Array

_POINTS = 41
_DRAWS = 200
_WIDTH = 0.14  # of the kernel, as a share of the range
_COVER = (2.5, 97.5)  # per cent


class Smooth(NamedTuple):
    """A curve and its 95 % band, each of shape (points,)."""

    x: Array
    y: Array
    low: Array
    high: Array


def smooth(x: Array, y: Array, run: NDArray[np.intp], levels: Array | None = None) -> Smooth:
    """Local linear regression of y over x (Gaussian kernel), band by bootstrap over runs.

    x, y: finite, shape (rows,). run: index of each row's run. levels: where x has only a few
    values, these; the curve then is the mean at each. Points that fewer than 3 runs support have
    no band (NaN). Local linear regression: Cleveland 1979.
    """
    _, run = np.unique(run, return_inverse=True)
    run = run.reshape(-1)
    if levels is None:
        grid = np.linspace(x.min(), x.max(), _POINTS)
        offset = (x - grid[:, None]) / (_WIDTH * np.ptp(x))
        weight = np.exp(-0.5 * offset**2)
    else:
        grid = levels
        offset = np.zeros((grid.size, x.size))
        weight = (np.abs(x - grid[:, None]).argmin(axis=0) == np.arange(grid.size)[:, None]) * 1.0
    runs = int(run.max()) + 1
    draws = np.random.default_rng(0).multinomial(runs, np.full(runs, 1 / runs), _DRAWS)
    times = np.concatenate([np.ones((1, runs)), draws])[:, run].T  # (rows, 1 + draws)
    fitted = _local_linear(weight, offset, y, times)
    support = np.array([np.unique(run[w > 0.3]).size for w in weight])
    known = np.isfinite(fitted[:, 1:]).all(axis=1) & (support >= 3)
    low, high = np.full(grid.size, np.nan), np.full(grid.size, np.nan)
    if known.any():
        low[known], high[known] = np.percentile(fitted[known, 1:], _COVER, axis=1)
    return Smooth(grid, fitted[:, 0], low, high)


def _local_linear(weight: Array, offset: Array, y: Array, times: Array) -> Array:
    """Value at each grid point for each weighting of the rows, shape (points, weightings)."""
    s0, s1, s2 = weight @ times, (weight * offset) @ times, (weight * offset**2) @ times
    t0, t1 = (weight * y) @ times, (weight * offset * y) @ times
    determinant = s0 * s2 - s1**2
    slope_known = determinant > 1e-9 * s0**2
    with np.errstate(divide="ignore", invalid="ignore"):
        line = (s2 * t0 - s1 * t1) / determinant
        mean = t0 / s0
    return np.where(slope_known, line, mean)
