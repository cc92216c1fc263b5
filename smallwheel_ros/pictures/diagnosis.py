"""Pictures of a diagnosis, drawn from its JSON document alone."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from smallwheel_ros.display import display, number, words
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.pictures.comparison import COLOURS, GREY, INK, new_figure, style

_STATUS_COLOURS = {
    "significant": COLOURS[2],
    "confounded": COLOURS[1],
    "not_significant": "#c3c8cf",
}
SHOWN = 0.01  # probability under which an effect is counted, not shown


def _plain(text: str) -> str:
    return text.replace("$", r"\$")


def staircase(document: Mapping[str, Any]) -> Figure | None:
    """Held-out error after each effect was added, down to the noise floor; None without steps."""
    steps = document.get("steps") or []
    channels = [name for name in CHANNEL_UNITS if any(name in s["held_out_rmse"] for s in steps)]
    if not channels:
        return None
    names = ["base model" if s["added"] is None else f"+ {words(s['added'])}" for s in steps]
    figure = new_figure(max(len(channels) * max(3.4, 0.9 * len(steps) + 1.6), 4.2), 2.9)
    panels = figure.subplots(1, len(channels), squeeze=False)[0]
    at = np.arange(len(steps))
    for axes, channel in zip(panels, channels, strict=True):
        shown = display(channel, CHANNEL_UNITS[channel])
        errors = [s["held_out_rmse"].get(channel) for s in steps]
        heights = np.array([np.nan if e is None else e * shown.scale for e in errors])
        axes.bar(at, heights, 0.62, color=[GREY] + [COLOURS[2]] * (len(steps) - 1))
        for x, height in zip(at, heights, strict=True):
            if np.isfinite(height):
                axes.annotate(number(height), (x, height), (0, 3), textcoords="offset points",
                              ha="center", fontsize=8.5, color=INK,
                              bbox={"fc": "white", "ec": "none", "pad": 0.2})  # fmt: skip
        floor = (document.get("channels") or {}).get(channel, {}).get("noise_floor")
        top = float(np.nanmax([*heights, (floor or 0.0) * shown.scale]))
        right = len(steps) - 0.5
        if floor is not None:
            axes.axhline(floor * shown.scale, color=INK, linewidth=1.0, linestyle="--")
            level = floor * shown.scale
            axes.annotate(f"noise floor\n{number(level)}", (right, level), (4, 3),
                          textcoords="offset points", fontsize=8, color=INK)  # fmt: skip
            right += 0.95
        axes.set_xlim(-0.55, right)
        style(axes, "", f"held-out RMSE [{shown.unit}]", words(channel))
        axes.grid(visible=False, axis="x")
        axes.set_xticks(at, [fill(_plain(name), 12) for name in names])
        axes.set_ylim(0.0, 1.25 * top or 1.0)
    return figure


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
    axes.set_yticks(at, [_plain(_label(row["effect"])) for row in rows])
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
        style(axes, _plain(across.label), f"factor on {curve['stage']}")
    return figure
