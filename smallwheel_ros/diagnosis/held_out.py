# SPDX-License-Identifier: Apache-2.0
"""Held-out errors of a diagnosis: the effects that it names are chosen again in each fold."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import Competitor
from smallwheel_ros.diagnosis.posterior import Posterior, by_library
from smallwheel_ros.diagnosis.search import Candidate, Search, refit
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.constants import USEFUL
from smallwheel_ros.fitting.fit import FAILURES, Fit
from smallwheel_ros.fitting.held_out import (
    CvErrors,
    compare_cv,
    cross_validate,
    folds_of,
    leave_out,
    sizes_of,
)
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.model.model import Model

Array = NDArray[np.float64]
Choose = Callable[[Points], Sequence[Fit]]  # of training runs, the models of a fold

_SHORTLIST = 4  # models of the whole search that a fold chooses from
_NEAR = 0.15  # of the range of a setting on one side: eight even levels are near each other, three are not
_LISTED = 5  # families whose held-out error is worked out for the ranking


@dataclass(frozen=True)
class Step:
    """A model on the way to the verdict, with its held-out errors.

    Attributes
    ----------
    added
        Id of the effect that this model has and the one before has not; None for the base model.
    model
        The model, fitted to all runs.
    errors
        Its held-out errors.
    """

    added: str | None
    model: Fit
    errors: CvErrors


@dataclass(frozen=True)
class HeldOut:
    """Held-out evidence for or against each effect named as missing, from runs not used in choosing it.

    A family is an effect with all its forms, by the effect's id.

    Attributes
    ----------
    steps
        The base model, and the model after each named effect is added.
    named
        Families of the named effects, in the order in which they were added.
    best
        The model with the named effects, each as a law of the library; if none is named, the most probable
        model, or the base model if nothing is missing.
    useless
        Families that the probabilities name, and that are named no longer since they lower the held-out error
        of no channel. Without them all errors are computed again: one tuple for each time, the last first.
    falls
        For each family in `useless`, the relative reduction of the held-out error by channel, where known.
    blind
        Named effects that held-out errors cannot judge: of the runs on which such an effect acts, some or all
        have none near them once they are left out, so that their prediction is extrapolation. On the others,
        if there are any, the effect lowers an error.
    worse
        Channels whose held-out error rises with the named effects.
    forces
        Channels of pull and torque whose held-out error rises, where sinkage or resistance decides what is
        named; a reservation only.
    rivals_help
        Whether a held-out error falls with the most probable model of at least one rival; true also if an
        effect is named, or if there are fewer than two rivals.
    besides
        Families to be added to the rivals: effects of the soil that lower the held-out error of a channel
        on which no rival acts. Empty if an effect is named, or if there are fewer than two rivals.
    """

    steps: tuple[Step, ...]
    named: tuple[str, ...]
    best: Candidate
    useless: tuple[tuple[str, ...], ...]
    falls: Mapping[str, Mapping[str, float]]
    blind: tuple[Competitor, ...]
    worse: tuple[str, ...]
    forces: tuple[str, ...]
    rivals_help: bool
    besides: tuple[str, ...]


def held_out(problem: Problem, found: Search, posterior: Posterior) -> HeldOut:
    """Compute held-out errors of the base model, and after adding each effect that the probabilities name.

    An effect that lowers the error of no channel is named no longer, and the errors of the others are
    computed without it.

    Parameters
    ----------
    problem
        The table and the base model.
    found
        All models that were fitted.
    posterior
        Probabilities of the effects.

    Returns
    -------
    HeldOut
        The errors, and the effects that stay named.
    """
    judged, best, names = problem.judged, posterior.best, posterior.named
    useless: list[tuple[str, ...]] = []
    falls: dict[str, Mapping[str, float]] = {}
    sizes = sizes_of(problem.deciding.points)
    while True:
        models = _staircase(found, best, names)
        choose = _chosen_anew(judged, found, [m.families for m in models])
        errors = errors_of(problem.deciding, choose, len(models))
        added = [next(iter(b.families - a.families)) for a, b in itertools.pairwise(models)]
        blind, no_help = [], [name for name in names if name not in added]
        for name, model, (before, after) in zip(
            added, models[1:], itertools.pairwise(errors), strict=True
        ):
            law = next(c for c in model.competitors if c.family == name)
            if _helps(before, after, sizes):
                continue
            if _evidence_alone(judged.points, law, before, after):
                blind.append(law)
            else:
                no_help.append(name)
                falls[name] = compare_cv(before, after).reduction
        if not no_help:
            break
        names = tuple(name for name in names if name not in no_help)
        best = by_library(found, best, [*names]) if names else found.ordered[0]
        useless.insert(0, tuple(no_help))
    rivals = {*itertools.chain(*useless), *posterior.rivals}
    helps = names or len(rivals) < 2 or _any_helps(problem.deciding, found, rivals)
    worse = compare_cv(errors[0], errors[-1]).worse
    forces: tuple[str, ...] = ()
    if problem.deciding is not problem:
        errors = errors_of(problem, choose, len(models))
        rising = compare_cv(errors[0], errors[-1]).worse
        forces = tuple(name for name in rising if name in problem.points.forces)
    steps = tuple(Step(*step) for step in zip([None, *added], models, errors, strict=True))
    named, left_out = tuple(added), tuple(useless)
    besides = (
        () if names or len(rivals) < 2 else _besides(problem.deciding, found, posterior, rivals)
    )
    return HeldOut(
        steps, named, best, left_out, falls, tuple(blind), worse, forces, bool(helps), besides
    )


def _helps(before: CvErrors, after: CvErrors, sizes: Mapping[str, Array]) -> bool:
    """Whether the error of a channel falls, and by more than its standard error.

    Absolute errors are dominated by a few of the largest values, since errors grow with them: a single run
    under the largest load outweighs all others. So a fall by more than the standard error of the errors
    relative to the size of each value counts as well.
    """
    change = compare_cv(before, after)
    in_shares = compare_cv(before.over(sizes), after.over(sizes)).better
    return change.helps or any(change.reduction[name] >= USEFUL for name in in_shares)


def _evidence_alone(points: Points, law: Competitor, before: CvErrors, after: CvErrors) -> bool:
    """Whether left-out runs cannot speak against a law that acts on one side of a setting.

    A run does not count where the fold without it has nothing near its setting: its error is then one of
    extrapolation. The others have to show that the law helps, if there are any that it acts on.
    """
    side = 0 if law.effect is None else law.effect.side
    if not side or not law.drivers:
        return False
    size = np.maximum(side * points.column(law.drivers[0]), 0.0)
    acts, blind = size > 0.0, np.zeros(len(points), dtype=bool)
    for out in leave_out(folds_of(points)[points.run]):
        seen = size[~out & acts]
        for i in np.flatnonzero(out & acts):
            blind[i] = not np.any(np.abs(seen - size[i]) <= _NEAR * size.max())
    if not blind.any():
        return False
    if blind[acts].all():
        return True
    rows = np.concatenate([points.rows[i] for i in np.flatnonzero(blind)])
    return compare_cv(before.without(rows), after.without(rows)).helps


def _staircase(found: Search, best: Candidate, names: Collection[str]) -> list[Candidate]:
    """The base, and the models with one, two, ... of the named effects, the most probable one first."""
    models = [found.none]
    remaining = [c for c in best.competitors if c.family in names]
    while remaining:
        made = [
            found.made(models[-1], c, best.theta[best.vector.places(c.part.id)]) for c in remaining
        ]
        known = [m for m in made if m is not None]
        if not known:
            break
        models.append(max(known, key=lambda m: m.weight))
        remaining = [c for c in remaining if c.key not in models[-1].key]
    return models


def errors_of(problem: Problem, choose: Choose, steps: int) -> list[CvErrors]:
    """Compute held-out errors of a model after each step, as every command reports them.

    Each chosen model is fitted to all channels with the weights of an ordinary fit, as a command would
    write it to a file.

    Parameters
    ----------
    problem
        The table and the base model.
    choose
        Function that returns the models, fitted to a fold's training points, in the order of the steps.
    steps
        Number of models; if `choose` returns fewer, the last one stands for the rest.

    Returns
    -------
    list of CvErrors
        One for each step, of the table's rows.
    """
    judged = problem.judged.points

    def models(training: Points) -> list[Model]:
        fits = choose(judged.take(judged.of_runs(training)))
        return [problem.refitted(fit, training).model for fit in fits]

    return cross_validate(problem.points, models, steps, known=problem.base.priors)


def kept(choose: Choose) -> Choose:
    """Wrap a function of training points so that it is computed only once for each set of runs."""
    made: dict[bytes, Sequence[Fit]] = {}

    def known(training: Points) -> Sequence[Fit]:
        key = np.unique(training.run).tobytes()
        if key not in made:
            made[key] = choose(training)
        return made[key]

    return known


def _chosen_anew(judged: Problem, found: Search, chain: list[frozenset[str]]) -> Choose:
    """Return a function that chooses the base and the model of each step anew from a fold's training points.

    `chain` has the families of each step. For the last step a fold takes the model of that size that is
    most probable by its own runs, from a shortlist of the search of all runs. A step before has the
    families in `chain`; only their forms are chosen anew.
    """
    # What is named is added as a law of the library.
    laws = [m for m in found.ordered if all(c.kind != "unknown" for c in m.competitors)]

    def choose(training: Points) -> Sequence[Fit]:
        fitter, base = judged.fold(training)
        steps, seen = list[Fit]([base]), judged.points.of_runs(training)
        for size, wanted in enumerate(chain[1:], start=1):
            known = [m for m in laws if len(m.competitors) == size]
            named = [m for m in known[_SHORTLIST:] if m.families == wanted][:_SHORTLIST]
            made = [refit(fitter, m.take(seen), turns=1) for m in (*known[:_SHORTLIST], *named)]
            fits = sorted((m for m in made if m is not None), key=lambda m: -m.weight)
            if size < len(chain) - 1:
                fits = [m for m in fits if m.families == wanted] or fits
            steps += fits[:1]
        return steps

    return kept(choose)


def _as_they_are(judged: Problem, models: Sequence[Fit]) -> Choose:
    """Return a function that fits given models to a fold's training points, without choosing among them."""

    def choose(training: Points) -> Sequence[Fit]:
        (fitter, _), seen = judged.fold(training), judged.points.of_runs(training)
        made = []
        for m in models:
            try:
                made.append(fitter.fit(m.take(seen), turns=0))
            except FAILURES:
                made.append(m)
        return made

    return choose


def _any_helps(problem: Problem, found: Search, rivals: Collection[str]) -> bool:
    """Whether one of the rivals lowers a held-out error by `USEFUL`, be it within its standard error."""
    best = {f: next((m for m in found.ordered if f in m.families), found.none) for f in rivals}
    models = [found.none, *best.values()]
    choose = _as_they_are(problem.judged, models)
    base, *errors = errors_of(problem, choose, len(models))
    falls = [fall for e in errors for fall in compare_cv(base, e).reduction.values()]
    return max(falls, default=0.0) >= USEFUL


def _besides(
    problem: Problem, found: Search, posterior: Posterior, rivals: Collection[str]
) -> tuple[str, ...]:
    """Effects of the soil that lower the error of a channel which no rival acts on.

    The probabilities may have rejected them in favour of a rival with which k and n can imitate them. A
    sensor is not blamed without probability.
    """
    competitors = [c for c in found.field.competitors if c.effect is not None]
    acts_on = {c.family: set(c.effect.channels) for c in competitors if c.effect is not None}
    idle = set(problem.points.channels).difference(*(acts_on.get(name, ()) for name in rivals))
    families = dict.fromkeys(c.family for c in competitors if c.kind == "soil")
    others = [f for f in families if f not in rivals and idle & acts_on[f]]
    others = sorted(others, key=lambda f: -posterior.probabilities.get(f, 0.0))[:_LISTED]
    models = {}
    for family in others:
        made = [found.made(found.none, c) for c in competitors if c.family == family]
        if known := [m for m in made if m is not None]:
            models[family] = max(known, key=lambda m: m.weight)
    if not models:
        return ()
    choose = _as_they_are(problem.judged, [found.none, *models.values()])
    base, *errors = errors_of(problem, choose, len(models) + 1)
    falls = zip(models, errors, strict=True)
    return tuple(f for f, error in falls if idle & {*compare_cv(base, error).better})


def errors_alone(
    problem: Problem, found: Search, held: HeldOut, probabilities: Mapping[str, float]
) -> dict[str, CvErrors]:
    """Compute held-out errors of the most probable families, each alone in its best form.

    Parameters
    ----------
    problem
        The table and the base model.
    found
        All models that were fitted.
    held
        Errors of the steps; the family added in the first step has that step's error.
    probabilities
        Probability of each family, 0 to 1.

    Returns
    -------
    dict of CvErrors
        By family, for the five most probable ones that were fitted alone, and that of the first step.
    """
    known = {step.added: step.errors for step in held.steps[1:2] if step.added is not None}
    families = sorted(found.field.kinds, key=lambda f: -probabilities.get(f, 0.0))
    alone = {f: found.all_alone(f) for f in families}
    shown = [f for f in families if alone[f]][:_LISTED]
    models = {f: alone[f][0] for f in shown if f not in known}
    choose = _as_they_are(problem.judged, list(models.values()))
    return known | dict(zip(models, errors_of(problem, choose, len(models)), strict=True))
