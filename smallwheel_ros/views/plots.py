# SPDX-License-Identifier: Apache-2.0
"""One description of a plot, drawn by matplotlib: on axes of a notebook, as PNG, or as SVG in a page.

`views.svg` makes SVG elements of the plots drawn here.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.files import OutputError, write_bytes
from smallwheel_ros.measurements.display import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

Array = NDArray[np.float64]

# Okabe and Ito's colours, told apart by the colour-blind and in grey print; page.css has each by its name.
PALETTE = {
    "ink": "#22262b", "base": "#8a8f98", "with": "#0072b2", "grid": "#e6e8eb", "band": "#e9ebef",
    "paper": "#ffffff", "w1": "#d55e00", "w2": "#009e73", "w3": "#cc79a7", "w4": "#e69f00",
    "w5": "#56b4e9", "w6": "#444444", "w7": "#a6761d",
}  # fmt: skip
CYCLE = ("with", "w1", "w2", "w3", "w4", "w5", "w6", "w7")
WIDTH = 4.3  # inch, of a panel: small, so that its letters are legible on a phone
_RASTER = 600  # points of a layer from which a page has an image instead
_ACROSS = 3  # panels of a row


@dataclass(frozen=True)
class Layer:
    """One element of a plot.

    Attributes
    ----------
    kind
        `points`; `means`, as squares; `line`; `band`, an area from `low` to `high` (numbers) around 0 or the
        diagonal; `way`, a line coloured by `value`.
    x, y
        Data in the units of the axes, shape (points,).
    low, high
        Ends of the band of a line or of the whiskers of points, in the unit of y, shape (points,), or None.
    colour
        Key of `PALETTE`.
    name
        Name in the plot's key; empty: it is not in the key.
    dash, width
        Style of a line as matplotlib has it, and its width in points.
    diagonal
        Whether a band is around the diagonal.
    value
        Values by which a `way` is coloured, shape (points,); the last one is not used.
    """

    kind: Literal["points", "means", "line", "band", "way"]
    x: ArrayLike = ()
    y: ArrayLike = ()
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    colour: str = "with"
    name: str = ""
    dash: str = "-"
    width: float = 1.7
    diagonal: bool = False
    value: ArrayLike = ()


class Span(NamedTuple):
    """A named range of the x-axis, shaded in the background.

    Attributes
    ----------
    start, end
        Ends, in the unit of the x-axis.
    name
        Words at its start.
    shade
        Number of the shade; there are three.
    """

    start: float
    end: float
    name: str
    shade: int


class Mark(NamedTuple):
    """A vertical line at `x`, in the unit of the x-axis; `colour` is a key of `PALETTE`."""

    x: float
    colour: str


@dataclass(frozen=True)
class Bar:
    """A horizontal bar.

    Attributes
    ----------
    name
        Name beside the bar.
    value, std
        Length of the bar in the unit of the x-axis, and its standard error; None if unknown.
    colour
        Key of `PALETTE`.
    pale
        Length of a second, pale bar; None for none.
    """

    name: str
    value: float | None
    colour: str = "with"
    std: float | None = None
    pale: float | None = None


@dataclass(frozen=True)
class Panel:
    """A plot, either of layers or of bars.

    Attributes
    ----------
    x, y, title
        Labels of the axes, and the title.
    layers, bars
        Elements of the plot, the first at the back; bars from top to bottom.
    level, level_name
        Value of a dashed line across the bars, None for none, and the words beside it.
    x_range, y_range
        Ends of the axes; None: those of the data.
    key
        Whether names of layers are shown in a key.
    log
        Whether the y-axis is logarithmic.
    equal
        Whether both axes have the same scale.
    spans, marks
        Shaded ranges in the background, and vertical lines.
    height
        Height of a plot of layers, inch.
    wide
        Whether it takes the width of two plots.
    """

    x: str = ""
    y: str = ""
    title: str = ""
    layers: Sequence[Layer] = ()
    bars: Sequence[Bar] = ()
    level: float | None = None
    level_name: str = "a true model"
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    key: bool = True
    log: bool = False
    equal: bool = False
    spans: Sequence[Span] = ()
    marks: Sequence[Mark] = ()
    height: float = 2.9
    wide: bool = False

    @property
    def label(self) -> str:
        """A description in words, for readers who cannot see it."""
        what = f"{self.y} over {self.x}" if self.y else self.x
        values = ", ".join(f"{bar.name} {number(bar.value)}" for bar in self.bars)
        return ": ".join(part for part in (self.title, what, values) if part)


def draw(axes: Axes, panel: Panel) -> None:
    """Draw a plot on axes, in the style of all plots.

    Parameters
    ----------
    axes
        Axes of matplotlib to draw on.
    panel
        The plot.
    """
    for layer in panel.layers:
        _draw_layer(axes, panel, layer)
    if panel.bars:
        _draw_bars(axes, panel)
    for span in panel.spans:
        axes.axvspan(
            span.start,
            span.end,
            color=PALETTE["band"],
            alpha=0.3 * (1 + span.shade % 3),
            zorder=-5,
            linewidth=0,
        )
        axes.annotate(span.name.replace("_", " "), (span.start, 0.99), (2, 0), va="top", fontsize=7,
                      xycoords=("data", "axes fraction"), textcoords="offset points",
                      color=PALETTE["base"])  # fmt: skip
    for mark in panel.marks:
        axes.axvline(mark.x, color=PALETTE[mark.colour], linewidth=1.0, linestyle=":")
    if panel.log:
        axes.set_yscale("log")
    if panel.equal:
        # By wider limits, so that the axes of a narrow path are no strip without room for their numbers.
        axes.set_aspect("equal", adjustable="datalim")
    decorate(axes, panel)
    if not panel.equal:  # whose limits follow from the room that there is
        axes.set(xlim=panel.x_range or axes.get_xlim(), ylim=panel.y_range or axes.get_ylim())
    if panel.key and any(layer.name for layer in panel.layers):
        # Above a path, which the search for a free place does not see.
        way = any(layer.kind == "way" for layer in panel.layers)
        where = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)} if way else {}
        axes.legend(fontsize=7.5, frameon=False, labelcolor=PALETTE["ink"], **where)


def decorate(axes: Axes, panel: Panel) -> None:
    """Apply the style of all plots to axes: no box, a light grid, small type; set labels and title.

    Parameters
    ----------
    axes
        Axes of matplotlib to style.
    panel
        Plot whose labels and title are set; with bars, only the x-axis has a grid.
    """
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALETTE["base"])
    axes.grid(
        visible=True, axis="x" if panel.bars else "both", color=PALETTE["grid"], linewidth=0.6
    )
    axes.set_axisbelow(True)
    axes.tick_params(colors=PALETTE["ink"], labelsize=8, length=0)
    axes.locator_params(axis="x", nbins=6)
    for set_label, text in ((axes.set_xlabel, panel.x), (axes.set_ylabel, panel.y)):
        set_label(_safe(text), fontsize=9, color=PALETTE["ink"])
    axes.set_title(_safe(panel.title), fontsize=9.5, color=PALETTE["ink"], loc="left")


def _draw_layer(axes: Axes, panel: Panel, layer: Layer) -> None:
    colour, label = PALETTE[layer.colour], _safe(layer.name) or None
    x, y = np.asarray(layer.x, float), np.asarray(layer.y, float)
    known = layer.low is not None and layer.high is not None
    low, high = (np.asarray(end if known else np.nan, float) for end in (layer.low, layer.high))
    if layer.kind == "band":
        ends = np.array(panel.x_range or (0.0, 1.0))
        middle = ends if layer.diagonal else 0.0 * ends
        axes.fill(np.append(ends, ends[::-1]), np.append(middle + low, (middle + high)[::-1]),
                  color=PALETTE["band"], linewidth=0)  # fmt: skip
        axes.plot(ends, middle, color=PALETTE["base"], linewidth=1.0)
    elif layer.kind == "way":
        from matplotlib.collections import LineCollection

        ends = np.stack([np.column_stack([x, y])[:-1], np.column_stack([x, y])[1:]], axis=1)
        way = axes.add_collection(
            LineCollection(list(ends), cmap="cividis_r", linewidth=3.5, zorder=0.9)
        )
        way.set_array(np.asarray(layer.value, float)[:-1])
        least, most = min(0.0, float(np.nanmin(layer.value))), float(np.nanmax(layer.value))
        way.set_clim(least, most if most > least else least + 1.0)
        axes.figure.colorbar(way, ax=axes, shrink=0.9, aspect=12, pad=0.01).ax.tick_params(
            labelsize=7.5, length=0, colors=PALETTE["ink"])  # fmt: skip
        axes.autoscale()
    elif layer.kind in ("points", "means"):
        means = layer.kind == "means"
        axes.scatter(x, y, s=26 if means else 12, alpha=1.0 if means else 0.6, color=colour, label=label,
                     marker="s" if means else "o", linewidth=0.5 if means else 0.0,
                     edgecolor=PALETTE["paper"], rasterized=x.size > _RASTER)  # fmt: skip
        if known:
            axes.vlines(x, low, high, color=colour, linewidth=1.2 if means else 0.8)
    else:
        axes.plot(x, y, color=colour, linewidth=layer.width, linestyle=layer.dash, label=label)
        if known:
            axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)


def _draw_bars(axes: Axes, panel: Panel) -> None:
    two = any(bar.pale is not None for bar in panel.bars)
    height, off = (0.34, 0.17) if two else (0.6, 0.0)
    for at, bar in enumerate(panel.bars):
        colour = PALETTE[bar.colour]
        if bar.pale is not None:
            axes.barh(at + off, bar.pale, height, color=colour, alpha=0.4)
        if bar.value is None:
            continue
        axes.barh(at - off, bar.value, height, color=colour, xerr=bar.std,
                  error_kw={"elinewidth": 0.9, "ecolor": PALETTE["ink"]})  # fmt: skip
        axes.annotate(number(bar.value), (bar.value + (bar.std or 0.0), at - off), (3, 0),
                      va="center", textcoords="offset points", fontsize=7.5, color=PALETTE["ink"],
                      bbox={"facecolor": PALETTE["paper"], "edgecolor": "none", "pad": 0.5})  # fmt: skip
    if panel.level is not None:
        axes.axvline(panel.level, color=PALETTE["ink"], linewidth=1.0, linestyle="--")
        axes.annotate(f"{panel.level_name} {number(panel.level)}", (panel.level, 1.0), (2, 1),
                      xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=7.5,
                      color=PALETTE["ink"])  # fmt: skip
    axes.set_ylim(len(panel.bars) - 0.5, -0.5)
    axes.set_yticks(range(len(panel.bars)), [_safe(bar.name) for bar in panel.bars])
    axes.margins(x=0.15)
    axes.set_xlim(left=0.0)


def _safe(text: str) -> str:
    """Escape dollar signs: in a column's name from a file they do not begin mathematics."""
    return text.replace("$", r"\$")


def picture(panels: Sequence[Panel]) -> Picture:
    """The panels in one figure of matplotlib, in rows of three."""
    from matplotlib.figure import Figure

    columns = min(len(panels), _ACROSS)
    rows = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    heights = [max(map(height_of, row)) for row in rows]
    made = Figure(figsize=(WIDTH * columns, sum(heights)), layout="constrained")
    grid = made.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
    for axes, panel in zip(grid.flat, panels, strict=False):
        draw(axes, panel)
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    return made


def height_of(panel: Panel) -> float:
    """The height of a plot, inch."""
    return 0.9 + 0.32 * len(panel.bars) if panel.bars else panel.height


def write_picture(panels: Sequence[Panel], path: Path) -> Path:
    """Write panels as one picture.

    Parameters
    ----------
    panels
        Plots, drawn in rows of three.
    path
        The file; its suffix selects the format, such as .png or .svg; without a suffix it is PNG.

    Returns
    -------
    Path
        The given path.

    Raises
    ------
    OutputError
        If the format is unknown or the file cannot be written.
    """
    drawn = io.BytesIO()
    try:
        picture(panels).savefig(drawn, format=path.suffix[1:] or "png", dpi=150)
    except ValueError as error:
        raise OutputError(f"{path}: cannot be drawn: {error}") from error
    write_bytes(path, drawn.getvalue())
    return path
