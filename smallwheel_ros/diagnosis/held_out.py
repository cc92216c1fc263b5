# SPDX-License-Identifier: Apache-2.0
"""Held-out errors of a diagnosis: what is named is chosen again in each fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from smallwheel_ros.diagnosis.candidate import FAILURES, CandidateFit, Competitor, refit
from smallwheel_ros.diagnosis.search import Search
from smallwheel_ros.diagnosis.verdict import Verdict
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.held_out import CvErrors, cross_validate
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.model.model import Model

_SHORTLIST = 4  # models of the whole search that a fold chooses from


def staircase(found: Search, verdict: Verdict) -> list[CandidateFit]:
    """The base and the models with one, two, ... of what is named, the one that says most first."""
    best = verdict.best
    remaining = [c for c in best.competitors if c.family in verdict.named]
    models = [found.none]
    while remaining:
        parent = models[-1]
        made = [_with(found, parent, c, best) for c in remaining]
        known = [m for m in made if m is not None]
        if not known:
            break
        models.append(max(known, key=lambda m: m.weight))
        keys = {c.key for c in models[-1].competitors}
        remaining = [c for c in remaining if c.key not in keys]
    return models[: len(verdict.named) + 1]


def _with(
    found: Search, parent: CandidateFit, competitor: Competitor, best: CandidateFit
) -> CandidateFit | None:
    key = tuple(sorted([*(c.key for c in parent.competitors), competitor.key]))
    if key in found.models:
        return found.models[key]
    start = best.fit.theta[best.fit.vector.places(competitor.part.id)]
    made = refit(found.fitter, parent, competitor, start)
    found.add(made)
    return made


def nested(problem: Problem, found: Search, chain: list[frozenset[str]]) -> list[CvErrors]:
    """Held-out errors of the base and of each step, chosen anew in each fold.

    chain: families of each step. Of the last step's size a fold takes its most probable model, by its
    own runs alone, of a shortlist of the search of all runs.
    A step on the way has the families that it is called by; their forms are chosen anew.
    """

    def choose(training: Points) -> list[Model]:
        fitter, base = problem.fold(training)
        models = [base.model]
        for size, wanted in enumerate(chain[1:], start=1):
            listed = [m for m in _laws(found) if len(m.competitors) == size]
            named = [m for m in listed[_SHORTLIST:] if m.families == wanted]
            made = [refit(fitter, m, turns=1) for m in [*listed[:_SHORTLIST], *named[:_SHORTLIST]]]
            fits = sorted((m for m in made if m is not None), key=lambda m: -m.weight)
            if size < len(chain) - 1:
                fits = [m for m in fits if m.families == wanted] or fits
            models += [m.fit.model for m in fits[:1]]
        return models

    return cross_validate(problem.points, choose, len(chain))


def _laws(found: Search) -> list[CandidateFit]:
    """Models of laws of the library alone: what is named is added as one of them."""
    return [m for m in found.ordered if all(c.kind != "unknown" for c in m.competitors)]


def of_model(problem: Problem, models: Sequence[CandidateFit]) -> list[CvErrors]:
    """Held-out errors of models as they are, refitted in each fold from where they were."""

    def choose(training: Points) -> list[Model]:
        fitter = problem.fitter.of_runs(training)
        made = []
        for m in models:
            try:
                fit = fitter.fit(m.fit.vector, m.fit.theta, m.fit.scatter, turns=0)
            except FAILURES:
                fit = m.fit
            made.append(fit.model)
        return made

    return cross_validate(problem.points, choose, len(models))


def with_forces(
    problem: Problem, models: Sequence[CandidateFit], errors: list[CvErrors]
) -> list[CvErrors]:
    """Errors of models of the judged channels, with those of pull and torque, which had no say in them."""
    if problem.judged is problem:
        return errors
    full = [replace(m, fit=problem.with_all_channels(m.fit)) for m in models]
    return [
        replace(e, error={**e.error, **{name: p.error[name] for name in problem.points.forces}})
        for e, p in zip(errors, of_model(problem, full), strict=True)
    ]
