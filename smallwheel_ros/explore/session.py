"""What the page shows, without the page: a table, its diagnosis, and fits with any of the effects."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

from smallwheel_ros.diagnosis import Base, diagnose
from smallwheel_ros.diagnosis.apply import held_out_with, with_effects
from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.held_out import with_pull
from smallwheel_ros.effects.registry import Registry
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting import FitResult, Problem
from smallwheel_ros.fitting.held_out import Comparison, CvErrors, compare_cv
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model_file import write_model
from smallwheel_ros.physics.soil import nearest
from smallwheel_ros.report.residual_picture import failing_settings

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
        self.present = base.names
        self.chosen = tuple(name for name in self.forms if name in self.present)
        self.settings = tuple(points.varied) or ("load",)
        self._steps = self._diagnosed()
        self._views: dict[tuple[str, ...], View] = {}
        self._problems = {self.chosen: problem}

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
            failing = failing_settings(self.document, self.problem.points.settings)
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
            except FAILURES as error:
                what = f"with {', '.join(chosen)}" if chosen else "of the base model"
                raise ExploreError(f"the fit {what} failed: {error}") from error
        return self._views[chosen]

    def model_file(self, names: Collection[str]) -> bytes:
        """The model with these effects as a model file."""
        view = self.view(names)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "model.yaml")
            write_model(path, replace(view.fit, held_out=view.after.rmse()).model)
            return path.read_bytes()

    def _view(self, names: tuple[str, ...]) -> View:
        step = self._steps.get(names)
        if step is not None:
            fit, after = self.diagnosis.fitted(step), self.diagnosis.steps[step].errors
        else:
            problem = self._problem(tuple(name for name in names if name in self.chosen))
            added = [self.forms[name] for name in names if name not in self.chosen]
            model, forms = with_effects(problem.judged, added)
            fit = problem.result(model.fit)
            after = with_pull(problem, [model], held_out_with(problem.judged, forms)[1:])[0]
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
