# SPDX-License-Identifier: Apache-2.0
"""Held-out errors over settings: a model as it was, and with what was added to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import column_display, display, words
from smallwheel_ros.measurements.settings import levels
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.pictures.house import COLOURS, GREY, new_figure, plain, style
from smallwheel_ros.pictures.smoothing import smooth

Array = NDArray[np.float64]

BEFORE, AFTER = GREY, COLOURS[2]
_MOST_POINTS = 2000  # of a channel: beyond, the eye sees no more and the file grows
_PANELS = 3


class Shown(NamedTuple):
    """Held-out errors of one model, and how they are drawn."""

    errors: CvErrors
    colour: str
    label: str


def residual_panels(
    measurements: Measurements,
    shown: Sequence[Shown],
    pairs: Sequence[tuple[str, str]],
) -> Figure:
    """A panel for each of the first few pairs of channel and setting; over load if there are none."""
    pairs = list(pairs[:_PANELS]) or [(name, "load") for name in shown[0].errors.error]
    figure = new_figure(3.4 * len(pairs) + 0.4, 3.0)
    panels = figure.subplots(1, len(pairs), squeeze=False)[0]
    for axes, (channel, setting) in zip(panels, pairs, strict=True):
        draw_residuals(axes, measurements, shown, channel, setting)
        axes.set_title(words(channel), fontsize=9.5, loc="left")
    legend(figure, panels[0], shown)
    return figure


def legend(figure: Figure, axes: Axes, shown: Sequence[Shown]) -> None:
    """Say above the panels what each colour is."""
    handles = [axes.scatter([], [], s=20, color=one.colour, linewidth=0) for one in shown]
    labels = [plain(one.label) for one in shown]
    figure.legend(handles, labels, loc="outside upper left", ncols=2, fontsize=8.5, frameon=False)


def draw_residuals(
    axes: Axes,
    measurements: Measurements,
    shown: Sequence[Shown],
    channel: str,
    setting: str,
) -> None:
    """Points, smooth and 95 % band (bootstrap over runs) of each model's held-out errors."""
    how, across = display(channel, CHANNEL_UNITS[channel]), column_display(measurements, setting)
    rows = rows_of(shown[0].errors, channel)
    rows = rows[np.isfinite(measurements.conditions[setting][rows])]  # what is pressed has no slip
    x = measurements.conditions[setting][rows] * across.scale
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    low, high = 0.0, 0.0
    for one in shown:
        y = one.errors.error[channel][rows] * how.scale
        low, high = min([low, *y]), max([high, *y])
        _curve(axes, x, y, one.errors.run[rows], one.colour)
    margin = 0.08 * max(high - low, 1e-9)
    axes.set_ylim(low - margin, high + margin)  # of the points: where few are the band runs far out
    style(axes, plain(across.label), f"measured - predicted [{how.unit}]")


def _curve(axes: Axes, x: Array, y: Array, run: NDArray[np.intp], colour: str) -> None:
    axes.scatter(x, y, s=9, alpha=0.4, color=colour, linewidth=0, rasterized=x.size > 500)
    if x.size < 3 or np.ptp(x) == 0.0:
        return
    few = levels(x)
    curve = smooth(x, y, run, few)
    axes.plot(curve.x, curve.y, color=colour, linewidth=1.7, marker="o" if few is not None else "",
              markersize=4)  # fmt: skip
    if few is None:
        axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.16, linewidth=0)
    else:
        axes.vlines(curve.x, curve.low, curve.high, color=colour, linewidth=1.3)


def rows_of(errors: CvErrors, channel: str) -> NDArray[np.intp]:
    """The rows that have an error of a channel, or as many of them as a picture can show."""
    rows = np.flatnonzero(np.isfinite(errors.error[channel]))
    if rows.size <= _MOST_POINTS:
        return rows
    return np.sort(np.random.default_rng(0).choice(rows, _MOST_POINTS, replace=False))
