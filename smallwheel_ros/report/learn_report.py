# SPDX-License-Identifier: Apache-2.0
"""A learnt law as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from smallwheel_ros.learn.document import grows, trust
from smallwheel_ros.learn.learning import Learnt
from smallwheel_ros.measurements.display import listed, number, sentence, shown_value, words
from smallwheel_ros.pictures.learnt import learnt_figure
from smallwheel_ros.report.page import (
    Block,
    Callout,
    Details,
    Picture,
    Section,
    Table,
    Text,
    page,
    write_page,
)

_HEADLINES = {
    "law": "A law was learnt",
    "unstable": "Something is missing, and what it follows is not settled",
    "weak": "Perhaps something is missing: too weak for a law",
    "nothing": "Nothing could be learnt",
    "refused": "This data is too little for a law",
}
_CAPTION = (
    "What each setting asks for, from sinkage and from resistance, with their standard deviations; the "
    "law black with its band, formulas that fit as well grey (moved onto the law at the middle of the "
    "range, since k is fitted anew for each), a smooth without any formula dashed. The measured range "
    "is shaded."
)


def learn_figures(result: Learnt) -> dict[str, Figure]:
    """The picture by name; none where there is no law of one setting."""
    curves = result.tied_curves
    return {} if curves is None else {"learnt": learnt_figure(result.document, curves)}


def write_learnt(result: Learnt, path: Path) -> None:
    """Write the page. Raises OutputError where it cannot be written."""
    write_page(path, learn_page(result))


def learn_page(result: Learnt) -> str:
    """The whole answer as one self-contained HTML page."""
    document = result.document
    law = document["law"]
    said = [sentence(reason) for reason in document["reasons"]]
    headline = _HEADLINES[document["verdict"]]
    if law is not None:
        headline = grows(document)
        said = [law["formula"], *said, trust(document)]
    kind = "result" if document["verdict"] in ("law", "nothing") else "warning"
    first: list[Block] = [Callout(headline, said, "result" if kind == "result" else "warning")]
    for figure in learn_figures(result).values():
        first.append(Picture(figure, _CAPTION, headline))
    sections = [Section("What was learnt", first)]
    if document["tied"]:
        sections += [
            Section("Does it hold on settings that it never saw?", _held_out(document)),
            Section("What fits as well", _tied(document)),
        ]
    if document["measure_next"]:
        sections.append(Section("What to measure next", [Text(document["measure_next"]["text"])]))
    sections.append(Section("How it was found", _search(document)))
    if result.source is not None:
        lines = result.source.splitlines()
        sections.append(Section("The effect file", [Details("Show it", [Text(items=lines)])]))
    data = document["data"]
    about = f"{data['file']}: {data['rows']} rows, {data['runs']} runs, {data['settings']} settings"
    return page("A law learnt from data", sections, about, f"Data: SHA-256 {data['sha256']}.")


def _held_out(document: dict[str, Any]) -> list[Block]:
    rows = [
        [words(name), *(shown_value(name, error[k]) for k in ("before", "after", "floor"))]
        for name, error in document["held_out"].items()
    ]
    header = ["channel", "without the law", "with it", "what noise leaves"]
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
    blocks: list[Block] = [
        Text(
            "Formulas within 3 nats of the shortest description; the data cannot tell them apart."
        ),
        Table(["formula", "stage", "follows", "nats behind"], rows, numbers=(3,)),
    ]
    law = document["law"]
    if law is not None:
        numbers = [
            [c["name"], number(c["value"]), number(c["std"]), f"{number(c['low'])} to "
             f"{number(c['high'])}", c["unit"]] for c in law["constants"]
        ]  # fmt: skip
        blocks.append(
            Table(["constant", "value", "std", "over the tied formulas", "unit"], numbers,
                  numbers=(1, 2))
        )  # fmt: skip
    return blocks


def _search(document: dict[str, Any]) -> list[Block]:
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
    return [Text(items=[*items, *document["notes"], *document["warnings"]])]
