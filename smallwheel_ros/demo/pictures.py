# SPDX-License-Identifier: Apache-2.0
"""The demo's pictures: inputs and estimates of the node, with bands of 95 %; true values are dashed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.views.plots import CYCLE, PALETTE, Panel, decorate

if TYPE_CHECKING:
    from smallwheel_ros.ros.play import PlayedRecording

Array = NDArray[np.float64]

GREY, INK = PALETTE["base"], PALETTE["ink"]
_WARNED, _LAW = PALETTE["w4"], PALETTE["with"]
_GROUND = ("#f6efe2", "#e9eef2", "#efe9ef")
_BAND = 1.96  # standard deviations: 95 %
_TIME = "time [s]"
_EVERY = 0.5  # s, over which the wheels' margins are averaged
_UNITS = {"k": " [Pa/mⁿ⁺ᵐ]", "n": "", "m": ""}


class Clip(NamedTuple):
    """The node's answers to a bag played into it.

    Attributes
    ----------
    mobility
        One row for each estimate of a wheel: fields of MobilityEstimate, with `time` in s; unknown values are
        NaN.
    soil
        One row for each message: fields of SoilEstimate, with `time` in s and standard deviations of k, n, m.
    recording
        The answers as they were received.
    epoch
        Stamp at which `time` is 0, ns.
    """

    mobility: pd.DataFrame
    soil: pd.DataFrame
    recording: PlayedRecording
    epoch: int


def draw_drive(clip: Clip, truth: Mapping[str, Any], warned: Sequence[float], path: Path) -> None:
    """Write a PNG of a drive of four wheels that was played into the node.

    Parameters
    ----------
    clip
        The node's answers.
    truth
        True values of the simulated drive, as its `answer()` gives them.
    warned
        Times at which the node warned, s, on the clock of the tables.
    path
        File of the picture.
    """
    wheels = sorted(truth["wheels"])
    figure = Figure(figsize=(13.0, 16.0), layout="constrained")
    places: list[Any] = [
        *_two_in_a_row("sinkage", wheels),
        ["k", "k", "n", "n", "m", "m"],
        *_two_in_a_row("drawbar pull", wheels),
        ["slip"] * 3 + ["margin"] * 3,
    ]
    panels = figure.subplot_mosaic(places)
    for i, wheel in enumerate(wheels):
        colour = PALETTE[CYCLE[i % len(CYCLE)]]
        rows = clip.mobility[clip.mobility["wheel"] == wheel]
        sinkage, pull = panels[f"{wheel}: sinkage"], panels[f"{wheel}: drawbar pull"]
        _draw_sinkage(sinkage, rows, truth["wheels"][wheel], colour)
        _draw_pull(pull, rows, truth["wheels"][wheel], colour)
        panels["slip"].plot(
            rows["time"], rows["slip"], color=colour, linewidth=1.0, alpha=0.7, label=wheel
        )
    for name in _UNITS:
        _draw_parameter(panels[name], name, clip.soil, truth)
    rover = truth["rover"]
    true = np.where(np.array(rover["speed"]) > 1e-3, rover["slip"], np.nan)
    _dashed(panels["slip"], rover["time"], true)
    panels["slip"].set_ylim(-0.3, 1.05)
    _style(panels["slip"], _TIME, "slip", "slip")
    _draw_margin(panels["margin"], clip.mobility)
    _dashed(panels["margin"], rover["time"], np.degrees(rover["climb"]), "true slope here")
    _style(panels["margin"], _TIME, "slope [deg]", "slope that holds")
    for axes in (panels["slip"], panels["margin"]):
        for i, time in enumerate(warned):
            label = None if i else "the node warns"
            axes.axvline(time, color=_WARNED, linewidth=2.0, alpha=0.6, label=label)
    end = float(clip.mobility["time"].max())
    for axes in panels.values():
        axes.set_xlim(0.0, end)
        _draw_ground(axes, truth, end)
        _key(axes)
    figure.suptitle(
        "Played over DDS into the node mobility_estimator: its inputs, its estimates; "
        "soil: p = k zⁿ Dᵐ\n"
        "bands: 95 %; sinkage is predicted before the measurement of that instant is used; "
        "dashed: true values of the simulation, which the node never sees",
        fontsize=11,
        color=INK,
    )
    figure.savefig(path, dpi=110)


def _two_in_a_row(what: str, wheels: list[str]) -> list[list[str]]:
    """Two rows of a mosaic with a panel for each of four wheels, each three of six columns wide."""
    places = [f"{wheel}: {what}" for wheel in wheels for _ in range(3)]
    return [places[:6], places[6:]]


def _style(axes: Axes, x: str, y: str, title: str) -> None:
    decorate(axes, Panel(x, y, title))


def _key(axes: Axes) -> None:
    """Add the key in the line of the title, on the right, where it covers nothing."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=8, fontsize=7.5, frameon=False,
                borderpad=0.0, borderaxespad=0.3, columnspacing=1.1, handlelength=1.4,
                handletextpad=0.5)  # fmt: skip


def _band(
    axes: Axes, x: ArrayLike, y: ArrayLike, low: ArrayLike, high: ArrayLike, label: str, colour: str
) -> None:
    """A curve and its band of 95 %."""
    axes.plot(x, y, color=colour, linewidth=1.2, label=label)
    axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0, label="its 95 % band")


def _curve(
    axes: Axes, rows: pd.DataFrame, name: str, colour: str, label: str, scale: float = 1.0
) -> None:
    """A quantity of a table, with its band."""
    middle, half = scale * rows[name], _BAND * scale * rows[f"{name}_standard_deviation"]
    _band(axes, rows["time"], middle, middle - half, middle + half, label, colour)


def _dashed(axes: Axes, time: ArrayLike, true: ArrayLike, label: str = "true") -> None:
    axes.plot(time, true, "--", color=INK, linewidth=1.0, label=label)


def _draw_sinkage(axes: Axes, rows: pd.DataFrame, true: Mapping[str, Any], colour: str) -> None:
    """Draw measured and predicted sinkage of a wheel, and its true sinkage while it moves."""
    time, measured = rows["time"], 1e3 * rows["sinkage_measured"]
    rejected = rows["status"] == Status.REJECTED
    if measured.notna().any():
        axes.plot(time, measured, ".", color=GREY, markersize=3, label="measured")
        axes.plot(time[rejected], measured[rejected], "x", color=INK, markersize=5,
                  label="did not fit")  # fmt: skip
    _curve(axes, rows, "sinkage_predicted", colour, "predicted", 1e3)
    _dashed(axes, true["time"], 1e3 * np.where(true["moving"], true["sinkage"], np.nan))
    known = pd.concat([measured, 1e3 * rows["sinkage_predicted"]]).dropna()
    if known.size:
        axes.set_ylim(1.15 * np.percentile(known, 99.8), 0.0)  # positive down, as in the soil
    _style(axes, _TIME, "sinkage [mm]", f"{rows['wheel'].iloc[0]}: sinkage")


def _draw_pull(axes: Axes, rows: pd.DataFrame, true: Mapping[str, Any], colour: str) -> None:
    """Draw the drawbar pull of a wheel, and its true pull while it moves."""
    _curve(axes, rows, "drawbar_pull", colour, "drawbar pull")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    _dashed(axes, true["time"], np.where(true["moving"], true["drawbar_pull"], np.nan))
    known = rows["drawbar_pull"].dropna()
    if known.size:
        low, high = np.percentile(known, [0.5, 99.5])
        edge = 0.35 * (high - low) + 1.0
        axes.set_ylim(low - edge, high + edge)
    _style(axes, _TIME, "drawbar pull [N]", f"{rows['wheel'].iloc[0]}: drawbar pull")


def _draw_margin(axes: Axes, mobility: pd.DataFrame) -> None:
    """Draw the steepest slope that the vehicle holds: the wheels' mean margin, weighted by load."""
    known = mobility.dropna(subset=["mobility_margin"])
    instants = (known["time"] / _EVERY).round() * _EVERY
    names = ["mobility_margin", "mobility_margin_standard_deviation"]
    sums = known[names].mul(known["load"], axis=0).groupby(instants).sum()
    means = sums.div(known["load"].groupby(instants).sum(), axis=0)
    margin, half = means[names[0]], _BAND * means[names[1]]
    middle, low, high = (np.degrees(np.arctan(m)) for m in (margin, margin - half, margin + half))
    _band(axes, means.index, middle, low, high, "slope held", _LAW)


def _draw_parameter(axes: Axes, name: str, soil: pd.DataFrame, truth: Mapping[str, Any]) -> None:
    """Draw k, n or m of the soil, estimated and true."""
    value = soil[name]
    if name == "k":
        # k is closer to log-normal: a band in its logarithm never reaches below zero.
        factor = np.exp(_BAND * soil["k_standard_deviation"] / value)
        _band(axes, soil["time"], value, value / factor, value * factor, "k", _LAW)
        axes.set_yscale("log")
        low, high = np.percentile(value, [1, 99])
        axes.set_ylim(low / 6, high * 6)
    else:
        _curve(axes, soil, name, _LAW, name)
        axes.set_ylim(value.median() - 0.9, value.median() + 0.9)
    time, index = _stretch_of_time(truth)
    _dashed(axes, time, np.array([stretch[name] for stretch in truth["stretches"]])[index])
    _style(axes, _TIME, f"{name}{_UNITS[name]}", f"{name} of the soil")


def _stretch_of_time(truth: Mapping[str, Any]) -> tuple[Array, NDArray[np.intp]]:
    """Times (s), and the index of the stretch of soil under the rover's middle at each, shape (times,)."""
    starts = [stretch["start"] for stretch in truth["stretches"]]
    index = np.searchsorted(starts, truth["rover"]["way"], side="right") - 1
    return np.array(truth["rover"]["time"]), np.maximum(index, 0)


def _draw_ground(axes: Axes, truth: Mapping[str, Any], end: float) -> None:
    """Shade the soils in the background, with their names; the last one reaches to the end."""
    time, index = _stretch_of_time(truth)
    stretches = truth["stretches"]
    names = list(dict.fromkeys(stretch["name"] for stretch in stretches))
    for i in np.unique(index):
        name, inside = stretches[i]["name"], time[index == i]
        last = end if i == len(stretches) - 1 else inside[-1]
        shade = _GROUND[names.index(name) % len(_GROUND)]
        axes.axvspan(inside[0], last, color=shade, zorder=-5, linewidth=0)
        axes.text(inside[0] + 0.5, 0.98, name.replace("_", " "), va="top", fontsize=8, color=GREY,
                  transform=axes.get_xaxis_transform())  # fmt: skip
