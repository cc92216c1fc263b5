# SPDX-License-Identifier: Apache-2.0
"""Pictures of a comparison; each function returns a matplotlib figure and writes nothing."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from smallwheel_ros.compare.comparison import Comparison, ModelResult
from smallwheel_ros.compare.resistance_ratio import resistance_ratio
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import Display, column_display, display, number, words
from smallwheel_ros.measurements.settings import levels, varied_settings
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Array
from smallwheel_ros.pictures.fit import chosen_channel
from smallwheel_ros.pictures.house import COLOURS, GREY, INK, new_figure, plain, style
from smallwheel_ros.pictures.smoothing import smooth

_MOST_POINTS = 3000  # of a scatter: beyond, the eye sees no more and the file grows
_PANELS = 3  # a row of a grid


def _grid(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(count, _PANELS)
    rows = -(-count // columns)
    figure = new_figure(max(width * columns, 4.5), height * rows)
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes[:count]


def _colours(comparison: Comparison) -> list[str]:
    """One for each model; a constant is grey."""
    count = itertools.count()
    return [
        GREY if m.model is None else COLOURS[next(count) % len(COLOURS)] for m in comparison.models
    ]


def _thinned(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    if rows.size <= _MOST_POINTS:
        return rows
    return np.sort(np.random.default_rng(0).choice(rows, _MOST_POINTS, replace=False))


def _residual(comparison: Comparison, result: ModelResult, channel: str) -> tuple[Array, bool]:
    """Held-out residuals where there are, else in sample; and which it is."""
    held_out = result.held_out is not None
    return comparison.residual(result, channel, held_out), held_out


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
    height = 1.1 + 0.42 * len(comparison.models)
    figure = new_figure(max(3.6 * len(channels), 5.0), height)
    panels = figure.subplots(1, len(channels), squeeze=False, sharey=True)[0]
    for axes, channel in zip(panels, channels, strict=True):
        draw_errors(axes, comparison, channel)
    panels[0].invert_yaxis()
    expected = any(comparison.noise[channel].value is not None for channel in channels)
    known = "   dashed: expected of a true model" if expected else ""
    figure.suptitle(
        "solid: held out, with its standard error   pale: in sample" + known,
        fontsize=8.5,
        color=INK,
        x=0.01,
        ha="left",
    )
    return figure


def draw_comparison(axes: Axes, comparison: Comparison, channel: str | None = None) -> None:
    """Each model's error of one channel, the first if not given. Raises ResultError."""
    draw_errors(axes, comparison, chosen_channel(channel, comparison.channels))


def draw_errors(axes: Axes, comparison: Comparison, channel: str) -> None:
    """Held-out (solid) and in-sample (pale) RMSE of one channel, a bar for each model."""
    shown = display(channel, CHANNEL_UNITS[channel])
    for i, (result, colour) in enumerate(zip(comparison.models, _colours(comparison), strict=True)):
        inside = comparison.score(result, channel)
        outside = comparison.score(result, channel, held_out=True)
        if outside is not None:
            error = shown.scale * (outside.rmse_std or 0.0)
            axes.barh(i - 0.17, shown.scale * outside.rmse, 0.34, color=colour, xerr=error,
                      error_kw={"elinewidth": 0.9, "ecolor": INK})  # fmt: skip
        if inside is not None:
            axes.barh(i + 0.17, shown.scale * inside.rmse, 0.34, color=colour, alpha=0.4)
    floor = comparison.noise[channel].value
    if floor is not None:
        axes.axvline(shown.scale * floor, color=INK, linewidth=1.0, linestyle="--")
    style(axes, f"RMSE of {shown.label}")
    names = [plain(result.contender.name) for result in comparison.models]
    axes.set_yticks(range(len(names)), names)
    axes.set_xlim(left=0.0)


def measured_against_predicted(comparison: Comparison, channel: str) -> Figure:
    """Measured over predicted, a panel for each model, with the line of a perfect model."""
    shown = display(channel, CHANNEL_UNITS[channel])
    able = [m for m in comparison.models if np.isfinite(comparison.residual(m, channel)).any()]
    figure, panels = _grid(len(able), 3.1, 3.0)
    measured = comparison.measurements.channels[channel] * shown.scale
    colour_of = dict(zip([m.contender.name for m in comparison.models], _colours(comparison),
                         strict=True))  # fmt: skip
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    margin = 0.06 * max(high - low, 1e-9)
    repeats = comparison.noise[channel].repeatability
    for axes, result in zip(panels, able, strict=True):
        residual, held_out = _residual(comparison, result, channel)
        rows = _thinned(np.flatnonzero(np.isfinite(residual)))
        predicted = measured - residual * shown.scale
        ends = np.array([low - margin, high + margin])
        if repeats is not None:
            band = 2.0 * repeats * shown.scale
            axes.fill_between(ends, ends - band, ends + band, color="#e3e6ea", linewidth=0)
        axes.plot(ends, ends, color=GREY, linewidth=1.0)
        colour = colour_of[result.contender.name]
        axes.scatter(predicted[rows], measured[rows], s=10, alpha=0.65, linewidth=0, color=colour,
                     rasterized=rows.size > 500)  # fmt: skip
        found = comparison.score(result, channel, held_out)
        error = "" if found is None else f"   RMSE {number(found.rmse * shown.scale)} {shown.unit}"
        kind = (
            "held out" if held_out else "in sample" if result.contender.fitted else "as it stands"
        )
        style(axes, f"predicted {shown.label}", f"measured {shown.label}",
              f"{result.contender.name}\n{kind}{error}")  # fmt: skip
        axes.set_ylim(*ends)
        reach = predicted[rows]
        axes.set_xlim(min(ends[0], reach.min() - margin), max(ends[1], reach.max() + margin))
    return figure


def residuals(comparison: Comparison, channel: str, focus: int = -1) -> Figure | None:
    """Residual over each condition that varies: points, smooth and 95 % band of one model.

    focus: index of that model (default the last); the others are thin lines. None where nothing
    varies.
    """
    columns = varied_settings(comparison.measurements)
    result = comparison.models[focus]
    if not columns or not np.isfinite(comparison.residual(result, channel)).any():
        return None
    shown = display(channel, CHANNEL_UNITS[channel])
    figure, panels = _grid(len(columns), 3.1, 2.6)
    repeats = comparison.noise[channel].repeatability
    colours = _colours(comparison)
    for axes, (name, column) in zip(panels, columns.items(), strict=True):
        across = column_display(comparison.measurements, name)
        if repeats is not None:
            level = 2.0 * repeats * shown.scale
            axes.axhspan(-level, level, color="#eceef1", linewidth=0)
        axes.axhline(0.0, color=GREY, linewidth=0.9)
        for i, other in enumerate(comparison.models):
            if other is not result:
                _curve(axes, comparison, other, channel, column, (across, shown), colours[i], False)
        _curve(axes, comparison, result, channel, column, (across, shown), colours[focus], True)
        style(axes, plain(across.label), f"measured - predicted [{shown.unit}]")
    held_out = result.held_out is not None
    figure.suptitle(
        plain(
            f"{words(channel)}, {result.contender.name}{' held out' if held_out else ''}: points, "
            "smooth and 95 % band over runs; thin: other models; grey: ±2 repeatability"
        ),
        fontsize=8.5,
        color=INK,
        x=0.01,
        ha="left",
    )
    lines = [Line2D([], [], color=colour, linewidth=1.8) for colour in colours]
    names = [plain(m.contender.name) for m in comparison.models]
    figure.legend(lines, names, loc="outside lower left", ncols=4, fontsize=8, frameon=False)
    return figure


def _curve(
    axes: Axes,
    comparison: Comparison,
    result: ModelResult,
    channel: str,
    column: Array,
    shown: tuple[Display, Display],
    colour: str,
    full: bool,
) -> None:
    residual, _ = _residual(comparison, result, channel)
    rows = _thinned(np.flatnonzero(np.isfinite(residual) & np.isfinite(column)))
    if rows.size < 3 or np.ptp(column[rows]) == 0.0:
        return
    x, y = column[rows] * shown[0].scale, residual[rows] * shown[1].scale
    few = levels(x)
    curve = smooth(x, y, comparison.run[rows], few)
    mark = "o" if few is not None else ""
    if not full:
        axes.plot(curve.x, curve.y, color=colour, linewidth=0.9, alpha=0.8, marker=mark,
                  markersize=2.5)  # fmt: skip
        return
    axes.scatter(x, y, s=7, alpha=0.35, color=colour, linewidth=0, rasterized=rows.size > 500)
    # Where few points are, the band may run far out of the picture.
    margin = 0.12 * max(float(np.ptp(y)), 1e-9)
    axes.set_ylim(min(float(y.min()), 0.0) - margin, max(float(y.max()), 0.0) + margin)
    axes.plot(curve.x, curve.y, color=colour, linewidth=1.8, marker=mark, markersize=4)
    if few is None:
        axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0)
    else:
        axes.vlines(curve.x, curve.low, curve.high, color=colour, linewidth=1.4)


def resistance_picture(measurements: Measurements) -> Figure | None:
    """R/W over sqrt(z/D); None where sinkage and resistance were not measured together."""
    found = resistance_ratio(measurements)
    if found is None:
        return None
    figure = new_figure(5.2, 3.6)
    axes = figure.subplots()
    for (n, y), line in zip(found.lines.items(), ("-", "--", ":"), strict=True):
        axes.plot(found.line_x, y, color=INK, linewidth=1.1, linestyle=line,
                  label=f"compaction alone, n = {n:g}")  # fmt: skip
    for i, name in enumerate(np.unique(found.soil)):
        chosen = found.soil == name
        axes.scatter(found.x[chosen], found.y[chosen], s=12, alpha=0.65, linewidth=0,
                     color=COLOURS[(2 + i) % len(COLOURS)],
                     label=plain(str(name) or "measured"))  # fmt: skip
    style(axes, "√(sinkage / diameter)", "resistance / load")
    axes.set_xlim(left=0.0)
    axes.legend(fontsize=8, frameon=False)
    return figure
