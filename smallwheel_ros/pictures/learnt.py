# SPDX-License-Identifier: Apache-2.0
"""The picture of a learnt law: what each setting asks for, and the law through it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smallwheel_ros.learn.learning import Learnt
from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.measurements.display import display, number, words
from smallwheel_ros.pictures.house import COLOURS, GREY, INK, new_figure, plain, style
from smallwheel_ros.pictures.smoothing import smooth

Array = NDArray[np.float64]

_CHANNELS = {"sinkage": ("std", 2), "resistance": ("resistance_std", 0)}
_AXES = {"n": "added to n", "R": "added resistance over what carries it"}
_FEWEST = 8  # points from which a smooth is drawn


def figures(result: Learnt) -> dict[str, Figure]:
    """The picture by name; none where there is no law of one setting."""
    curves = result.tied_curves
    return {} if curves is None else {"learnt": learnt_figure(result.document, curves)}


def learnt_figure(document: Mapping[str, Any], tied: Sequence[Array] = ()) -> Figure:
    """The picture, with how much the channels disagree about each stage under it."""
    figure = new_figure(6.4, 4.3)
    draw_learnt(figure.subplots(), document, tied)
    stages = {k: v for k, v in document["stage_disagreement"].items() if v is not None}
    if stages:
        said = ", ".join(
            f"{k} {number(v, 2)}" for k, v in sorted(stages.items(), key=lambda s: s[1])
        )
        figure.text(0.02, 0.012, f"sinkage and resistance disagree about each stage by: {said} "
                    "(1: noise)", fontsize=8, color=INK)  # fmt: skip
        figure.set_layout_engine("constrained", rect=(0.0, 0.05, 1.0, 0.95))
    return figure


def draw_law(axes: Axes, learnt: Learnt) -> None:
    """What each setting asks for, and the law; `learnt` has one of a setting."""
    draw_learnt(axes, learnt.document, learnt.tied_curves or ())


def draw_learnt(axes: Axes, document: Mapping[str, Any], tied: Sequence[Array] = ()) -> Axes:
    """Factor against driver: settings with deviations, law black, tied laws grey, smooth dashed.

    tied: curves of tied laws over the document's `shape`. k is fitted anew for each law, so these are
    moved onto the law at the middle of the range.
    """
    shape, law = document["shape"], document["law"]
    place = law or document["places"][0]
    stage, driver = place["stage"], place["drivers"][0]
    shown = display(driver, unit_of(driver))
    x = np.array(shape["x"]) * shown.scale
    axes.axvspan(x[0], x[-1], color="#f2f4f7", zorder=0)
    axes.fill_between(x, shape["low"], shape["high"], color="#d9dde3", linewidth=0, zorder=1)
    middle = len(x) // 2
    for curve in tied:
        aligned = np.asarray(curve) + _shift(np.array(shape["factor"]), curve, middle)
        axes.plot(x, aligned, color=GREY, linewidth=1.0, zorder=2)
    points: list[tuple[float, float]] = []
    for channel, (deviation, colour) in _CHANNELS.items():
        mine = [e for e in document["implied"] if e[channel] is not None]
        if not mine:
            continue
        at = np.array([e["x"] for e in mine]) * shown.scale
        value = np.array([e[channel] for e in mine])
        axes.errorbar(at, value, [e[deviation] for e in mine], fmt="o", markersize=3.5,
                      elinewidth=0.8, color=COLOURS[colour], alpha=0.8, zorder=3,
                      label=f"{words(channel)} asks for")  # fmt: skip
        points += list(zip(at.tolist(), value.tolist(), strict=True))
    if len(points) >= _FEWEST:
        free = np.array(points)
        line = smooth(free[:, 0], free[:, 1], np.arange(len(points)))
        axes.plot(line.x, line.y, color=INK, linewidth=1.0, linestyle="--", zorder=4,
                  label="free smooth")  # fmt: skip
    name = "drafted law" if law is not None else "best formula"
    axes.plot(x, shape["factor"], color="black", linewidth=1.8, zorder=5, label=name)
    if tied:
        axes.plot([], [], color=GREY, linewidth=1.0, label=f"{len(tied)} tied")
    label = _AXES.get(stage, f"factor on {stage}")
    style(axes, shown.label, label, "" if law is None else plain(law["formula"]))
    axes.legend(fontsize=8.5, frameon=False)
    inside = [v for _, v in points] + [*shape["low"], *shape["high"]]
    low, high = np.quantile(inside, [0.01, 0.99])
    axes.set_ylim(low - 0.25 * (high - low), high + 0.25 * (high - low))
    return axes


def _shift(law: Array, curve: Array, middle: int) -> float:
    """What brings a tied curve onto the law at the middle of the range."""
    return float(law[middle] - curve[middle])
