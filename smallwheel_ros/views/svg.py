# SPDX-License-Identifier: Apache-2.0
"""Plots as SVG elements of a page: in its colours, dark or light, in its type, and short.

matplotlib draws them; here is left out what is not seen. Nothing is drawn by a script.
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
# Its head, fonts, ids but of what is used elsewhere, and turns by nothing.
_UNSEEN = re.compile(
    r"^.*?(?=<svg )|<metadata>.*?</metadata>|<!--.*?-->|<defs>\s*<style.*?</style>\s*</defs>|xlink:"
    r"| id=\"(?!p\w{10}\"|m\w{10}\")[^\"]*\"| transform=\"rotate\(-0 [^\"]*\"|font-family: [^;\"]*; "
    r"|(?<=>)\s+(?=<)",
    re.DOTALL,
)
_ROOT = re.compile(r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>")
_TAG = re.compile("<[^>]+>")
_FINER, _WHOLE = re.compile(r"(?<=\.\d)\d+"), re.compile(r"\.0(?!\d)")  # than a tenth of a point
_GROUP = re.compile("<g[^>]*/>|<g[^>]*>|</g>")
_PATH = re.compile(r'<path d="([^"]*)"([^>]*fill: none[^>]*)/>')
_D = re.compile(r' d="([^"]*)"')
_CIRCLE = re.compile(r'<defs><path id="(\w+)" d="M0 ([\d.]+)C[^"]*"/></defs>')
_USES = re.compile(
    r'(?:<use href="#(\w+)" x="[^"]*" y="[^"]*" (style="[^"]*")/>)(?:<use href="#\1"[^>]*\2/>)*'
)
_AT = re.compile(r'x="([^"]*)" y="([^"]*)"')


def svg(panel: Panel) -> str:
    """A plot as an SVG element in the colours of the page."""
    return frame(panel)[0]


def frame(panel: Panel) -> tuple[str, list[float]]:
    """An SVG element with room for points, and how values become its units: (ax, bx, ay, by).

    x of the element is ax + bx * value.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    width, height = WIDTH * (2 if panel.wide else 1), height_of(panel)
    # More than numbers beside the axes: a layout finds room for it.
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
    return _shorter(out.getvalue()), [float(f"{value:.6g}") for value in scale]


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
    """The axes without what was drawn on them; ticks and grid stay, and are moved."""
    for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.texts):
        artist.remove()
    if (key := axes.get_legend()) is not None:
        key.remove()
    axes.set_yscale("linear")
    axes.relim()
    axes.autoscale()
    return axes


def _shorter(text: str) -> str:
    """The same picture in a third of the letters."""
    text = _UNSEEN.sub("", text.replace("\n", " "))
    text = _ROOT.sub(r"<svg \1>", text)
    text = _TAG.sub(lambda tag: _WHOLE.sub("", _FINER.sub("", tag[0])), text)
    text = _SHADE.sub(lambda found: _COLOURS[found[0]], text)
    text = _D.sub(lambda d: f' d="{_short_path(d[1])}"', _ungrouped(text))
    return _merged(_with_dots(text))


def _short_path(d: str) -> str:
    """A path without the spaces beside its letters; pairs that follow a pair are lines."""
    packed = re.sub(r" *([MLCQz]) *", r"\1", d).strip()
    return packed if re.search("[CQ]", packed) else packed.replace("L", " ")


def _ungrouped(text: str) -> str:
    """Without groups that say nothing of what is in them."""
    kept: list[bool] = []

    def one(tag: re.Match[str]) -> str:
        if tag[0] == "</g>":
            return tag[0] if kept.pop() else ""
        says = " " in tag[0]
        if tag[0].endswith("/>"):
            return ""
        kept.append(says)
        return tag[0] if says else ""

    return _GROUP.sub(one, text)


def _with_dots(text: str) -> str:
    """Circles of one size and colour as one line, whose pieces have no length and round ends."""
    radius = {name: float(size) for name, size in _CIRCLE.findall(text)}

    def dots(uses: re.Match[str]) -> str:
        if uses[1] not in radius:
            return uses[0]
        d = "".join(f"M{x} {y}h0" for x, y in _AT.findall(uses[0]))
        style = uses[2].removesuffix('"').replace("fill", "stroke")
        width = f"{2.0 * radius[uses[1]]:.1f}"
        return f'<path d="{d}" {style}; stroke-width: {width}; stroke-linecap: round"/>'

    return _USES.sub(dots, _CIRCLE.sub("", text))


def _merged(text: str) -> str:
    """Lines of one style, as those of a grid are, are one path where the first of them is."""
    lines: dict[str, list[str]] = {}
    for d, style in _PATH.findall(text):
        lines.setdefault(style, []).append(d)
    return _PATH.sub(lambda p: _all_of(lines.pop(p[2], []), p[2]), text)


def _all_of(lines: list[str], style: str) -> str:
    return f'<path d="{"".join(lines)}"{style}/>' if lines else ""
