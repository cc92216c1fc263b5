# SPDX-License-Identifier: Apache-2.0
"""Pictures of a drive: a column of a replay's table; what a node was told and believed, with its bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.results import ResultError
from smallwheel_ros.onboard.result import Status
from smallwheel_ros.pictures.house import (
    COLOURS,
    GREY,
    INK,
    band,
    key,
    new_figure,
    style,
    wheel_colours,
)
from smallwheel_ros.replay.result import Replayed

Array = NDArray[np.float64]

_WARNED = COLOURS[1]
_GROUND = ("#f6efe2", "#e9eef2", "#efe9ef")
_BAND = 1.96  # standard deviations: 95 %
_TIME = "time [s]"
_EVERY = 0.5  # s, over which the wheels' margins are put together
_QUANTITIES = (
    ("drawbar_pull", "drawbar_pull", 1.0, "drawbar pull [N]"),
    ("sinkage_predicted", "sinkage", 1e3, "predicted sinkage [mm]"),
)
_POINTS = 700  # of a wheel


def draw_replay(axes: Axes, replayed: Replayed, quantity: str) -> None:
    """One column of the estimates over time, a curve for each wheel. Raises ResultError."""
    table = replayed.to_frame()
    numbers = [str(name) for name in table.select_dtypes("number").columns]
    if quantity not in numbers:
        raise ResultError(f"no column '{quantity}' in the estimates: {nearest(quantity, numbers)}")
    colours = wheel_colours(table["wheel"])
    for wheel, rows in table.groupby("wheel"):
        shown = rows.iloc[:: max(1, len(rows) // _POINTS)]
        name, colour = str(wheel).replace("_", " "), colours[str(wheel)]
        axes.plot(shown["time"], shown[quantity], color=colour, linewidth=1.0, label=name)
    style(axes, _TIME, quantity.replace("_", " "))
    key(axes)


def draw_drive(
    mobility: pd.DataFrame,
    soil: pd.DataFrame,
    path: Path,
    truth: Mapping[str, Any],
    warned: Sequence[float],
) -> None:
    """Write a PNG of a simulated drive that was played into the node; true values are dashed.

    Parameters
    ----------
    mobility, soil
        Tables as the demo writes them: `time` in s, quantities in SI units with the suffix
        `_standard_deviation` for theirs.
    path
        PNG file.
    truth
        Answer of the simulated drive.
    warned
        Times (s) at which the node warned of something.
    """
    wheels = sorted(mobility["wheel"].unique())
    columns = 2
    rows_of_wheels = (len(wheels) + 1) // columns
    count = 2 * rows_of_wheels + 2
    figure = new_figure(13.0, 2.5 * count + 1.0)
    colours = wheel_colours(wheels)
    grid = figure.add_gridspec(count, 6)
    limits = (0.0, float(mobility["time"].max()))
    for i, wheel in enumerate(wheels):
        rows = mobility[mobility["wheel"] == wheel]
        place = slice(3 * (i % columns), 3 * (i % columns) + 3)
        axes = figure.add_subplot(grid[i // columns, place])
        _draw_sinkage(axes, wheel, rows, colours[wheel])
        axes = figure.add_subplot(grid[rows_of_wheels + 1 + i // columns, place])
        _draw_pull(axes, wheel, rows, colours[wheel], truth)
    for i, name in enumerate(("k", "n", "m")):
        axes = figure.add_subplot(grid[rows_of_wheels, 2 * i : 2 * i + 2])
        _draw_parameter(axes, name, soil, truth)
    for place, draw in ((slice(0, 3), _draw_slip), (slice(3, 6), _draw_margin)):
        axes = figure.add_subplot(grid[count - 1, place])
        draw(axes, mobility, truth, warned)
    for axes in figure.axes:
        axes.set_xlim(limits)
        _draw_ground(axes, truth, limits[1])
    figure.suptitle(
        "Played over DDS into the node mobility_estimator: what it was told, what it believes; "
        "soil: p = k zⁿ Dᵐ\n"
        "bands: 95 %; sinkage is predicted before the measurement of that instant is used; "
        "dashed: true values of the simulation, which the node never sees",
        fontsize=11,
        color=INK,
    )
    figure.savefig(path, dpi=110)


def _curve(
    axes: Axes,
    time: ArrayLike,
    value: ArrayLike,
    deviation: ArrayLike,
    label: str,
    colour: str,
) -> None:
    """Draw a quantity with its band of 95 %."""
    centre, spread = np.asarray(value), _BAND * np.asarray(deviation)
    band(axes, np.asarray(time), centre, centre - spread, centre + spread, label, colour)


def _draw_sinkage(axes: Axes, wheel: str, rows: pd.DataFrame, colour: str) -> None:
    time = rows["time"].to_numpy()
    measured = rows["sinkage_measured"].to_numpy() * 1e3
    rejected = (rows["status"] == Status.REJECTED).to_numpy()
    predicted = rows["sinkage_predicted"].to_numpy() * 1e3
    deviation = rows["sinkage_predicted_standard_deviation"].to_numpy() * 1e3
    axes.plot(time, measured, ".", color=GREY, markersize=3, label="measured")
    axes.plot(
        time[rejected],
        measured[rejected],
        "x",
        color=INK,
        markersize=5,
        label="measured, did not fit",
    )
    _curve(axes, time, predicted, deviation, "predicted", colour)
    top = np.nanpercentile(np.concatenate([measured, predicted]), 99.8)
    axes.set_ylim(1.15 * top, 0.0)  # positive down, as in the soil
    style(axes, _TIME, "sinkage [mm]", f"{wheel}: sinkage")
    key(axes)


def _draw_pull(
    axes: Axes, wheel: str, rows: pd.DataFrame, colour: str, truth: Mapping[str, Any]
) -> None:
    time = rows["time"].to_numpy()
    pull = rows["drawbar_pull"].to_numpy()
    deviation = rows["drawbar_pull_standard_deviation"].to_numpy()
    _curve(axes, time, pull, deviation, "drawbar pull", colour)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    _draw_true(axes, truth["wheels"][wheel], "drawbar_pull")
    known = pull[np.isfinite(pull)]
    if known.size:
        low, high = np.percentile(known, [0.5, 99.5])
        axes.set_ylim(low - 0.35 * (high - low) - 1.0, high + 0.35 * (high - low) + 1.0)
    style(axes, _TIME, "drawbar pull [N]", f"{wheel}: drawbar pull")
    key(axes)


def _draw_true(axes: Axes, wheel: Mapping[str, Any], quantity: str, scale: float = 1.0) -> None:
    """Draw what is true of a wheel, as long as it moves."""
    true = scale * np.where(wheel["moving"], wheel[quantity], np.nan)
    axes.plot(wheel["time"], true, "--", color=INK, linewidth=0.9, label="true")


def _draw_warnings(axes: Axes, warned: Sequence[float]) -> None:
    for i, time in enumerate(warned):
        label = "the node warns" if i == 0 else None
        axes.axvline(time, color=_WARNED, linewidth=2.0, alpha=0.6, label=label)


def _draw_slip(
    axes: Axes, mobility: pd.DataFrame, truth: Mapping[str, Any], warned: Sequence[float]
) -> None:
    colours = wheel_colours(mobility["wheel"])
    for wheel, rows in mobility.groupby("wheel"):
        label, colour = str(wheel), colours[str(wheel)]
        axes.plot(rows["time"], rows["slip"], color=colour, linewidth=1.0, alpha=0.7, label=label)
    moving = np.array(truth["rover"]["speed"]) > 1e-3
    true = np.where(moving, truth["rover"]["slip"], np.nan)
    axes.plot(truth["rover"]["time"], true, "--", color=INK, linewidth=1.0, label="true")
    _draw_warnings(axes, warned)
    axes.set_ylim(-0.3, 1.05)
    style(axes, _TIME, "slip", "slip")
    key(axes)


def _draw_margin(
    axes: Axes, mobility: pd.DataFrame, truth: Mapping[str, Any], warned: Sequence[float]
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
    band(axes, time, np.degrees(np.arctan(margin)), low, high, "slope held", COLOURS[2])
    climb = np.degrees(truth["rover"]["climb"])
    axes.plot(truth["rover"]["time"], climb, "--", color=INK, label="true slope here")
    _draw_warnings(axes, warned)
    style(axes, _TIME, "slope [deg]", "slope that holds")
    key(axes)


def _draw_parameter(axes: Axes, name: str, soil: pd.DataFrame, truth: Mapping[str, Any]) -> None:
    time, value = soil["time"].to_numpy(), soil[name].to_numpy()
    deviation = soil[f"{name}_standard_deviation"].to_numpy()
    if name == "k":
        # k is closer to log-normal: a band in its logarithm never reaches below zero.
        factor = np.exp(_BAND * deviation / value)
        band(axes, time, value, value / factor, value * factor, name, COLOURS[2])
        axes.set_yscale("log")
        low, high = np.percentile(value, [1, 99])
        axes.set_ylim(low / 6, high * 6)
    else:
        _curve(axes, time, value, deviation, name, COLOURS[2])
        centre = np.median(value)
        axes.set_ylim(centre - 0.9, centre + 0.9)
    _draw_true_parameter(axes, name, truth)
    unit = " [Pa/mⁿ⁺ᵐ]" if name == "k" else ""
    style(axes, _TIME, f"{name}{unit}", f"{name} of the soil")
    key(axes)


def _draw_true_parameter(axes: Axes, name: str, truth: Mapping[str, Any]) -> None:
    times, index = _stretch_of_time(truth)
    true = np.array([stretch[name] for stretch in truth["stretches"]])[index]
    axes.plot(times, true, "--", color=INK, linewidth=1.2, label="true")


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
            color=GREY,
        )


def draw_known(
    mobility: Mapping[str, pd.DataFrame],
    soil: Mapping[str, pd.DataFrame],
    truth: Mapping[str, Any],
    path: Path,
) -> None:
    """Write a PNG: a column for each of several runs of one drive, by name.

    Parameters
    ----------
    mobility, soil
        Tables as the demo makes them; the picture ends with the shortest.
    truth
        Answer of the simulated drive.
    """
    end = min(float(table["time"].max()) for table in mobility.values())
    wheel = sorted(truth["wheels"])[0]
    figure = new_figure(13.0, 7.5)
    colour = wheel_colours(truth["wheels"])[wheel]
    grid = figure.subplots(3, len(mobility), sharex=True, sharey="row")
    for j, (name, table) in enumerate(mobility.items()):
        rows = table[(table["wheel"] == wheel) & (table["time"] <= end)]
        for i, (quantity, true, scale, label) in enumerate(_QUANTITIES):
            axes, deviation = grid[i, j], scale * rows[f"{quantity}_standard_deviation"]
            _curve(axes, rows["time"], scale * rows[quantity], deviation, "estimated", colour)
            _draw_true(axes, truth["wheels"][wheel], true, scale)
            style(axes, "", label if j == 0 else "", f"{wheel}, {name}" if i == 0 else "")
        _draw_exponent(grid[2, j], soil[name], truth, end)
        style(grid[2, j], _TIME, "n of the soil" if j == 0 else "")
    for axes in grid.ravel():
        axes.set_xlim(0.0, end)
        key(axes)
    # Bands of what is not known may be wider than what anybody wants to see.
    pulls = np.array(truth["wheels"][wheel]["drawbar_pull"])
    grid[0, 0].set_ylim(pulls.min() - 20.0, pulls.max() + 20.0)
    grid[1, 0].set_ylim(40.0, 0.0)  # positive down, as in the soil
    figure.suptitle(
        "The same drive with more and with fewer sensors; bands: 95 %", fontsize=11, color=INK
    )
    figure.savefig(path, dpi=110)


def _draw_exponent(axes: Axes, soil: pd.DataFrame, truth: Mapping[str, Any], end: float) -> None:
    rows = soil[soil["time"] <= end] if len(soil) > 1 else soil
    time = np.append(rows["time"], end)
    if len(rows) == 1:
        time[0] = 0.0
    value = np.append(rows["n"], rows["n"].iloc[-1])
    deviation = np.append(rows["n_standard_deviation"], rows["n_standard_deviation"].iloc[-1])
    _curve(axes, time, value, deviation, "estimated", COLOURS[2])
    _draw_true_parameter(axes, "n", truth)
