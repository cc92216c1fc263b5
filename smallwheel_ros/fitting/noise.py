# SPDX-License-Identifier: Apache-2.0
"""The size of each value and its repeatability: what rows of one point differ by, and which do not belong.

    sigma^2 = absolute^2 + (relative * level)^2    by channel, from sums of squares within points

Where the table states deviations, these are taken times one factor, which repeats determine. The level is
the size of the value as the model has it; of pull the load, of torque the load times the radius.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from smallwheel_ros.fitting.constants import (
    CLEAN,
    FORCE_LUGS,
    FORCE_WHEEL,
    OUTLIER,
    ROW_NOISE,
)
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Source = Literal["repeats", "declared", "residuals"]

_SMALLEST = 0.05  # of a channel's median: least level of a value
_SHARES = np.linspace(0.0, 1.0, 21)  # of the variance that grows with the level
MOST_OUTLIERS = 0.10  # of the points; where more than one have some, the noise is heavy
NORMAL = 1.4826  # median absolute deviation to standard deviation, Gaussian
_FEWEST = 3  # rows of a point from which its middle is told from an outlier


def of_load(conditions: Conditions, channel: str) -> Array:
    """What a pull (N) is measured by, the load, and a torque (N m), the load times the radius, (rows,)."""
    return conditions.load * (0.5 * conditions.diameter if channel == "torque" else 1.0)


def wheel_discrepancy(conditions: Conditions) -> Array:
    """What the law of pull and torque is off by for a wheel at all slips, of the load, shape (rows,)."""
    if "grouser_height" not in conditions:
        return np.full(len(conditions), FORCE_WHEEL)
    high = conditions["grouser_height"] >= 0.05 * conditions.diameter
    return np.where(high, FORCE_LUGS, FORCE_WHEEL)


def first_levels(points: Points) -> Array:
    """The size of each value before any fit: as measured, a curve by its own power law of the load.

    A curve along which the load hardly changes (slip was swept) has one size: were each value its own,
    a model that predicts nothing would have the same relative error all along, and that is what a run
    may be off by as a whole.
    """
    level = _of_setting(points)
    loads = points.column("load")
    for channel in range(len(points.channels)):
        mine = points.channel == channel
        if points.channels[channel] in FORCES:
            level[mine] = of_load(points.conditions, points.channels[channel])[points.row[mine]]
            continue
        for run in np.unique(points.run[mine & points.swept]):
            curve = np.flatnonzero(mine & points.swept & (points.run == run) & (points.value > 0))
            if curve.size > 2:
                load, value = np.log(loads[curve]), np.log(points.value[curve])
                line = np.polyfit(load, value, 1) if np.ptp(load) > 0.1 else [value.mean()]
                level[curve] = np.exp(np.polyval(line, load))
    return _floored(points, level)


def _of_setting(points: Points) -> Array:
    """Mean size of the values of one setting and channel, shape (values,); of a curve each its own.

    Not each value's own: relative errors of a model that predicts nothing would all be one.
    """
    size = np.maximum(np.abs(points.value), 1e-12)
    key = points.setting * len(points.channels) + points.channel
    code = np.unique(key, return_inverse=True)[1].reshape(-1)
    mean = np.exp(np.bincount(code, np.log(size)) / np.bincount(code))
    return np.where(points.swept, size, mean[code])


def _floored(points: Points, level: Array) -> Array:
    for channel in range(len(points.channels)):
        mine = points.channel == channel
        least = _SMALLEST * float(np.median(level[mine]))
        level[mine] = np.maximum(level[mine], max(least, 1e-9))
    return level


def levels_from(points: Points, predicted: Array) -> Array:
    """The size of each value as a model has it; of pull the load, of torque that times the radius."""
    level = np.abs(predicted)
    for name in points.forces:
        mine = points.of_channel(name)
        level[mine] = of_load(points.conditions, name)[points.row[mine]]
    return _floored(points, level)


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


def furthest_off(groups: list[Array]) -> list[tuple[int, int]]:
    """Group and place of each value that lies grossly off the others of its group, a few at most.

    Deviations from the group's median over their robust deviation, relative to the group's size. Only the
    worst of a group, since it pulls the others.
    """
    off = [values - np.median(values) for values in groups]
    size = np.array([max(abs(float(np.median(values))), 1e-12) for values in groups])
    size = np.maximum(size, 0.1 * np.median(size))
    shares = [np.abs(o) / s for o, s in zip(off, size, strict=True)]
    known = np.concatenate([np.delete(share, np.argmin(share)) for share in shares])
    deviation = max(NORMAL * float(np.median(known)), 1e-6)
    limit = outlier_limit(known.size) * deviation
    found = [(g, int(np.argmax(s))) for g, s in enumerate(shares) if float(s.max()) > limit]
    return found if len(found) <= max(1.0, MOST_OUTLIERS * len(groups)) else []


def outlier_limit(count: int) -> float:
    """Robust deviations from which one of so many values is an outlier.

    `OUTLIER`, and more where so few values know their deviation that chance alone would exceed it in one
    table of `1 / CLEAN`: a median knows about half as much as a sum of squares.
    """
    return max(OUTLIER, float(student.isf(0.5 * CLEAN / max(count, 1), max(0.5 * count, 1.0))))


def outlier_rows(points: Points) -> Index:
    """Rows that lie grossly off the others of their point."""
    found: list[int] = []
    for name in points.channels:
        measured = points.measurements.channels[name]
        mask = points.of_channel(name) & (points.count >= _FEWEST) & ~points.swept
        members = [points.rows[i] for i in np.flatnonzero(mask)]
        if members:
            far = furthest_off([measured[rows] for rows in members])
            found += [int(members[g][i]) for g, i in far]
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
