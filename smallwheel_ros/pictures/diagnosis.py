# SPDX-License-Identifier: Apache-2.0
"""Pictures of a diagnosis, most of them drawn from its JSON document alone."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smallwheel_ros.diagnosis.apply import Added
from smallwheel_ros.diagnosis.document import failing_settings
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import display, listed, words
from smallwheel_ros.pictures.comparison import resistance_picture
from smallwheel_ros.pictures.fit import error_steps
from smallwheel_ros.pictures.house import COLOURS, GREY, new_figure, plain, style
from smallwheel_ros.pictures.residuals import AFTER, BEFORE, Shown, residual_panels

_STATUS_COLOURS = {
    "significant": COLOURS[2],
    "confounded": COLOURS[1],
    "not_significant": "#c3c8cf",
}
SHOWN = 0.01  # probability under which an effect is counted, not shown


def staircase(document: Mapping[str, Any]) -> Figure | None:
    """Held-out error after each effect was added, beside that of a true model; None without steps."""
    steps = document.get("steps") or []
    channels = [name for name in CHANNEL_UNITS if any(name in s["held_out_rmse"] for s in steps)]
    if not channels:
        return None
    figure = new_figure(max(len(channels) * max(3.4, 0.9 * len(steps) + 1.6), 4.2), 2.9)
    panels = figure.subplots(1, len(channels), squeeze=False)[0]
    errors = errors_of_steps(document)
    for axes, channel in zip(panels, channels, strict=True):
        error_steps(axes, errors, channel, floors_of(document))
    return figure


def draw_steps(axes: Axes, diagnosis: Diagnosis, channel: str | None = None) -> None:
    """Held-out error of one channel after each step."""
    document = diagnosis.document
    error_steps(axes, errors_of_steps(document), channel, floors_of(document))


def draw_added(axes: Axes, added: Added, channel: str | None = None) -> None:
    """Held-out error of one channel before and after an effect was added."""
    errors: dict[str, dict[str, float | None]] = {
        "without": {**added.before.rmse()},
        f"+ {words(added.effect)}": {**added.after.rmse()},
    }
    error_steps(axes, errors, channel)


def errors_of_steps(document: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """Held-out error by channel after each step, by the step's name."""
    found: dict[str, dict[str, float | None]] = {}
    for step in document.get("steps") or []:
        name = "base model" if step["added"] is None else f"+ {words(step['added'])}"
        found[fill(name, 12)] = dict(step["held_out_rmse"])
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
    axes = figure.subplots()
    at = np.arange(len(rows))
    bars = axes.barh(at, [row["probability"] for row in rows], 0.7,
                     color=[_STATUS_COLOURS[row["status"]] for row in rows])  # fmt: skip
    for bar, row in zip(bars, rows, strict=True):
        if row.get("kind") == "instrument":
            bar.set(hatch="////", edgecolor="white", linewidth=0)
    style(axes, "probability")
    axes.grid(visible=False, axis="y")
    axes.set_yticks(at, [plain(_label(row["effect"])) for row in rows])
    axes.set_xlim(0.0, 1.0)
    axes.invert_yaxis()
    return figure


def _label(effect: str) -> str:
    return words(effect.replace("unknown:", "something over ").replace("@", " at "))


def unknown_curves(document: Mapping[str, Any]) -> Figure | None:
    """The smooth of each setting that something without a name follows; None where there is none."""
    curves = document.get("curves") or []
    if not curves:
        return None
    figure = new_figure(3.4 * len(curves) + 0.6, 2.7)
    for axes, curve in zip(figure.subplots(1, len(curves), squeeze=False)[0], curves, strict=True):
        across = display(curve["setting"], unit_of(curve["setting"]))
        x = across.scale * np.array(curve["x"])
        axes.axhline(1.0, color=GREY, linewidth=0.9)
        axes.fill_between(x, curve["low"], curve["high"], color=COLOURS[2], alpha=0.16, linewidth=0)
        axes.plot(x, curve["factor"], color=COLOURS[2], linewidth=1.7)
        style(axes, plain(across.label), f"factor on {curve['stage']}")
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
    shown = [Shown(first.errors, BEFORE, "base model")]
    if added:
        names = [step.added for step in added if step.added is not None]
        shown.append(Shown(added[-1].errors, AFTER, f"with {listed(names)}"))
    settings = diagnosis.problem.points.settings
    pairs = failing_settings(diagnosis.document, settings)
    return residual_panels(diagnosis.measurements, shown, pairs)
