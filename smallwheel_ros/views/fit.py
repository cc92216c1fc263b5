# SPDX-License-Identifier: Apache-2.0
"""A fit as people see it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smallwheel_ros.fitting.result import FitResult
from smallwheel_ros.measurements.display import LAW, shown_value, words
from smallwheel_ros.views.blocks import Column, Figure, Section, Table, Text, of_channel
from smallwheel_ros.views.leftovers import Left, measured_panel
from smallwheel_ros.views.notes import grouped
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.parameters import parameter_rows, parameter_table
from smallwheel_ros.views.plots import Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def page(found: FitResult, pictures: bool = True) -> Page:
    """The page of a fit."""
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
                "Parameters", [parameter_table(parameter_rows(found, derived=True), ""), Text(LAW)]
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


def draw(axes: Axes, found: FitResult, channel: str | None = None) -> None:
    """Measured over predicted in sample, of the first channel if not given."""
    names = list(found.residuals)
    draw_panel(axes, _panels(found)[names.index(channel) if channel else 0])


def _panels(found: FitResult) -> list[Panel]:
    left = [Left(found.errors, "", "with")]
    channels = found.measurements.channels
    return [measured_panel(channels[name], left, name) for name in found.residuals]
