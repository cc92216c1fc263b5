"""What a diagnosis found, in a few sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from smallwheel_ros.compare.scores import UNITS
from smallwheel_ros.display import display, number, sentence, words
from smallwheel_ros.report.page import Callout

_TINY = 1e-6  # a smaller p says more of the test's assumptions than of the data


def listed(names: Sequence[str], last: str = "and") -> str:
    """Join names in words: `a, b and c`."""
    shown = [words(name) for name in names]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} {last} {shown[-1]}"


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
        lines.append(said(str(reason)))
    p = (document.get("lack_of_fit") or {}).get("p_value")
    if p is not None:
        lines.append(
            f"Test of whether anything is missing at all: p {'' if p < _TINY else '= '}{p_text(p)}."
        )
    return Callout(headline, lines, "result" if verdict in ("missing_effect", "adequate") else
                   "warning")  # fmt: skip


def _fall(document: Mapping[str, Any]) -> list[str]:
    steps = document.get("steps") or []
    lines = []
    for channel in UNITS:
        errors = [step["held_out_rmse"].get(channel) for step in steps]
        known = [e for e in errors if e is not None]
        if len(known) > 1:
            ends = f"from {shown_value(channel, known[0])} to {shown_value(channel, known[-1])}"
            what = "it" if len(steps) == 2 else "them"
            lines.append(f"Adding {what} takes the held-out error of {words(channel)} {ends}.")
    return lines


def shown_value(channel: str, value: float | None) -> str:
    """Show a value of a channel with its unit, "-" for none."""
    if value is None:
        return "-"
    shown = display(channel, UNITS.get(channel, ""))
    return f"{number(value * shown.scale)} {shown.unit}".rstrip()


def p_text(p: float | None) -> str:
    """Show a p value: three digits, one where it is small, a limit where it is tiny."""
    if p is None:
        return "-"
    if p < _TINY:
        return f"under {_TINY:g}"
    return f"{p:.1g}" if p < 0.001 else f"{p:.3f}"
