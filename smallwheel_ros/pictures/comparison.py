# SPDX-License-Identifier: Apache-2.0
"""Pictures of a comparison."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import display, number, words
from smallwheel_ros.measurements.settings import varied_settings
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.pictures.fit import chosen_channel
from smallwheel_ros.pictures.house import (
    COLOURS,
    GREY,
    Bar,
    bars,
    draw,
    grid,
    headed,
    key_outside,
    new_figure,
)
from smallwheel_ros.pictures.layers import Shown, measured_plot, ratio_plot, residual_plot


def _shown(comparison: Comparison, channel: str, focus: int = -1) -> list[Shown]:
    """What each model leaves, held out where it was fitted; a constant is grey, the one in focus full."""
    count = itertools.count()
    models = comparison.models
    return [
        Shown(
            comparison.residual(one, channel, held_out=one.held_out is not None),
            GREY if one.model is None else COLOURS[next(count) % len(COLOURS)],
            one.contender.name,
            one is models[focus],
        )
        for one in models
    ]


def all_figures(comparison: Comparison) -> dict[str, Figure]:
    """Every picture of the comparison by name."""
    found: dict[str, Figure | None] = {
        "resistance_ratio": resistance_picture(comparison.measurements)
    }
    if comparison.channels:
        found["errors"] = error_bars(comparison)
    for channel in comparison.channels:
        found[f"{channel}_measured_predicted"] = measured_against_predicted(comparison, channel)
        found[f"{channel}_residuals"] = residuals(comparison, channel)
    return {name: figure for name, figure in found.items() if figure is not None}


def error_bars(comparison: Comparison) -> Figure:
    """Held-out and in-sample RMSE of each model beside each other."""
    channels = comparison.channels
    figure, panels = grid(len(channels), 3.8, 1.2 + 0.42 * len(comparison.models))
    for axes, channel in zip(panels, channels, strict=True):
        draw_comparison(axes, comparison, channel)
    headed(figure, "solid: held out, with its standard error   pale: in sample")
    return figure


def draw_comparison(axes: Axes, comparison: Comparison, channel: str | None = None) -> None:
    """Held-out (solid) and in-sample (pale) RMSE of one channel, the first if not given.

    Raises ResultError where there is no such channel.
    """
    name = chosen_channel(channel, comparison.channels)
    shown, rows = display(name, CHANNEL_UNITS[name]), []
    for result, one in zip(comparison.models, _shown(comparison, name), strict=True):
        outside = comparison.score(result, name, held_out=True)
        inside = comparison.score(result, name)
        value, std = (outside.rmse, outside.rmse_std) if outside else (None, None)
        rows.append(Bar(one.label, value, one.colour, std, inside.rmse if inside else None))
    level = comparison.noise[name].value
    bars(axes, rows, f"RMSE of {shown.label}", level=level, scale=shown.scale)


def measured_against_predicted(comparison: Comparison, channel: str) -> Figure:
    """Measured over predicted, a panel for each model, with the line of a perfect model."""
    unit = display(channel, CHANNEL_UNITS[channel])
    able = [
        (result, one)
        for result, one in zip(comparison.models, _shown(comparison, channel), strict=True)
        if np.isfinite(one.residual).any()
    ]
    figure, panels = grid(len(able), 3.1, 3.0)
    measured = comparison.measurements.channels[channel]
    repeats = comparison.noise[channel].repeatability
    for axes, (result, one) in zip(panels, able, strict=True):
        held_out = result.held_out is not None
        found = comparison.score(result, channel, held_out)
        error = "" if found is None else f"   RMSE {number(found.rmse * unit.scale)} {unit.unit}"
        kind = (
            "held out" if held_out else "in sample" if result.contender.fitted else "as it stands"
        )
        title = f"{result.contender.name}\n{kind}{error}"
        draw(axes, measured_plot(channel, measured, one, repeats, title))
    return figure


def residuals(comparison: Comparison, channel: str, focus: int = -1) -> Figure | None:
    """Residual over each condition that varies: points, smooth and 95 % band of one model.

    focus: index of that model (default the last); the others are thin lines. None where nothing
    varies.
    """
    data, result = comparison.measurements, comparison.models[focus]
    settings = list(varied_settings(data))
    if not settings or not np.isfinite(comparison.residual(result, channel)).any():
        return None
    shown = _shown(comparison, channel, focus)
    figure, panels = grid(len(settings), 3.1, 2.6)
    repeats = comparison.noise[channel].repeatability
    for axes, name in zip(panels, settings, strict=True):
        ordered = sorted(shown, key=lambda one: one.full)
        draw(axes, residual_plot(data, comparison.run, ordered, channel, name, repeats))
    held_out = " held out" if result.held_out is not None else ""
    headed(figure, f"{words(channel)}, {result.contender.name}{held_out}: points, smooth and 95 % band "
           "over runs; thin: other models; grey: ±2 repeatability")  # fmt: skip
    key_outside(figure, [(one.colour, one.label) for one in shown])
    return figure


def resistance_picture(measurements: Measurements) -> Figure | None:
    """R/W over sqrt(z/D); None where sinkage and resistance were not measured together."""
    plot = ratio_plot(measurements)
    if plot is None:
        return None
    figure = new_figure(5.2, 3.6)
    axes = figure.subplots()
    draw(axes, plot)
    axes.set_xlim(left=0.0)
    axes.legend(fontsize=8, frameon=False)
    return figure
