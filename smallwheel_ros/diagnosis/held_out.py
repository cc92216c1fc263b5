"""Held-out errors of a diagnosis: what is named is chosen again in each fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import Competitor
from smallwheel_ros.diagnosis.problem import Problem
from smallwheel_ros.diagnosis.screen import Column
from smallwheel_ros.diagnosis.search import FOLD, CandidateFit, Search, refit, refitted, search
from smallwheel_ros.diagnosis.verdict import Verdict
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors, cross_validate
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.model import Model

_SHORTLIST = 4  # models of the whole search that a fold judges beside those it finds itself


def in_order(found: Search, verdict: Verdict) -> list[CandidateFit]:
    """The base and the models with one, two, ... of what is named, the one that says most first."""
    named = [c for c in verdict.best.competitors if c.family in verdict.named]
    return staircase(found, verdict.best, named)


def staircase(found: Search, best: CandidateFit, remaining: list[Competitor]) -> list[CandidateFit]:
    """The base, and models with one more of these competitors each, by their evidence."""
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
    return models


def _with(
    found: Search, parent: CandidateFit, competitor: Competitor, best: CandidateFit
) -> CandidateFit | None:
    key = tuple(sorted([*(c.key for c in parent.competitors), competitor.key]))
    if key in found.models:
        return found.models[key]
    start = np.array(
        [
            best.fit.theta[j]
            for j, p in enumerate(best.fit.vector.free)
            if p.of_effect and p.owner == competitor.part.id
        ]
    )
    made = refit(found.fitter, parent, competitor, start)
    found.add(made)
    return made


def nested(problem: Problem, found: Search, chain: list[frozenset[str]]) -> list[CvErrors]:
    """Held-out errors of the base and of each step, chosen anew in each fold.

    chain: families of each step. Of the last step's size a fold takes its most probable model, by its
    own runs alone: of those that its own search finds and of a shortlist of the search of all runs.
    A step on the way has the families that it is called by; their forms are chosen anew.
    """
    columns = [] if found.screen is None else found.screen.columns
    columns = [c for c in columns if c.competitor.kind != "unknown"]
    budget = replace(FOLD, most=len(chain) - 1)

    def choose(training: Points) -> list[Model]:
        fitter, base, keep = _training(problem, training)
        models = [base.vector.model(base.theta)]
        if len(chain) > 1:
            shorter = [Column(c.competitor, c.shift[keep], c.start) for c in columns]
            here = search(fitter, base, found.field, budget=budget, replicates=0, columns=shorter)
            for size, wanted in enumerate(chain[1:], start=1):
                listed = [m for m in _laws(found) if len(m.competitors) == size]
                named = [m for m in listed[_SHORTLIST:] if m.families == wanted]
                listed = [*listed[:_SHORTLIST], *named[:_SHORTLIST]]
                for model in listed:
                    here.add(refitted(fitter, model))
                fits = [m for m in here.ordered if len(m.competitors) == size]
                if size < len(chain) - 1:
                    fits = [m for m in fits if m.families == wanted] or fits
                models += [m.fit.vector.model(m.fit.theta) for m in fits[:1]]
        return models

    return cross_validate(problem.points, choose, len(chain))


def _laws(found: Search) -> list[CandidateFit]:
    """Models of laws of the library alone: what is named is added as one of them."""
    return [m for m in found.ordered if all(c.kind != "unknown" for c in m.competitors)]


def _training(problem: Problem, training: Points) -> tuple[Fitter, Fit, NDArray[np.bool_]]:
    keep = np.isin(problem.points.run, np.unique(training.run))
    fitter = problem.fitter.of_runs(training)
    vector = problem.base.vector(fitter.points)
    start = problem.fit.theta if vector.names == problem.fit.vector.names else None
    return fitter, fitter.fit(vector, start, problem.fit.scatter, turns=2), keep


def of_model(problem: Problem, models: Sequence[CandidateFit]) -> list[CvErrors]:
    """Held-out errors of models as they are, refitted in each fold from where they were."""

    def choose(training: Points) -> list[Model]:
        fitter = problem.fitter.of_runs(training)
        made = []
        for m in models:
            try:
                fit = fitter.fit(m.fit.vector, m.fit.theta, m.fit.scatter, turns=0)
            except (SmallwheelError, ArithmeticError, np.linalg.LinAlgError):
                fit = m.fit
            made.append(fit.vector.model(fit.theta))
        return made

    return cross_validate(problem.points, choose, len(models))
