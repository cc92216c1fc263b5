# SPDX-License-Identifier: Apache-2.0
"""Pictures of one model: of a fit, of a learnt law, of held-out errors before and after effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.results import ResultError
from smallwheel_ros.diagnosis.apply import Added
from smallwheel_ros.fitting.result import FitResult
from smallwheel_ros.learn.learning import Learnt
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import display, number, words
from smallwheel_ros.pictures.house import GREY, INK, WITH_COLOUR, Bar, bars, draw, new_figure
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
) -> None:
    """Held-out error of one channel, a bar for each model.

    errors: by the bar's name, the error by channel, m or N. floor: that of a true model by channel.
    """
    names = [c for c in CHANNEL_UNITS if any(e.get(c) is not None for e in errors.values())]
    name = chosen_channel(channel, names)
    shown = display(name, unit_of(name))
    rows = [Bar(label, found.get(name), WITH_COLOUR) for label, found in errors.items()]
    rows[0] = rows[0]._replace(colour=GREY)
    label, level = f"held-out RMSE [{shown.unit}]", (floor or {}).get(name)
    bars(axes, rows, label, words(name), level, shown.scale)
