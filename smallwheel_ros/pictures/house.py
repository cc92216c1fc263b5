# SPDX-License-Identifier: Apache-2.0
"""How all pictures look: the colours of the pages, thin axes, small type, bands that are light."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.files import OutputError, check_target, write_bytes
from smallwheel_ros.measurements.display import number

Array = NDArray[np.float64]

# Okabe and Ito's colours: told apart by colour-blind readers and in grey print.
COLOURS = ("#D55E00", "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#444444")
GREY, INK = "#8a8f98", "#22262b"
# A wheel has the same colour in every picture and page (page.css: --w0 and on).
_WHEELS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#444444", "#A6761D")
WITH_COLOUR = _WHEELS[0]  # of a model with what was added
_SHADES = {"--ink": INK, "--base": GREY, "--with": WITH_COLOUR} | {
    f"--w{i}": colour for i, colour in enumerate(_WHEELS)
}
_BAND = "#e9ebef"
_PANELS = 3  # in a row of a grid


def wheel_colours(wheels: Iterable[str]) -> dict[str, str]:
    """The colour of each wheel, by name."""
    return {wheel: _WHEELS[i % len(_WHEELS)] for i, wheel in enumerate(sorted(set(wheels)))}


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that size (inch) that keeps its labels inside."""
    return Figure(figsize=(width, height), layout="constrained")


def style(axes: Axes, x: str = "", y: str = "", title: str = "") -> None:
    """The house style: no box, light grid, small type."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.grid(color="#e6e8eb", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, labelsize=8, width=0.6)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)
    axes.set_title(title, fontsize=9.5, color=INK, loc="left", parse_math=False)


def plain(text: str) -> str:
    """Column names come from a file: a dollar sign in one is not mathematics."""
    return text.replace("$", r"\$")


def band(
    axes: Axes, x: ArrayLike, y: ArrayLike, low: ArrayLike, high: ArrayLike, label: str, colour: str
) -> None:
    """A curve and its band of 95 %."""
    axes.plot(x, y, color=colour, linewidth=1.2, label=label)
    axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0, label="its 95 % band")


def key(axes: Axes) -> None:
    """The key of a panel in the line of its title, on the right: nothing is under it."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=8, fontsize=7.5, frameon=False,
                borderpad=0.0, borderaxespad=0.3, columnspacing=1.1, handlelength=1.4,
                handletextpad=0.5)  # fmt: skip


def grid(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """A figure with that many panels of that size (inch), in rows of three."""
    columns = min(count, _PANELS)
    rows = -(-count // columns)
    figure = new_figure(max(width * columns, 4.5), height * rows)
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes[:count]


def headed(figure: Figure, text: str) -> None:
    """Say above the panels what is seen in them."""
    figure.suptitle(plain(text), fontsize=8.5, color=INK, x=0.01, ha="left")


class Bar(NamedTuple):
    """A bar: its value with standard error, a second one that is pale; None where there is none."""

    name: str
    value: float | None
    colour: str
    std: float | None = None
    pale: float | None = None
    hatched: bool = False


def bars(
    axes: Axes,
    rows: Sequence[Bar],
    label: str,
    title: str = "",
    level: float | None = None,
    scale: float = 1.0,
) -> None:
    """Bars below each other, each with its name and value, times scale. level: of a true model, dashed."""
    two = any(row.pale is not None for row in rows)
    height, off = (0.34, 0.17) if two else (0.68, 0.0)
    for at, row in enumerate(rows):
        value, std, pale = (
            None if size is None else scale * size for size in (row.value, row.std, row.pale)
        )
        if value is not None:
            axes.barh(at - off, value, height, color=row.colour, xerr=std,
                      hatch="////" if row.hatched else None, edgecolor="white", linewidth=0,
                      error_kw={"elinewidth": 0.9, "ecolor": INK})  # fmt: skip
            axes.annotate(number(value), (value + (std or 0.0), at - off), (3, 0), va="center",
                          textcoords="offset points", fontsize=7.5, color=INK,
                          bbox={"fc": "white", "ec": "none", "pad": 0.2})  # fmt: skip
        if pale is not None:
            axes.barh(at + off, pale, height, color=row.colour, alpha=0.4)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    if level is not None:
        level *= scale
        axes.axvline(level, color=INK, linewidth=1.0, linestyle="--")
        title += f"   dashed: a true model, {number(level)}"
    style(axes, label, "", title)
    axes.grid(visible=False, axis="y")
    axes.set_yticks(range(len(rows)), [plain(row.name) for row in rows])
    axes.margins(x=0.15)
    axes.set_xlim(left=0.0)


def key_outside(figure: Figure, entries: Sequence[tuple[str, str]]) -> None:
    """Say below the panels what each colour is. entries: colours and labels."""
    lines = [Line2D([], [], color=_shade(colour), linewidth=1.8) for colour, _ in entries]
    figure.legend(lines, [plain(label) for _, label in entries], loc="outside lower left", ncols=4,
                  fontsize=8, frameon=False)  # fmt: skip


def _shade(colour: str) -> str:
    """A colour of the page's by its name there; any other as it is."""
    return _SHADES.get(colour, colour)


# Plots as plain data, see layers.py.


def draw(axes: Axes, plot: Mapping[str, Any]) -> None:
    """Draw a plot on axes, in the style of the house."""
    across = np.concatenate([np.asarray(part.get("x", []), float) for part in plot["layers"]])
    x_range = plot.get("x_range") or (np.nanmin(across), np.nanmax(across))
    for layer in plot["layers"]:
        colour = _shade(layer.get("colour", "--with"))
        known = ("x", "y", "low", "high")  # None in them is a gap
        place = {name: np.asarray(layer[name], float) for name in known if name in layer}
        if layer["kind"] == "band":
            middle = layer.get("slope", 0.0) * np.array(x_range)
            ends = middle + place["low"], middle + place["high"]
            axes.fill_between(x_range, *ends, color=_BAND, linewidth=0)
            axes.plot(x_range, middle, color=GREY, linewidth=1.0)
        elif layer["kind"] == "points":
            _points(axes, layer, colour, **place)
        else:
            _line(axes, layer, colour, **place)
    style(axes, plain(plot["x"]), plain(plot["y"]), plot.get("title", ""))
    axes.set(xlim=plot.get("x_range"), ylim=plot.get("y_range"))


def _points(
    axes: Axes, layer: Mapping[str, Any], colour: str, x: Array, y: Array, **whiskers: Array
) -> None:
    axes.scatter(x, y, s=12, alpha=layer.get("alpha", 0.65), linewidth=0, color=colour,
                 label=plain(layer.get("name", "")), rasterized=x.size > 500)  # fmt: skip
    if whiskers:
        axes.vlines(x, whiskers["low"], whiskers["high"], color=colour, linewidth=0.8)


def _line(
    axes: Axes, layer: Mapping[str, Any], colour: str, x: Array, y: Array, **band: Array
) -> None:
    dash, dots = layer.get("dash"), layer.get("dots", False)
    axes.plot(x, y, color=colour, linewidth=layer.get("width", 1.7), label=plain(layer.get("name", "")),
              linestyle=(0, tuple(dash)) if dash else "-", marker="o" if dots else "",
              markersize=4)  # fmt: skip
    if band and dots:
        axes.vlines(x, band["low"], band["high"], color=colour, linewidth=1.4)
    elif band:
        axes.fill_between(x, band["low"], band["high"], color=colour, alpha=0.18, linewidth=0)


# Into files.


def save(figure: Figure, path: Path) -> None:
    """Write a figure; the suffix picks the format. Raises OutputError."""
    check_target(path)
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be drawn: {error}") from error


def write_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write each figure as PNG under its name. Raises OutputError where it cannot."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    written = []
    for name, figure in figures.items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=150)
        written.append(folder / f"{name}.png")
        write_bytes(written[-1], picture.getvalue())
    return written
