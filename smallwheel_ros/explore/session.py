"""What the page shows, without the page: a table, the effects that it can test, and fits with any of them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smallwheel_ros.compare.scores import drivers
from smallwheel_ros.diagnosis.apply import base_physics, without_corrections
from smallwheel_ros.diagnosis.candidates import Family, list_families, measured_forces
from smallwheel_ros.diagnosis.held_out import Errors, better, noise_floor, refitted
from smallwheel_ros.diagnosis.search import best_form, cost, plausible
from smallwheel_ros.diagnosis.table import Lead, look
from smallwheel_ros.diagnosis.workbench import Base, Explanation, Workbench
from smallwheel_ros.effects.registry import Registry
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting.calibrate import calibrate
from smallwheel_ros.fitting.files import calibrated
from smallwheel_ros.fitting.observations import observe
from smallwheel_ros.fitting.result import FitResult, result_of
from smallwheel_ros.measurements.noise_floor import repeatability
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model_file import write_model
from smallwheel_ros.physics.soil import nearest

CLEAR = 10.0  # gain of -2 log likelihood that chance rarely makes
_FAILURES = (SmallwheelError, ArithmeticError, ValueError, np.linalg.LinAlgError)  # of a fit
_MOST_FOR_FLOOR = 3  # effects that are added to find the noise floor

Progress = Callable[[str], None]


class ExploreError(SmallwheelError):
    """Something that was asked for and cannot be shown; or a port that cannot be had."""


@dataclass(frozen=True)
class View:
    """The model with some effects. before, after: held-out errors without any and with them.

    fit: the model as it is saved. floor: held-out error that the true model would leave, m or N, of
    the channels of which it is known.
    fall, sigmas: of the error, relative and over its standard error. worth: what each effect that is
    set takes off -2 log likelihood, and what each other one would. implausible: effects whose
    strength is at a bound or outside the published range.
    """

    names: tuple[str, ...]
    explanation: Explanation
    fit: FitResult
    before: Errors
    after: Errors
    floor: dict[str, float]
    fall: float
    sigmas: float
    worth: dict[str, float]
    implausible: tuple[str, ...]


class Session:
    """One table and everything that was fitted to it. Not to be used by two threads at once.

    families: every effect by name, with the reason where it cannot be tested. present: those that
    stay in the model. chosen: those to begin with. runs: how many have usable rows. drivers: settings
    that vary. floor_with: effects that were in the model from which the noise floor is known.
    Raises FittingError where nothing usable was measured, ExploreError where all is of one run.
    """

    def __init__(
        self,
        measurements: Measurements,
        base: Base,
        registry: Registry,
        progress: Progress = lambda step: None,
    ) -> None:
        self.measurements = measurements
        base = base_physics(base, measurements, registry)
        observations = observe(measurements)
        self.runs = int(np.unique(observations.run).size)
        if self.runs < 2:
            raise ExploreError(
                f"{measurements.source or 'the measurements'}: all usable rows are of one run, so "
                "nothing can be held out: measure more runs"
            )
        responses = measured_forces(measurements.units)
        families = list_families(observations, (), base.geometry, registry, responses)
        testable = [f.name for f in families if not f.blocked]
        # What the model file has and this data can test may be unset; the rest stays as it is.
        self.chosen = tuple(e.id for e in base.effects if e.id in testable)
        base = replace(base, effects=tuple(e for e in base.effects if e.id not in testable))
        self.present = tuple(e.id for e in base.effects)
        self.families: dict[str, Family] = {f.name: f for f in families}
        progress("fitting the base model")
        self.workbench = Workbench(calibrate(observations, base.layout(observations)), base)
        self.drivers = tuple(drivers(measurements)) or ("load",)
        self.repeats = repeatability(measurements)
        progress("finding the noise floor")
        self._views: dict[tuple[str, ...], View] = {}
        self._fullest = self._best_of_few()
        self.floor_with = self._fullest.families

    def choose(self, names: Sequence[str]) -> tuple[str, ...]:
        """The names in the library's order. Raises ExploreError for one that cannot be fitted."""
        for name in names:
            if name not in self.families:
                raise ExploreError(f"no effect '{name}': {nearest(name, list(self.families))}")
            if self.families[name].blocked:
                raise ExploreError(
                    f"effect '{name}' cannot be fitted to this data: {self.families[name].blocked}"
                )
        return tuple(name for name in self.families if name in names)

    def covariate(self, name: str | None) -> str:
        """The setting of that name. Raises ExploreError where it is none, or does not vary."""
        if name is None:
            first = next((lead.family for lead in self._leads(self.workbench.fit(()))), None)
            follows = self.families[first].drivers if first else ()
            return next((d for d in follows if d in self.drivers), self.drivers[0])
        if name not in self.drivers:
            raise ExploreError(
                f"no covariate '{name}' that varies: {nearest(name, list(self.drivers))}"
            )
        return name

    def view(self, names: Sequence[str]) -> View:
        """Fit the model with these effects. Raises ExploreError where that is not possible."""
        chosen = self.choose(names)
        if chosen not in self._views:
            try:
                self._views[chosen] = self._view(chosen)
            except _FAILURES as error:
                what = (
                    f"the fit with {', '.join(chosen)}" if chosen else "the fit of the base model"
                )
                raise ExploreError(f"{what} failed: {error}") from error
        return self._views[chosen]

    def model_file(self, names: Sequence[str]) -> bytes:
        """The model with these effects as a model file."""
        view = self.view(names)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "model.yaml")
            write_model(path, calibrated(view.fit, self.measurements, view.after.rmse()))
            return path.read_bytes()

    def _view(self, names: tuple[str, ...]) -> View:
        explanation = self._explain(names)
        after = refitted(self.workbench, explanation)
        before = self.view(()).after if names else after
        fall, sigmas = better(before, after) if names else (0.0, 0.0)
        known = min(self._fullest, explanation, key=cost)
        fit = without_corrections(self.workbench.calibration.observations, explanation)
        return View(
            names,
            explanation,
            result_of(fit),
            before,
            after,
            self._floor(known),
            fall,
            sigmas,
            self._worth(explanation, names),
            tuple(name for name in names if not plausible(explanation, name)),
        )

    def _explain(self, names: tuple[str, ...]) -> Explanation:
        # Always from the base and in one order: what was looked at before must not matter.
        explanation = self.workbench.fit(())
        for name in names:
            form = self.families[name].forms[0]
            explanation = self.workbench.fit((*explanation.forms, form), near=explanation)
            explanation = best_form(self.workbench, explanation, self.families[name])
        for name in names[:-1]:
            explanation = best_form(self.workbench, explanation, self.families[name])
        return explanation

    def _floor(self, explanation: Explanation) -> dict[str, float]:
        """By channel; none where the noise is only what a fit leaves: misfit would pass for it."""
        noise = self.workbench.calibration.noise.channels
        return {
            name: floor
            for name, floor in noise_floor(self.workbench, explanation).items()
            if noise[name].source in ("repeats", "declared")
        }

    def _worth(self, explanation: Explanation, names: tuple[str, ...]) -> dict[str, float]:
        worth = {lead.family: lead.gain for lead in self._leads(explanation)}
        for name in names:
            without = self._explain(tuple(other for other in names if other != name))
            worth[name] = max(0.0, cost(without) - cost(explanation))
        return worth

    def _leads(self, explanation: Explanation) -> tuple[Lead, ...]:
        rest = [
            family
            for name, family in self.families.items()
            if not family.blocked and name not in explanation.families
        ]
        return look(self.workbench, explanation, rest, draws=0, seed=0).leads if rest else ()

    def _best_of_few(self) -> Explanation:
        """The model with what gains most, one effect after the other: what it leaves is noise.

        Seen from a model that lacks an effect, its misfit would pass for scatter of the soil.
        """
        explanation = self.workbench.fit(())
        for _ in range(_MOST_FOR_FLOOR):
            lead = next(iter(self._leads(explanation)), None)
            if lead is None or lead.gain < CLEAR:
                break
            start = {lead.family: lead.strength}
            try:
                further = self.workbench.fit((*explanation.forms, lead.form), explanation, start)
            except _FAILURES:  # said when it is asked for
                break
            if cost(further) > cost(explanation) - CLEAR:
                break
            explanation = further
        return explanation
