# SPDX-License-Identifier: Apache-2.0
"""A picture of a replayed drive."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes

from smallwheel_ros.physics.soil import nearest
from smallwheel_ros.results import ResultError

_POINTS = 700  # of a wheel


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
