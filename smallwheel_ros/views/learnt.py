# SPDX-License-Identifier: Apache-2.0
"""The page of a learnt law, from its document and from the laws that fit as well."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.learn.document import headline, trust
from smallwheel_ros.learn.learning import Learnt
from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.measurements.display import display, listed, number, sentence, words
from smallwheel_ros.views.blocks import (
    Block,
    Callout,
    Column,
    Details,
    Figure,
    Section,
    Table,
    Text,
    of_channel,
    plain_number,
)
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.plots import Layer, Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Document = Mapping[str, Any]

_DOUBTS = {
    "unstable": "Something is missing, and what it follows is not settled.",
    "weak": "Perhaps something is missing: too weak for a law.",
}
_LISTED = 8  # formulas before the rest is folded away
_ASKED = {"sinkage": ("std", "with"), "resistance": ("resistance_std", "w1")}
_ADDED = {"n": "added to n", "R": "added resistance over the force that carries it"}
_CAPTION = (
    "What each setting requires, from sinkage and from resistance, with standard deviations; dark: the law "
    "with its band over the measured range; grey: formulas as good (moved onto the law at mid-range, "
    "since k is refitted for each)."
)


def page(found: Learnt, pictures: bool = True) -> Page:
    """Make the page of a learnt law.

    Parameters
    ----------
    found
        Result of learning.
    pictures
        Whether the page has a figure of the law.
    """
    document, data = found.document, found.document["data"]
    law, verdict = document["law"], document["verdict"]
    said = [sentence(reason) for reason in document["reasons"]]
    if law is not None:
        said = [law["formula"], *said, trust(document)]
    elif verdict in _DOUBTS:
        said = [_DOUBTS[verdict], *said]
    clear = verdict in ("law", "nothing")
    answer: list[Block] = [Callout(headline(document), said, "result" if clear else "warning")]
    if pictures and document["shape"] is not None:
        answer.append(Figure("learnt", [_panel(found)], _CAPTION))
    tied, proposal = bool(document["tied"]), document["measure_next"]
    source: list[Block] = []
    if found.source is not None:
        lines = found.source.splitlines()
        source.append(Details(f"{len(lines)} lines of Python", [Text(items=lines)]))
    return Page(
        "A law learnt from data",
        [
            Section("What was learnt", answer),
            Section(
                "Does it hold on settings that it never saw?", _held_out(document) if tied else []
            ),
            Section("What fits as well", _tied(document) if tied else []),
            Section("What to measure next", [Text(proposal["text"])] if proposal else []),
            Section("How it was found", [Text(items=_search(document))]),
            Section("The effect file", source),
        ],
        f"{data['file']}: {data['rows']} rows, {data['runs']} runs, {data['settings']} settings",
        f"Data: SHA-256 {data['sha256']}.",
    )


def draw(axes: Axes, found: Learnt) -> None:
    """Draw the correction of the model that each setting requires, and the law learnt from it.

    Parameters
    ----------
    axes
        Axes to draw on.
    found
        Result of learning.
    """
    draw_panel(axes, _panel(found))


def _held_out(document: Document) -> list[Block]:
    search = document["search"]
    text = (
        f"Settings were left out in {search['folds']} folds, with the whole search repeated in each; "
        f"{100 * search['folds_agreeing']:.0f} % of the folds chose the same drivers."
    )
    columns = [
        Column("channel", "channel", words), of_channel("without the law", "before"),
        of_channel("with it", "after"), of_channel("expected of a true model", "floor"),
    ]  # fmt: skip
    rows = [{"channel": name} | errors for name, errors in document["held_out"].items()]
    return [Text(text), Table(columns, rows)]


def _tied(document: Document) -> list[Block]:
    rows, law = document["tied"], document["law"]
    columns = [
        Column("formula", "formula"), Column("stage", "stage"),
        Column("follows", "drivers", lambda drivers: listed(drivers) or "nothing"),
        Column("nats behind", "nats", "{:.1f}".format, right=True),
    ]  # fmt: skip
    blocks: list[Block] = [
        Text("Formulas within 3 nats of the shortest description; the data cannot tell them apart."
             if rows[1:] else
             "No other formula comes within 3 nats of the shortest description."),
        Table(columns, rows[:_LISTED]),
    ]  # fmt: skip
    if rows[_LISTED:]:
        blocks.append(Details(f"and {len(rows) - _LISTED} more", [Table(columns, rows[_LISTED:])]))
    stages = [(v, k) for k, v in document["stage_disagreement"].items() if v is not None]
    if stages:
        apart = ", ".join(f"{stage} {number(value, 2)}" for value, stage in sorted(stages))
        blocks.append(
            Text(
                "How far sinkage and resistance disagree about the change at each stage: "
                f"{apart} (1: within noise)."
            )
        )
    if law is not None:
        constants = [
            Column("constant", "name"), plain_number("value", "value"), plain_number("std", "std"),
            Column("over the tied formulas", lambda c: f"{number(c['low'])} to {number(c['high'])}"),
            Column("unit", "unit", lambda unit: "" if unit == "1" else unit),
        ]  # fmt: skip
        blocks.append(Table(constants, law["constants"]))
    return blocks


def _search(document: Document) -> list[str]:
    search = document["search"]
    items = [
        f"{search['formulas']} formulas at the stages {', '.join(search['stages'])}",
        f"drivers: {', '.join(map(words, search['drivers']))}",
    ]
    if search["p"] is not None:
        items.append(f"p = {search['p']:.2g} by {search['permutations']} permutations of the runs' errors, "
                     "the whole search in each")  # fmt: skip
    if search["vault_settings"]:
        items.append(
            f"{search['vault_settings']} settings were kept out of the search and the folds"
        )
    return [*items, *document["warnings"], *document["notes"]]


def _panel(found: Learnt) -> Panel:
    """Corrections required, with standard deviations, the law with its band, and laws that fit as well."""
    document, tied = found.document, found.tied_curves or ()
    shape, law = document["shape"], document["law"]
    place = law or document["places"][0]
    stage, driver = place["stage"], place["drivers"][0]
    shown = display(driver, unit_of(driver))
    x, y = np.array(shape["x"]) * shown.scale, np.array(shape["factor"])
    middle, inside = len(x) // 2, [*shape["low"], *shape["high"]]
    layers = [
        Layer("line", x, curve + y[middle] - curve[middle], colour="base", width=1.0,
              name="" if i else f"fits as well ({len(tied)})")
        for i, curve in enumerate(map(np.asarray, tied))
    ]  # fmt: skip
    for channel, (deviation, colour) in _ASKED.items():
        mine = [e for e in document["implied"] if e[channel] is not None]
        value, spread = (np.array([e[name] for e in mine]) for name in (channel, deviation))
        if mine:
            layers.append(Layer("points", [e["x"] * shown.scale for e in mine], value, value - spread,
                                value + spread, colour, f"{words(channel)} requires"))  # fmt: skip
        inside += value.tolist()
    layers.append(Layer("line", x, y, shape["low"], shape["high"], "ink",
                        "drafted law" if law else "best formula"))  # fmt: skip
    low, high = np.quantile(inside, [0.01, 0.99]).tolist()
    room = 0.25 * (high - low)
    return Panel(shown.label, _ADDED.get(stage, f"factor on {stage}"), law["formula"] if law else "",
                 layers, y_range=(low - room, high + room))  # fmt: skip
