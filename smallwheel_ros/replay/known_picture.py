# SPDX-License-Identifier: Apache-2.0
"""A picture of one drive seen twice: with all that can be measured, and with hardly anything."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from smallwheel_ros.pictures.house import COLOURS, INK, band, key, new_figure, style, wheel_colours
from smallwheel_ros.replay.drive_picture import stretch_of_time

_BAND = 1.96  # standard deviations: 95 %
_QUANTITIES = (
    ("drawbar_pull", "drawbar_pull", 1.0, "drawbar pull [N]"),
    ("sinkage_predicted", "sinkage", 1e3, "predicted sinkage [mm]"),
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
            axes = grid[i, j]
            _draw(axes, rows["time"], rows[quantity], rows[f"{quantity}_standard_deviation"], colour,
                  scale)  # fmt: skip
            of_wheel = truth["wheels"][wheel]
            known = np.where(of_wheel["moving"], of_wheel[true], np.nan) * scale
            axes.plot(of_wheel["time"], known, "--", color=INK, linewidth=0.9, label="true")
            style(axes, "", label if j == 0 else "", f"{wheel}, {name}" if i == 0 else "")
        _draw_exponent(grid[2, j], soil[name], truth, end)
        style(grid[2, j], "time [s]", "n of the soil" if j == 0 else "")
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


def _draw(
    axes: Axes,
    time: ArrayLike,
    value: ArrayLike,
    deviation: ArrayLike,
    colour: str,
    scale: float = 1.0,
) -> None:
    centre, spread = scale * np.asarray(value), scale * _BAND * np.asarray(deviation)
    band(axes, np.asarray(time), centre, centre - spread, centre + spread, "estimated", colour)


def _draw_exponent(axes: Axes, soil: pd.DataFrame, truth: Mapping[str, Any], end: float) -> None:
    rows = soil[soil["time"] <= end] if len(soil) > 1 else soil
    time = np.append(rows["time"], end)
    if len(rows) == 1:
        time[0] = 0.0
    value = np.append(rows["n"], rows["n"].iloc[-1])
    deviation = np.append(rows["n_standard_deviation"], rows["n_standard_deviation"].iloc[-1])
    _draw(axes, time, value, deviation, COLOURS[2])
    times, index = stretch_of_time(truth)
    true = np.array([stretch["n"] for stretch in truth["stretches"]])[index]
    axes.plot(times, true, "--", color=INK, linewidth=1.2, label="true")
