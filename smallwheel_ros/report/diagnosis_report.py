"""The report of a diagnosis, made from its JSON document and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from smallwheel_ros.diagnosis_plots import ranking_bars, staircase
from smallwheel_ros.display import brief, display, number, words
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
from smallwheel_ros.scores import UNITS

_STATUS = {
    "significant": "significant",
    "not_significant": "not significant",
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
    verdict = document.get("verdict")
    if verdict not in _HEADLINES:
        raise ReportError(
            f"not a diagnosis: verdict is {verdict!r}, expected one of {', '.join(_HEADLINES)}"
        )
    more = pictures or {}
    return page(
        "Which effect is missing?",
        [
            Section("In short", [_verdict(document)]),
            Section("The data", [*_data(document), *more.get("data", ())]),
            Section("Where the model fails",
                    [*_where_it_fails(document), *more.get("where_it_fails", ())]),
            Section("Which effect is missing", [*_ranking(document), *more.get("effects", ())]),
            Section("Error, step by step", [*_steps(document), *more.get("steps", ())]),
            Section("What this data cannot tell", _unknowable(document)),
            Section("What to measure next", [*_next(document), *more.get("next", ())]),
            Section("What to keep in mind", [_caveats(document)]),
        ],
        source,
    )  # fmt: skip


def _listed(names: Sequence[str], last: str = "and") -> str:
    shown = [words(name) for name in names]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} {last} {shown[-1]}"


_HEADLINES = {
    "missing_effect": "The base model lacks an effect",
    "adequate": "Nothing is missing that this data could show",
    "unknown_effect": "Something is missing, and no known effect explains it",
    "indistinguishable": "Something is missing, and this data cannot tell which of several effects",
    "insufficient_data": "The data is too small or too uniform for a verdict",
}


def _verdict(document: Mapping[str, Any]) -> Callout:
    verdict, named = document["verdict"], list(document.get("missing_effects") or [])
    rivals = list(document.get("candidates") or [])
    headline, lines = _HEADLINES[verdict], []
    if verdict == "missing_effect" and named:
        headline = f"Missing: {_listed(named)}"
        lines += _fall(document)
        if rivals:
            lines.append(f"For a further effect these are rivals: {_listed(rivals)}.")
    elif verdict == "indistinguishable" and rivals:
        headline = f"Something is missing: {_listed(rivals, 'or')}"
        lines.append("This data cannot tell which of them: see what to measure next.")
    elif verdict == "adequate":
        lines.append(
            "What the data could have shown, and what not, is below under what this data cannot "
            "tell: an effect that is not testable may still be there."
        )
    elif verdict == "unknown_effect":
        lines.append("Where it fails, below, says which condition the error follows.")
    reason = document.get("reason")
    if reason:
        lines.append(str(reason))
    p = (document.get("lack_of_fit") or {}).get("p_value")
    if p is not None:
        lines.append(f"Test of whether anything is missing at all: p = {_p(p)}.")
    return Callout(headline, lines, "result" if verdict in ("missing_effect", "adequate") else
                   "warning")  # fmt: skip


def _fall(document: Mapping[str, Any]) -> list[str]:
    steps = document.get("steps") or []
    lines = []
    for channel in UNITS:
        errors = [step["held_out_rmse"].get(channel) for step in steps]
        known = [e for e in errors if e is not None]
        if len(known) > 1:
            ends = f"from {_value(channel, known[0])} to {_value(channel, known[-1])}"
            what = "it" if len(steps) == 2 else "them"
            lines.append(f"Adding {what} takes the held-out error of {words(channel)} {ends}.")
    return lines


def _value(channel: str, value: float | None) -> str:
    if value is None:
        return "-"
    shown = display(channel, UNITS.get(channel, ""))
    return f"{number(value * shown.scale)} {shown.unit}".rstrip()


def _p(p: float | None) -> str:
    if p is None:
        return "-"
    return f"{p:.1g}" if p < 0.001 else f"{p:.3f}"


def _data(document: Mapping[str, Any]) -> list[Block]:
    rows = [
        [words(name), str(c["rows"]), _value(name, c["rmse"]), _value(name, c["bias"]),
         _value(name, c.get("noise_floor")), str(c.get("noise_floor_source") or "-")]
        for name, c in (document.get("channels") or {}).items()
    ]  # fmt: skip
    blocks: list[Block] = []
    if rows:
        header = ["channel", "rows", "base model's RMSE", "bias", "noise floor", "known from"]
        caption = "What was measured, and what the base model leaves; bias is measured - predicted"
        blocks.append(Table(header, rows, caption, numbers=(1, 2, 3, 4)))
    warnings = list(document.get("warnings") or [])
    if warnings:
        blocks.append(Callout("Worth a second look", warnings, "warning"))
    return blocks


def _where_it_fails(document: Mapping[str, Any]) -> list[Block]:
    regions = document.get("where_it_fails") or []
    if not regions:
        return []
    rows = [
        [str(r["region"]), words(str(r["channel"])), str(r["rows"]),
         _value(r["channel"], r["bias"]), _value(r["channel"], r["rmse"]),
         _value(r["channel"], r.get("rmse_elsewhere")), _p(r.get("p_value"))]
        for r in regions
    ]  # fmt: skip
    header = ["where", "channel", "rows", "bias", "RMSE", "RMSE elsewhere", "p"]
    caption = "Held-out errors of the base model; values of conditions in SI units"
    return [Table(header, rows, caption, numbers=range(2, 7))]


def _ranking(document: Mapping[str, Any]) -> list[Block]:
    tested = [r for r in document.get("ranking") or [] if r["status"] != "not_testable"]
    if not tested:
        return []
    named = set(document.get("missing_effects") or [])
    rows = [
        [words(r["effect"]), _STATUS.get(r["status"], r["status"]), _p(r.get("p_value")),
         "-" if r.get("reduction") is None else f"{100 * r['reduction']:.0f} %",
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
    parameters = _parameters(tested)
    if parameters:
        header = ["effect", "parameter", "value", "std", "unit", "published", "plausible"]
        table = Table(header, parameters, "Fitted parameters", numbers=(2, 3))
        likely = [r for r in tested if r["status"] in ("significant", "confounded")]
        blocks.append(table if likely else Details("Fitted parameters", [table]))
    return blocks


def _parameters(ranking: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for row in ranking:
        for name, p in (row.get("parameters") or {}).items():
            low_high = p.get("published_range")
            plausible = {True: "yes", False: "no", None: "-"}[p.get("plausible")]
            rows.append([
                words(row["effect"]), str(name), number(p.get("value")), number(p.get("std")),
                "" if p.get("unit") in (None, "1") else str(p["unit"]),
                "-" if not low_high else f"{brief(low_high[0])} to {brief(low_high[1])}",
                plausible,
            ])  # fmt: skip
    return rows


def _steps(document: Mapping[str, Any]) -> list[Block]:
    figure = staircase(document)
    if figure is None:
        return []
    steps = document["steps"]
    last = steps[-1]["added"]
    caption = "Held-out error of the base model" + (
        "" if last is None else " and after each effect that was added"
    )
    if any(c.get("noise_floor") is not None for c in (document.get("channels") or {}).values()):
        caption += "; the dashed line is what repeated measurements differ by"
    return [Picture(figure, caption + ".")]


def _unknowable(document: Mapping[str, Any]) -> list[Block]:
    ranking = document.get("ranking") or []
    blind = [r for r in ranking if r["status"] == "not_testable"]
    blocks: list[Block] = []
    if blind:
        rows = [[words(r["effect"]), str(r.get("reason") or "")] for r in blind]
        blocks.append(Table(["effect", "why not"], rows, "Not testable with this data"))
    ties = [
        f"{words(r['effect'])} and {words(c['effect'])}: alike to {number(c.get('similarity'), 2)}"
        for r in ranking
        for c in r.get("confounded_with") or []
    ]
    if ties:
        blocks.append(Text("What acts alike here, of 1 for exactly alike:", ties))
    return blocks


def _next(document: Mapping[str, Any]) -> list[Block]:
    proposals = document.get("next_measurements") or []
    rows = [
        [_settings(p.get("settings") or {}), _listed(p["separates"], "from")
         if p.get("separates") else "", str(p.get("runs", "-")),
         "-" if p.get("expected_power") is None else f"{100 * p['expected_power']:.0f} %"]
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


def _caveats(document: Mapping[str, Any]) -> Block:
    lines = [
        "A named effect is the best explanation among those in the library, not a proof: another "
        "cause that follows the same condition would look the same.",
        "All errors are held out: each run was predicted by a model that was fitted without it.",
        *[str(note) for note in document.get("notes") or []],
    ]
    return Text(items=lines)
