# SPDX-License-Identifier: Apache-2.0
"""The verdict of a diagnosis in words, made from its document."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from smallwheel_ros.diagnosis.next_measurement import RUNS
from smallwheel_ros.fitting.constants import REPLICATES
from smallwheel_ros.measurements.display import listed, p_text, sentence, words

_LEAST_P = 1.0 / (1.0 + REPLICATES)  # no simulation was as bad: p is at most this

SAID = {
    "missing_effect": "The model lacks {named}.",
    "adequate": "Nothing is missing that this data could show.",
    "unknown_effect": "Something is missing, and no effect of the library explains it.",
    "unconfirmed": "Something may be missing: {candidates}. This data does not confirm it.",
    "indistinguishable": "Something is missing: {candidates}. This data cannot tell which.",
    "insufficient_data": "Too little data for a verdict.",
}


_NEXT = {
    "missing_effect": "Next: add it with `smallwheel diagnose {table} --apply -o MODEL.yaml`, and confirm it "
    "with the measurements proposed.",
    "adequate": "Next: use the model within the settings measured; what this data could not show may still "
    "be there.",
    "unknown_effect": "Next: record what else differs between the runs, or let `smallwheel learn` look for a "
    "law.",
    "unconfirmed": "Next: make the measurements proposed, which would confirm it or rule it out.",
    "indistinguishable": "Next: make the measurements proposed, which tell them apart.",
    "none proposed": "Next: measure at settings beyond these: within them no {runs} runs would settle it.",
    "tied": "Next: make the measurements proposed, or others off that line.",
    "insufficient_data": "Next: measure more runs, at several loads.",
}


def verdict_sentences(document: Mapping[str, Any]) -> list[str]:
    """The verdict, what speaks for it, and how sure it is."""
    verdict = document["verdict"]
    if verdict == "unknown_effect" and document["candidates"]:
        verdict = "unconfirmed"
    lines = [
        SAID[verdict].format(
            named=listed(document["missing_effects"], "and"),
            candidates=listed(document["candidates"], "or"),
        )
    ]
    tied = [_tied_words(*map(words, one["settings"])) for one in document.get("tied", [])]
    # That nothing is missing holds on that line alone.
    lines = [*tied, *lines] if verdict == "adequate" else [*lines, *tied]
    findings = {n: c.get("finding") for n, c in document["channels"].items()}
    lines += [f"{words(n).capitalize()}: {said}." for n, said in findings.items() if said]
    summaries = {r["effect"]: r["summary"] for r in document["ranking"] if r.get("summary")}
    named = [*document["missing_effects"], *document["candidates"]]
    lines += [f"{words(n).capitalize()}: {summaries[n]}" for n in named if n in summaries]
    if document["verdict"] == "missing_effect" and document["candidates"]:
        rivals = listed(document["candidates"], "or")
        lines.append(f"Something more is missing: {rivals}. This data cannot tell which.")
    faults = [r["effect"] for r in document["ranking"] if r.get("kind") == "instrument"]
    blamed = [n for n in named if n in faults]
    if blamed:
        said = f"{listed(blamed)}: the instrument, not the soil. Check it first"
        lines.append(sentence(said))
    if document.get("closest"):
        closest = listed(document["closest"], "or")
        lines.append(f"The closest in the library: {closest}. It does not describe this data.")
    if document.get("reason"):
        lines.append(sentence(str(document["reason"])))
    p = document["lack_of_fit"]["p_value"]
    if p is not None:
        chance = f"= {p_text(p)}" if p > _LEAST_P else f"at most {p_text(_LEAST_P)}"
        lines.append(f"Chance of such errors if nothing were missing: p {chance}.")
    table = shlex.quote(document.get("table") or "TABLE")
    following = "tied" if tied and verdict == "adequate" else verdict
    if verdict in ("unconfirmed", "indistinguishable") and not document["next_measurements"]:
        following = "none proposed"
    lines.append(_NEXT[following].format(table=table, runs=RUNS))
    return lines


def _tied_words(one: str, other: str) -> str:
    return (
        f"{other.capitalize()} was varied together with {one}: an effect of the one cannot be told from one "
        "of the other, and off the line on which they were measured nothing is known."
    )
