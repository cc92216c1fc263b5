# SPDX-License-Identifier: Apache-2.0
"""What the page shows, without the page: a table, its diagnosis, and fits with any of the effects."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.diagnosis import Base, Diagnosis, diagnose
from smallwheel_ros.diagnosis.apply import Grown
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.document import failing_settings
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import FitResult, Problem
from smallwheel_ros.fitting.fit import FAILURES
from smallwheel_ros.fitting.held_out import Comparison, CvErrors, compare_cv
from smallwheel_ros.learn.learning import Learnt, learn
from smallwheel_ros.measurements.display import number, shown_value, words
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model.model_file import write_model

Names = tuple[str, ...]
Progress = Callable[[str], None]
Count = Callable[[int, int], None]

_TOLD = 1.0  # deviations by which a number must move to be told of


class ExploreError(SmallwheelError):
    """Something that was asked for and cannot be shown; or a port that cannot be had."""


@dataclass(frozen=True)
class View:
    """A model with some effects. names: those that are set. fit: the model as it is saved.

    before, after: held-out errors of the base model and of this one. change: between them.
    """

    names: Names
    fit: FitResult
    before: CvErrors
    after: CvErrors
    change: Comparison


class Session:
    """One table, its diagnosis, and all that was fitted to it. Not for two threads at once.

    document: what `diagnose` says, on which base and with which errors. forms: of each effect that can
    be set. blocked: why others cannot. present: effects of the base model; chosen: those of them that
    may be unset. settings: those that vary.
    Raises ExploreError where all is of one run.
    """

    def __init__(
        self,
        diagnosis: Diagnosis,
        registry: Registry | None = None,
        without: Collection[str] = (),
    ) -> None:
        self.diagnosis = diagnosis
        self.document = self.diagnosis.document
        self.problem = problem = self.diagnosis.problem
        self.measurements = problem.measurements
        if problem.points.run_count < 2:
            raise ExploreError(
                f"{self.measurements.source or 'the measurements'}: all usable rows are of one run, so "
                "nothing can be held out: measure more runs"
            )
        found, points = self.diagnosis.search, problem.judged.points
        model = problem.judged.vector.model(problem.judged.vector.start)
        known = registry or default_registry()
        field = field_of(points, model, known, without) if found is None else found.field
        self.kinds = {name: kind for name, kind in field.kinds.items() if kind != "unknown"}
        self.blocked = {n: why for n, why in field.blocked.items() if n in self.kinds}
        self.forms = {
            name: [c for c in field.competitors if c.family == name]
            for name in self.kinds
            if name not in self.blocked
        }
        self.present = problem.base.names
        self.chosen = tuple(name for name in self.forms if name in self.present)
        self.settings = tuple(points.varied) or ("load",)
        self._steps = self._diagnosed()
        self._views: dict[Names, View] = {}
        self._problems = {self.chosen: problem}
        self._made: dict[tuple[Names, Names], Grown] = {}
        self.progress = (0, 0)  # fits done and needed of what is being fitted; read from any thread
        self._searched = registry, problem.base, tuple(without)
        self._learnt: Learnt | None = None

    def learnt(self) -> Learnt:
        """What `learn` finds in the table, on the base model; searched for once."""
        if self._learnt is None:
            known, base, without = self._searched
            self._learnt = learn(self.measurements, base, registry=known, without=without)
        return self._learnt

    @classmethod
    def of(
        cls,
        measurements: Measurements,
        base: Base,
        registry: Registry,
        without: Collection[str] = (),
        progress: Progress = lambda step: None,
    ) -> Session:
        """Diagnose a table, and open a session on it.

        Raises FittingError where nothing usable was measured, ExploreError where all is of one run.
        """
        found = diagnose(measurements, base, registry=registry, without=without, progress=progress)
        return cls(found, registry, without)

    @property
    def fitted(self) -> list[Names]:
        """What was fitted until now."""
        return list(self._views)

    def steps(self) -> list[Names]:
        """The base, and each step to the verdict: their fits are the diagnosis's."""
        return list(dict.fromkeys([self.chosen, *self._steps]))

    def beforehand(self, pairs: bool = True) -> list[Names]:
        """The steps to the verdict, each effect alone, and each pair, set or unset."""
        near = [self.chosen, *self._steps]
        for size in (1, 2) if pairs else (1,):
            for some in itertools.combinations(self.forms, size):
                near.append(self.choose(set(self.chosen) ^ set(some)))
        return list(dict.fromkeys(near))

    def fit_beforehand(
        self, progress: Count = lambda done, needed: None, pairs: bool = True
    ) -> list[Names]:
        """Fit all of these; progress: told how many of how many are done. Gives those that could be."""
        wanted, fitted = self.beforehand(pairs), []
        for i, names in enumerate(wanted):
            progress(i, len(wanted))
            try:
                self.view(names)
                fitted.append(names)
            except ExploreError:  # said where somebody asks for it
                continue
        progress(len(wanted), len(wanted))
        return fitted

    def _diagnosed(self) -> dict[Names, int]:
        """Effects of each step of the diagnosis: its fits and errors are shown, not others."""
        found: dict[Names, int] = {}
        # What pull and torque named is in the base that was searched, and not in the first step.
        names = set(self.chosen) - {step.added for step in self.diagnosis.steps}
        for i, step in enumerate(self.diagnosis.steps):
            if step.added is not None:
                if step.added not in self.forms:
                    break
                names.add(step.added)
            found.setdefault(self.choose(names), i)
        return found

    def choose(self, names: Collection[str]) -> Names:
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

    def without_run(self, names: Collection[str], run: str) -> list[str]:
        """What a fit of these effects without one run says, in sentences.

        Raises ExploreError where there is no such run, or the rest cannot be fitted.
        """
        chosen, before = self.choose(names), self.view(names)
        rows = self.measurements.run == run
        if not rows.any():
            raise ExploreError(f"no run '{run}': {nearest(run, list(self.measurements.runs))}")
        kept = tuple(name for name in chosen if name in self.chosen)
        try:
            base = self._problem(kept).base
            problem = Problem.of(self.measurements.take(~rows), base)
            grown = Grown.of(problem.judged)
            for name in chosen:
                if name not in self.chosen:
                    grown = grown.with_effect(problem.judged, self.forms[name])
            fit, errors = problem.result(grown.model), grown.held_out(problem)
        except FAILURES as error:
            raise ExploreError(f"without run '{run}' the fit failed: {error}") from error
        return [*_errors_moved(before, errors, rows), *_numbers_moved(before.fit, fit)]

    def _view(self, names: Names) -> View:
        step = self._steps.get(names)
        if step is not None:
            fit, after = self.diagnosis.fitted(step), self.diagnosis.steps[step].errors
        else:
            kept = tuple(name for name in names if name in self.chosen)
            problem = self._problem(kept)
            grown = self._grown(kept, tuple(name for name in names if name not in self.chosen))
            self.progress = (len(names), 1 + len(names))
            fit = problem.result(grown.model)
            after = grown.held_out(problem)
        before = after if names == self.chosen else self.view(self.chosen).after
        return View(names, fit, before, after, compare_cv(before, after))

    def _grown(self, kept: Names, added: Names) -> Grown:
        """The base with these effects, one after the other: pairs share the fits of their first."""
        if (kept, added) not in self._made:
            judged = self._problem(kept).judged
            if added:
                before = self._grown(kept, added[:-1])
                self.progress = (len(added) - 1, 1 + len(added))
                self._made[kept, added] = before.with_effect(judged, self.forms[added[-1]])
            else:
                self._made[kept, added] = Grown.of(judged)
        return self._made[kept, added]

    def _problem(self, kept: Names) -> Problem:
        """The problem of a base model that keeps these of the effects that may be unset."""
        if kept not in self._problems:
            gone, base = set(self.chosen) - set(kept), self.problem.base
            parts = tuple(part for part in base.parts if part.id not in gone)
            effects = tuple(e for e in base.effects if e.id not in gone)
            self._problems[kept] = replace(
                self.problem, base=replace(base, parts=parts, effects=effects)
            )
        return self._problems[kept]


def _errors_moved(before: View, without: CvErrors, gone: NDArray[np.bool_]) -> list[str]:
    """Held-out error of the other runs, by fits with and without one run."""
    lines = []
    for channel in without.error:
        first, then = before.after.score(channel, ~gone), without.score(channel)
        if first is not None and then is not None:
            lines.append(
                f"Held-out error of {words(channel)}, other runs: {shown_value(channel, first.rmse)} "
                f"with it, {shown_value(channel, then.rmse)} without."
            )
    return lines


def _numbers_moved(before: FitResult, without: FitResult) -> list[str]:
    """Numbers that a fit without one run moves by over a standard deviation."""
    then = {p.full_name: p for p in without.parameters}
    moved = [
        f"{p.full_name}: {number(p.value)} with it, {number(then[p.full_name].value)} without."
        for p in before.parameters
        if p.std and p.full_name in then and abs(then[p.full_name].value - p.value) > _TOLD * p.std
    ]
    return moved or ["No fitted number moves by more than its standard deviation."]
