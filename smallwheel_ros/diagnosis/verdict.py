"""From what was found to what may be said: a name only where the data leaves one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import chi2

from smallwheel_ros.diagnosis.candidates import Family
from smallwheel_ros.diagnosis.generic import RIG
from smallwheel_ros.diagnosis.held_out import one_step
from smallwheel_ros.diagnosis.search import ALARM, RIVAL_GAP, Member, Search
from smallwheel_ros.diagnosis.ties import Tie, partners

Verdict = Literal[
    "missing_effect", "adequate", "unknown_effect", "indistinguishable", "insufficient_data"
]

_SURE = 0.003  # p-value of a misfit that no effect explains, in one of three tests
_LEFT_OVER = 0.001  # p-value of what the best explanation leaves
_LEFT_SHARE = 0.7  # of the weakest effect's gain
_MOST_EXPLAINED = 0.9  # of the error: beyond it, what is left cannot be what made a name look right
_PREPARED = 0.15  # scatter of ln k from run to run
_SCALE = (
    "elastic_rebound sets sinkage apart from resistance: a wrong scale of either sensor (the gain of a "
    "load cell, a depth read too large) looks the same, so check the calibration first"
)
_LEAST_REMOVED = 0.02  # of the standardised error, for such a misfit to matter


@dataclass(frozen=True)
class Finding:
    """The verdict. named: effects that every good explanation has, in the order added.

    candidates: effects that cannot be told apart. reasons: sentences. pairs: rivals, for what to
    measure next: an effect and one that could be in its place.
    """

    verdict: Verdict
    named: tuple[str, ...]
    candidates: tuple[str, ...]
    reasons: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] = ()


def _tied_families(
    member: Member, families: Sequence[Family], ties: Sequence[Tie], taken: Sequence[str]
) -> list[tuple[str, Tie]]:
    """Other families whose driver moves with the member's."""
    own = next(f for f in families if f.name == member.family)
    found: dict[str, Tie] = {}
    for driver in own.drivers:
        for tie in partners(list(ties), driver):
            other = tie.second if tie.first == driver else tie.first
            for family in families:
                if family.blocked or family.name in taken or family.name in found:
                    continue
                if other in family.drivers:
                    found[family.name] = tie
    return list(found.items())


def decide(search: Search, families: Sequence[Family], ties: Sequence[Tie]) -> Finding:
    """The verdict of a search."""
    accepted = [m for m in search.members if not m.objection]
    left = _more_left_than_explained(search, accepted)
    explained = _explained(search) if left else 0.0
    curve = _better_without_physics(search, accepted, families)
    if curve or (left and explained < _MOST_EXPLAINED):
        why = curve or f"{left}, and it may be what made that effect look right"
        return Finding("unknown_effect", (), (), (why,))
    taken = [m.family for m in accepted]
    named: list[str] = []
    open_sets: list[str] = []
    pairs: list[tuple[str, str]] = []
    reasons: list[str] = [text for text in (left, unrecorded(search)) if text and accepted]
    for member in accepted:
        rivals = [name for name, _ in member.rivals]
        tied = _tied_families(member, families, ties, taken)
        if not rivals and not tied:
            named.append(member.family)
            continue
        others = list(dict.fromkeys(rivals + [name for name, _ in tied]))
        pairs += [(member.family, other) for other in others]
        open_sets += [member.family, *others]
        if rivals:
            reasons.append(
                f"{member.family} explains the data best, but {_listed(rivals)} would do nearly as "
                "well in its place"
            )
        for name, tie in tied:
            reasons.append(
                f"{member.family} cannot be told from {name}: {tie.first} and {tie.second} were "
                f"varied together (r = {tie.correlation:.2f})"
            )
    candidates = tuple(dict.fromkeys(open_sets))
    if "elastic_rebound" in (*named, *candidates):
        reasons.append(_SCALE)
    if named:
        return Finding("missing_effect", tuple(named), candidates, tuple(reasons), tuple(pairs))
    if candidates:
        return Finding("indistinguishable", (), candidates, tuple(reasons), tuple(pairs))
    return _without_name(search)


def _more_left_than_explained(search: Search, accepted: Sequence[Member]) -> str:
    """A sentence where the best explanation leaves a misfit as clear as what it explains."""
    last = search.last
    if not accepted or last.p_generic >= _LEFT_OVER:
        return ""
    weakest = min(accepted, key=lambda m: m.gain)
    if last.generic_gain < _LEFT_SHARE * weakest.gain:
        return ""
    return (
        f"with {_listed([m.family for m in accepted])} in, which explains the data best, the error "
        f"still follows {last.generic} (p {last.p_generic:.2g}): something else is missing"
    )


def _explained(search: Search) -> float:
    """Share of the squared standardised held-out error beyond noise that the best explanation removes."""
    before = one_step(search.workbench, search.base).standardised() ** 2 - 1.0
    after = one_step(search.workbench, search.best).standardised() ** 2 - 1.0
    return 1.0 - max(after, 0.0) / max(before, 1e-9)


def _better_without_physics(
    search: Search, accepted: Sequence[Member], families: Sequence[Family]
) -> str:
    """A sentence where one channel's error over one setting says more than any effect does.

    An effect of the library that is really there explains more than such a curve, since it knows
    how the channels and settings hang together. Drawbar pull does not count: its law is crude.
    """
    first = search.first
    channel, _, setting = first.generic.partition(" over ")
    leads = [lead for m in accepted if (lead := first.lead(m.family)) is not None]
    channels = search.workbench.observations.channels
    if not leads or channel == "drawbar_pull" or len(channels) < 2:
        return ""
    names = [m.family for m in accepted]
    own = {driver for f in families if f.name in names for driver in f.drivers}
    if channel == "sinkage" and setting in own:
        return ""
    # One curve that does as well as two effects, short of what a second one must gain, is simpler.
    gain = search.base.cost - search.best.cost - (len(accepted) - 1) * first.critical
    if first.generic == RIG:
        # Both gains are of whole fits here, and there is no reason to think of a rig's friction first.
        needed = gain + RIVAL_GAP
    else:
        needed = max(gain if len(accepted) > 1 else 0.0, *(lead.gain for lead in leads))
    if first.generic_gain < needed:
        return ""
    return (
        f"the error is described better by {first.generic} alone than by {_listed(names)}: an effect "
        "that the library does not have"
    )


def unrecorded(search: Search) -> str:
    """A sentence where runs differ more than soils prepared alike do (lower 95 % bound of tau)."""
    names = search.workbench.effects.names
    if "ln k" not in names:
        return ""
    tau = float(search.best.fit.scatter.tau[names.index("ln k")])
    runs = np.unique(search.workbench.observations.run).size
    if tau * np.sqrt((runs - 1) / chi2.ppf(0.95, runs - 1)) < _PREPARED:
        return ""
    return (
        f"runs differ by {100 * tau:.0f} % in k, more than soil prepared alike does (2 to "
        f"{100 * _PREPARED:.0f} %): something that was not recorded changes from run to run"
    )


def _without_name(search: Search) -> Finding:
    first = search.first
    reasons = [f"{m.family} was not accepted: {m.objection}" for m in search.members]
    hidden = unrecorded(search)
    if hidden:
        return Finding("unknown_effect", (), (), (*reasons, hidden))
    signs = [
        (first.p_generic, first.generic, first.generic_gain),
        (first.p_soil, first.soil, first.soil_gain),
    ]
    if first.leads:
        signs.append((first.p_any, first.generic, first.leads[0].gain))
    p, where, gain = min(signs)
    rows = len(search.workbench.observations)
    removed = 1.0 - float(np.exp(-gain / (2.0 * rows)))
    if p < _SURE and removed > _LEAST_REMOVED:
        reasons.append(
            f"the base model misses something (p {p:.2g}), most clearly in "
            f"{where or 'nothing recorded'}, and no effect of the library explains it well enough"
        )
        return Finding("unknown_effect", (), (), tuple(reasons))
    if p < ALARM:
        reasons.append(
            f"there is a sign that something is missing (p {p:.2g}), but none that helps prediction: "
            "too small to matter here, or chance"
        )
    elif p < 0.10:
        reasons.append("there is a weak sign that something is missing: measure more runs")
    return Finding("adequate", (), (), tuple(reasons))


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
