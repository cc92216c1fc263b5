# SPDX-License-Identifier: Apache-2.0
"""The verdict of a diagnosis in words, from its document.

What to do next may be a command. It repeats the options that were typed, so a result made by a command
carries the commands that follow (`apply` adds what is named, `learn` looks for a law). In Python, the model
with what is named is saved from the result itself.
"""

from __future__ import annotations

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
    "unconfirmed": "Something may be missing: {candidates}. This data does not confirm {them}.",
    "indistinguishable": "Something is missing: {candidates}. This data cannot tell which.",
    "insufficient_data": "Too little data for a verdict.",
}

_NEXT = {
    "adequate": "use the model within the settings measured; what this data could not show may still be "
    "there",
    "unconfirmed": "make the measurements proposed, which would settle it",
    "indistinguishable": "make the measurements proposed, which tell them apart",
    "none proposed": "measure at settings beyond these: within them no {runs} runs would settle it",
    "tied": "make the measurements proposed, or others off that line",
    "insufficient_data": "measure more runs, at several loads",
}


def verdict_sentences(
    document: Mapping[str, Any], following: Mapping[str, str] | None = None
) -> list[str]:
    """State the verdict, the evidence for it, how certain it is, and what to do next.

    Parameters
    ----------
    document
        The document of the diagnosis.
    following
        Commands that continue from here: `apply`, if the named effects are in no model file yet, and
        `learn`. None if the diagnosis was made in Python.

    Returns
    -------
    list of str
        Sentences; the verdict is the first, unless settings varied together limit it.
    """
    verdict = document["verdict"]
    if verdict == "unknown_effect" and document["candidates"]:
        verdict = "unconfirmed"
    lines = [
        SAID[verdict].format(
            named=listed(document["missing_effects"], "and"),
            candidates=listed(document["candidates"], "or"),
            them="it" if len(document["candidates"]) < 2 else "any of them",
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
    lines.append(f"Next: {_next(document, verdict, bool(tied), following)}.")
    return lines


def _next(
    document: Mapping[str, Any], verdict: str, tied: bool, following: Mapping[str, str] | None
) -> str:
    """What to do next, as a clause without a full stop."""
    proposed = bool(document["next_measurements"])
    if verdict == "missing_effect":
        steps = _adding(len(document["missing_effects"]), following)
        if proposed or not steps:
            with_what = "the measurements proposed" if proposed else "runs at further settings"
            steps.append(f"confirm it with {with_what}")
        return ", and ".join(steps)
    if document.get("stuck_gauge"):
        return "check the gauge, by hand or with a spacer of known height, and measure again"
    if verdict == "unknown_effect":
        law = "let `sw.learn` look for a law"
        if following is not None:
            law = f"look for a law: `{following['learn']}`"
        return f"record what else differs between the runs, or {law}"
    if verdict in ("unconfirmed", "indistinguishable") and not proposed:
        return _NEXT["none proposed"].format(runs=RUNS)
    if tied and verdict == "adequate":
        return _NEXT["tied"] if proposed else "measure off that line"
    return _NEXT[verdict]


def _adding(count: int, following: Mapping[str, str] | None) -> list[str]:
    """How the named effects get into a model; empty where they are in one already."""
    named = "it" if count == 1 else "them"
    if following is None:
        return [f"write the model with {named}, `.save('MODEL.yaml')` of this result"]
    return [f"add {named} with `{following['apply']}`"] if "apply" in following else []


def _tied_words(one: str, other: str) -> str:
    return (
        f"{other.capitalize()} was varied together with {one}: an effect of the one cannot be told from one "
        "of the other, and off the line on which they were measured nothing is known."
    )
