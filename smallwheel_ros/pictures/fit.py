# SPDX-License-Identifier: Apache-2.0
"""Pictures on axes that are given: of a fit, an added effect, a comparison and a diagnosis in one panel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.results import ResultError
from smallwheel_ros.fitting.result import FitResult
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import display, number, words
from smallwheel_ros.pictures.house import COLOURS, GREY, INK, plain, style


def chosen_channel(channel: str | None, known: Sequence[str]) -> str:
    """The channel to draw, the first where none is asked for. Raises ResultError."""
    if not known:
        raise ResultError("there is nothing to draw: no channel has an error")
    if channel is None:
        return known[0]
    if channel not in known:
        raise ResultError(f"no channel '{channel}' to draw: {nearest(str(channel), list(known))}")
    return channel


def measured_over_predicted(axes: Axes, fit: FitResult, channel: str | None = None) -> Axes:
    """Measured over predicted in sample, with the line of a perfect model."""
    name = chosen_channel(channel, list(fit.residuals))
    shown = display(name, CHANNEL_UNITS[name])
    measured = shown.scale * fit.measurements.channels[name]
    predicted = measured - shown.scale * fit.residuals[name]
    known = np.isfinite(predicted)
    ends = [float(np.min([measured[known], predicted[known]])),
            float(np.max([measured[known], predicted[known]]))]  # fmt: skip
    axes.plot(ends, ends, color=GREY, linewidth=1.0)
    axes.scatter(predicted[known], measured[known], s=12, alpha=0.65, linewidth=0, color=COLOURS[2])
    style(axes, f"predicted {shown.label}", f"measured {shown.label}", fit.bare.headline())
    return axes


def error_steps(
    axes: Axes,
    errors: Mapping[str, Mapping[str, float | None]],
    channel: str | None = None,
    floor: Mapping[str, float | None] | None = None,
) -> Axes:
    """Held-out error of one channel, a bar for each model.

    errors: by the bar's name, the error by channel, m or N. floor: that of a true model by channel.
    """
    names = [c for c in CHANNEL_UNITS if any(e.get(c) is not None for e in errors.values())]
    name = chosen_channel(channel, names)
    shown = display(name, unit_of(name))
    heights = [np.nan if (e := found.get(name)) is None else shown.scale * e
               for found in errors.values()]  # fmt: skip
    at = np.arange(len(heights))
    axes.bar(at, heights, 0.62, color=[GREY] + [COLOURS[2]] * (len(heights) - 1))
    for x, height in zip(at, heights, strict=True):
        if np.isfinite(height):
            axes.annotate(number(height), (float(x), height), (0, 3), textcoords="offset points",
                          ha="center", fontsize=8.5, color=INK,
                          bbox={"fc": "white", "ec": "none", "pad": 0.2})  # fmt: skip
    level = (floor or {}).get(name)
    top = float(np.nanmax([*heights, shown.scale * (level or 0.0)]))
    if level is not None:
        level *= shown.scale
        axes.axhline(level, color=INK, linewidth=1.0, linestyle="--")
        axes.annotate(f"a true model\n{number(level)}", (len(heights) - 0.5, level), (4, 3),
                      textcoords="offset points", fontsize=8, color=INK)  # fmt: skip
    axes.set_xlim(-0.55, len(heights) - 0.5 + (0.0 if level is None else 0.95))
    style(axes, "", f"held-out RMSE [{shown.unit}]", words(name))
    axes.grid(visible=False, axis="x")
    axes.set_xticks(at, [plain(text) for text in errors])
    axes.set_ylim(0.0, 1.25 * top or 1.0)
    return axes
