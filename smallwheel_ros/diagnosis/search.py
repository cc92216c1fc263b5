"""Find which effects explain the data best, and which others would do as well.

Explanations are sets of effects. One effect is added at a time as long as the score test says that
something is missing; each time the best few sets are kept, so that two effects can be found of which
neither is the best alone. Then every member of the best set must earn its place, and every other effect
is tried in the place of each member.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.bend import bent
from smallwheel_ros.diagnosis.candidates import Family, Form
from smallwheel_ros.diagnosis.held_out import better, one_step
from smallwheel_ros.diagnosis.table import Lead, Table, look
from smallwheel_ros.diagnosis.workbench import Explanation, Workbench

Array = NDArray[np.float64]

ALARM = 0.02  # p-value under which something is missing
_FURTHER = 0.005  # the same, of each effect where there are several: more was looked at
_MOST_EFFECTS = 3
_BEAM = 3
RIVAL_GAP = 6.0  # of -2 log likelihood: 20 to 1
_RIVAL_SHARE = 0.9  # of the improvement
_DRAWS = 999
_LATER_DRAWS = 499
_WORSE_ALONE = 40.0  # of -2 log likelihood: how much worse a form may be without the second effect
_AS_GOOD = 15.0  # of -2 log likelihood: a form that might be the true one
LEAST_FALL = 0.05  # of a channel's held-out error


@dataclass(frozen=True)
class Member:
    """One effect of the best set and why it is in it, or why it is not accepted.

    gain: of -2 log likelihood over the set without it. p: of a gain this large by chance. fall, sigmas: of
    held-out error, relative and over its standard error. objection: why it is not accepted.
    rivals: effects that would do as well in its place, with their gap.
    """

    family: str
    gain: float
    p: float
    fall: float
    sigmas: float
    objection: str
    rivals: tuple[tuple[str, float], ...] = ()


@dataclass
class Search:
    """What was found: the best explanation, its members, and everything fitted on the way."""

    workbench: Workbench
    families: Sequence[Family]
    seed: int
    base: Explanation
    first: Table
    best: Explanation
    last: Table
    members: list[Member] = field(default_factory=list)


def cost(explanation: Explanation) -> float:
    """-2 log likelihood, with 2 for each parameter beyond one of an effect."""
    extra = sum(len(f.effect.parameters()) - 1 for f in explanation.forms)
    return explanation.cost + 2.0 * extra


def _family(families: Sequence[Family], name: str) -> Family:
    return next(f for f in families if f.name == name)


def best_form(workbench: Workbench, explanation: Explanation, family: Family) -> Explanation:
    """The explanation with the best form of one of its families."""
    rest = explanation.without(family.name)
    trials = [explanation]
    trials += [workbench.fit((*rest, form), near=explanation) for form in family.forms]
    # A form at its bound, or beyond what anybody found, only if no other form makes sense.
    sensible = [trial for trial in trials if plausible(trial, family.name)]
    return min(sensible or trials, key=cost)


def _with(workbench: Workbench, explanation: Explanation, lead: Lead) -> Explanation:
    start = {lead.family: lead.strength}
    return workbench.fit((*explanation.forms, lead.form), near=explanation, strengths=start)


def nuisance(workbench: Workbench, explanation: Explanation, families: Sequence[Family]) -> Array:
    """What the effects that are in may do otherwise than their best form: (observations, columns).

    Other forms of theirs that were fitted, and the law bent over its own driver.
    """
    predicted = explanation.fit.solution.predicted
    columns = []
    for other in workbench.known():
        same = sorted(other.families) == sorted(explanation.families)
        if same and cost(other) - cost(explanation) < _AS_GOOD:
            apart = other.fit.solution.predicted - predicted
            if np.any(np.abs(apart) > 1e-6 * np.abs(other.fit.solution.predicted)):
                columns.append(apart)
    columns = columns[:8] + bent(explanation, families)
    if not columns:
        return np.zeros((len(workbench.observations), 0))
    return np.column_stack(columns)


def search(workbench: Workbench, families: Sequence[Family], seed: int) -> Search:
    """Find the best explanation and test its members."""
    base = workbench.fit(())
    first = look(workbench, base, families, draws=_DRAWS, seed=seed, generic=True)
    found = Search(workbench, families, seed, base, first, base, first)
    beam, table = [base], first
    while len(found.best.forms) < _MOST_EFFECTS:
        may_be_chance = table.p_any >= _threshold(len(found.best.forms) + 1)
        pool = _extend(found, _other_forms(found) if may_be_chance else beam, first.critical)
        if may_be_chance:
            pool = [e for e in pool if cost(found.best) - cost(e) > 2.0 * first.critical]
        if not pool:
            break
        best = pool[0]
        if cost(found.best) - cost(best) < 0.5 * first.critical:
            break
        best = polish(found, best)
        if not _all_plausible(best):
            # an explanation that no plausible strength makes: try the next ones
            plausible = [e for e in pool[1:] if _all_plausible(e)]
            plausible = [e for e in plausible if cost(found.best) - cost(e) > first.critical]
            if plausible:
                best = polish(found, plausible[0])
        found.best = best
        beam = [best, *[e for e in pool[:_BEAM] if e.families != best.families]]
        table = look(
            workbench,
            best,
            families,
            draws=_LATER_DRAWS,
            seed=seed,
            nuisance=nuisance(workbench, best, families),
            generic=True,
        )
        found.last = table
    _judge(found)
    return found


def _threshold(effects: int) -> float:
    return ALARM if effects < 2 else _FURTHER


def _other_forms(found: Search) -> list[Explanation]:
    """The best explanation's effects in other forms: two effects may only show together.

    A form that fits worse alone may be the true one once the second effect is in.
    """
    best = found.best
    if not best.forms:
        return []
    wanted = sorted(best.families)
    others = [e for e in found.workbench.known() if sorted(e.families) == wanted and e is not best]
    near = [e for e in others if cost(e) - cost(best) < _WORSE_ALONE and _all_plausible(e)]
    return sorted(near, key=cost)[: 2 * _BEAM]


def _extend(found: Search, beam: Sequence[Explanation], critical: float) -> list[Explanation]:
    pool: dict[tuple[str, ...], Explanation] = {}
    for explanation in beam:
        table = found.first
        if explanation.forms:
            table = look(
                found.workbench, explanation, found.families, draws=0, seed=0, critical=critical
            )
        top = table.leads[0].gain if table.leads else 0.0
        for lead in table.leads[: 12 if not explanation.forms else 3]:
            if lead.gain < max(2.0, 0.1 * top):
                continue
            trial = _with(found.workbench, explanation, lead)
            if not explanation.forms:
                trial = best_form(found.workbench, trial, _family(found.families, lead.family))
            key = tuple(sorted(trial.families))
            if key not in pool or cost(trial) < cost(pool[key]):
                pool[key] = trial
    return sorted(pool.values(), key=cost)


def polish(found: Search, explanation: Explanation) -> Explanation:
    """Try the other forms of each effect, given the others."""
    for name in explanation.families:
        explanation = best_form(found.workbench, explanation, _family(found.families, name))
    return explanation


def plausible(explanation: Explanation, family: str) -> bool:
    """Whether what was fitted is, within two deviations, in the published range, not at a bound.

    A form that has to be bent as far as it goes is not the one that is there.
    Ranges are widened by a quarter of their width on each side: they are of other soils.
    """
    for j, slot in enumerate(explanation.layout.slots):
        if not slot.of_effect or explanation.layout.owner_name(slot) != family:
            continue
        effect = explanation.layout.model.effects[slot.owner]
        known = next(p for p in effect.parameters() if p.name == slot.field)
        if explanation.fit.solution.frozen[j]:
            return False
        if known.published is None:
            continue
        low, high = known.published
        margin = 0.25 * (high - low)
        deviation = float(np.sqrt(explanation.covariance()[j, j]))
        value = explanation.theta[j]
        if value + 2.0 * deviation < low - margin or value - 2.0 * deviation > high + margin:
            return False
    return True


def _all_plausible(explanation: Explanation) -> bool:
    return all(plausible(explanation, name) for name in explanation.families)


def _judge(found: Search) -> None:
    """Test each member; drop the weakest that fails and test the others again."""
    while found.best.forms:
        members = [_member(found, name) for name in found.best.families]
        failed = [m for m in members if m.objection]
        if not failed:
            found.members = [_with_rivals(found, m) for m in members]
            return
        worst = min(failed, key=lambda m: m.gain)
        found.members = members
        rest = found.best.without(worst.family)
        if not rest:
            return
        found.best = polish(found, found.workbench.fit(rest, near=None))


def _member(found: Search, name: str) -> Member:
    workbench, best = found.workbench, found.best
    rest = workbench.fit(best.without(name), near=_shrunk(found, name))
    without = min(rest, _shrunk(found, name), key=cost)
    gain = cost(without) - cost(best)
    table = look(
        workbench,
        rest,
        found.families,
        draws=_LATER_DRAWS,
        seed=found.seed,
        nuisance=nuisance(workbench, rest, found.families) if rest.forms else None,
    )
    lead = table.lead(name)
    p = lead.p_any if lead is not None else 1.0
    fall, sigmas = better(one_step(workbench, without), one_step(workbench, best))
    objection = ""
    if p >= _threshold(len(best.forms)):
        objection = f"a gain this large comes by chance (p {p:.2g})"
    elif not plausible(best, name):
        objection = "what was fitted is at a bound or outside the published range"
    elif fall < LEAST_FALL:
        objection = f"held-out error falls by {100 * fall:.1f} % only"
    elif sigmas < 1.0:
        objection = "held-out error falls by less than its standard error"
    return Member(name, gain, p, fall, sigmas, objection)


def _shrunk(found: Search, name: str) -> Explanation:
    """A fitted explanation near the best one without that effect."""
    wanted = sorted(n for n in found.best.families if n != name)
    near = [e for e in found.workbench.known() if sorted(e.families) == wanted]
    return min(near, key=cost) if near else found.base


def _with_rivals(found: Search, member: Member) -> Member:
    """Put every other effect in the member's place."""
    workbench, best = found.workbench, found.best
    rest = _shrunk(found, member.family)
    table = look(workbench, rest, found.families, draws=0, seed=0)
    own = table.lead(member.family)
    reference = own.gain if own is not None else 0.0
    rivals = []
    for lead in table.leads:
        if lead.family in best.families or lead.family == member.family:
            continue
        if lead.gain < min(0.4 * reference, reference - 3.0 * RIVAL_GAP):
            continue
        if lead.gain < 1.0:
            continue
        trial = _with(workbench, rest, lead)
        gap = cost(trial) - cost(best)
        if gap < 4.0 * RIVAL_GAP or gap < 0.3 * member.gain:
            trial = best_form(workbench, trial, _family(found.families, lead.family))
            gap = cost(trial) - cost(best)
        near = gap <= RIVAL_GAP or member.gain - gap >= _RIVAL_SHARE * member.gain
        if near and plausible(trial, lead.family):
            rivals.append((lead.family, float(gap)))
    # Two other effects together that do better than the set with this one.
    for other in workbench.known():
        if member.family in other.families or len(other.forms) != len(best.forms) + 1:
            continue
        if cost(other) + found.first.critical <= cost(best) and _all_plausible(other):
            extra = [n for n in other.families if n not in best.families]
            rivals += [(n, float(cost(other) - cost(best))) for n in extra]
    unique = dict(sorted(rivals, key=lambda r: -r[1]))
    ordered = tuple(sorted(unique.items(), key=lambda r: r[1]))
    return Member(member.family, member.gain, member.p, member.fall, member.sigmas, "", ordered)


def forms_alike(workbench: Workbench, explanation: Explanation, family: Family) -> list[Form]:
    """Forms of a family that fit as well as the best one (within 4 of -2 log likelihood)."""
    rest = sorted(explanation.without(family.name), key=lambda f: f.family)
    found = []
    for other in workbench.known():
        if sorted(other.families) != sorted(explanation.families):
            continue
        if sorted(other.without(family.name), key=lambda f: f.family) != rest:
            continue
        if cost(other) - cost(explanation) < 4.0:
            found += [f for f in other.forms if f.family == family.name]
    return found
