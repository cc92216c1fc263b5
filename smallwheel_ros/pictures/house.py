# SPDX-License-Identifier: Apache-2.0
"""How all pictures look: the colours of the pages, thin axes, small type, bands that are light."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

# Okabe and Ito's colours: told apart by colour-blind readers and in grey print.
COLOURS = ("#D55E00", "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#444444")
GREY, INK = "#8a8f98", "#22262b"
# A wheel has the same colour in every picture and page (page.css: --w0 and on).
_WHEELS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#444444", "#A6761D")


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


def key(axes: Axes, place: str = "lower left", columns: int = 4) -> None:
    """The key of a panel, small, on a ground through which the data is seen."""
    axes.legend(loc=place, fontsize=7.5, ncols=columns, frameon=True, framealpha=0.7,
                edgecolor="none")  # fmt: skip
