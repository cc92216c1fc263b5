"""Add one effect to a model, and say what that does to the held-out error."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.diagnosis.competitors import Competitor, field_of
from smallwheel_ros.diagnosis.pipeline import Diagnosis, diagnose
from smallwheel_ros.diagnosis.problem import Base, Problem
from smallwheel_ros.diagnosis.search import CandidateFit, Search, refit
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import Comparison, CvErrors, compare_cv, cross_validate
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Model


@dataclass(frozen=True)
class Added:
    """An effect that was added to a model. before, after: held-out errors; change: between them.

    recommended: the diagnosis of the same data names the effect, and no channel is predicted worse.
    reason: why not, or what else it could be.
    """

    effect: str
    form: str
    fit: FitResult
    before: CvErrors
    after: CvErrors
    change: Comparison
    recommended: bool
    reason: str


def add_effect(
    effect: str,
    base: Base,
    measurements: Measurements,
    *,
    registry: Registry | None = None,
    without: Collection[str] = (),
    seed: int = 0,
) -> Added:
    """Add one effect, in the form that fits best, and fit everything anew.

    Raises EffectError where there is no such effect or the data does not have what it needs.
    """
    known = registry or default_registry()
    forms_of(effect, Problem.of(measurements, base), known)  # refused before the work, not after it
    judged = diagnose(measurements, base, registry=known, without=without, seed=seed)
    problem = judged.problem
    forms = forms_of(effect, problem, known)
    best = fitted_with(problem, forms)
    before, after = held_out_with(problem, forms)
    change = compare_cv(before, after)
    recommended, reason = _recommended(effect, judged, change)
    form = best.competitors[0]
    return Added(
        effect,
        form.geometry or form.form,
        problem.result(best.fit.vector, best.fit.theta),
        before,
        after,
        change,
        recommended,
        reason,
    )


def forms_of(effect: str, problem: Problem, registry: Registry) -> list[Competitor]:
    """The forms of an effect that can be fitted to this data. Raises EffectError where none can."""
    registry.family(effect)  # says what exists where there is none
    field = field_of(problem.points, problem.vector.model(problem.vector.start), registry)
    found = [c for c in field.competitors if c.family == effect]
    if not found:
        reason = field.blocked.get(effect, "its column is not there")
        raise EffectError(f"effect '{effect}' cannot be fitted to this data: {reason}")
    return found


def fitted_with(problem: Problem, forms: list[Competitor]) -> CandidateFit:
    """The base with one effect, in the form of the most evidence. Raises EffectError where none fits."""
    return _best_form(problem.fitter, problem.fit, forms)


def _best_form(fitter: Fitter, fit: Fit, forms: list[Competitor]) -> CandidateFit:
    none = CandidateFit((), fit, fit.evidence)
    starts = [np.array([value for _, value, *_ in c.part.parameters]) for c in forms]
    made = [refit(fitter, none, c, start) for c, start in zip(forms, starts, strict=True)]
    good = [m for m in made if m is not None]
    if not good:
        raise EffectError(f"effect '{forms[0].family}' cannot be fitted to this data")
    return max(good, key=lambda m: m.weight)


def held_out_with(problem: Problem, forms: list[Competitor]) -> list[CvErrors]:
    """Held-out errors of the base and of it with the effect, its form chosen anew in each fold."""

    def choose(training: Points) -> list[Model]:
        fitter = problem.fitter.of_runs(training)
        vector = problem.base.vector(fitter.points)
        start = problem.fit.theta if vector.names == problem.fit.vector.names else None
        fit = fitter.fit(vector, start, problem.fit.scatter, turns=2)
        models = [fit.vector.model(fit.theta)]
        best = _best_form(fitter, fit, forms).fit
        return [*models, best.vector.model(best.theta)]

    return cross_validate(problem.points, choose, 2)


def held_out_rmse(problem: Problem) -> dict[str, float]:
    """Held-out RMSE of the base fitted to these rows, by channel, m or N; empty with one run only."""
    if problem.points.run_count < 2:
        return {}

    def choose(training: Points) -> list[Model]:
        fitter = problem.fitter.of_runs(training)
        fit = fitter.fit(problem.base.vector(fitter.points), None, problem.fit.scatter, turns=2)
        return [fit.vector.model(fit.theta)]

    return cross_validate(problem.points, choose, 1)[0].rmse()


def _recommended(effect: str, judged: Diagnosis, change: Comparison) -> tuple[bool, str]:
    """One verdict for `add` and `diagnose`: what is recommended is what is named."""
    document = judged.document
    found: Search | None = judged.search
    if document["verdict"] == "insufficient_data" or found is None:
        return False, f"{document['reason']}; not recommended"
    row = next((r for r in document["ranking"] if r["effect"] == effect), None)
    if effect in document["missing_effects"]:
        if change.worse:
            rises = " and ".join(change.worse)
            return False, f"named, but the held-out error of {rises} rises; not recommended alone"
        return True, ""
    if effect in document["candidates"]:
        others = ", ".join(c for c in document["candidates"] if c != effect)
        return False, f"this data cannot tell it from {others}; not recommended before it can"
    chance = 0.0 if row is None else row.get("probability") or 0.0
    if document["missing_effects"]:
        named = ", ".join(document["missing_effects"])
        return False, f"the data speaks for {named} (this one {chance:.2f}); not recommended"
    return (
        False,
        f"probability {chance:.2f}, p {document['lack_of_fit']['p_value']:.2g}; not recommended",
    )
