"""The diagnosis from measurements to document; each step is in a module of its own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smallwheel_ros.diagnosis import document as written
from smallwheel_ros.diagnosis.competitors import Field, field_of, varied
from smallwheel_ros.diagnosis.held_out import in_order, nested, of_model
from smallwheel_ros.diagnosis.leads import curve_shown, residuals_left, worst_left
from smallwheel_ros.diagnosis.next_measurement import Limits, Proposal, propose
from smallwheel_ros.diagnosis.problem import Base, Problem
from smallwheel_ros.diagnosis.regions import where_it_fails
from smallwheel_ros.diagnosis.search import Budget, CandidateFit, Search, exchanged, search
from smallwheel_ros.diagnosis.verdict import Verdict, decide
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.fitting.constants import (
    ALARM,
    FEWEST_RUNS,
    LEAST_POWER,
    SOIL_SCATTER,
    SPREAD,
    THRUST_LAW,
)
from smallwheel_ros.fitting.held_out import CvErrors, compare_cv, in_sample
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.result import expected_error
from smallwheel_ros.measurements.noise_floor import repeatability
from smallwheel_ros.measurements.table import Measurements

_MOST_PROPOSALS = 3
_LISTED = 5  # families whose held-out error is worked out for the ranking

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """The base (added None) or an effect that was added, with the held-out errors after it."""

    added: str | None
    model: CandidateFit
    errors: CvErrors


@dataclass(frozen=True)
class Diagnosis:
    """A diagnosis. document: what the JSON holds. The rest is what the document was made from.

    search and verdict are None, and steps empty, where the data is insufficient.
    """

    document: dict[str, Any]
    measurements: Measurements
    problem: Problem
    search: Search | None = None
    verdict: Verdict | None = None
    steps: tuple[Step, ...] = ()

    def fitted(self, step: int) -> FitResult:
        """The model of a step fitted to all runs and channels, for people and for model files."""
        model = self.steps[step].model.fit
        return self.problem.result(model.vector, model.theta)


def diagnose(
    measurements: Measurements,
    base: Base | None = None,
    *,
    registry: Registry | None = None,
    seed: int = 0,
    without: Collection[str] = (),
    limits: Limits | None = None,
    progress: Progress = lambda step: None,
) -> Diagnosis:
    """Find out which effect a model is missing, as far as the measurements can tell.

    Parameters
    ----------
    measurements
        The table.
    base
        What the model has already; the contact integral and nothing else where None.
    registry
        The effects that could be missing; those of the library where None.
    seed
        Of the null distribution: the same seed gives the same document.
    without
        Ids of effects that are taken out of the competition.
    limits
        By setting (SI), the levels that the user can set, for the measurements to make next.
    progress
        Told each step in words.

    Raises
    ------
    FittingError
        Where nothing usable was measured.
    """
    known = registry or default_registry()
    progress("fitting the base model")
    problem = Problem.of(measurements, base)
    judged = problem.judged
    reason = _insufficient(judged.points)
    if len(problem.points) < 2:
        reason = reason or "one measurement only"
        empty = written.plain(_document_head("insufficient_data", reason, problem.measurements))
        return Diagnosis(empty, problem.measurements, problem)
    field = field_of(judged.points, judged.vector.model(judged.vector.start), known, without)
    if reason:
        return _too_little(problem, field, reason)
    progress("testing each effect")
    found = search(judged.fitter, judged.fit, field, seed=seed)
    verdict = _with_scatter(found, decide(found))
    progress("held-out error of each step")
    verdict, steps = _steps(problem, found, verdict)
    progress("ranking")
    document = _document(problem, found, verdict, steps, seed)
    progress("what to measure next")
    proposals = _proposals(found, verdict, limits or {})
    document["next_measurements"] = [written.proposal_entry(p) for p in proposals]
    plain = written.plain(document)
    return Diagnosis(plain, problem.measurements, problem, found, verdict, tuple(steps))


def _insufficient(points: Points) -> str:
    runs = points.run_count
    if runs < FEWEST_RUNS:
        return (
            f"{runs} run{'s' if runs != 1 else ''}: under {FEWEST_RUNS} runs nothing can be told from "
            "the scatter of the soil; rows of one run are repeats, not more runs"
        )
    if not varied(points):
        return "every setting is the same in all rows: vary at least the load"
    return ""


def _document_head(word: str, reason: str, measurements: Measurements) -> dict[str, Any]:
    return {
        "schema": written.SCHEMA,
        "verdict": word,
        "reason": reason,
        "missing_effects": [],
        "candidates": [],
        "channels": {},
        "lack_of_fit": {"p_value": None},
        "where_it_fails": [],
        "ranking": [],
        "steps": [{"added": None, "held_out_rmse": {}}],
        "next_measurements": [],
        "notes": list(measurements.notes),
        "warnings": list(measurements.warnings),
    }


def _too_little(problem: Problem, field: Field, reason: str) -> Diagnosis:
    fit = problem.fit
    errors = in_sample(problem.points, fit.vector.model(fit.theta))
    document = _document_head("insufficient_data", reason, problem.measurements)
    document["channels"] = _channels(problem, errors, {})
    document["steps"] = [{"added": None, "held_out_rmse": errors.rmse()}]
    document["ranking"] = [
        {"effect": name, "kind": kind, "status": "not_testable",
         "reason": field.blocked.get(name, reason)}
        for name, kind in sorted(field.kinds.items()) if kind != "unknown"
    ]  # fmt: skip
    notes = problem.result(fit.vector, fit.theta).notes
    document["notes"] = [
        "the errors given here are in sample: with so little data nothing was held out",
        *notes,
        *problem.measurements.notes,
    ]
    return Diagnosis(written.plain(document), problem.measurements, problem)


def _steps(problem: Problem, found: Search, verdict: Verdict) -> tuple[Verdict, list[Step]]:
    """Held-out errors of the base and of it with each name; a channel that gets worse is said."""
    judged = problem.judged
    models = in_order(found, verdict) if verdict.named else [found.none]
    models = models[: len(verdict.named) + 1]
    errors = nested(judged, found, [m.families for m in models])
    if len(models) > 1:
        worse = compare_cv(errors[0], errors[-1]).worse
        if worse:
            said = (
                f"on runs that the choice never saw, the error of {' and '.join(worse)} rises with what "
                "is named: its law does not carry over to settings outside those measured"
            )
            verdict = replace(verdict, reasons=(*verdict.reasons, said))
    errors = _with_pull(problem, models, errors)
    if "drawbar_pull" in compare_cv(errors[0], errors[-1]).worse and problem.judged is not problem:
        said = "the held-out error of drawbar pull rises with what is named: its law is crude"
        verdict = replace(verdict, reasons=(*verdict.reasons, said))
    named = [_added(models, i) for i in range(len(models))]
    verdict = replace(verdict, named=tuple(n for n in named if n is not None) or verdict.named)
    return verdict, [
        Step(name, model, error) for name, model, error in zip(named, models, errors, strict=True)
    ]


def _with_scatter(found: Search, verdict: Verdict) -> Verdict:
    """What runs of one setting differ by, where that is more than soil does that was prepared.

    Beyond the prior's usual range it is said; beyond twice that, something unknown differs.
    """
    tau = found.ordered[0].fit.scatter.as_dict(found.fitter.variance)["tau"]
    if tau <= SOIL_SCATTER * np.exp(SPREAD):
        return verdict
    said = (
        f"runs differ by {100 * tau:.0f} % of k, more than most prepared soil: something that is not "
        "recorded differs from run to run"
    )
    word = verdict.word
    if word == "adequate" and tau > SOIL_SCATTER * np.exp(2.0 * SPREAD):
        word = "unknown_effect"
    return replace(verdict, word=word, reasons=(*verdict.reasons, said))


def _added(models: list[CandidateFit], step: int) -> str | None:
    if step == 0:
        return None
    new = models[step].families - models[step - 1].families
    return next(iter(new))


def _with_pull(
    problem: Problem, models: list[CandidateFit], errors: list[CvErrors]
) -> list[CvErrors]:
    """The errors with those of drawbar pull, which had no say in the choice."""
    if problem.judged is problem:
        return errors
    full = []
    for model in models:
        vector = problem.own(model.fit.vector)
        known = dict(zip(model.fit.vector.names, model.fit.theta, strict=True))
        start = np.array([known.get(p.name, p.start) for p in vector.free])
        fit = problem.fitter.fit(vector, start, problem.fit.scatter)
        full.append(replace(model, fit=fit))
    pulls = of_model(problem, full)
    return [
        replace(e, error={**e.error, "drawbar_pull": p.error["drawbar_pull"]})
        for e, p in zip(errors, pulls, strict=True)
    ]


def _channels(
    problem: Problem, errors: CvErrors, floors: Mapping[str, float]
) -> dict[str, dict[str, Any]]:
    rmse, bias = errors.rmse(), errors.bias()
    repeats = repeatability(problem.measurements)
    found = {}
    for name in problem.points.channels:
        noise = problem.fitter.repeats.channels[name]
        found[name] = {
            "rows": int(np.isfinite(errors.error[name]).sum()),
            "rmse": rmse[name],
            "bias": bias[name],
            "noise_floor": floors.get(name),
            "noise_floor_source": noise.source if name in floors else None,
            "repeatability": repeats.get(name),
            "noise": {"absolute": noise.absolute, "relative": noise.relative},
        }
    return found


def _document(
    problem: Problem, found: Search, verdict: Verdict, steps: list[Step], seed: int
) -> dict[str, Any]:
    judged = problem.judged
    base = steps[0].errors
    best = verdict.best if verdict.named else found.ordered[0]
    floors = expected_error(judged.fitter, best.fit)
    reasons = list(verdict.reasons)
    scatter = best.fit.scatter.as_dict(judged.fitter.variance)
    document = _document_head(verdict.word, "; ".join(reasons), problem.measurements)
    alone = _alone(judged, found, verdict)
    alike = {} if found.screen is None else written.similar(*found.screen.cosines())
    certain = found.p <= ALARM
    document |= {
        "missing_effects": list(verdict.named),
        "candidates": list(verdict.rivals),
        "unknown": list(verdict.unknown),
        "channels": _channels(problem, base, floors),
        "lack_of_fit": {"p_value": found.p, "probability_of_none": found.probabilities[()]},
        "where_it_fails": [
            written.region_entry(r)
            for r in where_it_fails(judged.points, base, judged.fitter.level, seed, certain=certain)
        ],
        "ranking": written.ranking(found, verdict, alone, base, alike),
        "steps": [{"added": s.added, "held_out_rmse": s.errors.rmse()} for s in steps],
        "run_scatter": scatter,
    }
    left = residuals_left(judged.fitter, best)
    document["residuals_left"] = left
    document["curves"] = curve_shown(judged.fitter, found.ordered[0])
    worst = worst_left(left)
    model = steps[-1].model.fit
    document["notes"] = [
        *problem.result(model.vector, model.theta).notes,
        *problem.measurements.notes,
        *([f"after the best explanation {worst}"] if worst else []),
        *_about_pull(problem, found, steps[-1].errors, seed),
    ]
    return document


def _alone(judged: Problem, found: Search, verdict: Verdict) -> dict[str, CvErrors]:
    """Held-out errors of the most probable families, each alone in its best form."""
    families = sorted(found.field.kinds, key=lambda f: -verdict.probabilities.get(f, 0.0))
    models = {f: written.best_of_family(found, f) for f in families}
    listed = [(f, m) for f, m in models.items() if m is not None][:_LISTED]
    errors = of_model(judged, [m for _, m in listed]) if listed else []
    return {f: e for (f, _), e in zip(listed, errors, strict=True)}


def _about_pull(problem: Problem, found: Search, errors: CvErrors, seed: int) -> list[str]:
    """Whether drawbar pull would say something else of the effects, in words. errors: held out."""
    if problem.judged is problem:
        return []
    with_pull = search(problem.fitter, problem.fit, found.field, seed=seed,
                       budget=Budget(0, 0, 0, 0))  # fmt: skip
    said = "drawbar pull did not decide: its law is known to about 30 % of the load only"
    share = errors.error["drawbar_pull"] / problem.measurements.conditions.load
    off = float(np.sqrt(np.nanmean(share**2)))
    if off > 2.0 * THRUST_LAW:
        said += (
            f". It is off by {100 * off:.0f} % of the load, more than any such law: the two channels "
            "disagree; check its sign, its zero and what else pulls"
        )
    if with_pull.p <= ALARM < found.p:
        first = min(with_pull.p_values, key=lambda f: with_pull.p_values[f])
        said += (
            f". With it something is missing (p {with_pull.p:.2g}, most likely {first}), without it "
            "nothing is: the two channels disagree"
        )
    elif found.p <= ALARM < with_pull.p:
        said += (
            f". With it the test would say that nothing is missing (p {with_pull.p:.2g}): "
            "the two channels disagree"
        )
    return [said]


def _proposals(found: Search, verdict: Verdict, limits: Limits) -> list[Proposal]:
    """Runs that would decide between the best explanation and those that come next."""
    ordered = found.ordered
    first = ordered[0] if verdict.word != "missing_effect" else verdict.best
    pairs: list[tuple[CandidateFit, CandidateFit]] = []
    if verdict.rivals:
        models = [_explained_by(found, verdict, rival) for rival in verdict.rivals]
        known = [m for m in models if m is not None]
        pairs += [(known[0], other) for other in known[1:]]
    pairs += [(first, m) for m in ordered if m.families != first.families][:_MOST_PROPOSALS]
    proposals: list[Proposal] = []
    for one, other in pairs:
        names = _told_apart(one, other)
        if names is None or any(set(p.separates) == set(names) for p in proposals):
            continue
        hints = [c.effect.next_step for m in (one, other) for c in m.competitors
                 if c.family in names and c.effect is not None and c.effect.next_step]  # fmt: skip
        try:
            made = propose(found.fitter, one, other, names, hints[0] if hints else "", limits)
        except (SmallwheelError, ArithmeticError, np.linalg.LinAlgError):
            continue
        if made is not None and made.power > LEAST_POWER:
            proposals.append(made)
    return proposals[:_MOST_PROPOSALS]


def _explained_by(found: Search, verdict: Verdict, rival: str) -> CandidateFit | None:
    """The best model with a rival. One that is only tied was not fitted: it takes the name's place."""
    known = next((m for m in found.ordered if rival in m.families), None)
    named = next((m for m in found.ordered if verdict.rivals[0] in m.families), None)
    if known is not None or named is None:
        return known
    tied = next(c for c in named.competitors if c.family == verdict.rivals[0])
    forms = [c for c in found.field.competitors if c.family == rival]
    made = [exchanged(found, named, tied, form) for form in forms]
    return max((m for m in made if m is not None), key=lambda m: m.weight, default=None)


def _told_apart(one: CandidateFit, other: CandidateFit) -> tuple[str, str] | None:
    """What differs between two models: one name of each, `none` where one has nothing instead."""
    first, second = sorted(one.families - other.families), sorted(other.families - one.families)
    if not first and not second:
        return None
    return (first[0] if first else "none", second[0] if second else "none")
