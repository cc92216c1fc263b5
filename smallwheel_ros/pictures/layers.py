# SPDX-License-Identifier: Apache-2.0
"""Plots as plain data, which a page's script draws (report/web/plots.js), and house.draw with matplotlib.

A plot is {"x", "y": labels, "label": for those who cannot see it, "layers"}, and may have "title",
"height" (pixels of a page), "x_range", "y_range". Layers are drawn in their order, each with a "colour" of
the page's (page.css) and, where it stands in the key, a "name":

    {"kind": "points", "x", "y", "low", "high", "alpha", "names"}   low, high: whiskers
    {"kind": "line", "x", "y", "low", "high", "dash", "dots", "width"}   low, high: a band; dots: whiskers
    {"kind": "band", "low", "high", "slope"}   around 0, or around the diagonal
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.compare.resistance_ratio import resistance_ratio
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import column_display, display, words
from smallwheel_ros.measurements.settings import levels
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.pictures.smoothing import smooth

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Plot = dict[str, Any]

BASE, WITH = "--base", "--with"
_DASHES: tuple[list[int], ...] = ([], [6, 4], [2, 3])
_MOST_POINTS = 1000  # of a layer: beyond, the eye sees no more and the file grows
_WHEELS = 8  # colours of the page for what is of one kind
_FEWEST = 3  # points from which a smooth is drawn


# What is drawn of measurements and models.


class Shown(NamedTuple):
    """What one model leaves: measured less predicted of each row (SI, NaN where not known).

    full: with its points and band, else a thin line.
    """

    residual: Array
    colour: str
    label: str
    full: bool = True


def thinned(rows: Index) -> Index:
    """These rows, or as many of them as a picture can show."""
    if rows.size <= _MOST_POINTS:
        return rows
    return np.sort(np.random.default_rng(0).choice(rows, _MOST_POINTS, replace=False))


def measured_plot(
    channel: str, measured: Array, one: Shown, repeats: float | None = None, title: str = ""
) -> Plot:
    """Measured over predicted of one model, with the line of a perfect one.

    measured: of each row, SI. repeats: what rows of one run differ by, SI; twice that is the band.
    """
    shown = display(channel, CHANNEL_UNITS[channel])
    rows = thinned(np.flatnonzero(np.isfinite(one.residual)))
    y = measured * shown.scale
    x = y[rows] - one.residual[rows] * shown.scale
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    margin = 0.06 * max(high - low, 1e-9)
    low, high = low - margin, high + margin
    band = 2.0 * shown.scale * (repeats or 0.0)
    reach = (min(low, float(x.min()) - margin), max(high, float(x.max()) + margin))
    return {
        "x": f"predicted {shown.label}",
        "y": f"measured {shown.label}",
        "title": title,
        "x_range": reach,
        "y_range": (low, high),
        "layers": [
            {"kind": "band", "slope": 1.0, "low": -band, "high": band},
            {"kind": "points", "x": x, "y": y[rows], "colour": one.colour},
        ],
    }


def residual_plot(
    measurements: Measurements,
    run: Index,
    shown: Sequence[Shown],
    channel: str,
    setting: str,
    repeats: float | None = None,
) -> Plot:
    """Points, smooth and 95 % band (bootstrap over runs) of what models leave, over one setting.

    run: index of each row's run. repeats: as of `measured_plot`.
    """
    how, across = display(channel, CHANNEL_UNITS[channel]), column_display(measurements, setting)
    column = measurements.conditions[setting]
    band = 2.0 * how.scale * (repeats or 0.0)
    layers: list[Plot] = [{"kind": "band", "low": -band, "high": band}]
    lines: list[Plot] = []
    ends = [0.0]
    for one in shown:
        rows = np.isfinite(one.residual) & np.isfinite(column)  # what is pressed has no slip
        at = thinned(np.flatnonzero(rows))
        x, y = column[at] * across.scale, one.residual[at] * how.scale
        if one.full:
            layers.append({"kind": "points", "x": x, "y": y, "colour": one.colour, "alpha": 0.4})
            ends += y.tolist()
        if x.size < _FEWEST or np.ptp(x) == 0.0:
            continue
        few = levels(x)
        curve = smooth(x, y, run[at], few)._asdict()
        look = {"kind": "line", "colour": one.colour, "dots": few is not None}
        if not one.full:
            curve, look["width"] = {"x": curve["x"], "y": curve["y"]}, 0.9
        lines.append(look | curve)
    # Of the points: where few are the band runs far out.
    margin = 0.1 * max(max(ends) - min(ends), 1e-9)
    return {
        "x": across.label,
        "y": f"measured - predicted [{how.unit}]",
        "title": words(channel),
        "y_range": (min(ends) - margin, max(ends) + margin),
        "layers": [*layers, *lines],
    }


def ratio_plot(measurements: Measurements) -> Plot | None:
    """R/W over sqrt(z/D); None where sinkage and resistance were not measured together."""
    found = resistance_ratio(measurements)
    if found is None:
        return None
    layers: list[Plot] = [
        {"kind": "line", "name": f"compaction alone, n = {n:g}", "dash": dash, "colour": BASE,
         "x": found.line_x, "y": y}
        for (n, y), dash in zip(found.lines.items(), _DASHES, strict=True)
    ]  # fmt: skip
    shown = thinned(np.arange(found.rows.size))
    for i, soil in enumerate(np.unique(found.soil)):
        at = shown[found.soil[shown] == soil]
        rows = zip(measurements.run[found.rows[at]], measurements.line[found.rows[at]], strict=True)
        layers.append(
            {
                "kind": "points",
                "name": str(soil) or "measured",
                "colour": f"--w{i % _WHEELS}",
                "x": found.x[at],
                "y": found.y[at],
                "names": [f"run {run}, {measurements.place} {line}" for run, line in rows],
            }
        )
    return {
        "x": "√(sinkage / diameter)",
        "y": "resistance / load",
        "label": "resistance over load against the root of sinkage over diameter",
        "height": 320,
        "layers": layers,
    }


def curve_plots(document: Mapping[str, Any]) -> list[Plot]:
    """The smooth of each setting that something without a name follows, from a diagnosis document."""
    found = []
    for curve in document.get("curves") or []:
        across = display(curve["setting"], unit_of(curve["setting"]))
        x = [across.scale * value for value in curve["x"]]
        factor = f"factor on {curve['stage']}"
        none = {"kind": "line", "x": x[:: len(x) - 1], "y": [1.0, 1.0], "colour": BASE}
        line = {"kind": "line", "x": x, "y": curve["factor"], "low": curve["low"],
                "high": curve["high"]}  # fmt: skip
        found.append({"x": across.label, "y": factor, "label": f"{factor} over {across.label}",
                      "layers": [none, line]})  # fmt: skip
    return found


# Of a law that was learnt.

_ASKED = {"sinkage": ("std", "--w0"), "resistance": ("resistance_std", "--w1")}
_ADDED = {"n": "added to n", "R": "added resistance over what carries it"}
_FREE = 8  # points from which a smooth without any formula is drawn


def learnt_plot(document: Mapping[str, Any], tied: Collection[Array] = ()) -> Plot:
    """What each setting asks for with deviations, the law with its band, tied laws, a smooth dashed.

    document: of a law of one setting. tied: curves of tied laws over its `shape`; k is fitted anew for
    each, so they are moved onto the law at the middle of the range.
    """
    shape, law = document["shape"], document["law"]
    place = law or document["places"][0]
    stage, driver = place["stage"], place["drivers"][0]
    shown = display(driver, unit_of(driver))
    x, y = np.array(shape["x"]) * shown.scale, np.array(shape["factor"])
    layers: list[Plot] = []
    for i, curve in enumerate(tied):
        name = {} if i else {"name": f"{len(tied)} tied"}
        moved = np.asarray(curve) + float(y[len(x) // 2] - curve[len(x) // 2])
        layers.append({"kind": "line", "x": x, "y": moved, "colour": BASE, "width": 1.0, **name})
    points: list[tuple[float, float]] = []
    for channel, (deviation, colour) in _ASKED.items():
        mine = [e for e in document["implied"] if e[channel] is not None]
        at = [e["x"] * shown.scale for e in mine]
        value, spread = ([e[name] for e in mine] for name in (channel, deviation))
        ends = np.array(value) - spread, np.array(value) + spread
        if mine:
            layers.append({"kind": "points", "x": at, "y": value, "low": ends[0], "high": ends[1],
                           "names": [f"run {e['run']}" for e in mine], "colour": colour,
                           "alpha": 0.8, "name": f"{words(channel)} asks for"})  # fmt: skip
        points += zip(at, value, strict=True)
    if len(points) >= _FREE:
        free = np.array(points)
        line = smooth(free[:, 0], free[:, 1], np.arange(len(points)))
        layers.append({"kind": "line", "x": line.x, "y": line.y, "colour": "--ink", "width": 1.0,
                       "dash": [6, 4], "name": "free smooth"})  # fmt: skip
    layers.append({"kind": "line", "x": x, "y": y, "low": shape["low"], "high": shape["high"],
                   "colour": "--ink", "name": "drafted law" if law else "best formula"})  # fmt: skip
    inside = [v for _, v in points] + [*shape["low"], *shape["high"]]
    low, high = np.quantile(inside, [0.01, 0.99]).tolist()
    label = _ADDED.get(stage, f"factor on {stage}")
    return {
        "x": shown.label,
        "y": label,
        "title": law["formula"] if law else "",
        "label": f"{label} over {shown.label}",
        "height": 360,
        "y_range": (low - 0.25 * (high - low), high + 0.25 * (high - low)),
        "layers": layers,
    }
