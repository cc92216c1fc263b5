# SPDX-License-Identifier: Apache-2.0
"""Pictures of one model: of a fit, of a learnt law, of held-out errors before and after effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.results import ResultError
from smallwheel_ros.diagnosis.apply import Added
from smallwheel_ros.fitting.result import FitResult
from smallwheel_ros.learn.learning import Learnt
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import display, number, words
from smallwheel_ros.pictures.house import COLOURS, GREY, INK, draw, new_figure, plain, style
from smallwheel_ros.pictures.layers import WITH, Shown, learnt_plot, measured_plot


def chosen_channel(channel: str | None, known: Sequence[str]) -> str:
    """The channel to draw, the first where none is asked for. Raises ResultError."""
    if not known:
        raise ResultError("there is nothing to draw: no channel has an error")
    if channel is None:
        return known[0]
    if channel not in known:
        raise ResultError(f"no channel '{channel}' to draw: {nearest(str(channel), list(known))}")
    return channel


def draw_fit(axes: Axes, fit: FitResult, channel: str | None = None) -> None:
    """Measured over predicted in sample, with the line of a perfect model."""
    name = chosen_channel(channel, list(fit.residuals))
    one = Shown(fit.residuals[name], WITH, "")
    measured = fit.measurements.channels[name]
    draw(axes, measured_plot(name, measured, one, title=fit.bare.headline()))


def draw_learnt(axes: Axes, learnt: Learnt) -> None:
    """What each setting asks for, and the law; `learnt` has one of a setting."""
    draw(axes, learnt_plot(learnt.document, learnt.tied_curves or ()))
    axes.legend(fontsize=8.5, frameon=False)


def learnt_figures(learnt: Learnt) -> dict[str, Figure]:
    """The picture by name, with how much the channels disagree about each stage; none without a law."""
    if learnt.tied_curves is None:
        return {}
    figure = new_figure(6.4, 4.3)
    draw_learnt(figure.subplots(), learnt)
    stages = learnt.document["stage_disagreement"]
    known = sorted((value, stage) for stage, value in stages.items() if value is not None)
    if known:
        said = ", ".join(f"{stage} {number(value, 2)}" for value, stage in known)
        figure.supxlabel(f"sinkage and resistance disagree about each stage by: {said} (1: noise)",
                         fontsize=8, color=INK, x=0.02, ha="left")  # fmt: skip
    return {"learnt": figure}


def draw_added(axes: Axes, added: Added, channel: str | None = None) -> None:
    """Held-out error of one channel before and after an effect was added."""
    errors: dict[str, dict[str, float | None]] = {
        "without": {**added.before.rmse()},
        f"+ {words(added.effect)}": {**added.after.rmse()},
    }
    error_steps(axes, errors, channel)


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
