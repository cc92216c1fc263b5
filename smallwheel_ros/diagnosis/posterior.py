# SPDX-License-Identifier: Apache-2.0
"""What the probabilities of the models show, before any other evidence is used.

- A family that is in models with at least `NAMED` of the probability would be named.
- Families that replace each other and together reach that probability are rivals. If none do, the families
  found may be missing, but nothing missing is more probable: the data does not confirm them.
- Something is missing if p of `Search` is at most `ALARM`. Above it nothing is named.
- A curve without a name counts for the named effect whose most general form it is, as long as a law of that
  effect does better than none; otherwise something unknown follows that setting.
- A name whose setting was varied together with another one is a tie.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from smallwheel_ros.diagnosis.competitors import Competitor
from smallwheel_ros.diagnosis.search import Candidate, Key, Search
from smallwheel_ros.fitting.constants import (
    ALARM,
    APART,
    BEATS,
    MENTIONED,
    NAMED,
    TOGETHER,
)
from smallwheel_ros.measurements.display import listed

Word = Literal[
    "missing_effect", "adequate", "unknown_effect", "indistinguishable", "insufficient_data"
]


@dataclass(frozen=True)
class Posterior:
    """Probabilities of what is missing, and the models from which they are computed.

    A family is an effect with all its forms, by the effect's id.

    Attributes
    ----------
    word
        The verdict by these probabilities alone, before held-out errors and the misfit that is left are
        considered.
    probabilities
        Probability of each family, 0 to 1.
    best
        The model with the named effects, each as a law of the library; if none is named, the most probable
        model, which may have curves, or the base model if nothing is missing.
    named
        Families that are missing, the most probable first.
    rivals
        Families of which one is missing; for an unknown effect, candidates that this data does not confirm.
    unknown
        Ids of curves that stand for an effect in no library, such as `unknown:slip@sinkage`: no effect of
        the library describes the data as well.
    closest
        Families that describe the data best, though not well enough.
    ties
        Sentences on settings that were varied together.
    doubtful
        Whether it is less probable that any of the rivals is missing than that nothing is.
    """

    word: Word
    probabilities: Mapping[str, float]
    best: Candidate
    named: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    closest: tuple[str, ...] = ()
    ties: tuple[str, ...] = ()
    doubtful: bool = False


def posterior_of(search: Search) -> Posterior:
    """Combine the models of a search into the probabilities of what is missing."""
    best, share = search.ordered[0], search.probabilities
    speaks = {c.family: family_of(search, c) for m in search.models.values() for c in m.competitors}
    members = {key: {speaks[family] for family, _ in key} for key in search.models}
    families = {f for m in members.values() for f in m}
    probability = {f: sum(share[k] for k, m in members.items() if f in m) for f in sorted(families)}
    if search.p > ALARM:
        return Posterior("adequate", probability, search.none)
    ordered = [f for f in sorted(probability, key=lambda f: -probability[f])
               if probability[f] >= MENTIONED]  # fmt: skip
    named = [f for f in ordered if probability[f] >= NAMED]
    rest = [f for f in ordered if f not in named]
    groups = _rival_groups(rest, probability, members, share) or ([] if named else [rest])
    named, unknown = _without_a_law(search, best, named, speaks)
    # A set that has the truth holds what is likely, too.
    rivals = [*(groups[0] if groups else []), *(f for f in rest if probability[f] > 0.5)]
    library, ties = by_library(search, best, named), []
    for name in list(named):
        tied = _tied(search, library, name)
        if tied:
            named.remove(name)
            rivals = [name, *(t for t in tied if t not in (*named, *rivals)), *rivals]
            ties.append(f"{listed([name, *tied])} were varied together")
    rivals = list(dict.fromkeys(rivals))
    if named:
        word: Word = "missing_effect"
        rivals = rivals if len(rivals) > 1 else []
    elif len(rivals) > 1 and (groups or not unknown):
        word = "indistinguishable"
    else:
        word = "unknown_effect"
        unknown = unknown or [r for r in rivals if r.startswith("unknown:")]
    closest: list[str] = []
    if word == "unknown_effect" and (unknown or len(rivals) > 1):
        rivals, closest = [], [r for r in rivals if r not in unknown]
    with_one = sum(share[key] for key, m in members.items() if m & {*rivals})
    doubtful = not named and bool(rivals) and with_one < share[search.none.key]
    if doubtful:
        word = "unknown_effect"
    return Posterior(
        word, probability, library if named else best, tuple(named),
        tuple(rivals), tuple(unknown), tuple(closest), tuple(ties), doubtful,
    )  # fmt: skip


def family_of(search: Search, competitor: Competitor) -> str:
    """The family that a competitor counts for: its own, or that of the effect that a curve generalises.

    Where a curve generalises several effects, it counts for the one that depends on the fewest settings: a
    curve of slip counts for a law of slip rather than for one of slip and lugs.

    Parameters
    ----------
    search
        All models that were fitted.
    competitor
        An effect of the library or a curve.
    """
    if competitor.kind != "unknown":
        return competitor.family
    named = [other for other in search.field.competitors if competitor.generalises(other)]
    return min(named, key=lambda other: len(other.drivers), default=competitor).family


def _rival_groups(
    rest: list[str],
    probability: Mapping[str, float],
    members: Mapping[Key, set[str]],
    share: Mapping[Key, float],
) -> list[list[str]]:
    """Groups of families that exclude each other and together reach the probability of a name (`NAMED`)."""
    models = {f: {k for k, m in members.items() if f in m} for f in rest}
    groups, left = [], list(rest)
    while left:
        group, covered = left[:1], models[left[0]]
        for other in left[1:]:
            if sum(map(share.__getitem__, covered)) >= NAMED and probability[other] < 1.0 - NAMED:
                break
            if sum(map(share.__getitem__, models[other] - covered)) >= APART * probability[other]:
                group.append(other)
                covered = covered | models[other]
        if sum(map(share.__getitem__, covered)) >= NAMED:
            groups.append(group)
        left = [f for f in left if f not in group]
    return groups


def _without_a_law(
    search: Search, best: Candidate, named: list[str], speaks: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """Divide the names into those with a law that explains them, and curves for which there is none."""
    kept, unknown = [], []
    for name in named:
        if name.startswith("unknown:"):
            unknown.append(name)
            continue
        curves = [c for c in best.competitors if c.kind == "unknown" and speaks[c.family] == name]
        if not curves or any(c.family == name for c in best.competitors):
            kept.append(name)
            continue
        without = search.models.get(best.key - {c.key for c in curves})
        least = -np.inf if without is None else without.evidence
        law = _best_form(search, best, curves[0], name)
        if name in law.families and law.evidence > least + BEATS:
            kept.append(name)
        else:
            unknown.append(curves[0].family)
    return kept, unknown


def by_library(search: Search, best: Candidate, named: list[str]) -> Candidate:
    """Return the best model that has exactly the named effects, each as a law of the library.

    Their forms are chosen by evidence. A form that was not fitted before is fitted, and kept in
    `search.models`.

    Parameters
    ----------
    search
        All models that were fitted.
    best
        The most probable model, which may have curves; the fits start from it.
    named
        Families that are named as missing.
    """
    wanted, model = frozenset(named), best
    for competitor in best.competitors:
        family = family_of(search, competitor)
        if competitor.family != family and family in wanted - model.families:
            model = _best_form(search, model, competitor, family)
    for family in sorted(wanted - model.families):
        model = _best_form(search, model, None, family)
    for competitor in model.competitors:
        if competitor.family not in wanted:
            model = search.made(model, out=competitor) or model
    known = [m for m in search.ordered if m.families == model.families]
    return max([model, *known], key=lambda m: m.weight)


def _best_form(search: Search, model: Candidate, out: Competitor | None, family: str) -> Candidate:
    """The model with the family's best form in place of the competitor `out`, or besides all that it has."""
    forms = [c for c in search.field.competitors if c.family == family]
    made = [
        search.made(model, form, out=out) for form in forms if out is None or form.key != out.key
    ]
    good = [m for m in made if m is not None]
    if out is not None and out.family == family:
        good.append(model)
    return max(good, key=lambda m: m.weight, default=model)


# --- Settings that were varied together


def _tied(search: Search, best: Candidate, name: str) -> list[str]:
    """Rivals of a named family: those that follow a setting that was varied together with its own."""
    law = next((c for c in best.competitors if c.family == name), None)
    columns = search.field.columns
    if law is None or law.effect is None or not law.drivers or law.drivers[0] not in columns:
        return []
    rivals, own = [], columns[law.drivers[0]]
    for other, column in columns.items():
        varied = min(np.ptp(own), np.ptp(column)) > 1e-12 and other != law.drivers[0]
        if not varied or float(np.corrcoef(own, column)[0, 1]) ** 2 < TOGETHER:
            continue
        known = [c.family for c in search.field.competitors
                 if other in c.drivers and c.kind == "soil" and c.family != name]  # fmt: skip
        rivals.append(known[0] if known else f"unknown:{other}@{law.effect.stage}")
    return rivals
