# SPDX-License-Identifier: Apache-2.0
"""The diagnosis in words, made from its document."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Any

from smallwheel_ros.measurements.display import (
    LAW,
    brief,
    listed,
    number,
    p_text,
    percent,
    region_words,
    sentence,
    shown_value,
    words,
)

_SHOWN = 0.01  # probability under which an effect is counted, not listed

SAID = {
    "missing_effect": "The model lacks {named}.",
    "adequate": "Nothing is missing that this data could show.",
    "unknown_effect": "Something is missing, and no effect of the library explains it.",
    "indistinguishable": "Something is missing: {candidates}. This data cannot tell which.",
    "insufficient_data": "Too little data for a verdict.",
}


_NEXT = {
    "missing_effect": "Next: add it with `smallwheel diagnose {table} --apply -o MODEL.yaml`, and make sure "
    "by the measurements proposed.",
    "adequate": "Next: use the model within the settings measured; what this data could not show may still "
    "be there.",
    "unknown_effect": "Next: record what else differs between the runs, or let `smallwheel learn` look for a "
    "law.",
    "indistinguishable": "Next: make the measurements proposed, which tell them apart.",
    "insufficient_data": "Next: measure more runs, at several loads.",
}
_OF_LAW = re.compile(r"\.(k|n|m|log_reference_pressure)\b")


def diagnosis_text(document: Mapping[str, Any]) -> str:
    """The document for people, in the order in which one asks."""
    lines = verdict_sentences(document)
    lines += ["", *_steps(document), *_regions(document), *_ranking(document), *_blind(document)]
    if document["next_measurements"]:
        lines += ["", "What to measure next"]
        for proposal in document["next_measurements"]:
            power = proposal.get("expected_power")
            chance = "" if power is None else f" (chance to decide {percent(power)})"
            lines.append(f"  {proposal['text']}{chance}")
    for title, key in (("Warnings", "warnings"), ("Notes", "notes")):
        if document.get(key):
            lines += ["", title, *[f"  {text}" for text in document[key]]]
    if any(_OF_LAW.search(note) for note in document.get("notes") or []):
        lines.append(f"  {LAW}")
    return "\n".join(lines)


def verdict_sentences(document: Mapping[str, Any]) -> list[str]:
    """The verdict, what speaks for it, and how sure it is."""
    lines = [
        SAID[document["verdict"]].format(
            named=listed(document["missing_effects"], "and"),
            candidates=listed(document["candidates"], "or"),
        )
    ]
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
        lines.append(f"Chance of such errors if nothing were missing: p = {p_text(p)}.")
    table = shlex.quote(document.get("table") or "TABLE")
    lines.append(_NEXT[document["verdict"]].format(table=table))
    return lines


def _steps(document: Mapping[str, Any]) -> list[str]:
    if not document["channels"]:
        return []
    little = document["verdict"] == "insufficient_data"
    lines = ["Error of the fit itself: nothing was held out" if little else "Held-out error"]
    for name, channel in document["channels"].items():
        path = [shown_value(name, step["held_out_rmse"].get(name)) for step in document["steps"]]
        floor = channel.get("noise_floor")
        known = (
            "" if floor is None else f"; expected error of a true model {shown_value(name, floor)}"
        )
        if channel.get("repeatability") is not None:
            known += (
                f" (repeats of one run differ by {shown_value(name, channel['repeatability'])})"
            )
        lines.append(f"  {words(name)}, {channel['rows']} rows: {' -> '.join(path)}{known}")
    return lines


def _regions(document: Mapping[str, Any]) -> list[str]:
    if not document["where_it_fails"]:
        return []
    lines = ["", "Where the base model fails"]
    for region in document["where_it_fails"]:
        channel = region["channel"]
        p = region["p_value"]
        doubt = f"; too few runs to be sure (p {p_text(p)})" if p > 0.05 else ""
        here, elsewhere, bias = (
            shown_value(channel, region[name]) for name in ("rmse", "rmse_elsewhere", "bias")
        )
        where = region_words(region["region"])
        lines.append(
            f"  {words(channel)} where {where} ({region['rows']} rows): error {here}, "
            f"elsewhere {elsewhere}, measured - predicted {bias} on average{doubt}"
        )
    return lines


def _ranking(document: Mapping[str, Any]) -> list[str]:
    rows = [row for row in document["ranking"] if row["status"] != "not_testable"]
    if not rows:
        return []
    lines, others = ["", "Effects, by their probability"], 0
    for row in rows:
        telling = row["status"] in ("significant", "confounded")
        if not telling and (row.get("probability") or 0.0) < _SHOWN:
            others += 1
            continue
        share = row.get("reduction")
        removed = "" if share is None else f"{percent(share):>6s} of the error"
        lines.append(f"  {words(row['effect']):26s} {removed:>18s}  {row['reason']}")
        if telling:
            if row.get("next_step"):
                lines.append(f"      to be sure: {row['next_step']}")
            for name, p in row["parameters"].items():
                unit = "" if p["unit"] == "1" else f" {p['unit']}"
                std = "" if p["std"] is None else f" +- {number(p['std'])}"
                known = p["published_range"]
                where = "" if not known else f", published {brief(known[0])} to {brief(known[1])}"
                lines.append(
                    f"      {name} = {number(p['value'])}{std}{unit} ({row['form']}{where})"
                )
    if others:
        lines.append(f"  {others} others: probability under {_SHOWN:g} each")
    return lines


def _blind(document: Mapping[str, Any]) -> list[str]:
    rows = [row for row in document["ranking"] if row["status"] == "not_testable"]
    if not rows:
        return []
    lines = ["", "Not testable with this data"]
    return lines + [f"  {words(row['effect'])}: {row['reason']}" for row in rows]
