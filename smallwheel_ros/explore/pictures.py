"""The picture of a view: measured against predicted, and what is left over one setting."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smallwheel_ros.compare.scores import UNITS, levels
from smallwheel_ros.compare.smoothing import smooth
from smallwheel_ros.diagnosis.candidates import settings_of
from smallwheel_ros.diagnosis.held_out import Errors
from smallwheel_ros.display import column_display, display, words
from smallwheel_ros.explore.session import Session, View
from smallwheel_ros.pictures.comparison import COLOURS, GREY, new_figure, style

Array = NDArray[np.float64]

_MOST_POINTS = 2000  # of a channel
_BLUE = COLOURS[2]


def view_picture(session: Session, view: View, over: str) -> Figure:
    """A row for each channel: measured over predicted, and residual over the setting; held out."""
    observations = session.workbench.observations
    across = column_display(session.measurements, over)
    setting = settings_of(observations)[over][observations.row] * across.scale
    shown = [(view.before, GREY, "without effects")]
    if view.names:
        shown.append((view.after, _BLUE, "with " + ", ".join(words(n) for n in view.names)))
    channels = observations.channels
    figure = new_figure(9.2, 2.75 * len(channels) + 0.3)
    panels = figure.subplots(len(channels), 2, squeeze=False, width_ratios=[1.0, 1.45])
    for (left, right), channel in zip(panels, channels, strict=True):
        rows = _thinned(np.flatnonzero(observations.of_channel(channel)))
        how = display(channel, UNITS[channel])
        floor = 2.0 * view.floor.get(channel, 0.0) * how.scale
        _against(left, observations.value[rows] * how.scale, shown, rows, how.scale, floor)
        style(left, f"predicted {how.label}", f"measured {how.label}")
        right.axhspan(-floor, floor, color="#eceef1", linewidth=0)
        right.axhline(0.0, color=GREY, linewidth=0.9)
        for errors, colour, _ in shown:
            _curve(right, setting[rows], errors.error[rows] * how.scale, errors.run[rows], colour)
        left_over = np.concatenate([errors.error[rows] for errors, _, _ in shown]) * how.scale
        edge = 0.08 * max(float(np.ptp(left_over)), 1e-9)
        # Of the points: where they are few the band may run far out.
        right.set_ylim(min(left_over.min(), 0.0) - edge, max(left_over.max(), 0.0) + edge)
        style(right, _plain(across.label), f"measured - predicted [{how.unit}]")
    handles = panels[0, 0].collections[-len(shown) :]
    figure.legend(handles, [_plain(label) for _, _, label in shown], loc="outside upper left",
                  ncols=2, fontsize=8.5, frameon=False)  # fmt: skip
    return figure


def _against(
    axes: Axes,
    measured: Array,
    shown: list[tuple[Errors, str, str]],
    rows: NDArray[np.intp],
    scale: float,
    floor: float,
) -> None:
    margin = 0.06 * max(float(np.ptp(measured)), 1e-9)
    ends = np.array([measured.min() - margin, measured.max() + margin])
    axes.fill_between(ends, ends - floor, ends + floor, color="#eceef1", linewidth=0)
    axes.plot(ends, ends, color=GREY, linewidth=1.0)
    for errors, colour, _ in shown:
        predicted = measured - errors.error[rows] * scale
        axes.scatter(predicted, measured, s=11, alpha=0.6, linewidth=0, color=colour,
                     rasterized=rows.size > 500)  # fmt: skip
    axes.set_ylim(*ends)


def _curve(axes: Axes, x: Array, y: Array, run: NDArray[np.intp], colour: str) -> None:
    axes.scatter(x, y, s=9, alpha=0.4, color=colour, linewidth=0, rasterized=x.size > 500)
    if x.size < 3 or np.ptp(x) == 0.0:
        return
    few = levels(x)
    curve = smooth(x, y, run, few)
    axes.plot(curve.x, curve.y, color=colour, linewidth=1.7, marker="o" if few is not None else "",
              markersize=4)  # fmt: skip
    if few is None:
        axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.16, linewidth=0)
    else:
        axes.vlines(curve.x, curve.low, curve.high, color=colour, linewidth=1.3)


def _plain(text: str) -> str:
    """A dollar sign in a column's name is not mathematics."""
    return text.replace("$", r"\$")


def _thinned(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    if rows.size <= _MOST_POINTS:
        return rows
    return np.sort(np.random.default_rng(0).choice(rows, _MOST_POINTS, replace=False))
