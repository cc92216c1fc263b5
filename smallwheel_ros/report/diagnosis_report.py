"""The report of a diagnosis, made from its JSON document and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from smallwheel_ros.display import brief, display, number, words
from smallwheel_ros.pictures.diagnosis import ranking_bars, staircase
from smallwheel_ros.report.page import (
    Block,
    Callout,
    Details,
    Picture,
    ReportError,
    Section,
    Table,
    Text,
    page,
)
from smallwheel_ros.report.verdict_section import (
    HEADLINES,
    listed,
    p_text,
    said,
    shown_value,
    verdict_block,
)

_STATUS = {
    "significant": "significant",
    "not_significant": "not\u00a0significant",  # on one line
    "not_testable": "not testable",
    "confounded": "cannot be told apart",
}
_SETTING_UNITS = {"load": "N", "diameter": "m", "width": "m", "sinkage": "m", "slip": "1",
                  "slip_angle": "rad", "slope": "rad", "speed": "m/s", "pass_number": "1",
                  "grouser_height": "m"}  # fmt: skip


def diagnosis_report(
    document: Mapping[str, Any],
    pictures: Mapping[str, Sequence[Picture]] | None = None,
    *,
    source: str = "",
) -> str:
    """One self-contained HTML page for a diagnosis.

    document: what `smallwheel diagnose --json` writes. Beside the contract it may have "notes" and
    "warnings" (lists of sentences), and a "summary" in a ranking row. pictures: further ones for
    the sections "data", "where_it_fails", "effects", "steps", "next". source: the data's file.
    Raises ReportError where the document is not one of a diagnosis.
    """
    check_diagnosis(document)
    more = pictures or {}
    return page(
        "Which effect is missing?",
        [
            Section("In short", [verdict_block(document)]),
            Section("The data", [*_data(document), *more.get("data", ())]),
            Section("Where the model fails",
                    [*region_blocks(document), *more.get("where_it_fails", ())]),
            Section("Which effect is missing",
                    [*ranking_blocks(document), *more.get("effects", ())]),
            Section("Error, step by step", [*step_blocks(document), *more.get("steps", ())]),
            Section("What this data cannot tell", unknowable_blocks(document)),
            Section("What to measure next", [*next_blocks(document), *more.get("next", ())]),
            Section("What to keep in mind", [Text(items=caveats(document))]),
        ],
        source,
    )  # fmt: skip


def check_diagnosis(document: Mapping[str, Any]) -> None:
    """Raise ReportError where the document is not one of a diagnosis."""
    verdict = document.get("verdict")
    if verdict not in HEADLINES:
        raise ReportError(
            f"not a diagnosis: verdict is {verdict!r}, expected one of {', '.join(HEADLINES)}"
        )


def _data(document: Mapping[str, Any]) -> list[Block]:
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
        header = ["channel", "rows", "base model's RMSE", "bias", *apart, "noise floor",
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
        [str(r["region"]), words(str(r["channel"])), str(r["rows"]),
         shown_value(r["channel"], r["bias"]), shown_value(r["channel"], r["rmse"]),
         shown_value(r["channel"], r.get("rmse_elsewhere")), p_text(r.get("p_value"))]
        for r in regions
    ]  # fmt: skip
    header = ["where", "channel", "rows", "bias", "RMSE", "RMSE elsewhere", "p"]
    caption = "Held-out errors of the base model; values of conditions in SI units"
    return [Table(header, rows, caption, numbers=range(2, 7))]


def ranking_blocks(document: Mapping[str, Any]) -> list[Block]:
    """Every effect that was tested, and its fitted numbers."""
    tested = [r for r in document.get("ranking") or [] if r["status"] != "not_testable"]
    if not tested:
        return []
    named = set(document.get("missing_effects") or [])
    rows = [
        [words(r["effect"]), _STATUS.get(r["status"], r["status"]), p_text(r.get("p_value")),
         _percent(r.get("reduction")),
         str(r.get("reason") or r.get("summary") or "")]
        for r in tested
    ]  # fmt: skip
    strong = [i for i, r in enumerate(tested) if r["effect"] in named]
    header = ["effect", "verdict", "p", "error removed", ""]
    blocks: list[Block] = [Table(header, rows, "", numbers=(2, 3), strong=strong)]
    figure = ranking_bars(document)
    if figure is not None:
        caption = "Blue: significant; orange: cannot be told apart; grey: not significant."
        blocks.insert(0, Picture(figure, caption))
    header = ["effect", "parameter", "value", "std", "unit", "published", "plausible"]
    likely = [r for r in tested if r["status"] in ("significant", "confounded")]
    fitted = _parameters(likely)
    if fitted:
        blocks.append(Table(header, fitted, "Fitted parameters", numbers=(2, 3)))
    others = _parameters([r for r in tested if r not in likely])
    if others:
        table = Table(header, others, numbers=(2, 3))
        blocks.append(Details("Fitted parameters of the other effects", [table]))
    return blocks


def _parameters(ranking: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for row in ranking:
        for name, p in (row.get("parameters") or {}).items():
            low_high = p.get("published_range")
            plausible = {True: "yes", False: "no", None: "-"}[p.get("plausible")]
            rows.append([
                words(row["effect"]), str(name), number(p.get("value")), number(p.get("std")),
                _plain_unit(p.get("unit")),
                "-" if not low_high else f"{brief(low_high[0])} to {brief(low_high[1])}",
                plausible,
            ])  # fmt: skip
    return rows


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{round(100 * share)} %"


def _plain_unit(unit: str | None) -> str:
    return "" if unit in (None, "1") else str(unit)


def step_blocks(document: Mapping[str, Any]) -> list[Block]:
    """The staircase of held-out errors."""
    # With too little data nothing was held out: there is one error, in sample, and no stairs.
    figure = None if document["verdict"] == "insufficient_data" else staircase(document)
    if figure is None:
        return []
    steps = document["steps"]
    last = steps[-1]["added"]
    caption = "Held-out error of the base model" + (
        "" if last is None else " and after each effect that was added"
    )
    if any(c.get("noise_floor") is not None for c in (document.get("channels") or {}).values()):
        caption += (
            "; the dashed line is the noise floor: the held-out error that the true model would "
            "leave, with the noise of each row and the scatter of the soil from run to run"
        )
        if document["verdict"] == "unknown_effect":
            caption += "; with something still missing, part of that may pass for scatter, and the "
            caption += "true floor be lower"
    return [Picture(figure, caption + ".")]


def unknowable_blocks(document: Mapping[str, Any]) -> list[Block]:
    """What could not be tested, seen or told apart."""
    ranking = document.get("ranking") or []
    blind = [r for r in ranking if r["status"] == "not_testable"]
    blocks: list[Block] = []
    if blind:
        rows = [[words(r["effect"]), str(r.get("reason") or "")] for r in blind]
        blocks.append(Table(["effect", "why not"], rows, "Not testable with this data"))
    seen = [
        [
            words(r["effect"]),
            f"{brief(t['smallest_visible'])} {_plain_unit(t.get('unit'))}".rstrip(),
        ]
        for r in ranking
        if r["status"] != "not_testable"
        and (t := r.get("testability"))
        and t.get("smallest_visible") is not None
    ]
    if seen:
        header = ["effect", "smallest strength seen half the time"]
        caption = "How strong an effect must be for this data to show it"
        blocks.append(Table(header, seen, caption, numbers=(1,)))
    ties = {
        frozenset((r["effect"], c["effect"])): f"{words(r['effect'])} and {words(c['effect'])}: "
        f"{number(c.get('similarity'), 2)}"
        for r in ranking
        for c in r.get("confounded_with") or []
    }
    if ties:
        blocks.append(Text("What acts alike on this data (1 is exactly alike):", [*ties.values()]))
    return blocks


def next_blocks(document: Mapping[str, Any]) -> list[Block]:
    """The measurements that would decide."""
    proposals = document.get("next_measurements") or []
    rows = [
        [_settings(p.get("settings") or {}), listed(p["separates"], "from")
         if p.get("separates") else "", str(p.get("runs", "-")),
         _percent(p.get("expected_power"))]
        for p in proposals
    ]  # fmt: skip
    if not rows:
        return []
    header = ["settings", "tells apart", "runs", "chance to decide"]
    blocks: list[Block] = [Table(header, rows, numbers=(2, 3))]
    said = [str(p["text"]) for p in proposals if p.get("text")]
    if said:
        blocks.append(Text(items=said))
    return blocks


def _settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{words(name)} {_setting(name, value)}" for name, value in settings.items())


def _setting(name: str, value: object) -> str:
    if isinstance(value, (list, tuple)):
        return " to ".join(dict.fromkeys(_setting(name, v) for v in value))
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    shown = display(name, _SETTING_UNITS.get(name, ""))
    return f"{brief(value * shown.scale)} {shown.unit}".rstrip()


def caveats(document: Mapping[str, Any]) -> list[str]:
    """What to keep in mind of a diagnosis."""
    held_out = "Errors of the diagnosis are held out: each run was predicted by a fit without it."
    return [
        "A named effect is the best explanation among those in the library, not a proof: another "
        "cause that follows the same condition would look the same.",
        *([] if document["verdict"] == "insufficient_data" else [held_out]),
        *[said(str(note)) for note in document.get("notes") or []],
    ]
