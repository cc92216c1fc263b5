# SPDX-License-Identifier: Apache-2.0
"""Add one effect to a model, and say what that does to the held-out error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.result import Result, Writer
from smallwheel_ros.common.tables import plain
from smallwheel_ros.diagnosis.competitors import SETTINGS, Competitor, changed, field_of
from smallwheel_ros.diagnosis.held_out import Choose, errors_of, kept
from smallwheel_ros.diagnosis.pipeline import Diagnosis, Start, diagnosis_of
from smallwheel_ros.diagnosis.search import Candidate, refit
from smallwheel_ros.effects.base import Effect, EffectError
from smallwheel_ros.effects.registry import Registry, is_of_column
from smallwheel_ros.fitting import FitResult, Problem
from smallwheel_ros.fitting.constants import WINDOW
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors, ErrorComparison, compare_cv
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, TEXTS
from smallwheel_ros.measurements.display import probability_text, shown_value, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.given import AnyEffect, effects_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from smallwheel_ros.model.model import CalibratedModel


@dataclass(frozen=True, repr=False)
class Added(Result, shown="views.added"):
    """A model with one more effect, and what the effect changes.

    Attributes
    ----------
    effect, form
        Id of the effect, and its form: the one asked for, or else the one that fits best.
    fit
        The model with the effect, fitted to all runs.
    before, after
        Held-out errors without and with the effect.
    change
        Their comparison.
    recommended
        Whether the diagnosis of the same data names the effect, and no channel is predicted worse.
    reason
        Why it is not recommended, or a reservation where it is; may be empty.
    """

    effect: str
    form: str
    fit: FitResult
    before: CvErrors
    after: CvErrors
    change: ErrorComparison
    recommended: bool
    reason: str

    @property
    def model(self) -> CalibratedModel:
        """The model with the effect in it."""
        return self.fit.model

    def headline(self) -> str:
        """The held-out error before and after, in one line."""
        after = self.after.rmse()
        errors = ", ".join(
            f"{words(name)} {shown_value(name, before)} -> {shown_value(name, after.get(name))}"
            for name, before in self.before.rmse().items()
        )
        return f"{words(self.effect)} ({self.form}), held-out error {errors}"

    def to_dict(self) -> dict[str, Any]:
        """The result as plain values, as in the JSON of `smallwheel add`."""
        document = {
            "schema": 1,
            "effect": self.effect,
            "form": self.form,
            "recommended": self.recommended,
            "reason": self.reason,
            "before": {"held_out_rmse": self.before.rmse(), "std": self.before.rmse_std()},
            "after": {"held_out_rmse": self.after.rmse(), "std": self.after.rmse_std()},
            "reduction": dict(self.change.reduction),
            "z_score": dict(self.change.z_score),
            "fit": self.fit.to_dict(),
        }
        return dict(plain(document))

    def rows(self) -> list[dict[str, Any]]:
        """One row for each channel: held-out errors before and after, with standard errors, SI."""
        sides = {"before": self.before.scores(), "after": self.after.scores()}
        found = []
        for name in sides["before"]:
            row: dict[str, Any] = {"channel": name, "unit": CHANNEL_UNITS[name]}
            for when, scores in sides.items():
                score = scores.get(name)
                row[when] = None if score is None else score.rmse
                row[f"{when}_std"] = None if score is None else score.rmse_std
            found.append(row)
        return found

    def plot(self, ax: Axes | None = None, channel: str | None = None) -> Axes:
        """Draw the held-out error before and after.

        Parameters
        ----------
        ax
            Axes to draw on; new ones if not given.
        channel
            Channel to draw; the first one if not given.

        Returns
        -------
        matplotlib.axes.Axes
            The axes drawn on.
        """
        return self._drawn(ax, channel)

    def _writers(self) -> dict[str, Writer]:
        return super()._writers() | self.model._writers()


def added(wanted: AnyEffect, start: Start) -> Added:
    """Add one effect to a model, and fit all parameters again.

    The same data is also diagnosed, to judge whether the effect is recommended.

    Parameters
    ----------
    wanted
        Id of the effect, of which the form that fits best is taken; or one form of it: id/form, a class, or
        an effect, with numbers to start from.
    start
        Measurements, base model and effects.

    Returns
    -------
    Added
        The fitted model, and held-out errors without and with the effect.

    Raises
    ------
    EffectError
        If there is no such effect, or it cannot be fitted to this data.
    FittingError
        If nothing usable was measured.
    """
    measurements = start.measurements
    effect = wanted.partition("/")[0] if isinstance(wanted, str) else wanted.id
    _check_column(effect, measurements, start.registry)
    asked = None
    if wanted != effect:
        (asked,) = effects_of(wanted, measurements.conditions, start.registry)
        start = replace(start, registry=_with_class_of(asked, start.registry))
    forms = _forms_of(effect, Problem.of(measurements, start.base), start.registry, asked)
    judged = diagnosis_of(start)
    problem = judged.problem
    model, before, after = _step(effect, judged, forms, whole=asked is None)
    change = compare_cv(before, after)
    recommended, reason = _recommended(effect, judged, change)
    named = model.competitors if isinstance(model, Candidate) else ()
    form = next((c for c in named if c.family == effect), forms[0])
    return Added(
        effect,
        form.geometry or form.form,
        replace(problem.result(model), held_out=after.rmse()),
        before,
        after,
        change,
        recommended,
        reason,
    )


def _step(
    effect: str, judged: Diagnosis, forms: Sequence[Competitor], *, whole: bool
) -> tuple[Fit, CvErrors, CvErrors]:
    """Return the model with the effect, and the held-out errors without and with it.

    Where the diagnosis adds the effect to the base as its first step, these are that step's, so that both
    commands report the same error. whole: `forms` are all forms of the effect, as in the diagnosis.
    """
    if whole and len(judged.steps) > 1 and judged.steps[1].added == effect:
        first, second = judged.steps[:2]
        return second.model, first.errors, second.errors
    problem, deciding = judged.problem, judged.problem.judged
    base = Grown.of(deciding)
    grown = base.with_effect(deciding, forms)
    return grown.model, base.held_out(problem), grown.held_out(problem)


def _check_column(effect: str, measurements: Measurements, registry: Registry) -> None:
    """Refuse an effect `covariate:NAME` whose NAME is not a free column of the table, and say what to do.

    Any other effect passes. Raises EffectError.
    """
    kind, _, name = effect.partition(":")
    covariates = measurements.conditions.covariates
    free = [column for column in covariates if column not in SETTINGS]
    if kind != "covariate" or not name or name in free:
        return
    if name in ("load", "diameter", "width", *covariates):
        follow = [family for family, forms in registry.families.items()
                  if any(name in form.drivers for form in forms)]  # fmt: skip
        known = f" ({', '.join(follow)})" if follow else ""
        why = (
            f"'{name}' is a known setting, and those have effects of their own{known}: add one of "
            f"them; `smallwheel fit --effects {effect}` fits a free law of it all the same"
        )
    elif name in measurements.channels:
        why = f"'{name}' is a measured quantity, no setting"
    elif name in measurements.labels or name in TEXTS:
        why = f"'{name}' is text, expected a column of numbers"
    else:
        there = nearest(name, free) if free else "only the known settings are there"
        why = f"the table has no column '{name}' of numbers: {there}"
    raise EffectError(f"effect '{effect}' cannot be added: {why}")


def _with_class_of(effect: Effect, registry: Registry) -> Registry:
    """A registry with the effect's class, if it has no form of that name."""
    forms = registry.family(effect.id) if effect.id in registry or is_of_column(effect.id) else ()
    if effect.form in {kind.form for kind in forms}:
        return registry
    return registry.with_families({effect.id: (type(effect),)})


def _forms_of(
    effect: str, problem: Problem, registry: Registry, asked: Effect | None
) -> list[Competitor]:
    """The forms of an effect that can be fitted to this data, or the one asked for, from its numbers on.

    Raises EffectError where none can.
    """
    registry.family(effect)  # says what exists where there is none
    field = field_of(problem.points, problem.vector.model(problem.vector.start), registry)
    found = [c for c in field.competitors if c.family == effect]
    if not found:
        reason = field.blocked.get(effect, "its column is not there")
        raise EffectError(f"effect '{effect}' cannot be fitted to this data: {reason}")
    if asked is None:
        return found
    one = next((c for c in found if c.form == asked.form), None)
    if one is None:
        reason = asked.objection(problem.points.conditions) or "it does not act on it"
        others = ", ".join(c.form for c in found)
        raise EffectError(
            f"effect '{effect}/{asked.form}' cannot be fitted to this data: {reason} (these can: {others})"
        )
    priors = {p.field: p.prior for p in one.part.parameters}
    return [replace(one, effect=asked, part=part_of(asked, priors, one.part.replaces))]


@dataclass(frozen=True)
class Grown:
    """A base model to which effects are added one by one, each in the form of largest evidence.

    Attributes
    ----------
    model
        The model, fitted to all runs.
    choose
        Function that fits the model to the training points of one fold of a cross-validation, choosing the
        forms of its effects again; it returns a list of one fit.
    """

    model: Candidate
    choose: Choose

    @classmethod
    def of(cls, problem: Problem) -> Grown:
        """Fit the base model, without any added effect."""
        return cls(
            Candidate.of(problem.fit),
            kept(lambda training: [Candidate.of(problem.fold(training)[1])]),
        )

    def with_effect(self, problem: Problem, forms: Sequence[Competitor]) -> Grown:
        """Add one more effect; each fold chooses among the forms within `WINDOW` nats of the best.

        Parameters
        ----------
        problem
            The table and the base model.
        forms
            Forms of the effect.

        Returns
        -------
        Grown
            The model with the effect.

        Raises
        ------
        EffectError
            If it cannot be fitted.
        """
        fitter = problem.fitter
        made = _extended(fitter, self.model, [(form, form.part.start) for form in forms], 4)
        if not made:
            fit, said = self.model, f"effect '{forms[0].family}' cannot be fitted to this data"
            vector = changed(fit.vector, forms[0])
            try:
                fitter.predictor.with_slopes(vector, vector.begun_at(fit.vector, fit.theta))
            except FAILURES as error:
                raise EffectError(f"{said}: {error}") from error
            raise EffectError(said)
        close = [m for m in made if m.weight > made[0].weight - WINDOW]
        near = [
            (form, m.theta[m.vector.places(form.part.id)])
            for m in close
            for form in m.competitors[-1:]
        ]

        def choose(training: Points) -> Sequence[Fit]:
            (fold,) = self.choose(training)
            assert isinstance(fold, Candidate)  # as `of` and this make them
            return [*_extended(problem.fold(training)[0], fold, near, 1), fold][:1]

        return Grown(made[0], kept(choose))

    def held_out(self, problem: Problem) -> CvErrors:
        """Compute the held-out errors of the model for all channels of a problem (`errors_of`)."""
        return errors_of(problem, self.choose, 1)[0]


def _extended(
    fitter: Fitter,
    model: Candidate,
    forms: Sequence[tuple[Competitor, NDArray[np.float64]]],
    turns: int,
) -> list[Candidate]:
    """Fit the model with one more effect, for each form that can be fitted, and return these, best first.

    Each entry of `forms` has a form and the values from which its parameters start.
    """
    made = [refit(fitter, model, form, start, turns=turns) for form, start in forms]
    return sorted((m for m in made if m is not None), key=lambda m: -m.weight)


def _recommended(effect: str, judged: Diagnosis, change: ErrorComparison) -> tuple[bool, str]:
    """Return whether the effect is recommended, and why: what is recommended is what the diagnosis names."""
    document, found = judged.document, judged.search
    if found is None:
        return False, f"{document['reason']}; not recommended"
    if effect in document["missing_effects"]:
        if change.worse:
            rises = " and ".join(change.worse)
            return False, f"named, but the held-out error of {rises} rises; not recommended alone"
        learnt = effect in found.field.learnt_from(judged.measurements)
        why = "named, but it was learnt from this very data: other data must judge it"
        return True, why if learnt else ""
    if effect in document["candidates"]:
        others = ", ".join(c for c in document["candidates"] if c != effect)
        said = f"cannot tell it from {others}" if others else "does not confirm it"
        return False, f"this data {said}; not recommended until other data can"
    row: dict[str, Any] = next((r for r in document["ranking"] if r["effect"] == effect), {})
    chance = probability_text(row.get("probability") or 0.0)
    if document["missing_effects"]:
        named = ", ".join(document["missing_effects"])
        return False, f"the data favours {named} (this one {chance}); not recommended"
    p = document["lack_of_fit"]["p_value"]
    tested = "" if p is None else f", p {p:.2g}"
    return False, f"probability {chance}{tested}; not recommended"
