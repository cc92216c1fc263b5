# SPDX-License-Identifier: Apache-2.0
"""What was learnt, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smallwheel_ros.display import number, sentence, shown_value, words

_STAGES = {
    "k": "the soil's stiffness k",
    "z": "sinkage",
    "z without resistance": "sinkage, but not resistance,",
    "n": "the exponent n",
    "D": "the diameter that the soil meets",
    "R": "resistance",
}
_NOTHING = {
    "nothing": "Nothing could be learnt.",
    "refused": "Nothing was searched for: this data is too little for a law.",
}


def headline(document: Mapping[str, Any]) -> str:
    """The answer in a sentence."""
    verdict = document["verdict"]
    if verdict in _NOTHING:
        return _NOTHING[verdict]
    if verdict == "law":
        return grows(document)
    followed = " and ".join(words(d) for d in document["places"][0]["drivers"]) or "no setting"
    lead = "Something" if verdict == "unstable" else "Perhaps something"
    return f"{lead} depends on {followed}; no law is drafted."


def summary(document: Mapping[str, Any]) -> str:
    """The law in one or two sentences: what grows with what, by how much, how sure the form is."""
    return f"{grows(document)} {_origin(document)}."


def grows(document: Mapping[str, Any]) -> str:
    """Say what the law does: `Sinkage grows with slip and levels off (x 1.50 from 0 to 0.45).`."""
    law, shape = document["law"], document["shape"]
    what = _STAGES[law["stage"]]
    followed = " and ".join(words(d) for d in law["drivers"])
    if not law["drivers"]:
        return (
            f"{what[:1].upper()}{what[1:]} has a part that the model lacks, whatever the setting."
        )
    if shape is None or len(law["drivers"]) > 1:
        return f"{what[:1].upper()}{what[1:]} depends on {followed}."
    y, x = shape["factor"], shape["x"]
    lowest, highest = min(y), max(y)
    inside = slice(len(y) // 10, -len(y) // 10)
    bend = None
    if y.index(highest) in range(*inside.indices(len(y))):
        bend = f"has a maximum at {words(law['drivers'][0])} {number(x[y.index(highest)])}"
    elif y.index(lowest) in range(*inside.indices(len(y))):
        bend = f"has a minimum at {words(law['drivers'][0])} {number(x[y.index(lowest)])}"
    if bend:
        return f"{what[:1].upper()}{what[1:]} follows {followed}: it {bend}."
    up = y[-1] > y[0]
    third = len(y) // 3
    early, late = abs(y[third] - y[0]), abs(y[-1] - y[-1 - third])
    tail = " and levels off" if late < 0.4 * early else ""
    text = f"{what[:1].upper()}{what[1:]} {'grows' if up else 'falls'} with {followed}{tail}"
    if law["stage"] in ("n", "R") or y[0] <= 0:
        return f"{text}."
    return f"{text} (x {y[-1] / y[0]:.2f} from {number(x[0])} to {number(x[-1])})."


def _ranges(law: Mapping[str, Any]) -> str:
    return ", ".join(f"{words(n)} {number(a)} to {number(b)}" for n, (a, b) in law["range"].items())


def learnt_text(document: Mapping[str, Any]) -> str:
    """The document for people, in the order in which one asks."""
    law = document["law"]
    lines = [headline(document)]
    if law is not None:
        lines.append(f"  {law['formula']}")
        for c in law["constants"]:
            std = "" if c["std"] is None else f" +- {number(c['std'])}"
            unit = "" if c["unit"] == "1" else f" {c['unit']}"
            lines.append(f"    {c['name']} = {number(c['value'])}{std}{unit}")
    lines += [sentence(reason) for reason in document["reasons"]]
    if document["tied"]:
        lines += ["", *_evidence(document)]
    if document["measure_next"]:
        lines += ["", "What to measure next", f"  {document['measure_next']['text']}"]
    if law is not None:
        lines += ["", trust(document)]
    for title, key in (("Warnings", "warnings"), ("Notes", "notes")):
        if document[key]:
            lines += ["", title, *[f"  {text}" for text in document[key]]]
    return "\n".join(lines)


def _evidence(document: Mapping[str, Any]) -> list[str]:
    search = document["search"]
    lines = ["Held-out error, settings left out with the whole search inside"]
    for name, error in document["held_out"].items():
        floor = (
            ""
            if error["floor"] is None
            else f"; expected error of a true model {shown_value(name, error['floor'])}"
        )
        before, after = (shown_value(name, error[k]) for k in ("before", "after"))
        lines.append(f"  {words(name)}: {before} -> {after}{floor}")
    lines.append(
        f"Chance of such a gain by accident: p = {search['p']:.2g} ({search['formulas']} formulas, "
        f"{search['permutations']} permutations)."
    )
    tied = document["tied"]
    lines.append(_many(len(tied)))
    lines += [f"  {t['formula']}" for t in tied[:8]]
    lines += [f"  and {len(tied) - 8} more"] if len(tied) > 8 else []
    stages = {k: v for k, v in document["stage_disagreement"].items() if v is not None}
    if stages:
        listed = ", ".join(
            f"{k} {number(v, 2)}" for k, v in sorted(stages.items(), key=lambda s: s[1])
        )
        lines.append(
            f"What sinkage and resistance ask of each stage differs by: {listed} (1: noise)."
        )
    return lines


def _many(count: int) -> str:
    counts = {
        1: "One formula fits:",
        2: "Two formulas fit equally:",
        3: "Three formulas fit equally:",
    }
    return counts.get(count, f"{count} formulas fit equally:")


def trust(document: Mapping[str, Any]) -> str:
    """Say how far a law is known."""
    return f"{_origin(document)}; beyond that it is a guess."


def _origin(document: Mapping[str, Any]) -> str:
    """What a law was learnt from, and that nobody has published it."""
    law = document["law"]
    where = f", {_ranges(law)}" if law["range"] else ""
    return f"Learnt from {document['data']['settings']} settings{where}; not published"
