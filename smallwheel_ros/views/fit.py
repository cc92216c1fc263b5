# SPDX-License-Identifier: Apache-2.0
"""The page of a fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from smallwheel_ros.common.result import name_to_draw
from smallwheel_ros.fitting.result import FitResult
from smallwheel_ros.measurements.display import LAW, shown_value, words
from smallwheel_ros.views.blocks import (
    Column,
    Figure,
    Section,
    Table,
    Text,
    of_channel,
    plain_number,
)
from smallwheel_ros.views.leftovers import Left, measured_panel
from smallwheel_ros.views.notes import grouped
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.parameters import parameter_rows, parameter_table
from smallwheel_ros.views.plots import Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TOGETHER = 0.5  # correlation; below, a combination of two numbers is hardly better known than each


def page(found: FitResult, pictures: bool = True) -> Page:
    """Make the page of a fit.

    Parameters
    ----------
    found
        The fit.
    pictures
        Whether the page has a figure of measured over predicted values.
    """
    errors = [
        {"channel": name, "held_out": found.held_out.get(name), "in_sample": score.rmse,
         "absolute": noise.absolute, "relative": noise.relative, "source": noise.source}
        for name, noise in found.noise.items()
        if (score := found.errors.scores().get(name)) is not None
    ]  # fmt: skip
    columns = [
        Column("channel", "channel", words), of_channel("held-out RMSE", "held_out"),
        of_channel("in-sample RMSE", "in_sample"),
        Column("one row repeats within", lambda row: f"{shown_value(row['channel'], row['absolute'])} "
               f"and {100.0 * row['relative']:.1f} %"),
        Column("known from", "source"),
    ]  # fmt: skip
    return Page(
        "A fitted model",
        [
            Section("In short", [Text(found.headline())]),
            Section(
                "Parameters",
                [
                    parameter_table(parameter_rows(found, derived=True), ""),
                    Text(LAW),
                    *_correlations(found),
                ],
            ),
            Section(
                "Errors",
                [
                    Table(columns, errors),
                    *([Figure("measured", _panels(found))] if pictures else []),
                ],
            ),
            Section("Notes", [Text(items=grouped(found.notes))]),
        ],
        found.measurements.source,
    )


def _correlations(found: FitResult) -> list[Table]:
    """A table of the pairs of fitted numbers with a high correlation; empty if there are none."""
    rows = [
        {"one": found.names[b], "other": found.names[a], "correlation": found.correlation[a, b]}
        for a, b in np.argwhere(np.tril(np.abs(found.correlation) > _TOGETHER, -1))
    ]
    if not rows:
        return []
    columns = [
        Column("of", lambda row: _parameter_words(row["one"])),
        Column("and", lambda row: _parameter_words(row["other"])),
        plain_number("correlation", "correlation", 2),
    ]
    caption = f"Correlations over {_TOGETHER:g}; all are in the JSON"
    return [Table(columns, sorted(rows, key=lambda row: -abs(row["correlation"])), caption)]


def _parameter_words(full_name: str) -> str:
    owner, _, name = full_name.rpartition(".")
    return f"{owner}: {words(name)}"


def draw(axes: Axes, found: FitResult, channel: str | None = None) -> None:
    """Draw measured over predicted values of the rows that the model was fitted to.

    Parameters
    ----------
    axes
        Axes to draw on.
    found
        The fit.
    channel
        Name of the channel, such as `sinkage`; the first one if not given.

    Raises
    ------
    ResultError
        If there is no such channel.
    """
    panels = dict(zip(found.residuals, _panels(found), strict=True))
    draw_panel(axes, panels[name_to_draw(channel, panels)])


def _panels(found: FitResult) -> list[Panel]:
    left = [Left(found.errors, "", "with")]
    channels = found.measurements.channels
    return [measured_panel(channels[name], left, name) for name in found.residuals]
