"""What the page shows, without the page: a table, its diagnosis, and fits with any of the effects."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis import Base, diagnose
from smallwheel_ros.diagnosis.competitors import Competitor, field_of, settings_of, varied
from smallwheel_ros.diagnosis.held_out import of_model
from smallwheel_ros.diagnosis.problem import Problem
from smallwheel_ros.diagnosis.search import CandidateFit, refit
from smallwheel_ros.effects.registry import Registry
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.fitting.constants import WINDOW
from smallwheel_ros.fitting.files import calibrated
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import Comparison, CvErrors, compare_cv, cross_validate
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Model
from smallwheel_ros.model_file import write_model
from smallwheel_ros.physics.soil import nearest
from smallwheel_ros.report.residual_picture import failing_settings

_FAILURES = (SmallwheelError, ArithmeticError, ValueError, np.linalg.LinAlgError)  # of a fit

Forms = Sequence[tuple[Competitor, NDArray[np.float64]]]  # each with where its numbers start
Progress = Callable[[str], None]


class ExploreError(SmallwheelError):
    """Something that was asked for and cannot be shown; or a port that cannot be had."""


@dataclass(frozen=True)
class View:
    """A model with some effects. names: those that are set. fit: the model as it is saved.

    before, after: held-out errors of the base model and of this one. change: between them.
    """

    names: tuple[str, ...]
    fit: FitResult
    before: CvErrors
    after: CvErrors
    change: Comparison


class Session:
    """One table, its diagnosis, and all that was fitted to it. Not for two threads at once.

    document: what `diagnose` says, on which base and with which errors. forms: of each effect that can
    be set. blocked: why others cannot. present: effects of the base model; chosen: those of them that
    may be unset. settings: those that vary.
    Raises FittingError where nothing usable was measured, ExploreError where all is of one run.
    """

    def __init__(
        self,
        measurements: Measurements,
        base: Base,
        registry: Registry,
        without: Collection[str] = (),
        progress: Progress = lambda step: None,
    ) -> None:
        self.diagnosis = diagnose(
            measurements, base, registry=registry, without=without, progress=progress
        )
        self.document = self.diagnosis.document
        self.problem = problem = self.diagnosis.problem
        self.measurements = problem.measurements
        if problem.points.run_count < 2:
            raise ExploreError(
                f"{measurements.source or 'the measurements'}: all usable rows are of one run, so "
                "nothing can be held out: measure more runs"
            )
        found, points = self.diagnosis.search, problem.judged.points
        model = problem.judged.vector.model(problem.judged.vector.start)
        field = field_of(points, model, registry, without) if found is None else found.field
        self.kinds = {name: kind for name, kind in field.kinds.items() if kind != "unknown"}
        self.blocked = {n: why for n, why in field.blocked.items() if n in self.kinds}
        self.forms = {
            name: [c for c in field.competitors if c.family == name]
            for name in self.kinds
            if name not in self.blocked
        }
        self.present = tuple(e.id for e in base.effects)
        self.chosen = tuple(name for name in self.forms if name in self.present)
        self.settings = tuple(varied(points)) or ("load",)
        self._steps = self._diagnosed()
        self._views: dict[tuple[str, ...], View] = {}
        self._problems = {self.chosen: problem}
        self._fold_fits: dict[tuple[int, bytes], tuple[Fitter, Fit]] = {}

    def _diagnosed(self) -> dict[tuple[str, ...], int]:
        """Effects of each step of the diagnosis: its fits and errors are shown, not others."""
        found: dict[tuple[str, ...], int] = {}
        names = set(self.chosen)
        for i, step in enumerate(self.diagnosis.steps):
            if step.added is not None:
                if step.added not in self.forms:
                    break
                names.add(step.added)
            found.setdefault(self.choose(names), i)
        return found

    def choose(self, names: Collection[str]) -> tuple[str, ...]:
        """The names in the library's order. Raises ExploreError for one that cannot be fitted."""
        for name in names:
            if name not in self.kinds:
                raise ExploreError(f"no effect '{name}': {nearest(name, list(self.kinds))}")
            if name in self.blocked:
                raise ExploreError(
                    f"effect '{name}' cannot be fitted to this data: {self.blocked[name]}"
                )
        return tuple(name for name in self.forms if name in names)

    def setting(self, name: str | None) -> str:
        """The setting of that name; for None the one over which the base model fails most.

        Raises ExploreError where it is none, or does not vary.
        """
        if name is None:
            failing = failing_settings(self.document, settings_of(self.problem.points))
            return next((s for _, s in failing if s in self.settings), self.settings[0])
        if name not in self.settings:
            raise ExploreError(
                f"no setting '{name}' that varies: {nearest(name, list(self.settings))}"
            )
        return name

    def view(self, names: Collection[str]) -> View:
        """Fit the model with these effects. Raises ExploreError where that is not possible."""
        chosen = self.choose(names)
        if chosen not in self._views:
            try:
                self._views[chosen] = self._view(chosen)
            except _FAILURES as error:
                what = f"with {', '.join(chosen)}" if chosen else "of the base model"
                raise ExploreError(f"the fit {what} failed: {error}") from error
        return self._views[chosen]

    def model_file(self, names: Collection[str]) -> bytes:
        """The model with these effects as a model file."""
        view = self.view(names)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "model.yaml")
            write_model(path, calibrated(view.fit, self.measurements, view.after.rmse()))
            return path.read_bytes()

    def _view(self, names: tuple[str, ...]) -> View:
        step = self._steps.get(names)
        if step is not None:
            fit, after = self.diagnosis.fitted(step), self.diagnosis.steps[step].errors
        else:
            problem = self._problem(tuple(name for name in names if name in self.chosen))
            model, forms = self._fitted(problem.judged, [n for n in names if n not in self.chosen])
            fit = problem.result(model.fit.vector, model.fit.theta)
            after = self._held_out(problem, model, forms)
        before = after if names == self.chosen else self.view(self.chosen).after
        return View(names, fit, before, after, compare_cv(before, after))

    def _problem(self, kept: tuple[str, ...]) -> Problem:
        """The problem of a base model that keeps these of the effects that may be unset."""
        if kept not in self._problems:
            gone, base = set(self.chosen) - set(kept), self.problem.base
            parts = tuple(part for part in base.parts if part.id not in gone)
            effects = tuple(e for e in base.effects if e.id not in gone)
            self._problems[kept] = replace(
                self.problem, base=replace(base, parts=parts, effects=effects)
            )
        return self._problems[kept]

    def _fitted(self, judged: Problem, names: Sequence[str]) -> tuple[CandidateFit, list[Forms]]:
        """The base with these effects, one after the other, each in the form of the most evidence.

        Always from the base and in one order: what was looked at before must not matter. And, by
        effect, the forms within `WINDOW` of the best, from which each fold chooses.
        """
        model = CandidateFit((), judged.fit, judged.fit.evidence)
        near: list[Forms] = []
        for name in names:
            forms = [(c, np.array([v for _, v, *_ in c.part.parameters])) for c in self.forms[name]]
            made = _extended(judged.fitter, model, forms, 4)
            if not made:
                raise ExploreError(f"effect '{name}' cannot be fitted to this data")
            model = made[0]
            close = [m for m in made if m.weight > model.weight - WINDOW]
            near.append([(m.competitors[-1], _numbers(m)) for m in close])
        return model, near

    def _held_out(self, problem: Problem, model: CandidateFit, forms: list[Forms]) -> CvErrors:
        """Held-out errors, the form of each effect chosen anew in each fold."""
        judged = problem.judged

        def choose(training: Points) -> list[Model]:
            fitter, base = self._fold(judged, training)
            best = CandidateFit((), base, base.evidence)
            for of_effect in forms:
                best = next(iter(_extended(fitter, best, of_effect, 1)), best)
            return [best.fit.vector.model(best.fit.theta)]

        errors = cross_validate(judged.points, choose, 1)[0]
        if judged is problem:
            return errors
        # Drawbar pull has no say in the choice of forms.
        vector = problem.own(model.fit.vector)
        known = dict(zip(model.fit.vector.names, model.fit.theta, strict=True))
        start = np.array([known.get(p.name, p.start) for p in vector.free])
        full = problem.fitter.fit(vector, start, problem.fit.scatter)
        pull = of_model(problem, [replace(model, fit=full)])[0].error["drawbar_pull"]
        return replace(errors, error={**errors.error, "drawbar_pull": pull})

    def _fold(self, judged: Problem, training: Points) -> tuple[Fitter, Fit]:
        """The base fitted to a fold's training points; kept, since each view begins with it."""
        runs = np.unique(training.run)
        key = (id(judged), runs.tobytes())
        if key not in self._fold_fits:
            fitter = judged.fitter.of_runs(training)
            vector, known = judged.base.vector(fitter.points), judged.fit
            start = known.theta if vector.names == known.vector.names else None
            self._fold_fits[key] = fitter, fitter.fit(vector, start, known.scatter, turns=2)
        return self._fold_fits[key]


def _extended(fitter: Fitter, model: CandidateFit, forms: Forms, turns: int) -> list[CandidateFit]:
    """The model with one more effect in each of these forms that can be fitted, the best first."""
    made = [refit(fitter, model, form, start, turns) for form, start in forms]
    return sorted((m for m in made if m is not None), key=lambda m: -m.weight)


def _numbers(model: CandidateFit) -> NDArray[np.float64]:
    """The fitted numbers of the effect that was added last."""
    owner, fit = model.competitors[-1].part.id, model.fit
    mine = [j for j, p in enumerate(fit.vector.free) if p.of_effect and p.owner == owner]
    return fit.theta[mine]
