# SPDX-License-Identifier: Apache-2.0
"""A picture of a cost map, as a planner gets it."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.costmap.grid import HIGHEST, UNKNOWN, Grid
from smallwheel_ros.views.plots import PALETTE, Panel, decorate

_STEPS = 10  # of cost to a colour
_UNKNOWN = "#e8e8e8"
_LETHAL = "#1a1a1a"
_LABELS = ["unknown (-1)", "0 to 9", "40 to 49", "80 to 89", "100, lethal"]
_MARGIN = 1.0  # m around what is known


def draw_cost(
    grid: Grid,
    path: Path | str,
    *,
    way: ArrayLike | None = None,
    planned: ArrayLike | None = None,
    title: str = "",
) -> None:
    """Write a PNG of a grid's costs.

    Parameters
    ----------
    grid
        The costs.
    path
        File of the picture.
    way
        x and y of the robot along its path in the grid's frame, m, shape (places, 2); None: not drawn.
    planned
        x and y along a path that a planner has found, m, shape (places, 2); None: not drawn.
    title
        Text above the picture.
    """
    rows, columns = np.nonzero(grid.cells != UNKNOWN)
    x0, y0 = grid.origin
    extent = (
        x0,
        x0 + grid.cells.shape[1] * grid.resolution,
        y0,
        y0 + grid.cells.shape[0] * grid.resolution,
    )
    shades = matplotlib.colormaps["cividis_r"](np.linspace(0.0, 1.0, HIGHEST // _STEPS))
    colours = ListedColormap([_UNKNOWN, *shades, _LETHAL])
    # Unknown, ten steps up to 99, and 100 for itself.
    bounds = [UNKNOWN - 0.5, *np.arange(0, HIGHEST, _STEPS) - 0.5, HIGHEST - 0.5, HIGHEST + 0.5]
    across = _span(columns, x0, grid.resolution) if rows.size else extent[:2]
    along = _span(rows, y0, grid.resolution) if rows.size else extent[2:]
    # Of the ground's proportions, within limits in which it can be read.
    height = 7.5 * (along[1] - along[0]) / (across[1] - across[0]) + 1.2
    figure = Figure(figsize=(9.0, min(max(height, 3.0), 9.0)), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(
        grid.cells,
        origin="lower",
        extent=extent,
        cmap=colours,
        norm=BoundaryNorm(bounds, colours.N),
        interpolation="nearest",
    )
    lines = [(way, "robot's path", PALETTE["w1"]), (planned, "planned path", PALETTE["w4"])]
    for line, words, colour in lines:
        if line is not None:
            places = np.asarray(line, dtype=np.float64)
            axes.plot(places[:, 0], places[:, 1], color="white", linewidth=2.2)
            axes.plot(places[:, 0], places[:, 1], color=colour, linewidth=1.0, label=words)
    axes.set(xlim=across, ylim=along)
    # As high as the map, whatever shape that has.
    bar = figure.colorbar(image, cax=axes.inset_axes((1.02, 0.0, 0.02, 1.0)))
    bar.set_label("cost", fontsize=9)
    bar.set_ticks([UNKNOWN, 4.5, 44.5, 84.5, HIGHEST], labels=_LABELS)
    bar.ax.tick_params(labelsize=8, width=0.6)
    decorate(axes, Panel(f"x in {grid.frame} [m]", "y [m]", title))
    if axes.get_lines():
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=7.5, frameon=False
        )
    axes.grid(visible=False)
    axes.set_aspect("equal")
    figure.savefig(Path(path), dpi=120)


def _span(cells: NDArray[np.intp], origin: float, side: float) -> tuple[float, float]:
    low, high = float(np.min(cells)), float(np.max(cells)) + 1.0
    return origin + low * side - _MARGIN, origin + high * side + _MARGIN
