# SPDX-License-Identifier: Apache-2.0
"""A table of measurements as shown to people, before anything is computed from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from smallwheel_ros.common.result import name_to_draw
from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.measurements.display import column_display, display, number
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import varied_settings
from smallwheel_ros.views.plots import Layer, Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def text(data: Measurements) -> str:
    """A line for each column, and how the table was understood, what was assumed, and what is suspicious."""
    lines = [data.headline()]
    for name, values in data.columns().items():
        if np.asarray(values).dtype.kind != "f" or not np.isfinite(values).any():
            continue
        of_channel = name in data.channels
        shown = display(name, unit_of(name)) if of_channel else column_display(data, name)
        # A channel keeps its name, as the table has it.
        label = f"{name} [{shown.unit}]" if of_channel else shown.label
        low, high = (number(shown.scale * end(values)) for end in (np.nanmin, np.nanmax))
        lines.append(f"  {label}: {low} to {high}")
    lines += [f"understood: {said}" for said in data.understood]
    lines += [f"warning: {said}" for said in data.warnings]
    return "\n".join([*lines, *(f"note: {said}" for said in data.notes)])


def draw(
    axes: Axes, data: Measurements, channel: str | None = None, over: str | None = None
) -> None:
    """Draw a measured channel over a setting.

    Parameters
    ----------
    axes
        Axes to draw on.
    data
        The measurements.
    channel
        Name of the channel, such as `sinkage`; the first one if not given.
    over
        Name of the setting on the x-axis: `load`, or one that was varied; the load if not given.

    Raises
    ------
    ResultError
        If there is no such channel or setting.
    """
    settings = {"load": data.conditions.load} | dict(varied_settings(data))
    channel, over = name_to_draw(channel, data.channels), name_to_draw(over, settings)
    across, shown = column_display(data, over), display(channel, unit_of(channel))
    points = Layer("points", settings[over] * across.scale, data.channels[channel] * shown.scale)
    draw_panel(axes, Panel(across.label, shown.label, layers=[points]))
