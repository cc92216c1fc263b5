# SPDX-License-Identifier: Apache-2.0
"""A column of a replay's table of estimates as a picture."""

from __future__ import annotations

from matplotlib.axes import Axes

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.results import ResultError
from smallwheel_ros.pictures.house import key, style, wheel_colours
from smallwheel_ros.replay.result import Replayed

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
    style(axes, "time [s]", quantity.replace("_", " "))
    key(axes)
