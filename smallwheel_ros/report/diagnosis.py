# SPDX-License-Identifier: Apache-2.0
"""A diagnosis, made from its JSON document alone; and the whole story of a table, with a comparison."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.compare.comparison import Comparison, Floor
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.diagnosis.text import SAID, verdict_sentences
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import (
    LAW,
    brief,
    display,
    effect_words,
    listed,
    number,
    p_text,
    percent,
    probability_text,
    region_words,
    sentence,
    setting_words,
    shown_value,
    words,
)
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.pictures.layers import curve_plots
from smallwheel_ros.report import comparison as compared
from smallwheel_ros.report.blocks import Block, Callout, Details, Drawing, Section, Table, Text
from smallwheel_ros.report.effects_section import EffectsPage
from smallwheel_ros.report.page import Page

_STATUS = {
    "significant": "significant",
    "not_significant": "not\u00a0significant",  # on one line
    "not_testable": "not testable",
    "confounded": "cannot be told apart",
}
_SHOWN = 0.01  # probability under which an effect is counted, not shown
_SURE = 0.05  # p up to which a region is sure
_TOLD = 3.0  # standard errors by which a part's residual must differ to be stressed
_OF_LAW = re.compile(r"\.(k|n|m|log_reference_pressure)\b")
_FLOOR = "with the scatter of the soil from run to run"
_NO_FLOOR = "the diagnosis could not tell noise from misfit: repeat runs"
_TWICE = (
    "Comparison and diagnosis hold out the same runs. The comparison fits each model with noise of "
    "the size that its own predictions have, the diagnosis all models with one size, so that they can "
    "be ranked: their held-out errors of the same base model differ a little."
)
_HOW = (
    "Tick an effect: error, residuals and parameters follow. Each point is predicted by a fit without "
    "its run. Point at one to see what it is; click on it to put its run aside."
)


class ReportError(SmallwheelError):
    """A report that cannot be made."""


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """As `smallwheel diagnose` prints it."""
    return diagnosis_page(diagnosis.document).text()


def diagnosis_page(
    document: Mapping[str, Any],
    *,
    effects: EffectsPage | None = None,
    comparison: Comparison | None = None,
    measurements: Measurements | None = None,
    served: bool = False,
) -> Page:
    """A diagnosis, and a comparison of the same measurements.

    document: what `smallwheel diagnose --json` writes. effects: those to set and unset; None where
    nothing could be held out. served: by `explore`, which fits what the page lacks.
    Raises ReportError where the document is not one of a diagnosis.
    """
    if document.get("verdict") not in SAID:
        raise ReportError(
            f"not a diagnosis: verdict is {document.get('verdict')!r}, expected one of {', '.join(SAID)}"
        )
    table = measurements if comparison is None else comparison.measurements
    short: list[Block] = [verdict_block(document)]
    data, models, failures = channel_blocks(document), [], []
    said = caveats(document)
    if comparison is not None:
        comparison = replace(comparison, noise=_floors(comparison, document))
        short.append(Text(items=compared.summary(comparison)))
        data = compared.data_blocks(comparison)
        models = [*compared.model_blocks(comparison), *compared.model_plots(comparison)]
        failures = compared.failure_blocks(comparison)
        said = [*compared.caveats(comparison), *said, _TWICE]
    elif table is not None:
        failures = compared.ratio_blocks(table)
    play: list[Block] = [] if effects is None else [Text(_HOW), effects.block()]
    title = "Which effect is missing?" if comparison is None else (
        "Models, measurements, and what is missing"
    )  # fmt: skip
    return Page(
        title,
        [
            Section("In short", short),
            Section("Set and unset effects", play),
            Section("The data", data),
            Section("Models side by side", models),
            Section("Where the model fails", [*region_blocks(document), *failures]),
            Section("Which effect is missing", ranking_blocks(document)),
            Section("Held-out error, step by step", step_blocks(document)),
            Section("What this data cannot tell", unknowable_blocks(document)),
            Section("What to measure next", next_blocks(document)),
            Section("What to keep in mind", [Text(items=[*dict.fromkeys(said)])]),
        ],
        "" if table is None else table.source,
        f"Data: SHA-256 {table.sha256}." if table is not None and table.sha256 else "",
        served=served,
    )


def _floors(comparison: Comparison, document: Mapping[str, Any]) -> dict[str, Floor]:
    """What the diagnosis expects of a true model, in the comparison's pictures too."""
    known = document.get("channels") or {}
    floors = {}
    for name, floor in comparison.noise.items():
        channel = known.get(name, {})
        value, repeats = channel.get("noise_floor"), channel.get("repeatability")
        repeats = floor.repeatability if repeats is None else repeats
        if value is None:
            floors[name] = Floor(None, None, _NO_FLOOR, repeats)
        else:
            floors[name] = Floor(float(value), channel.get("noise_floor_source"), _FLOOR, repeats)
    return floors


def verdict_block(document: Mapping[str, Any]) -> Callout:
    """Say the verdict of a diagnosis document."""
    first, *lines = verdict_sentences(document)
    clear = document["verdict"] in ("missing_effect", "adequate")
    return Callout(first.removesuffix("."), lines, "result" if clear else "warning")


def channel_blocks(document: Mapping[str, Any]) -> list[Block]:
    """What was measured, and what the base model leaves of it."""
    channels = document.get("channels") or {}
    known = any(c.get("repeatability") is not None for c in channels.values())
    rows = [
        [words(name), str(c["rows"]), shown_value(name, c["rmse"]), shown_value(name, c["bias"]),
         *([shown_value(name, c.get("repeatability"))] if known else []),
         shown_value(name, c.get("noise_floor")), str(c.get("noise_floor_source") or "-")]
        for name, c in channels.items()
    ]  # fmt: skip
    blocks: list[Block] = []
    if rows:
        apart = ["repeats differ by"] if known else []
        header = ["channel", "rows", "base model's RMSE", "bias", *apart, "expected of a true model",
                  "known from"]  # fmt: skip
        caption = "What was measured, and what the base model leaves; bias is measured - predicted"
        blocks.append(Table(header, rows, caption, numbers=range(1, 5 + len(apart))))
    warnings = list(document.get("warnings") or [])
    if warnings:
        blocks.append(Callout("Worth a second look", warnings, "warning"))
    return blocks


def region_blocks(document: Mapping[str, Any]) -> list[Block]:
    """Where the base model fails, in words and numbers."""
    regions = document.get("where_it_fails") or []
    if not regions:
        return []
    rows = [
        [region_words(str(r["region"])), words(str(r["channel"])), str(r["rows"]),
         shown_value(r["channel"], r["bias"]), shown_value(r["channel"], r["rmse"]),
         shown_value(r["channel"], r.get("rmse_elsewhere")), p_text(r.get("p_value")),
         "too few runs to be sure" if (r.get("p_value") or 0.0) > _SURE else ""]
        for r in regions
    ]  # fmt: skip
    header = ["where", "channel", "rows", "bias", "RMSE", "RMSE elsewhere", "p", ""]
    caption = "Held-out errors of the base model; columns of one's own in SI units"
    return [Table(header, rows, caption, numbers=range(2, 7))]


def ranking_blocks(document: Mapping[str, Any]) -> list[Block]:
    """Every effect that was tested, and its fitted numbers; the curves of what has no name."""
    tested = [r for r in document.get("ranking") or [] if r["status"] != "not_testable"]
    if not tested:
        return []
    likely = [r for r in tested if r["status"] != "not_significant"]
    others = [r for r in tested if r not in likely and (r.get("probability") or 0.0) < _SHOWN]
    named = set(document.get("missing_effects") or [])
    blocks: list[Block] = []
    if document["verdict"] == "unknown_effect":
        caption = "The factor over the setting that it follows, with its 95 % band."
        blocks += [Drawing("xy", plot, caption) for plot in curve_plots(document)]
    header = ["effect", "form", "parameter", "value", "std", "unit", "published", "plausible"]
    if len(others) < len(tested):
        blocks.append(_ranking([r for r in tested if r not in others], named))
    if shown := _parameters(likely):
        blocks.append(Table(header, shown, "Fitted parameters", numbers=(3, 4)))
    if others:
        title = f"{len(others)} others, each with a probability under {_SHOWN:g}"
        inside: list[Block] = [_ranking(others, named)]
        if shown := _parameters(others):
            inside.append(Table(header, shown, "Fitted parameters", numbers=(3, 4)))
        blocks.append(Details(title, inside))
    return blocks


def _ranking(rows: Sequence[Mapping[str, Any]], named: Collection[str]) -> Table:
    cells = [
        [effect_words(r["effect"]), str(r.get("kind") or "-"), _STATUS.get(r["status"], r["status"]),
         probability_text(r.get("probability")),
         p_text(r.get("p_value")), percent(r.get("reduction")), _doubts(str(r.get("reason") or ""))]
        for r in rows
    ]  # fmt: skip
    strong = [i for i, r in enumerate(rows) if r["effect"] in named]
    header = ["effect", "kind", "verdict", "probability", "p", "error removed", ""]
    caption = "p and error removed: of the effect alone, added to the base model"
    return Table(header, cells, caption, numbers=(3, 4, 5), strong=strong, bars=3)


def _doubts(reason: str) -> str:
    """What a reason says beside the probability and the verdict, which have columns."""
    parts = [
        part.partition(": ")[2] if part.startswith("probability") else part
        for part in reason.split("; ")
        if not part.startswith("this data cannot tell")
    ]
    return "; ".join(part for part in parts if part)


def _parameters(ranking: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for row in (r for r in ranking if r.get("kind") != "unknown"):  # a curve is drawn
        for name, p in (row.get("parameters") or {}).items():
            plausible = {True: "yes", False: "no", None: "-"}[p.get("plausible")]
            cells = parameter_cells(str(p.get("unit") or ""), p.get("value"), p.get("std"),
                                    p.get("published_range"))  # fmt: skip
            rows.append(
                [
                    effect_words(row["effect"]),
                    str(row.get("form") or ""),
                    str(name),
                    *cells,
                    plausible,
                ]
            )
    return rows


def parameter_cells(
    unit: str, value: float | None, std: float | None, published: Sequence[float] | None
) -> list[str]:
    """Value, deviation, unit and published range of a fitted number, in degrees and millimetres."""
    how = display("", unit)
    shown = [number(None if v is None else v * how.scale, d) for v, d in ((value, 4), (std, 3))]
    known = "-" if not published else " to ".join(brief(v * how.scale) for v in published)
    return [*shown, how.unit.replace(" ", "\u00a0"), known]


def step_blocks(document: Mapping[str, Any]) -> list[Block]:
    """The staircase of held-out errors."""
    steps = document["steps"]
    channels = [name for name in CHANNEL_UNITS if any(name in s["held_out_rmse"] for s in steps)]
    # With too little data nothing was held out: there is one error, in sample, and no stairs.
    if document["verdict"] == "insufficient_data" or not channels:
        return []
    floors = {n: (document.get("channels") or {}).get(n, {}).get("noise_floor") for n in channels}
    rows = [
        ["base model" if s["added"] is None else f"+ {words(s['added'])}",
         *(shown_value(n, s["held_out_rmse"].get(n)) for n in channels)]
        for s in steps
    ]  # fmt: skip
    caption = "Held-out error of the base model" + (
        "" if steps[-1]["added"] is None else " and after each effect that was added"
    )
    if any(floor is not None for floor in floors.values()):
        rows.append(["expected of a true model", *(shown_value(n, floors[n]) for n in channels)])
        caption += (
            "; expected of a true model: the held-out error that the true model would "
            "leave, with the noise of each row and the scatter from run to run"
        )
        if document["verdict"] == "unknown_effect":
            caption += "; with something still missing, part of that may pass for scatter, and the "
            caption += "true one's be lower"
    header = ["", *(words(name) for name in channels)]
    numbers = range(1, 1 + len(channels))
    blocks: list[Block] = [Table(header, rows, caption + ".", numbers)]
    scatter = document.get("run_scatter") or {}
    if scatter.get("tau") is not None:
        own = [f"{words(n)} by {percent(v)}" for name, v in scatter.items()
               if (n := name.removeprefix("own:")) != name]  # fmt: skip
        text = f"From run to run the soil's stiffness differs by {percent(scatter['tau'])}"
        text += f"; beside that, {' and '.join(own)}." if own else "."
        blocks.append(Text(text))
    return blocks + _left_blocks(document)


def _left_blocks(document: Mapping[str, Any]) -> list[Block]:
    """What the best explanation leaves over each setting and in each group of rows."""
    left = document.get("residuals_left") or []
    if document["verdict"] not in ("unknown_effect", "adequate"):
        return []
    rows: list[list[str]] = []
    strong = []
    for entry in left:
        name, parts = str(entry.get("setting") or entry.get("group")), entry["parts"]
        if any(p["std"] and abs(p["mean"]) > _TOLD * p["std"] for p in parts):
            strong.append(len(rows))
        cells = [f"{setting_words(name, p['at'])}: {_off(p)}" for p in parts]
        rows.append([words(entry["channel"]), words(name), *cells])
    if not rows:
        return []
    width = max(len(row) for row in rows)
    rows = [row + [""] * (width - len(row)) for row in rows]
    caption = (
        "What the best explanation leaves: mean of (measured - predicted) / size, with its standard "
        f"error over runs; stressed where a part is over {_TOLD:g} of them off"
    )
    header = ["channel", "over", "at: mean left", *[""] * (width - 3)]
    return [Table(header, rows, caption, strong=strong)]


def _off(part: Mapping[str, Any]) -> str:
    mean, std = 100.0 * part["mean"], part["std"]
    shown = f"{mean:+.1f}" if abs(mean) >= 0.05 else "0.0"
    return shown + ("" if std is None else f"\u00a0±\u00a0{100.0 * std:.1f}") + "\u00a0%"


def unknowable_blocks(document: Mapping[str, Any]) -> list[Block]:
    """What could not be tested, seen or told apart."""
    ranking = document.get("ranking") or []
    blind = [r for r in ranking if r["status"] == "not_testable"]
    blocks: list[Block] = []
    if blind:
        rows = [[words(r["effect"]), str(r.get("reason") or "")] for r in blind]
        blocks.append(Table(["effect", "why not"], rows, "Not testable with this data"))
    ties = {
        frozenset((r["effect"], c["effect"])): f"{listed([r['effect'], c['effect']])}: "
        f"{number(c.get('similarity'), 2)}"
        for r in ranking
        for c in r.get("confounded_with") or []
    }
    if ties:
        text = Text(
            "Cosine of what they do to the predictions; 1 is exactly alike:", [*ties.values()]
        )
        blocks.append(Details(f"{len(ties)} pairs of effects act alike on this data", [text]))
    return blocks


def next_blocks(document: Mapping[str, Any]) -> list[Block]:
    """The measurements that would decide."""
    proposals = document.get("next_measurements") or []
    rows = [
        [_settings(p.get("settings") or {}), listed(p["separates"], "from")
         if p.get("separates") else "", str(p.get("runs", "-")),
         percent(p.get("expected_power")), str(p.get("text") or "").partition("; ")[2]]
        for p in proposals
    ]  # fmt: skip
    blocks: list[Block] = []
    if rows:
        header = ["settings", "tells apart", "runs", "chance to decide", ""]
        blocks.append(Table(header, rows, numbers=(2, 3)))
    steps = [
        f"{effect_words(r['effect'])}: {r['next_step']}"
        for r in document.get("ranking") or []
        if r["status"] in ("significant", "confounded") and r.get("next_step")
    ]
    return blocks + ([Text("To be sure of what is suspected:", steps)] if steps else [])


def _settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{words(name)} {setting_words(name, value)}" for name, value in settings.items()
    )


def caveats(document: Mapping[str, Any]) -> list[str]:
    """What to keep in mind of a diagnosis."""
    notes = document.get("notes") or []
    held_out = "Errors of the diagnosis are held out: each run was predicted by a fit without it."
    return [
        "A named effect is the best explanation among those in the library, not a proof: another "
        "cause that follows the same condition would look the same.",
        *([] if document["verdict"] == "insufficient_data" else [held_out]),
        *[sentence(str(note)) for note in notes],
        *([LAW] if any(_OF_LAW.search(str(note)) for note in notes) else []),
    ]
