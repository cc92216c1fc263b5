# SPDX-License-Identifier: Apache-2.0
"""The page of an effect that was added to a model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smallwheel_ros.common.result import name_to_draw
from smallwheel_ros.diagnosis.apply import Added
from smallwheel_ros.measurements.display import sentence, words
from smallwheel_ros.views.blocks import Block, Callout, Column, Figure, Section, Table, of_channel
from smallwheel_ros.views.leftovers import shown_channel
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.parameters import parameter_rows, parameter_table
from smallwheel_ros.views.plots import Bar, Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def page(found: Added, pictures: bool = True) -> Page:
    """Make the page of an effect that was added.

    Parameters
    ----------
    found
        Result of adding the effect.
    pictures
        Whether the page has a figure of the errors.
    """
    columns = [
        Column("held-out error", "channel", words), of_channel("before", "before"),
        of_channel("± s.e.", "before_std"), of_channel("after", "after"),
        of_channel("± s.e. ", "after_std"),
    ]  # fmt: skip
    said = sentence(found.reason or "recommended: the diagnosis of this data names it")
    answer: list[Block] = [
        Callout(f"{words(found.effect)} ({words(found.form)})", [said],
                "result" if found.recommended else "warning"),
        Table(columns, found.rows()),
    ]  # fmt: skip
    mine = [row for row in parameter_rows(found.fit) if row["owner"] == found.effect]
    figures: list[Block] = [Figure("errors", _panels(found))] if pictures else []
    sections = [Section("In short", [*answer, *figures]),
                Section("Its numbers", [parameter_table(mine, "")])]  # fmt: skip
    return Page("An effect added to a model", sections)


def draw(axes: Axes, found: Added, channel: str | None = None) -> None:
    """Draw the held-out error of a channel without and with the effect, as two bars.

    Parameters
    ----------
    axes
        Axes to draw on.
    found
        Result of adding the effect.
    channel
        Name of the channel, such as `sinkage`; the first one if not given.

    Raises
    ------
    ResultError
        If there is no such channel.
    """
    panels = {
        row["channel"]: panel for row, panel in zip(found.rows(), _panels(found), strict=True)
    }
    draw_panel(axes, panels[name_to_draw(channel, panels)])


def _panels(found: Added) -> list[Panel]:
    panels = []
    for row in found.rows():
        how = shown_channel(row["channel"])
        after = None if row["after"] is None else how.scale * row["after"]
        bars = [
            Bar("without", how.scale * row["before"], "base"),
            Bar(f"+ {words(found.effect)}", after),
        ]
        panels.append(Panel(f"held-out RMSE [{how.unit}]", "", words(row["channel"]), bars=bars))
    return panels
