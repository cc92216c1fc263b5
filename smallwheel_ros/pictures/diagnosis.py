# SPDX-License-Identifier: Apache-2.0
"""Pictures of a diagnosis, most of them drawn from its JSON document alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smallwheel_ros.diagnosis.document import failing_settings
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import listed, words
from smallwheel_ros.pictures.comparison import resistance_picture
from smallwheel_ros.pictures.fit import error_steps
from smallwheel_ros.pictures.house import COLOURS, Bar, bars, draw, grid, key_outside, new_figure
from smallwheel_ros.pictures.layers import BASE, WITH, Shown, curve_plots, residual_plot

_STATUS_COLOURS = {
    "significant": COLOURS[2],
    "confounded": COLOURS[1],
    "not_significant": "#c3c8cf",
}
_MOST_PANELS = 3
SHOWN = 0.01  # probability under which an effect is counted, not shown


def staircase(document: Mapping[str, Any]) -> Figure | None:
    """Held-out error after each effect was added, beside that of a true model; None without steps."""
    steps = document.get("steps") or []
    channels = [name for name in CHANNEL_UNITS if any(name in s["held_out_rmse"] for s in steps)]
    if not channels:
        return None
    errors = errors_of_steps(document)
    figure, panels = grid(len(channels), 3.6, 1.2 + 0.32 * len(steps))
    for axes, channel in zip(panels, channels, strict=True):
        error_steps(axes, errors, channel, floors_of(document))
    return figure


def draw_steps(axes: Axes, diagnosis: Diagnosis, channel: str | None = None) -> None:
    """Held-out error of one channel after each step."""
    document = diagnosis.document
    error_steps(axes, errors_of_steps(document), channel, floors_of(document))


def errors_of_steps(document: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """Held-out error by channel after each step, by the step's name."""
    found: dict[str, dict[str, float | None]] = {}
    for step in document.get("steps") or []:
        name = "base model" if step["added"] is None else f"+ {words(step['added'])}"
        found[name] = dict(step["held_out_rmse"])
    return found


def floors_of(document: Mapping[str, Any]) -> dict[str, float | None]:
    """Expected error of a true model by channel."""
    channels = document.get("channels") or {}
    return {name: channel.get("noise_floor") for name, channel in channels.items()}


def ranking_bars(document: Mapping[str, Any]) -> Figure | None:
    """Probability of each effect, those of instruments hatched; None where none is probable."""
    rows = [
        row
        for row in document.get("ranking") or []
        if row["status"] in _STATUS_COLOURS and (row.get("probability") or 0.0) >= SHOWN
    ]
    if not rows:
        return None
    figure = new_figure(6.4, 0.9 + 0.27 * len(rows))
    shown = [
        Bar(_label(row["effect"]), row["probability"], _STATUS_COLOURS[row["status"]],
            hatched=row.get("kind") == "instrument")
        for row in rows
    ]  # fmt: skip
    axes = figure.subplots()
    bars(axes, shown, "probability")
    axes.set_xlim(0.0, 1.08)
    return figure


def _label(effect: str) -> str:
    return words(effect.replace("unknown:", "something over ").replace("@", " at "))


def unknown_curves(document: Mapping[str, Any]) -> Figure | None:
    """The smooth of each setting that something without a name follows; None where there is none."""
    plots = curve_plots(document)
    if not plots:
        return None
    figure, panels = grid(len(plots), 3.6, 2.7)
    for axes, plot in zip(panels, plots, strict=True):
        draw(axes, plot)
    return figure


def figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Every picture of a diagnosis that there is, by name."""
    unknown = diagnosis.document["verdict"] == "unknown_effect"
    found = {
        "resistance_ratio": resistance_picture(diagnosis.measurements),
        "residuals": _residuals(diagnosis),
        "ranking": ranking_bars(diagnosis.document),
        "curves": unknown_curves(diagnosis.document) if unknown else None,
        "staircase": staircase(diagnosis.document),
    }
    return {name: figure for name, figure in found.items() if figure is not None}


def _residuals(diagnosis: Diagnosis) -> Figure | None:
    """Held-out errors over the settings at which the model fails, before and after what was added."""
    if not diagnosis.steps:
        return None
    first, *added = diagnosis.steps
    models = [(first.errors, (BASE, "base model"))]
    if added:
        names = [step.added for step in added if step.added is not None]
        models.append((added[-1].errors, (WITH, f"with {listed(names)}")))
    pairs = failing_settings(diagnosis.document, diagnosis.problem.points.settings)
    pairs = pairs[:_MOST_PANELS] or [(name, "load") for name in first.errors.error]
    figure, panels = grid(len(pairs), 3.5, 3.0)
    for axes, (channel, setting) in zip(panels, pairs, strict=True):
        shown = [Shown(errors.error[channel], *look) for errors, look in models]
        run = first.errors.run
        draw(axes, residual_plot(diagnosis.measurements, run, shown, channel, setting))
    key_outside(figure, [look for _, look in models])
    return figure
