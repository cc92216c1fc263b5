# SPDX-License-Identifier: Apache-2.0
"""A picture of a drive: sinkage of each wheel, k, n and m, drawbar pull, all with their bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MEASURED, _MODEL, _TRUE, _REJECTED = "#8a8a8a", "#1f6fb4", "#d1495b", "#e3a008"
_GROUND = ("#f6efe2", "#e9eef2", "#efe9ef")
_BAND = 1.96  # standard deviations: 95 %
_EVERY = 0.5  # s, over which the wheels' margins are put together


def draw_drive(
    mobility: pd.DataFrame,
    soil: pd.DataFrame,
    path: Path,
    truth: Mapping[str, Any] | None = None,
    warned: Sequence[float] = (),
) -> None:
    """Draw a drive.

    Parameters
    ----------
    mobility, soil
        Tables as the demo writes them: `time` in s, quantities in SI units with the suffix
        `_standard_deviation` for theirs.
    path
        PNG file.
    truth
        Answer of a simulated drive: true values are drawn as well, dashed.
    warned
        Times (s) at which the node warned of something.
    """
    wheels = sorted(mobility["wheel"].unique())
    columns = 2
    rows_of_wheels = (len(wheels) + 1) // columns
    count = 2 * rows_of_wheels + 2
    figure = Figure(figsize=(15, 3.1 * count + 1.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(count, 6)
    limits = (0.0, float(mobility["time"].max()))
    first: list[Axes] = []
    for i, wheel in enumerate(wheels):
        rows = mobility[mobility["wheel"] == wheel]
        place = slice(3 * (i % columns), 3 * (i % columns) + 3)
        axes = figure.add_subplot(grid[i // columns, place])
        _draw_sinkage(axes, wheel, rows, truth)
        first.append(axes)
        axes = figure.add_subplot(grid[rows_of_wheels + 1 + i // columns, place])
        _draw_pull(axes, wheel, rows, truth)
        first.append(axes)
    for i, name in enumerate(("k", "n", "m")):
        axes = figure.add_subplot(grid[rows_of_wheels, 2 * i : 2 * i + 2])
        _draw_parameter(axes, name, soil, truth)
        first.append(axes)
    for place, draw in ((slice(0, 3), _draw_slip), (slice(3, 6), _draw_margin)):
        axes = figure.add_subplot(grid[count - 1, place])
        draw(axes, mobility, truth, warned)
        first.append(axes)
    for axes in first:
        axes.set_xlim(limits)
        axes.set_xlabel("time [s]")
        axes.grid(alpha=0.25)
        if truth is not None:
            _draw_ground(axes, truth, limits[1])
    figure.suptitle(
        "Played over DDS into the node mobility_estimator: what it was told, what it believes\n"
        "bands: 95 %; sinkage is predicted before the measurement of that instant is used"
        + ("; dashed: true values of the simulation, which the node never sees" if truth else ""),
        fontsize=13,
    )
    figure.savefig(path, dpi=110)


def _band(
    axes: Axes, time: Array, centre: Array, low: Array, high: Array, label: str, colour: str
) -> None:
    axes.plot(time, centre, color=colour, linewidth=1.2, label=label)
    axes.fill_between(time, low, high, color=colour, alpha=0.25, linewidth=0, label="its 95 % band")


def _draw_sinkage(
    axes: Axes, wheel: str, rows: pd.DataFrame, truth: Mapping[str, Any] | None
) -> None:
    time = rows["time"].to_numpy()
    measured = rows["sinkage_measured"].to_numpy() * 1e3
    rejected = (rows["status"] == 3).to_numpy()
    predicted = rows["sinkage_predicted"].to_numpy() * 1e3
    deviation = rows["sinkage_predicted_standard_deviation"].to_numpy() * 1e3
    axes.plot(time, measured, ".", color=_MEASURED, markersize=3, label="measured")
    axes.plot(
        time[rejected],
        measured[rejected],
        "x",
        color=_REJECTED,
        markersize=5,
        label="measured, did not fit",
    )
    spread = _BAND * deviation
    _band(axes, time, predicted, predicted - spread, predicted + spread, "predicted", _MODEL)
    top = np.nanpercentile(np.concatenate([measured, predicted]), 99.8)
    axes.set_ylim(1.15 * top, 0.0)  # positive down, as in the soil
    axes.set_ylabel("sinkage [mm]")
    axes.set_title(f"{wheel}: sinkage")
    axes.legend(loc="lower left", fontsize=8, ncols=4)


def _draw_pull(axes: Axes, wheel: str, rows: pd.DataFrame, truth: Mapping[str, Any] | None) -> None:
    time = rows["time"].to_numpy()
    pull = rows["drawbar_pull"].to_numpy()
    spread = _BAND * rows["drawbar_pull_standard_deviation"].to_numpy()
    _band(axes, time, pull, pull - spread, pull + spread, "drawbar pull", _MODEL)
    axes.axhline(0.0, color="black", linewidth=0.8)
    if truth is not None:
        answer = truth["wheels"][wheel]
        moving = np.where(answer["moving"], answer["drawbar_pull"], np.nan)
        axes.plot(answer["time"], moving, "--", color=_TRUE, linewidth=0.9, label="true")
    known = pull[np.isfinite(pull)]
    if known.size:
        low, high = np.percentile(known, [0.5, 99.5])
        axes.set_ylim(low - 0.35 * (high - low) - 1.0, high + 0.35 * (high - low) + 1.0)
    axes.set_ylabel("drawbar pull [N]")
    axes.set_title(f"{wheel}: drawbar pull")
    axes.legend(loc="lower left", fontsize=8, ncols=3)


def _draw_warnings(axes: Axes, warned: Sequence[float]) -> None:
    for i, time in enumerate(warned):
        label = "the node warns" if i == 0 else None
        axes.axvline(time, color=_REJECTED, linewidth=2.0, alpha=0.6, label=label)


def _draw_slip(
    axes: Axes, mobility: pd.DataFrame, truth: Mapping[str, Any] | None, warned: Sequence[float]
) -> None:
    for i, (_, rows) in enumerate(mobility.groupby("wheel")):
        label = "measured, each wheel" if i == 0 else None
        axes.plot(rows["time"], rows["slip"], color=_MODEL, linewidth=0.6, alpha=0.6, label=label)
    if truth is not None:
        moving = np.array(truth["rover"]["speed"]) > 1e-3
        true = np.where(moving, truth["rover"]["slip"], np.nan)
        axes.plot(truth["rover"]["time"], true, "--", color=_TRUE, linewidth=1.0, label="true")
    _draw_warnings(axes, warned)
    axes.set(ylim=(-0.3, 1.05), ylabel="slip", title="slip")
    axes.legend(loc="upper left", fontsize=8, ncols=3)


def _draw_margin(
    axes: Axes, mobility: pd.DataFrame, truth: Mapping[str, Any] | None, warned: Sequence[float]
) -> None:
    """Steepest slope that the vehicle holds, mean of the wheels by load, and the risk."""
    known = mobility.dropna(subset=["mobility_margin"]).copy()
    known["bin"] = (known["time"] / _EVERY).round() * _EVERY
    for name in ("mobility_margin", "mobility_margin_standard_deviation"):
        known[f"{name}_share"] = known[name] * known["load"]
    sums = known.groupby("bin")[
        ["load", "mobility_margin_share", "mobility_margin_standard_deviation_share"]
    ].sum()
    margin = sums["mobility_margin_share"] / sums["load"]
    spread = _BAND * sums["mobility_margin_standard_deviation_share"] / sums["load"]
    time = sums.index.to_numpy()
    low, high = (np.degrees(np.arctan(margin + sign * spread)) for sign in (-1.0, 1.0))
    _band(axes, time, np.degrees(np.arctan(margin)), low, high, "slope held", _MODEL)
    if truth is not None:
        climb = np.degrees(truth["rover"]["climb"])
        axes.plot(truth["rover"]["time"], climb, "--", color=_TRUE, label="true slope here")
    _draw_warnings(axes, warned)
    axes.set(ylabel="slope [deg]", title="steepest slope that the soil holds, and the slope")
    axes.legend(loc="upper left", fontsize=8, ncols=2)


def _draw_parameter(
    axes: Axes, name: str, soil: pd.DataFrame, truth: Mapping[str, Any] | None
) -> None:
    time, value = soil["time"].to_numpy(), soil[name].to_numpy()
    deviation = soil[f"{name}_standard_deviation"].to_numpy()
    if name == "k":
        # k is closer to log-normal: a band in its logarithm never reaches below zero.
        factor = np.exp(_BAND * deviation / value)
        _band(axes, time, value, value / factor, value * factor, name, _MODEL)
        axes.set_yscale("log")
        low, high = np.percentile(value, [1, 99])
        axes.set_ylim(low / 6, high * 6)
        axes.set_ylabel("k [Pa/m^(n+m)]")
    else:
        spread = _BAND * deviation
        _band(axes, time, value, value - spread, value + spread, name, _MODEL)
        centre = np.median(value)
        axes.set_ylim(centre - 0.9, centre + 0.9)
        axes.set_ylabel(name)
    if truth is not None:
        times, index = _stretch_of_time(truth)
        true = np.array([stretch[name] for stretch in truth["stretches"]])[index]
        axes.plot(times, true, "--", color=_TRUE, linewidth=1.2, label="true")
    axes.set_title(f"{name} of the soil, p = k zⁿ Dᵐ")
    axes.legend(loc="lower left", fontsize=8, ncols=3)


def _stretch_of_time(truth: Mapping[str, Any]) -> tuple[Array, NDArray[np.intp]]:
    """Say which stretch of soil the middle of the rover is on, over time."""
    starts = [stretch["start"] for stretch in truth["stretches"]]
    way = np.array(truth["rover"]["way"])
    index = np.maximum(np.searchsorted(starts, way, side="right") - 1, 0)
    return np.array(truth["rover"]["time"]), index


def _draw_ground(axes: Axes, truth: Mapping[str, Any], end: float) -> None:
    time, index = _stretch_of_time(truth)
    names: list[str] = []
    for i, stretch in enumerate(truth["stretches"]):
        inside = time[index == i]
        if not inside.size:
            continue
        if stretch["name"] not in names:
            names.append(stretch["name"])
        colour = _GROUND[names.index(stretch["name"]) % len(_GROUND)]
        last = end if i == len(truth["stretches"]) - 1 else inside[-1]
        axes.axvspan(inside[0], last, color=colour, zorder=-5, linewidth=0)
        axes.text(
            inside[0] + 0.5,
            0.98,
            stretch["name"].replace("_", " "),
            transform=axes.get_xaxis_transform(),
            va="top",
            fontsize=8,
            color="#666666",
        )
