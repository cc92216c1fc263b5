"""Pictures of a diagnosis, drawn from its JSON document alone."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from smallwheel_ros.compare.scores import UNITS
from smallwheel_ros.display import display, number, words
from smallwheel_ros.pictures.comparison import COLOURS, GREY, INK, new_figure, style

_STATUS_COLOURS = {
    "significant": COLOURS[2],
    "confounded": COLOURS[1],
    "not_significant": "#c3c8cf",
}


def _plain(text: str) -> str:
    return text.replace("$", r"\$")


def staircase(document: Mapping[str, Any]) -> Figure | None:
    """Held-out error after each effect was added, down to the noise floor; None without steps."""
    steps = document.get("steps") or []
    channels = [name for name in UNITS if any(name in s["held_out_rmse"] for s in steps)]
    if not channels:
        return None
    names = ["base model" if s["added"] is None else f"+ {words(s['added'])}" for s in steps]
    figure = new_figure(max(3.4 * len(channels), 1.0 * len(steps) + 2.2, 4.2), 2.9)
    panels = figure.subplots(1, len(channels), squeeze=False)[0]
    at = np.arange(len(steps))
    for axes, channel in zip(panels, channels, strict=True):
        shown = display(channel, UNITS[channel])
        errors = [s["held_out_rmse"].get(channel) for s in steps]
        heights = np.array([np.nan if e is None else e * shown.scale for e in errors])
        axes.bar(at, heights, 0.62, color=[GREY] + [COLOURS[2]] * (len(steps) - 1))
        for x, height in zip(at, heights, strict=True):
            if np.isfinite(height):
                axes.annotate(number(height), (x, height), (0, 3), textcoords="offset points",
                              ha="center", fontsize=8.5, color=INK,
                              bbox={"fc": "white", "ec": "none", "pad": 0.2})  # fmt: skip
        floor = (document.get("channels") or {}).get(channel, {}).get("noise_floor")
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
        axes.set_ylim(0.0, 1.15 * np.nanmax(heights) if np.isfinite(heights).any() else 1.0)
    return figure


def ranking_bars(document: Mapping[str, Any]) -> Figure | None:
    """How much of the error above the noise each effect would explain; None where none was tested."""
    rows = [
        row
        for row in document.get("ranking") or []
        if row["status"] in _STATUS_COLOURS and row.get("reduction") is not None
    ]
    if not rows:
        return None
    figure = new_figure(6.4, 0.9 + 0.27 * len(rows))
    axes = figure.subplots()
    at = np.arange(len(rows))
    share = np.array([100.0 * row["reduction"] for row in rows])
    axes.barh(at, share, 0.7, color=[_STATUS_COLOURS[row["status"]] for row in rows])
    style(axes, "error that adding it would remove, held out [%]")
    axes.grid(visible=False, axis="y")
    axes.set_yticks(at, [_plain(words(row["effect"])) for row in rows])
    axes.set_xlim(min(0.0, float(share.min())), max(100.0, float(share.max())))
    axes.invert_yaxis()
    return figure
