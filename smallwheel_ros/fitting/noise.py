"""How large the noise of a measurement is: sigma^2 = absolute^2 + (relative * level)^2, by channel.

From repeats where there are enough (what rows of one run differ by, after the model has explained
what differs in their settings), else from declared standard deviations, else from the residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.observations import ROWS_OF_A_CURVE, Observations

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Source = Literal["repeats", "declared", "residuals"]

_FEWEST_REPEATS = 6  # degrees of freedom below which repeats say too little
_SHARES = np.linspace(0.0, 1.0, 21)  # of the variance that is relative
# No instrument agrees with a model better than this: keeps simulated data without noise sane.
_LEAST_RELATIVE = 2e-3


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one channel. absolute: m or N. relative: 1. freedom: degrees of freedom it rests on."""

    absolute: float
    relative: float
    source: Source
    freedom: int

    def variance(self, level: Array) -> Array:
        """sigma^2 at these levels of the measured quantity."""
        return np.asarray(
            self.absolute**2 + (self.relative**2 + _LEAST_RELATIVE**2) * level**2 + 1e-18
        )


@dataclass(frozen=True)
class Noise:
    """Noise of every channel, and the level (m or N) of each observation at which it was taken."""

    channels: Mapping[str, ChannelNoise]
    level: Array
    variance: Array


def reference_level(observations: Observations, predicted: Array) -> Array:
    """How large each measured quantity really is: the run's median, a little of the model.

    The model alone may lack an effect, a single measurement alone is noisy.
    """
    level = np.empty(len(observations))
    key = observations.run * len(observations.channels) + observations.channel
    _, group = np.unique(key, return_inverse=True)
    order = np.argsort(group.reshape(-1), kind="stable")
    ends = np.flatnonzero(np.diff(group.reshape(-1)[order])) + 1
    for rows in np.split(order, ends):
        apart = observations.value[rows] - predicted[rows]
        if observations.swept[rows[0]]:
            level[rows] = predicted[rows] + 0.5 * apart
        else:
            level[rows] = predicted[rows] + rows.size / (rows.size + 1.0) * np.median(apart)
    size = np.abs(observations.value)
    floor = np.zeros(len(observations))
    for name in observations.channels:
        mask = observations.of_channel(name)
        floor[mask] = 0.02 * np.median(size[mask])
    return np.asarray(np.maximum(np.abs(level), floor))


def _within(
    observations: Observations, residual: Array, mask: Mask
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Sums of squares of the residuals about each run's mean, degrees of freedom, and members."""
    rows = np.flatnonzero(mask)
    _, group = np.unique(observations.run[rows], return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    mean = np.bincount(group, residual[rows]) / count
    square = np.bincount(group, (residual[rows] - mean[group]) ** 2)
    freedom: Array = np.asarray(count, dtype=float) - 1.0
    return np.asarray(square, dtype=float), freedom, group.astype(np.intp)


def _two_terms(square: Array, freedom: Array, level: Array) -> tuple[float, float]:
    """Absolute and relative noise from sums of squares at levels: gamma likelihood on a grid.

    The mean over the grid, not its best point: which of the two it is, few repeats hardly say.
    """
    middle = float(np.sqrt(np.mean(level**2)))
    shape = (1.0 - _SHARES)[:, None] + _SHARES[:, None] * (level / middle) ** 2
    scale = np.maximum(np.sum(square / shape, axis=1) / freedom.sum(), 1e-300)
    cost = freedom.sum() * np.log(scale) + np.sum(freedom * np.log(shape), axis=1)
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    absolute = np.sqrt(np.sum(weight * (1.0 - _SHARES) * scale))
    relative = np.sqrt(np.sum(weight * _SHARES * scale)) / middle
    return float(absolute), float(relative)


def estimate_noise(
    observations: Observations, residual: Array, level: Array, used: Mask, parameters: int
) -> Noise:
    """Noise of each channel. residual: measured less predicted. used: what is no outlier.

    parameters: how many were fitted, where the residuals themselves must do.
    """
    channels: dict[str, ChannelNoise] = {}
    variance = np.empty(len(observations))
    for name in observations.channels:
        mask = observations.of_channel(name)
        good = mask & used
        square, freedom, group = _within(observations, residual, good & ~observations.swept)
        there = freedom > 0
        declared = observations.declared[good]
        stated = np.isfinite(declared)
        if int(freedom.sum()) >= _FEWEST_REPEATS:
            repeats = good & ~observations.swept
            mean = np.bincount(group, level[repeats]) / np.maximum(np.bincount(group), 1)
            absolute, relative = _two_terms(square[there], freedom[there], mean[there])
            found = ChannelNoise(absolute, relative, "repeats", int(freedom.sum()))
        elif stated.all() and stated.size:
            found = ChannelNoise(float(np.sqrt(np.mean(declared**2))), 0.0, "declared", stated.size)
        else:
            each = np.ones(int(good.sum()))
            lost = max(1.0 - parameters / max(int(used.sum()), 1), 0.2)
            absolute, relative = _two_terms(residual[good] ** 2 / lost, each, level[good])
            found = ChannelNoise(absolute, relative, "residuals", int(good.sum()))
        channels[name] = found
        variance[mask] = found.variance(level[mask])
        if found.source == "declared":
            own = observations.declared[mask]
            variance[mask] = np.where(np.isfinite(own), own**2, variance[mask])
    # Neighbouring rows of a curve say nearly the same: a curve counts as so many rows at most.
    rows = np.bincount(observations.run, minlength=len(observations.runs))[observations.run]
    variance *= np.where(observations.curves, np.maximum(rows / ROWS_OF_A_CURVE, 1.0), 1.0)
    return Noise(channels, level, variance)
