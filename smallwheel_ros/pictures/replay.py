"""Pictures of a replayed drive: the map of the way, wheels and soil over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smallwheel_ros.onboard.mobility import Status
from smallwheel_ros.physics.soil import nearest
from smallwheel_ros.replay.summary import Event
from smallwheel_ros.results import ResultError

Array = NDArray[np.float64]
Courses = Mapping[str, pd.DataFrame]  # of each wheel, rows of the table of estimates

_BAND = 1.96  # standard deviations: 95 %
_MEASURED, _MODEL, _UNUSED, _CHANGE = "#8a8a8a", "#0072b2", "#d55e00", "#009e73"
_STEPS = 240  # of the way in the map
_POINTS = 700  # of a wheel in a picture over time


_WITH_DEVIATION = (
    "sinkage_predicted",
    "drawbar_pull",
    "soil_k",
    "soil_n",
    "soil_m",
    "soil_reference_pressure",
)
_NUMBERS = (
    *("time", "x", "y", "load", "slip", "sinkage_measured", "mobility_margin"),
    *_WITH_DEVIATION,
    *(f"{name}_standard_deviation" for name in _WITH_DEVIATION),
)
_BLOCK = 100_000  # rows of a long drive that are in memory at a time


def read_courses(table: Path, every: int) -> dict[str, pd.DataFrame]:
    """Return every so many-th row of each wheel of a table of estimates (CSV).

    With a column `used`: whether the measured sinkage was used for the soil.
    """
    found: dict[str, list[pd.DataFrame]] = {}
    blocks = pd.read_csv(
        table,
        usecols=["wheel", "status", *_NUMBERS],
        dtype=dict.fromkeys(_NUMBERS, float),
        chunksize=_BLOCK,
    )
    for block in blocks:
        known = block["load"].notna() & block["sinkage_measured"].notna()
        block["used"] = known & (block["status"] != Status.REJECTED.name)
        for wheel, rows in block.groupby("wheel"):
            found.setdefault(str(wheel), []).append(rows.iloc[::every])
    return {wheel: pd.concat(parts) for wheel, parts in found.items()}


def _columns(courses: Sequence[pd.DataFrame]) -> dict[str, Array]:
    """Return the rows of several courses by column, in the order of time."""
    rows = pd.concat(courses).sort_values("time", kind="stable")
    return {name: rows[name].to_numpy(dtype=float) for name in (*_NUMBERS, "used")}


def _thinned(columns: Mapping[str, Array], most: int) -> dict[str, Array]:
    count = columns["time"].size
    keep = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
    return {name: values[keep] for name, values in columns.items()}


def _mean(index: NDArray[np.intp], values: Array, weights: Array, count: int) -> Array:
    """Weighted mean of the known values in each bin, NaN in an empty one."""
    known = np.isfinite(values) & np.isfinite(weights)
    total = np.bincount(index[known], (weights * values)[known], count)
    weight = np.bincount(index[known], weights[known], count)
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan)


def map_of_way(courses: Courses, events: Sequence[Event]) -> Figure | None:
    """The way of the vehicle, coloured by sinkage and by drawbar margin; None without odometry.

    Both are means over the wheels, the margin's weighted by load: what the vehicle as a whole
    could still climb.
    """
    columns = _columns(list(courses.values()))
    known = np.isfinite(columns["x"])
    if known.sum() < 2:
        return None
    columns = {name: values[known] for name, values in columns.items()}
    time = columns["time"]
    span = max(float(time[-1] - time[0]), 1e-9)
    index = np.minimum((_STEPS * (time - time[0]) / span).astype(int), _STEPS - 1)
    even = np.ones_like(time)
    x, y = (_mean(index, columns[name], even, _STEPS) for name in "xy")
    measured, predicted = columns["sinkage_measured"], columns["sinkage_predicted"]
    deep = np.where(np.isfinite(measured), measured, predicted)
    sinkage = 1e3 * _mean(index, deep, even, _STEPS)
    margin = 100.0 * _mean(index, columns["mobility_margin"], columns["load"], _STEPS)
    at = np.isfinite(x)
    across, along = float(np.ptp(x[at])), float(np.ptp(y[at]))
    wide = across >= along
    # As high as the way needs at the width that there is.
    height = 2 * np.clip(8.0 * along / max(across, 1e-9) + 0.9, 2.1, 4.6)
    if not wide:
        height = np.clip(4.0 * along / max(across, 1e-9) + 0.8, 4.0, 9.0)
    figure = Figure(figsize=(9.2, float(height)), layout="constrained")
    first, second = np.ravel(figure.subplots(*((2, 1) if wide else (1, 2))))
    _draw_way(figure, first, (x[at], y[at], sinkage[at]), "sinkage, mean of the wheels [mm]", False)
    _draw_way(figure, second, (x[at], y[at], margin[at]), "drawbar margin [% of load]", True)
    for axes in (first, second):
        _draw_events(axes, columns, events)
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.25)
        axes.set_ylabel("y [m]")
        axes.set_xlabel("x [m]")
    first.legend(loc="best", fontsize=8)
    return figure


def _draw_way(
    figure: Figure, axes: Axes, way: tuple[Array, Array, Array], label: str, signed: bool
) -> None:
    x, y, values = way
    known = values[np.isfinite(values)]
    norm: Normalize = Normalize(0.0, float(np.percentile(known, 99)) if known.size else 1.0)
    if signed:
        most = float(np.percentile(np.abs(known), 99)) if known.size else 1.0
        norm = TwoSlopeNorm(0.0, -max(most, 1e-3), max(most, 1e-3))
    points = np.stack([x, y], axis=1)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(
        list(segments), cmap="RdBu" if signed else "viridis", norm=norm, linewidths=6.0
    )
    lines.set_array(values[:-1])
    lines.set_capstyle("projecting")
    axes.plot(x, y, color="#c8c8c8", linewidth=7.0, solid_capstyle="round", zorder=1)
    lines.set_zorder(2)
    axes.add_collection(lines)
    bar = figure.colorbar(lines, ax=axes, extend="both" if signed else "max")
    axes.set_title(label, fontsize=10, loc="left")
    if not signed:
        bar.ax.invert_yaxis()  # deeper is lower


def _draw_events(axes: Axes, columns: Mapping[str, Array], events: Sequence[Event]) -> None:
    axes.plot(columns["x"][0], columns["y"][0], "k>", markersize=7, label="start", zorder=4)
    shown: set[str] = set()
    for event in events:
        marker, word = {
            "soil_change": ("o", "another soil"),
            "digging_in": ("X", "digging in"),
            "missing_effect": ("*", "missing effect"),
        }.get(event.kind, ("d", "time went back"))
        i = int(np.argmin(np.abs(columns["time"] - event.time)))
        axes.plot(
            columns["x"][i],
            columns["y"][i],
            marker,
            color="white",
            markeredgecolor="black",
            markersize=7,
            zorder=5,
            label=None if word in shown else word,
            linestyle="none",
        )
        shown.add(word)


def wheels_over_time(courses: Courses, events: Sequence[Event]) -> Figure:
    """Sinkage of each wheel, measured and predicted, and its drawbar pull, with 95 % bands."""
    has_pull = any(course["drawbar_pull"].notna().any() for course in courses.values())
    columns_of_axes = 2 if has_pull else 1
    figure = Figure(figsize=(10.4, 2.15 * len(courses) + 0.7), layout="constrained")
    grid = figure.subplots(len(courses), columns_of_axes, sharex=True, squeeze=False)
    for row, (name, course) in enumerate(courses.items()):
        values = _thinned(_columns([course]), _POINTS)
        _draw_sinkage(grid[row, 0], name, values)
        _draw_changes(grid[row, 0], events)
        if has_pull:
            _draw_pull(grid[row, 1], name, values)
            _draw_changes(grid[row, 1], events)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4, fontsize=8, frameon=False)
    return figure


def _draw_changes(axes: Axes, events: Sequence[Event]) -> None:
    for event in events:
        colour = _CHANGE if event.kind == "soil_change" else _UNUSED
        axes.axvline(event.time, color=colour, linewidth=1.0, linestyle=":", zorder=0)
    axes.grid(alpha=0.25)


def _band(
    axes: Axes, values: Mapping[str, Array], name: str, scale: float = 1.0, label: str = ""
) -> None:
    time, value = values["time"], scale * values[name]
    std = scale * values[f"{name}_standard_deviation"]
    axes.plot(time, value, color=_MODEL, linewidth=1.1, label=label or None)
    axes.fill_between(
        time, value - _BAND * std, value + _BAND * std, color=_MODEL, alpha=0.25, linewidth=0
    )


def _draw_sinkage(axes: Axes, name: str, values: Mapping[str, Array]) -> None:
    time, measured = values["time"], 1e3 * values["sinkage_measured"]
    used = values["used"] > 0
    axes.plot(time[used], measured[used], ".", color=_MEASURED, markersize=2.5, label="measured",
              rasterized=True)  # fmt: skip
    axes.plot(time[~used], measured[~used], "x", color=_UNUSED, markersize=3.5,
              label="measured, not used for the soil", rasterized=True)  # fmt: skip
    _band(axes, values, "sinkage_predicted", 1e3, "predicted, 95 %")
    both = np.concatenate([measured, 1e3 * values["sinkage_predicted"]])
    known = both[np.isfinite(both)]
    top = 1.15 * float(np.percentile(known, 99.5)) if known.size else 1.0
    axes.set_ylim(max(top, 1e-6), 0.0)  # positive down, as in the soil
    axes.set_ylabel("sinkage [mm]")
    axes.set_title(name.replace("_", " "), fontsize=10, loc="left")


def _draw_pull(axes: Axes, name: str, values: Mapping[str, Array]) -> None:
    pull = values["drawbar_pull"]
    _band(axes, values, "drawbar_pull")
    axes.axhline(0.0, color="black", linewidth=0.8)
    known = pull[np.isfinite(pull)]
    if known.size:
        low, high = np.percentile(known, [0.5, 99.5])
        room = 0.35 * (high - low) + 1.0
        axes.set_ylim(min(low - room, -1.0), high + room)
    axes.set_ylabel("drawbar pull [N]")
    axes.set_title(name.replace("_", " "), fontsize=10, loc="left")


def draw_estimates(axes: Axes, table: pd.DataFrame, quantity: str) -> None:
    """One column of the estimates over time, a curve for each wheel. Raises ResultError."""
    numbers = [str(name) for name in table.select_dtypes("number").columns]
    if quantity not in numbers:
        raise ResultError(f"no column '{quantity}' in the estimates: {nearest(quantity, numbers)}")
    for wheel, rows in table.groupby("wheel"):
        shown = rows.iloc[:: max(1, len(rows) // _POINTS)]
        axes.plot(shown["time"], shown[quantity], linewidth=1.0, label=str(wheel).replace("_", " "))
    axes.set_xlabel("time [s]")
    axes.set_ylabel(quantity.replace("_", " "))
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)


def slip_over_time(courses: Courses) -> Figure | None:
    """Slip of every wheel; None where it is never known."""
    figure = Figure(figsize=(10.4, 2.5), layout="constrained")
    axes = figure.subplots()
    drawn = False
    for name, course in courses.items():
        values = _thinned(_columns([course]), _POINTS)
        if np.isfinite(values["slip"]).any():
            drawn = True
            axes.plot(values["time"], values["slip"], linewidth=0.9, label=name.replace("_", " "))
    if not drawn:
        return None
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("slip")
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8, ncols=4, loc="best")
    return figure


def soil_over_time(courses: Courses, events: Sequence[Event]) -> Figure:
    """Reference pressure, k, n and m with 95 % bands; k's and the pressure's in their logarithm."""
    values = _thinned(_columns(list(courses.values())), 1200)
    figure = Figure(figsize=(10.4, 5.6), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    shown = (
        ("soil_reference_pressure", "reference pressure [kPa]", 1e-3),
        ("soil_k", "k [Pa/m$^{n+m}$]", 1.0),
        ("soil_n", "n", 1.0),
        ("soil_m", "m", 1.0),
    )
    for axes, (name, label, scale) in zip(grid.flat, shown, strict=True):
        time, value = values["time"], scale * values[name]
        std = scale * values[f"{name}_standard_deviation"]
        if name in ("soil_reference_pressure", "soil_k"):
            # Closer to log-normal: a band in the logarithm never reaches below zero.
            factor = np.exp(_BAND * np.minimum(std / value, 3.0))
            axes.plot(time, value, color=_MODEL, linewidth=1.1)
            axes.fill_between(
                time, value / factor, value * factor, color=_MODEL, alpha=0.25, linewidth=0
            )
            axes.set_yscale("log")
            low, high = np.percentile(value, [1, 99])
            axes.set_ylim(low / 4, high * 4)
        else:
            _band(axes, values, name, scale)
            centre = float(np.median(value))
            axes.set_ylim(centre - 0.9, centre + 0.9)
        axes.set_ylabel(label)
        _draw_changes(axes, events)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    return figure
