"""How large the noise of a measurement is: sigma^2 = absolute^2 + (relative * level)^2, by channel.

From repeats where there are enough (what rows of one run differ by, after the model has explained what
differs in their settings), else from declared standard deviations, else from the residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.observations import Observations

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
    """How large each measured quantity really is: half the run's median, half the model.

    The model alone may lack an effect, the measurement alone is noisy.
    """
    level = np.empty(len(observations))
    key = observations.run * len(observations.channels) + observations.channel
    _, group = np.unique(key, return_inverse=True)
    order = np.argsort(group.reshape(-1), kind="stable")
    ends = np.flatnonzero(np.diff(group.reshape(-1)[order])) + 1
    for rows in np.split(order, ends):
        ratio = observations.value[rows] - predicted[rows]
        level[rows] = predicted[rows] + 0.5 * np.median(ratio)
    floor = 0.02 * np.median(np.abs(observations.value))
    return np.maximum(np.abs(level), floor)


def _within(
    observations: Observations, residual: Array, mask: Mask
) -> tuple[Array, NDArray[np.intp], Array]:
    """Spread of the residuals in each run with repeats: mean square, degrees of freedom, members."""
    rows = np.flatnonzero(mask)
    _, group = np.unique(observations.run[rows], return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    mean = np.bincount(group, residual[rows]) / count
    square = np.bincount(group, (residual[rows] - mean[group]) ** 2)
    return square, (count - 1).astype(np.intp), group


def _two_terms(square: Array, freedom: NDArray[np.intp], level: Array) -> tuple[float, float]:
    """Absolute and relative noise from sums of squares at levels, by gamma likelihood on a grid."""
    middle = float(np.sqrt(np.mean(level**2)))
    total = float(freedom.sum())
    best, answer = np.inf, (0.0, 0.0)
    for share in _SHARES:
        shape = (1.0 - share) + share * (level / middle) ** 2
        scale = float(np.sum(square / shape)) / total
        cost = total * np.log(max(scale, 1e-300)) + float(np.sum(freedom * np.log(shape)))
        if cost < best - 1e-9:
            best = cost
            answer = np.sqrt((1.0 - share) * scale), np.sqrt(share * scale) / middle
    return float(answer[0]), float(answer[1])


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
        square, freedom, group = _within(observations, residual, good)
        there = freedom > 0
        declared = observations.declared[good]
        stated = np.isfinite(declared)
        if int(freedom.sum()) >= _FEWEST_REPEATS:
            mean = np.bincount(group, level[good]) / np.maximum(np.bincount(group), 1)
            absolute, relative = _two_terms(square[there], freedom[there], mean[there])
            found = ChannelNoise(absolute, relative, "repeats", int(freedom.sum()))
        elif stated.all() and stated.size:
            found = ChannelNoise(float(np.sqrt(np.mean(declared**2))), 0.0, "declared", stated.size)
        else:
            each = np.ones(int(good.sum()), dtype=np.intp)
            lost = max(1.0 - parameters / max(int(used.sum()), 1), 0.2)
            absolute, relative = _two_terms(residual[good] ** 2 / lost, each, level[good])
            found = ChannelNoise(absolute, relative, "residuals", int(good.sum()))
        channels[name] = found
        variance[mask] = found.variance(level[mask])
        if found.source == "declared":
            own = observations.declared[mask]
            variance[mask] = np.where(np.isfinite(own), own**2, variance[mask])
    return Noise(channels, level, variance)
