# SPDX-License-Identifier: Apache-2.0
"""Repeatability: what rows of one point differ by, and rows that do not belong to their point.

    sigma^2 = absolute^2 + (relative * level)^2    by channel, from sums of squares within points

Where the table states deviations, these are taken times one factor, which repeats determine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from smallwheel_ros.fitting.constants import OUTLIER, ROW_NOISE
from smallwheel_ros.fitting.points import Points

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Source = Literal["repeats", "declared", "residuals"]

_SHARES = np.linspace(0.0, 1.0, 21)  # of the variance that grows with the level
_MOST_OUTLIERS = 0.10  # of the points; where more than one have some, the noise is heavy
_NORMAL = 1.4826  # median absolute deviation to standard deviation, Gaussian
_FEWEST = 3  # rows of a point from which its middle is told from an outlier


@dataclass(frozen=True)
class RowNoise:
    """Repeatability of one row. absolute: m or N. relative: of the level. freedom: repeats."""

    absolute: float
    relative: float
    source: Source
    freedom: int

    def variance(self, level: Array) -> Array:
        """Of one row at these levels."""
        return np.asarray(self.absolute**2 + (self.relative * level) ** 2)


@dataclass(frozen=True)
class Repeats:
    """Repeatability by channel, and what it makes of each value, shape (values,).

    variance: of the mean of its rows. stated: declared deviation of that mean, 0 where repeats or
    nothing stands for it.
    """

    channels: Mapping[str, RowNoise]
    variance: Array
    stated: Array


def _apart(values: Array, swept: bool) -> tuple[Array, int]:
    """What rows of one point are off their mean (a line along a swept run), and degrees of freedom."""
    n = values.size
    apart = values - values.mean()
    if not swept or n < 3:
        return apart, (0 if swept else n - 1)
    x = np.arange(n) - (n - 1) / 2
    return np.asarray(apart - x * (x @ apart) / (x @ x)), n - 2


def outlier_rows(points: Points) -> Index:
    """Rows that lie grossly off the others of their point, a few at most.

    Deviations from the point's median over the channel's robust deviation, which a few repeats hardly
    know: the limit is as unlikely by Student's t as `OUTLIER` deviations are for Gaussian noise. Only
    the worst row of a point, since it pulls the others.
    """
    found: list[int] = []
    for name in points.channels:
        measured = points.measurements.channels[name]
        mask = points.of_channel(name) & (points.count >= _FEWEST) & ~points.swept
        members = [points.rows[i] for i in np.flatnonzero(mask)]
        if not members:
            continue
        off = [measured[rows] - np.median(measured[rows]) for rows in members]
        size = np.array([max(abs(float(np.median(measured[rows]))), 1e-12) for rows in members])
        size = np.maximum(size, 0.1 * np.median(size))
        shares = np.concatenate([np.delete(np.abs(o), np.argmin(np.abs(o))) / s
                                 for o, s in zip(off, size, strict=True)])  # fmt: skip
        deviation = _NORMAL * float(np.median(shares))
        freedom = sum(rows.size - 1 for rows in members) / 2  # a median knows about half as much
        limit = float(student.isf(norm.sf(OUTLIER), freedom)) * max(deviation, 1e-6)
        worst = [int(rows[np.argmax(np.abs(o))]) for rows, o, s in
                 zip(members, off, size, strict=True) if np.max(np.abs(o)) / s > limit]  # fmt: skip
        if len(worst) <= max(1.0, _MOST_OUTLIERS * len(members)):
            found += worst
    return np.unique(np.array(found, dtype=np.intp))


def repeats_of(points: Points, level: Array) -> Repeats:
    """Repeatability of each channel, and the variance that it leaves in each value."""
    channels: dict[str, RowNoise] = {}
    variance, stated = np.zeros(len(points)), np.zeros(len(points))
    for name in points.channels:
        mask = points.of_channel(name)
        measured = points.measurements.channels[name]
        squares, freedom, levels, declared = [], [], [], []
        for i in np.flatnonzero(mask):
            apart, free = _apart(measured[points.rows[i]], bool(points.swept[i]))
            if free > 0:
                squares.append(float(apart @ apart))
                freedom.append(free)
                levels.append(float(level[i]))
                declared.append(float(points.declared[i]))
        known = np.isfinite(points.declared[mask]).all()
        if freedom and known:
            noise, factor = _scaled(np.array(squares), np.array(freedom), np.array(declared))
            variance[mask] = factor * points.declared[mask] ** 2 / points.count[mask]
        elif freedom:
            noise = _two_terms(np.array(squares), np.array(freedom), np.array(levels))
            variance[mask] = noise.variance(level[mask]) / points.count[mask]
        elif known:
            size = float(np.sqrt(np.mean(points.declared[mask] ** 2)))
            noise = RowNoise(size, 0.0, "declared", 0)
            stated[mask] = points.declared[mask] ** 2 / points.count[mask]
        else:
            noise = RowNoise(0.0, ROW_NOISE, "residuals", 0)
        channels[name] = noise
    return Repeats(channels, variance, stated)


def _scaled(squares: Array, freedom: Array, declared: Array) -> tuple[RowNoise, float]:
    """Declared deviations times one factor; before the repeats it is 1, as sure as one repeat."""
    total = freedom.sum() + 1.0
    factor = float((np.sum(squares / declared**2) + 1.0) / total)
    size = float(np.sqrt(factor * np.mean(declared**2)))
    return RowNoise(size, 0.0, "repeats", int(freedom.sum())), factor


def _two_terms(squares: Array, freedom: Array, level: Array) -> RowNoise:
    """Absolute and relative noise: the mean over a grid of shares, each by its likelihood.

    The mean, not the best: few repeats hardly say which of the two it is. `ROW_NOISE` counts as one
    repeat.
    """
    middle = float(np.sqrt(np.mean(level**2)))
    total = float(freedom.sum()) + 1.0
    shape = (1.0 - _SHARES)[:, None] + _SHARES[:, None] * (level / middle) ** 2
    scale = (np.sum(squares / shape, axis=1) + (ROW_NOISE * middle) ** 2) / total
    cost = total * np.log(scale) + np.sum(freedom * np.log(shape), axis=1)
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    absolute = float(np.sqrt(np.sum(weight * (1.0 - _SHARES) * scale)))
    relative = float(np.sqrt(np.sum(weight * _SHARES * scale))) / middle
    return RowNoise(absolute, relative, "repeats", int(freedom.sum()))
