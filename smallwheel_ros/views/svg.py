# SPDX-License-Identifier: Apache-2.0
"""Plots as SVG elements of a page, by matplotlib, in the page's dark or light colours and its font.

No script draws anything.
"""

from __future__ import annotations

import io
import re
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

from smallwheel_ros.views.plots import PALETTE, WIDTH, Panel, draw, height_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARGINS = 0.62, 0.46, 0.08  # inch: left, below, right and above the axes of a plot in a page

_COLOURS = {shade: f"var(--{name})" for name, shade in PALETTE.items()}
_SHADE = re.compile("|".join(_COLOURS))
# What an element of a page does not need: the head of a file, metadata, comments, and its own font.
_OF_A_FILE = re.compile(
    r"^.*?(?=<svg )|<metadata>.*?</metadata>|<!--.*?-->|font-family: [^;\"]*; |(?<=>)\s+(?=<)",
    re.DOTALL,
)
_ROOT = re.compile(r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>")
# Coordinates, which matplotlib writes to a millionth of a point: they are inside tags, labels between them.
_ELEMENT, _FINER = re.compile(r"<[^>]*>"), re.compile(r"(?<=\d\.\d\d)\d+")


def svg(panel: Panel) -> str:
    """A plot as an SVG element in the colours of the page."""
    return frame(panel)[0]


def frame(panel: Panel) -> tuple[str, list[float]]:
    """Draw a plot without its title as an SVG element; return it with the scale of its axes.

    The scale is (ax, bx, ay, by): a point (x, y) in the units of the axes is at ax + bx x, ay + by y in the
    element, so that points can be added later.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    width, height = WIDTH * (2 if panel.wide else 1), height_of(panel)
    # Where there is more than numbers beside the axes, a layout makes room for it.
    more = panel.bars or panel.equal or any(layer.kind == "way" for layer in panel.layers)
    axes = _axes(width, height, "constrained") if more else _emptied(_plain_axes(width, height))
    draw(axes, replace(panel, title=""))
    out = io.StringIO()
    with rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "plot", "path.simplify_threshold": 0.5}
    ):
        # Not `savefig`, which draws all twice, the first time for nothing.
        canvas: Any = FigureCanvasSVG(axes.figure)  # type: ignore[arg-type]  # no SubFigure
        canvas.print_svg(out, metadata={"Date": None})
    (x0, y0), (x1, y1) = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)])
    scale: list[Any] = [x0, x1 - x0, 72.0 * height - y0, y0 - y1]
    return _in_colours_of_the_page(out.getvalue()), [float(f"{value:.6g}") for value in scale]


def _axes(width: float, height: float, layout: Literal["constrained"] | None = None) -> Axes:
    """The axes of a new figure; inch."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), dpi=72, layout=layout)
    if layout is None:
        left, below, around = _MARGINS
        made.subplots_adjust(left / width, below / height, 1 - around / width, 1 - around / height)
    made.patch.set_visible(False)
    axes = made.subplots()
    axes.patch.set_visible(False)
    return axes


@lru_cache
def _plain_axes(width: float, height: float) -> Axes:
    """Axes with fixed margins, which serve plot after plot: new ones take as long as all else."""
    return _axes(width, height)


def _emptied(axes: Axes) -> Axes:
    """Remove all drawn elements from the axes; ticks and grid stay, and move with the next plot."""
    for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.texts):
        artist.remove()
    if (key := axes.get_legend()) is not None:
        key.remove()
    axes.set_yscale("linear")
    axes.relim()
    axes.autoscale()
    return axes


def _in_colours_of_the_page(text: str) -> str:
    """The element of an SVG file, as wide as the page makes it, with places to a hundredth of a point."""
    text = _ROOT.sub(r"<svg \1>", _OF_A_FILE.sub("", text).replace("xlink:", ""))
    text = _ELEMENT.sub(lambda element: _FINER.sub("", element[0]), text)
    return _SHADE.sub(lambda found: _COLOURS[found[0]], text)
