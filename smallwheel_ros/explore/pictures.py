"""The picture of a view: measured against predicted, and what is left over one setting."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smallwheel_ros.display import display, words
from smallwheel_ros.explore.session import Session, View
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.pictures.comparison import GREY, new_figure, style
from smallwheel_ros.report.residual_picture import (
    AFTER,
    BEFORE,
    Shown,
    draw_residuals,
    legend,
    rows_of,
)


def view_picture(session: Session, view: View, over: str) -> Figure:
    """A row for each channel: measured over predicted, and residual over the setting; held out."""
    shown = [Shown(view.before, BEFORE, "base model")]
    if view.names != session.chosen:
        names = ", ".join(words(name) for name in view.names) or "no effect"
        shown.append(Shown(view.after, AFTER, f"with {names}"))
    channels = list(view.before.error)
    figure = new_figure(9.2, 2.75 * len(channels) + 0.3)
    panels = figure.subplots(len(channels), 2, squeeze=False, width_ratios=[1.0, 1.45])
    for (left, right), channel in zip(panels, channels, strict=True):
        scale = display(channel, CHANNEL_UNITS[channel]).scale
        floor = session.document["channels"][channel]["noise_floor"] or 0.0
        band = 2.0 * floor * scale
        _against(left, session, shown, channel, band)
        right.axhspan(-band, band, color="#eceef1", linewidth=0)
        draw_residuals(right, session.measurements, shown, channel, over)
    legend(figure, panels[0, 0], shown)
    return figure


def _against(axes: Axes, session: Session, shown: list[Shown], channel: str, band: float) -> None:
    rows = rows_of(shown[0].errors, channel)
    how = display(channel, CHANNEL_UNITS[channel])
    measured = session.measurements.channels[channel][rows] * how.scale
    margin = 0.06 * max(float(np.ptp(measured)), 1e-9)
    ends = np.array([measured.min() - margin, measured.max() + margin])
    axes.fill_between(ends, ends - band, ends + band, color="#eceef1", linewidth=0)
    axes.plot(ends, ends, color=GREY, linewidth=1.0)
    for one in shown:
        predicted = measured - one.errors.error[channel][rows] * how.scale
        axes.scatter(predicted, measured, s=11, alpha=0.6, linewidth=0, color=one.colour,
                     rasterized=rows.size > 500)  # fmt: skip
    axes.set_ylim(*ends)
    style(axes, f"predicted {how.label}", f"measured {how.label}")
