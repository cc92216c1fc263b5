# SPDX-License-Identifier: Apache-2.0
"""The estimator's innovations along a drive, without and with an effect in its model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smallwheel_ros.estimator.reading import Reading, UpdateResult
from smallwheel_ros.views.plots import PALETTE, Panel, decorate

Array = NDArray[np.float64]

_LIMIT = 6.0  # standard deviations shown
_LAGS = 12
_CHANCE = 1.96  # of a correlation's standard deviation


@dataclass(frozen=True)
class Innovations:
    """What one estimator made of a drive; arrays of shape (measurements,).

    normalised: innovation over its standard deviation. wheel: number of the wheel. alarm: travel (m)
    at which a missing effect was named first, None: never.
    """

    title: str
    distance: Array
    normalised: Array
    slip: Array
    accepted: NDArray[np.bool_]
    wheel: NDArray[np.intp]
    alarm: float | None

    @classmethod
    def of(
        cls,
        title: str,
        given: Sequence[Reading],
        results: Sequence[UpdateResult],
        alarm: float | None,
    ) -> Innovations:
        """Collect them from an estimator's answers; refused measurements have none."""
        numbers: dict[str, int] = {}
        rows = [
            (
                one.distance,
                result.innovation / math.sqrt(result.innovation_variance),
                math.nan if one.slip is None else one.slip.value,
                result.reason in ("accepted", "soil_changed"),
                numbers.setdefault(one.wheel.name, len(numbers)),
            )
            for one, result in zip(given, results, strict=True)
            if result.innovation is not None and result.innovation_variance
        ]
        distance, normalised, slip, accepted, wheel = (
            np.array(column) for column in zip(*rows, strict=True)
        )
        return cls(title, distance, normalised, slip, accepted, wheel, alarm)

    @property
    def correlation(self) -> tuple[Array, Array]:
        """Correlation of a wheel's innovations with its later ones by lag 1.., and its chance size.

        Innovations are cut off at three standard deviations: outliers would hide the rest.
        """
        wheels = [np.clip(self.normalised[self.wheel == w], -3, 3) for w in np.unique(self.wheel)]
        square = sum(float(np.sum(v * v)) for v in wheels)
        lagged = [sum(float(v[i:] @ v[:-i]) for v in wheels) / square for i in range(1, _LAGS + 1)]
        return np.array(lagged), np.full(_LAGS, _CHANCE / math.sqrt(self.normalised.size))


def innovations_picture(before: Innovations, after: Innovations) -> Figure:
    """Draw both: innovations along the way and over slip, and their correlation."""
    figure = Figure(figsize=(12.0, 6.4), layout="constrained")
    panels = figure.subplots(2, 3, width_ratios=(2.2, 1.0, 1.0))
    for row, one in zip(panels, (before, after), strict=True):
        _along(row[0], one)
        _over_slip(row[1], one)
        _correlation(row[2], one)
    return figure


def _along(axes: Axes, one: Innovations) -> None:
    shown = np.clip(one.normalised, -_LIMIT, _LIMIT)
    for taken, colour, label in (
        (one.accepted, PALETTE["with"], "used"),
        (~one.accepted, PALETTE["w1"], "taken for outliers"),
    ):
        share = f"{label} ({100.0 * np.mean(taken):.1f} %)"
        axes.plot(one.distance[taken], shown[taken], ".", color=colour, markersize=2, label=share)
    if one.alarm is not None:
        axes.axvline(one.alarm, color=PALETTE["ink"], linewidth=1.0)
        axes.text(one.alarm, 0.93 * _LIMIT, " alarm", fontsize=8, color=PALETTE["ink"], va="top")
    axes.set_ylim(-_LIMIT, _LIMIT)
    decorate(axes, Panel("travel [m]", "innovation [standard deviations]", one.title))
    axes.legend(fontsize=7, loc="lower right", markerscale=4, framealpha=0.9)


def _over_slip(axes: Axes, one: Innovations) -> None:
    shown = np.clip(one.normalised, -_LIMIT, _LIMIT)
    axes.plot(one.slip, shown, ".", color=PALETTE["base"], markersize=1.5)
    known = np.isfinite(one.slip)
    edges = np.unique(np.quantile(one.slip[known], np.linspace(0, 1, 13))) if known.any() else []
    for low, high in pairwise(edges):
        inside = known & (one.slip >= low) & (one.slip <= high)
        if inside.sum() > 5:
            middle = float(np.median(shown[inside]))
            axes.plot([low, high], [middle, middle], color=PALETTE["w1"], linewidth=2.5)
    axes.set_ylim(-_LIMIT, _LIMIT)
    decorate(axes, Panel("slip", "", "over slip, with medians"))


def _correlation(axes: Axes, one: Innovations) -> None:
    found, chance = one.correlation
    lags = np.arange(1, _LAGS + 1)
    axes.fill_between(lags, -chance, chance, color="#dfe6ee", label="chance, 95 %")
    axes.plot(lags, found, "o-", color=PALETTE["with"], markersize=4, linewidth=1.0)
    axes.axhline(0.0, color=PALETTE["base"], linewidth=0.6)
    axes.set_ylim(-0.3, 1.0)
    decorate(axes, Panel("measurements later", "", "correlation of one wheel's innovations"))
    axes.legend(fontsize=7, loc="upper right")
