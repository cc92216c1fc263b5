"""Add one effect to a model, and say what that does to the held-out error."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidate import CandidateFit, Competitor, refit
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.pipeline import Diagnosis, diagnose
from smallwheel_ros.diagnosis.search import Search
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.constants import WINDOW
from smallwheel_ros.fitting.fit import Fitter
from smallwheel_ros.fitting.held_out import Comparison, CvErrors, compare_cv, cross_validate
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Model

Forms = Sequence[tuple[Competitor, NDArray[np.float64]]]  # each with where its numbers start


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
    wanted = _forms_of(effect, Problem.of(measurements, base), known)
    judged = diagnose(measurements, base, registry=known, without=without, seed=seed)
    problem = judged.problem
    best, forms = with_effects(problem, [wanted])
    before, after = held_out_with(problem, forms)
    change = compare_cv(before, after)
    recommended, reason = _recommended(effect, judged, change)
    form = best.competitors[0]
    return Added(
        effect,
        form.geometry or form.form,
        problem.result(best.fit),
        before,
        after,
        change,
        recommended,
        reason,
    )


def _forms_of(effect: str, problem: Problem, registry: Registry) -> list[Competitor]:
    """The forms of an effect that can be fitted to this data. Raises EffectError where none can."""
    registry.family(effect)  # says what exists where there is none
    field = field_of(problem.points, problem.vector.model(problem.vector.start), registry)
    found = [c for c in field.competitors if c.family == effect]
    if not found:
        reason = field.blocked.get(effect, "its column is not there")
        raise EffectError(f"effect '{effect}' cannot be fitted to this data: {reason}")
    return found


def with_effects(
    problem: Problem, effects: Sequence[Sequence[Competitor]]
) -> tuple[CandidateFit, list[Forms]]:
    """The base with effects, one after the other, each in the form of the most evidence.

    And, by effect, the forms within `WINDOW` of the best, from which each fold chooses.
    Raises EffectError where one cannot be fitted.
    """
    model = CandidateFit((), problem.fit, problem.fit.evidence)
    near: list[Forms] = []
    for forms in effects:
        made = _extended(problem.fitter, model, [(c, c.part.start) for c in forms], 4)
        if not made:
            raise EffectError(f"effect '{forms[0].family}' cannot be fitted to this data")
        model = made[0]
        close = [m for m in made if m.weight > model.weight - WINDOW]
        last = [(m.competitors[-1], m.fit) for m in close]
        near.append([(c, fit.theta[fit.vector.places(c.part.id)]) for c, fit in last])
    return model, near


def held_out_with(problem: Problem, effects: Sequence[Forms]) -> list[CvErrors]:
    """Held-out errors of the base, and of it with these effects, their forms chosen in each fold."""

    def choose(training: Points) -> list[Model]:
        fitter, base = problem.fold(training)
        best = CandidateFit((), base, base.evidence)
        for forms in effects:
            best = next(iter(_extended(fitter, best, forms, 1)), best)
        return [base.model, best.fit.model]

    return cross_validate(problem.points, choose, 2)


def _extended(fitter: Fitter, model: CandidateFit, forms: Forms, turns: int) -> list[CandidateFit]:
    """The model with one more effect in each of these forms that can be fitted, the best first."""
    made = [refit(fitter, model, form, start, turns=turns) for form, start in forms]
    return sorted((m for m in made if m is not None), key=lambda m: -m.weight)


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
