# SPDX-License-Identifier: Apache-2.0
"""The decision from all the evidence together; it is made here only, and fits nothing.

The evidence is used in this order, and the first that is decisive settles the verdict:

1. the probabilities of the models (`posterior`): names, rivals, or nothing missing;
2. runs not used in the choice (`held_out`): a name that helps on none of them is a rival;
3. what the best explanation leaves (`misfit`): with lack of fit, a saturated sensor, runs of several soils
   or wild scatter no law here describes the data, and names are its closest description;
4. a fault that pull and torque reveal (`faults`) is named in any case, since they alone judge it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.diagnosis.bad_runs import BadRun, stuck
from smallwheel_ros.diagnosis.competitors import TAKEN_OUT
from smallwheel_ros.diagnosis.faults import Witness
from smallwheel_ros.diagnosis.held_out import HeldOut, Step
from smallwheel_ros.diagnosis.misfit import Misfit
from smallwheel_ros.diagnosis.posterior import Posterior, Word
from smallwheel_ros.diagnosis.search import Candidate, Search
from smallwheel_ros.fitting import Problem, constants
from smallwheel_ros.fitting.constants import ALARM, TIE, USEFUL
from smallwheel_ros.fitting.result import runs_differ
from smallwheel_ros.measurements.display import listed, number, p_text, percent, shown_value, words

_SURE = 0.002  # p of a plateau: with two channels one clean table in 250 has one

# By component of the scatter: what is usual, and the words for much more.
_UNUSUAL = {
    "tau": (
        constants.SOIL_SCATTER,
        "runs differ by {size} of k, more than most prepared soil: something that is not recorded differs "
        "from run to run",
    ),
    "own": (
        constants.CHANNEL_SCATTER,
        "{channel} differs by {size} from run to run, more than most rigs: its instrument, or something "
        "that is not recorded, differs",
    ),
    "fit": (
        constants.LACK_OF_FIT,
        "{channel} strays from the law by {size} from setting to setting",
    ),
    "along": (
        constants.CURVE_CORRELATED,
        "curves stray from a power of depth by {size} over their course",
    ),
}


@dataclass(frozen=True)
class Evidence:
    """The evidence that a decision uses.

    Attributes
    ----------
    problem
        The table without bad runs, and the base model, which includes `gauge_fault`.
    found
        All models that were fitted.
    posterior
        Probabilities of the effects, computed from these models.
    held_out
        Held-out errors of the named effects.
    misfit
        Misfit that the best explanation leaves.
    bad
        Runs that are left out.
    first
        The probabilities before these runs were left out.
    gauge_fault
        A fault of the sinkage gauge that pull and torque indicate; None if there is none.
    """

    problem: Problem
    found: Search
    posterior: Posterior
    held_out: HeldOut
    misfit: Misfit
    bad: tuple[BadRun, ...]
    first: Posterior
    gauge_fault: Witness | None


@dataclass(frozen=True)
class Verdict:
    """The verdict and its grounds.

    A family is an effect with all its forms, by the effect's id.

    Attributes
    ----------
    word
        `missing_effect`, `adequate`, `unknown_effect` or `indistinguishable`.
    named
        Families that are missing, the clearest first.
    rivals
        Families of which one is missing, where the data cannot tell which; for an unknown effect,
        candidates that the data does not confirm.
    unknown
        Ids of curves that stand for an effect in no library, such as `unknown:slip@sinkage`: no effect of
        the library describes the data as well.
    closest
        Families that describe the data best, though not well enough.
    probabilities
        Probability of each family, 0 to 1.
    best
        The model with the named effects, each as a law of the library; if none is named, the most probable
        model, which may have curves, or the base model if nothing is missing.
    steps
        The base model, and the model after each named effect is added.
    reasons
        Sentences that justify the verdict.
    """

    word: Word
    named: tuple[str, ...]
    rivals: tuple[str, ...]
    unknown: tuple[str, ...]
    closest: tuple[str, ...]
    probabilities: Mapping[str, float]
    best: Candidate
    steps: tuple[Step, ...]
    reasons: tuple[str, ...]


def decide(evidence: Evidence) -> Verdict:
    """Turn the evidence into a verdict."""
    said, held, fault = evidence.posterior, evidence.held_out, evidence.gauge_fault
    word, named, closest = said.word, held.named, said.closest
    rivals = tuple(dict.fromkeys([*itertools.chain(*held.useless), *said.rivals, *held.besides]))
    reasons = [*said.ties]
    if said.unknown:
        reasons.append(_unexplained(evidence.found, said.unknown))
    reasons += [*_of_bad_runs(evidence), *_of_held_out(held, rivals)]
    if held.useless and not named:
        word = "indistinguishable" if len(rivals) > 1 else "unknown_effect"
    if not held.rivals_help:
        word = "unknown_effect"
    mixed, stray, flat, scatter = _of_misfit(evidence.misfit)
    if word not in ("adequate", "missing_effect"):
        stray = []
    still = stuck(evidence.problem.points)
    flat = [*([still] if still else []), *flat]
    reasons = [*mixed, *reasons, *stray, *flat, *scatter]
    calm = word == "adequate" or said.doubtful or not held.rivals_help  # but for the scatter
    undescribed = bool(mixed or stray or flat or (calm and any(scatter.values())))
    if undescribed:
        word = "unknown_effect"
    # That no held-out error falls confirms no rival; that does not mean that none describes the data.
    unconfirmed = bool(rivals) and not (undescribed or said.unknown)
    if word == "unknown_effect" and not unconfirmed:
        # Of a gauge that does not move no effect is the closest description.
        closest, named, rivals = (() if still else (*closest, *named, *rivals)), (), ()
    steps, probabilities = held.steps if named else held.steps[:1], said.probabilities
    if fault is not None:
        name = fault.part.id
        named, probabilities = (name, *named), {**probabilities, name: fault.probability}
        word = "missing_effect" if word == "adequate" else word
        with_it = Step(name, steps[0].model, steps[0].errors)
        steps = (Step(None, fault.base, fault.errors), with_it, *steps[1:])
        forces = listed([words(n) for n in evidence.problem.points.forces])
        reasons.append(
            f"{words(name)} is indicated by {forces}: their law fits the sinkage as shown "
            f"{number(fault.evidence, 2)} nats worse than the corrected one"
        )
    return Verdict(
        word, named, rivals, said.unknown, closest, probabilities, held.best, steps, tuple(reasons)
    )


# --- What each piece of evidence says, in words


def _unexplained(search: Search, unknown: Sequence[str]) -> str:
    """Say which curve follows a setting, and whether laws of the library were tried on it and lost."""
    said, best = f"there is {listed(unknown)}", search.ordered[0]
    laws = [m for m in search.ordered if m.competitors
            and all(c.kind != "unknown" for c in m.competitors)]  # fmt: skip
    if not laws:
        return f"{said}; no law of the library could be tried on this data"
    if laws[0].weight > best.weight - TIE:
        return f"{said}; {listed(sorted(laws[0].families))} of the library would do about as well"
    tried = {family for m in search.models.values() for family in m.families}
    drivers = {d for c in best.competitors if c.kind == "unknown" for d in c.drivers}
    left = {
        c.family
        for c in search.field.competitors
        if c.kind != "unknown" and c.family not in tried
        and (c.kind == "instrument" or drivers & set(c.drivers))
    }  # fmt: skip
    left |= {family for family, why in search.field.blocked.items() if why == TAKEN_OUT}
    if left:
        return f"{said}, and no law of the library that was tried does; not tried: {listed(sorted(left))}"
    return f"{said}, and no law of the library does"


def _of_bad_runs(evidence: Evidence) -> Iterator[str]:
    """Say which runs are left out and why, and whether the probabilities would differ with them."""
    bad, before, after = evidence.bad, evidence.first, evidence.posterior
    for one in bad:
        yield one.words(evidence.problem.points.measurements)
    those = "it" if len(bad) == 1 else "them"
    if not bad:
        return
    if (before.word, set(before.named)) == (after.word, set(after.named)):
        yield f"with {those} the verdict would be the same"
        return
    named = f" of {listed(before.named)}" if before.named else ""
    yield f"with {those} the verdict would be '{words(before.word)}'{named}"


def _of_held_out(held: HeldOut, rivals: Sequence[str]) -> Iterator[str]:
    """Say which names help on no held-out run, and for which such runs cannot decide."""
    for names in reversed(held.useless):
        yield _no_help(names, held.falls)
    for law in held.blind:
        driver = words(law.drivers[0])
        yield (
            f"{words(law.family)} is named by evidence alone: where it acts, {driver} was set so far "
            "apart that a left-out run can only be extrapolated to. To settle it, measure at further "
            f"values of {driver} between these, or repeat them"
        )
    if not held.rivals_help:
        yield _no_help(rivals, {})
    if held.worse:
        yield (
            f"on runs that the choice never saw, the error of {listed(held.worse)} rises with what is named: "
            "its law does not carry over to settings outside those measured"
        )
    if held.forces:
        forces = listed([words(name) for name in held.forces])
        yield f"the held-out error of {forces} rises with what is named"


def _no_help(names: Sequence[str], falls: Mapping[str, Mapping[str, float]]) -> str:
    """Say that some names lower no held-out error, or none by more than chance."""
    within = {c: fall for n in names for c, fall in falls.get(n, {}).items() if fall >= USEFUL}
    said = f"with {listed(names, 'or')} "
    if not within:
        return f"{said}no error on held-out runs falls by {percent(USEFUL)}"
    each = listed([f"that of {words(c)} by {percent(fall)}" for c, fall in within.items()], "and")
    return f"{said}the error on held-out runs falls ({each}), but by less than its standard error"


def _of_misfit(misfit: Misfit) -> tuple[list[str], list[str], list[str], dict[str, bool]]:
    """Describe what is left beyond chance: of the soils, of the settings, of sensors, and of the scatter.

    Returns four parts: that runs are not of one soil; the channel whose settings deviate most from the
    model by more than their repeats allow; sensors that seem to be at the end of their range; scatter of
    over twice the usual size, with whether it is over four times that.
    """
    mixed = [runs_differ(misfit.mixed)] if misfit.mixed else []
    fits = misfit.lack_of_fit
    rejected = {name: one for name, one in fits.items() if one.p * len(fits) <= ALARM}
    stray = [
        f"runs of one setting repeat each other, and their means stray from the model: {words(name)} "
        f"by {percent(worst.misfit)}, {number(worst.ratio, 2)} times what the repeats allow (F test, "
        f"p {p_text(worst.p)}), most at {worst.at}"
        for name, worst in sorted(rejected.items(), key=lambda item: -item[1].ratio)[:1]
    ]
    flat = [
        f"the {top.count} largest values of {words(name)} lie within {percent(top.span)} of each "
        f"other, at settings where they should not (p {p_text(top.p)}): its sensor seems to "
        f"saturate at {shown_value(name, top.value)}. Leave these out, or measure within its range"
        for name, top in misfit.plateaus.items()
        if top.p <= _SURE
    ]
    scatter = {}
    for name, size in misfit.scatter.items():
        if name in misfit.mixed:
            continue
        component, _, channel = name.partition(":")
        usual, said = _UNUSUAL.get(component, (np.inf, ""))
        if size > usual * np.exp(constants.SPREAD):
            text = said.format(channel=words(channel), size=percent(size))
            scatter[text] = bool(size > usual * np.exp(2.0 * constants.SPREAD))
    return mixed, stray, flat, scatter
