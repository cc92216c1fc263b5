# SPDX-License-Identifier: Apache-2.0
"""The blocks of a diagnosis, made from its JSON document alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from smallwheel_ros.diagnosis.text import SAID
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import (
    display,
    effect_words,
    listed,
    number,
    p_text,
    percent,
    region_words,
    sentence,
    setting_words,
    shown_value,
    words,
)
from smallwheel_ros.report.page import Block, Callout, Details, Drawing, ReportError, Table, Text
from smallwheel_ros.report.verdict_section import parameter_cells

_STATUS = {
    "significant": "significant",
    "not_significant": "not\u00a0significant",  # on one line
    "not_testable": "not testable",
    "confounded": "cannot be told apart",
}
_SHOWN = 0.01  # probability under which an effect is counted, not shown
_TOLD = 3.0  # standard errors by which a part's residual must differ to be stressed


def check_diagnosis(document: Mapping[str, Any]) -> None:
    """Raise ReportError where the document is not one of a diagnosis."""
    verdict = document.get("verdict")
    if verdict not in SAID:
        raise ReportError(
            f"not a diagnosis: verdict is {verdict!r}, expected one of {', '.join(SAID)}"
        )


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
         shown_value(r["channel"], r.get("rmse_elsewhere")), p_text(r.get("p_value"))]
        for r in regions
    ]  # fmt: skip
    header = ["where", "channel", "rows", "bias", "RMSE", "RMSE elsewhere", "p"]
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
        blocks += _curves(document)
    header = ["effect", "parameter", "value", "std", "unit", "published", "plausible"]
    if len(others) < len(tested):
        blocks.append(_ranking([r for r in tested if r not in others], named))
    if shown := _parameters(likely):
        blocks.append(Table(header, shown, "Fitted parameters", numbers=(2, 3)))
    if others:
        title = f"{len(others)} others, each with a probability under {_SHOWN:g}"
        fitted = Table(header, _parameters(others), "Fitted parameters", numbers=(2, 3))
        blocks.append(Details(title, [_ranking(others, named), fitted]))
    return blocks


def _curves(document: Mapping[str, Any]) -> list[Block]:
    """The smooth of each setting that something without a name follows."""
    found: list[Block] = []
    for curve in document.get("curves") or []:
        across = display(curve["setting"], unit_of(curve["setting"]))
        x = [across.scale * value for value in curve["x"]]
        line = {"kind": "line", "x": x, "y": curve["factor"], "low": curve["low"],
                "high": curve["high"]}  # fmt: skip
        none = {"kind": "line", "x": x[:: len(x) - 1], "y": [1.0, 1.0], "colour": "--base"}
        factor = f"factor on {curve['stage']}"
        data = {"x": across.label, "y": factor, "label": f"{factor} over {across.label}",
                "layers": [none, line]}  # fmt: skip
        caption = "The factor over the setting that it follows, with its 95 % band."
        found.append(Drawing("xy", data, caption))
    return found


def _ranking(rows: Sequence[Mapping[str, Any]], named: Collection[str]) -> Table:
    cells = [
        [effect_words(r["effect"]), str(r.get("kind") or "-"), _STATUS.get(r["status"], r["status"]),
         "-" if r.get("probability") is None else f"{r['probability']:.2f}",
         p_text(r.get("p_value")), percent(r.get("reduction")),
         "; ".join(part for part in str(r.get("reason") or "").split("; ")
                   if not part.startswith(("probability", "this data cannot tell")))]
        for r in rows
    ]  # fmt: skip
    strong = [i for i, r in enumerate(rows) if r["effect"] in named]
    header = ["effect", "kind", "verdict", "probability", "p", "error removed", ""]
    caption = "p and error removed: of the effect alone, added to the base model"
    return Table(header, cells, caption, numbers=(3, 4, 5), strong=strong, bars=3)


def _parameters(ranking: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for row in (r for r in ranking if r.get("kind") != "unknown"):  # a curve is drawn
        for name, p in (row.get("parameters") or {}).items():
            plausible = {True: "yes", False: "no", None: "-"}[p.get("plausible")]
            cells = parameter_cells(str(p.get("unit") or ""), p.get("value"), p.get("std"),
                                    p.get("published_range"))  # fmt: skip
            rows.append([effect_words(row["effect"]), str(name), *cells, plausible])
    return rows


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
         percent(p.get("expected_power"))]
        for p in proposals
    ]  # fmt: skip
    blocks: list[Block] = []
    if rows:
        header = ["settings", "tells apart", "runs", "chance to decide"]
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
    held_out = "Errors of the diagnosis are held out: each run was predicted by a fit without it."
    return [
        "A named effect is the best explanation among those in the library, not a proof: another "
        "cause that follows the same condition would look the same.",
        *([] if document["verdict"] == "insufficient_data" else [held_out]),
        *[sentence(str(note)) for note in document.get("notes") or []],
    ]
