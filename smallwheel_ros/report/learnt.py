# SPDX-License-Identifier: Apache-2.0
"""A learnt law."""

from __future__ import annotations

from typing import Any

from smallwheel_ros.learn.document import headline, trust
from smallwheel_ros.learn.learning import Learnt
from smallwheel_ros.measurements.display import listed, number, sentence, shown_value, words
from smallwheel_ros.pictures.layers import learnt_plot
from smallwheel_ros.report.blocks import Block, Callout, Details, Drawing, Section, Table, Text
from smallwheel_ros.report.page import Page

_DOUBTS = {
    "unstable": "Something is missing, and what it follows is not settled.",
    "weak": "Perhaps something is missing: too weak for a law.",
}
_LISTED = 8  # formulas before the rest is folded away
_CAPTION = (
    "What each setting asks for, from sinkage and from resistance, with their standard deviations; the "
    "law dark with its band, over the measured range, formulas that fit as well grey (moved onto the law "
    "at the middle of the range, since k is fitted anew for each), a smooth without any formula dashed."
)


def learnt_page(result: Learnt) -> Page:
    """The whole answer."""
    document = result.document
    law, verdict = document["law"], document["verdict"]
    said = [sentence(reason) for reason in document["reasons"]]
    if law is not None:
        said = [law["formula"], *said, trust(document)]
    elif verdict in _DOUBTS:
        said = [_DOUBTS[verdict], *said]
    answer = headline(document).removesuffix(".")
    kind = "result" if verdict in ("law", "nothing") else "warning"
    first: list[Block] = [Callout(answer, said, "result" if kind == "result" else "warning")]
    if document["shape"] is not None:
        plot = learnt_plot(document, result.tied_curves or ())
        first.append(Drawing("xy", plot, _CAPTION))
    sections = [Section("What was learnt", first)]
    if document["tied"]:
        sections += [
            Section("Does it hold on settings that it never saw?", _held_out(document)),
            Section("What fits as well", _tied(document)),
        ]
    if document["measure_next"]:
        sections.append(Section("What to measure next", [Text(document["measure_next"]["text"])]))
    sections.append(Section("How it was found", [Text(items=_search(document))]))
    if result.source is not None:
        lines = result.source.splitlines()
        shown = Details(f"{len(lines)} lines of Python", [Text(items=lines)])
        sections.append(Section("The effect file", [shown]))
    data = document["data"]
    about = f"{data['file']}: {data['rows']} rows, {data['runs']} runs, {data['settings']} settings"
    return Page("A law learnt from data", sections, about, f"Data: SHA-256 {data['sha256']}.")


def _held_out(document: dict[str, Any]) -> list[Block]:
    rows = [
        [words(name), *(shown_value(name, error[k]) for k in ("before", "after", "floor"))]
        for name, error in document["held_out"].items()
    ]
    header = ["channel", "without the law", "with it", "expected of a true model"]
    share = document["search"]["folds_agreeing"]
    text = (
        f"Settings were left out in {document['search']['folds']} folds, with the whole search made anew "
        f"in each; {100 * share:.0f} % of the folds chose the same drivers."
    )
    return [Text(text), Table(header, rows, numbers=(1, 2, 3))]


def _tied(document: dict[str, Any]) -> list[Block]:
    rows = [
        [t["formula"], t["stage"], listed(t["drivers"]) or "nothing", f"{t['nats']:.1f}"]
        for t in document["tied"]
    ]
    header = ["formula", "stage", "follows", "nats behind"]
    blocks: list[Block] = [
        Text(
            "Formulas within 3 nats of the shortest description; the data cannot tell them apart."
            if rows[1:]
            else "No other formula comes within 3 nats of the shortest description."
        ),
        Table(header, rows[:_LISTED], numbers=(3,)),
    ]
    if rows[_LISTED:]:
        more = Table(header, rows[_LISTED:], numbers=(3,))
        blocks.append(Details(f"and {len(rows) - _LISTED} more", [more]))
    stages = {k: v for k, v in document["stage_disagreement"].items() if v is not None}
    if stages:
        ordered = sorted(stages.items(), key=lambda stage: stage[1])
        apart = ", ".join(f"{stage} {number(value, 2)}" for stage, value in ordered)
        blocks.append(
            Text(f"What sinkage and resistance ask of each stage differs by: {apart} (1: noise).")
        )
    law = document["law"]
    if law is not None:
        numbers = [
            [c["name"], number(c["value"]), number(c["std"]),
             f"{number(c['low'])} to {number(c['high'])}", "" if c["unit"] == "1" else c["unit"]]
            for c in law["constants"]
        ]  # fmt: skip
        blocks.append(
            Table(["constant", "value", "std", "over the tied formulas", "unit"], numbers,
                  numbers=(1, 2))
        )  # fmt: skip
    return blocks


def _search(document: dict[str, Any]) -> list[str]:
    search = document["search"]
    items = [
        f"{search['formulas']} formulas at the stages {', '.join(search['stages'])}",
        f"drivers: {', '.join(words(d) for d in search['drivers'])}",
    ]
    if search["p"] is not None:
        items.append(f"p = {search['p']:.2g} by {search['permutations']} permutations of the runs' "
                     "errors, the whole search in each")  # fmt: skip
    if search["vault_settings"]:
        items.append(f"{search['vault_settings']} settings were kept apart from search and folds")
    return [*items, *document["warnings"], *document["notes"]]
