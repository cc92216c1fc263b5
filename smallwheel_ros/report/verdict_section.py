"""What a diagnosis found, in a few sentences; and how its numbers and names are said everywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from smallwheel_ros.display import brief, display, listed, number, sentence, shown_value, words
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.report.page import Callout


def said(text: str) -> str:
    """The text as a sentence; one that begins with a name keeps its small letter."""
    name = any(mark in text.split(" ")[0] for mark in "_.:")
    return text[:1] + sentence(text)[1:] if name else sentence(text)


HEADLINES = {
    "missing_effect": "The base model lacks an effect",
    "adequate": "Nothing is missing that this data could show",
    "unknown_effect": "Something is missing, and no known effect explains it",
    "indistinguishable": "Something is missing, and this data cannot tell which of several effects",
    "insufficient_data": "The data is too small or too uniform for a verdict",
}


def verdict_block(document: Mapping[str, Any]) -> Callout:
    """Say the verdict of a diagnosis document, and what adding the missing effects gains."""
    verdict, named = document["verdict"], list(document.get("missing_effects") or [])
    rivals = list(document.get("candidates") or [])
    headline, lines = HEADLINES[verdict], []
    if verdict == "missing_effect" and named:
        headline = f"Missing: {listed(named)}"
        lines += _fall(document)
        if rivals:
            lines.append(f"For a further effect these are rivals: {listed(rivals)}.")
    elif verdict == "indistinguishable" and rivals:
        headline = f"Something is missing: {listed(rivals, 'or')}"
        lines.append("This data cannot tell which of them.")
    elif verdict == "adequate":
        lines.append(
            "An effect that is not testable with this data, or too weak to show, may still be there."
        )
    faults = [r["effect"] for r in document.get("ranking") or [] if r.get("kind") == "instrument"]
    faults = [name for name in (*named, *rivals) if name in faults]
    if faults:
        lines.append(said(f"{listed(faults)}: the instrument, not the soil"))
    reason = document.get("reason")
    if reason:
        lines.append(said(str(reason)))
    p = (document.get("lack_of_fit") or {}).get("p_value")
    if p is not None:
        lines.append(f"Test of whether anything is missing at all: p = {p_text(p)}.")
    return Callout(headline, lines, "result" if verdict in ("missing_effect", "adequate") else
                   "warning")  # fmt: skip


def _fall(document: Mapping[str, Any]) -> list[str]:
    steps = document.get("steps") or []
    lines = []
    for channel in CHANNEL_UNITS:
        errors = [step["held_out_rmse"].get(channel) for step in steps]
        known = [e for e in errors if e is not None]
        if len(known) > 1:
            ends = f"from {shown_value(channel, known[0])} to {shown_value(channel, known[-1])}"
            what = "it" if len(steps) == 2 else "them"
            lines.append(f"Adding {what} takes the held-out error of {words(channel)} {ends}.")
    return lines


def p_text(p: float | None) -> str:
    """Show a p value with two digits: it is a count of simulations, and has no more."""
    return "-" if p is None else f"{p:.2g}"


def per_cent(share: float | None) -> str:
    """Show a share in whole per cent, "-" for none; never "-0 %"."""
    return "-" if share is None else f"{round(100 * share)} %"


def parameter_cells(
    unit: str, value: float | None, std: float | None, published: Sequence[float] | None
) -> list[str]:
    """Value, deviation, unit and published range of a fitted number, in degrees and millimetres."""
    how = display("", unit)
    shown = [number(None if v is None else v * how.scale, d) for v, d in ((value, 4), (std, 3))]
    known = "-" if not published else " to ".join(brief(v * how.scale) for v in published)
    return [*shown, how.unit.replace(" ", "\u00a0"), known]
