# SPDX-License-Identifier: Apache-2.0
"""The diagnosis from measurements to document; each step is in a module of its own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.arguments import Ids, Levels, unheard
from smallwheel_ros.common.result import Result, Writer
from smallwheel_ros.common.threads import one_thread
from smallwheel_ros.diagnosis import document as written
from smallwheel_ros.diagnosis.bad_runs import BadRun, bad_runs, most_bad
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.faults import gauge_fault
from smallwheel_ros.diagnosis.held_out import Step, held_out
from smallwheel_ros.diagnosis.misfit import misfit_of
from smallwheel_ros.diagnosis.next_measurement import Limits, proposals
from smallwheel_ros.diagnosis.own_zeros import evened
from smallwheel_ros.diagnosis.posterior import Posterior, Word, posterior_of
from smallwheel_ros.diagnosis.search import Search, search
from smallwheel_ros.diagnosis.text import verdict_sentences
from smallwheel_ros.diagnosis.verdict import Evidence, Verdict, decide
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.constants import FEWEST_RUNS, TIE
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.problem import base_of
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.typed import limits_of
from smallwheel_ros.model.given import AnyModel, OwnEffects, ids_of, model_of, registry_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from smallwheel_ros.model.model import CalibratedModel

Progress = Callable[[str], object]


@dataclass(frozen=True)
class Start:
    """What a diagnosis starts from: a table, the model to fit to it, and the effects that may be missing.

    Attributes
    ----------
    measurements
        The table of measurements.
    base
        The model to fit, in which effects may be missing.
    registry
        All effects, of which those not in `without` compete.
    without
        Ids of effects that do not compete; `unknown` stands for the curves of effects in no library.
    limits
        Levels that the user can set in further measurements, SI, by setting.
    seed
        Seed of the simulations in `diagnose`, of permutations and folds in `learn`.
    """

    measurements: Measurements
    base: Base = field(default_factory=Base)
    registry: Registry = field(default_factory=default_registry)
    without: tuple[str, ...] = ()
    limits: Limits = field(default_factory=dict)
    seed: int = 0


def start_of(
    measurements: Measurements,
    model: AnyModel | Base | None = None,
    effects: OwnEffects | None = None,
    without: Ids = (),
    can: Levels | None = None,
    seed: int = 0,
) -> Start:
    """Prepare a diagnosis from what users give; see `api.diagnose`.

    From a vehicle's table, constant differences between the sinkages of its wheels are removed
    (`own_zeros`).

    Parameters
    ----------
    measurements
        The table of measurements.
    model
        Model, model file, soil or `Base`; the contact integral without effects if not given.
    effects
        The user's own effects: a Python file, or a registry.
    without
        Ids of effects that do not compete.
    can
        Levels that the user can set in further measurements, by setting, as numbers in SI units or as text.
    seed
        Seed of the random numbers.

    Returns
    -------
    Start
        With the model's soils under the priors of its covariance.

    Raises
    ------
    ArgumentError, EffectError, ModelFileError
        If model, effects or levels cannot be used.
    """
    known = registry_of(effects)
    base = Base() if model is None else model
    if not isinstance(base, Base):
        base = base_of(model_of(base, known), measurements)
    out = ids_of(without, known)
    measurements = evened(measurements)
    return Start(measurements, base, known, out, limits_of(can, measurements), seed)


@dataclass(frozen=True, repr=False)
class Diagnosis(Result, shown="views.diagnosis"):
    """Result of a diagnosis: the verdict and the evidence.

    Attributes
    ----------
    document
        The content of the JSON, computed from all the rest.
    problem
        The table without bad runs, and the base model.
    evidence, decision
        The evidence, and the verdict with its reasons; None if the data is insufficient.
    search, steps
        The models that were compared, and those on the way to the verdict; None and empty if the data is
        insufficient.
    following
        Commands that continue from this result, as `diagnosis.text` takes them; None if it was made in
        Python.
    """

    document: dict[str, Any]
    problem: Problem
    evidence: Evidence | None = None
    decision: Verdict | None = None
    following: Mapping[str, str] | None = None

    @property
    def search(self) -> Search | None:
        """Every model that was fitted in the search; None if the data is insufficient."""
        return None if self.evidence is None else self.evidence.found

    @property
    def steps(self) -> tuple[Step, ...]:
        """The base model, and the model after each named effect; empty if the data is insufficient."""
        return () if self.decision is None else self.decision.steps

    @property
    def measurements(self) -> Measurements:
        """The table."""
        return self.problem.points.measurements

    @property
    def verdict(self) -> Word:
        """missing_effect, adequate, unknown_effect, indistinguishable or insufficient_data."""
        word: Word = self.document["verdict"]
        return word

    @property
    def missing_effects(self) -> list[str]:
        """Effects that are missing, the clearest first."""
        return list(self.document["missing_effects"])

    @property
    def candidates(self) -> list[str]:
        """Effects of which one (more) may be missing, where this data cannot tell which or confirms none."""
        return list(self.document["candidates"])

    @cached_property
    def fit(self) -> FitResult:
        """The base model with all effects that the verdict names, fitted to all runs and channels."""
        return self.fitted(-1) if self.steps else self.problem.result()

    @cached_property
    def model(self) -> CalibratedModel:
        """The model with everything that the verdict names, and with its rivals if it leaves any."""
        evidence, decision = self.evidence, self.decision
        if evidence is None or decision is None:
            return self.fit.model
        tied = {name for one in self.fit.measured.tied for name in (one.setting, one.other)}
        # Candidates describe the data, though these do not confirm them.
        unknown = decision.word == "unknown_effect" and not decision.rivals
        if not (decision.rivals or unknown or (tied and decision.word == "adequate")):
            return self.fit.model
        found = evidence.found
        models = found.mixture(decision.named, decision.rivals, tied)
        # Where rivals are left, or a curve without a name does better, the data confirms no law.
        best = max((m.weight for _, m in models), default=-np.inf)
        unknown |= bool(decision.rivals) or best < found.ordered[0].weight - TIE

        def written(fit: FitResult) -> CalibratedModel:
            return replace(fit, measured=replace(fit.measured, unexplained=unknown)).model

        rivals = [(share, written(self.problem.result(model))) for share, model in models]
        return written(self.fit).changed(rivals=tuple(rivals) if len(rivals) > 1 else ())

    def fitted(self, step: int) -> FitResult:
        """Return the model of a step, by its index, fitted to all runs and channels, for users and files."""
        held_out = self.document["steps"][step]["held_out_rmse"]
        return replace(self.problem.result(self.steps[step].model), held_out=held_out)

    def headline(self) -> str:
        """The verdict in a sentence."""
        return verdict_sentences(self.document)[0]

    def to_dict(self) -> dict[str, Any]:
        """The document, as `smallwheel diagnose --json` writes it."""
        return dict(written.plain(self.document))

    def rows(self) -> list[dict[str, Any]]:
        """One row for each effect: probability, p-value, status and reason, the most probable first."""
        names = ("effect", "kind", "status", "probability", "p_value", "reduction", "reason")
        return [{name: row.get(name) for name in names} for row in self.document["ranking"]]

    def plot(self, ax: Axes | None = None, channel: str | None = None) -> Axes:
        """Draw the held-out error after each step.

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
        return super()._writers() | {".yaml": lambda path: self.model.save(path)}


@dataclass(frozen=True)
class Decided:
    """The verdict on a table of measurements, or the reason why there is none.

    Attributes
    ----------
    problem
        The table without bad runs, and the base model.
    reason
        Why there is no verdict, in words; empty if there is one.
    evidence, verdict
        The evidence, and the verdict reached from it; None if there is no verdict.
    """

    problem: Problem
    reason: str = ""
    evidence: Evidence | None = None
    verdict: Verdict | None = None

    @property
    def named(self) -> tuple[str, ...]:
        """The effects that are missing, the clearest first."""
        return () if self.verdict is None else self.verdict.named

    def fit(self) -> FitResult:
        """The base model with all effects that are named, fitted to all runs and channels."""
        steps = () if self.verdict is None else self.verdict.steps
        return self.problem.result(steps[-1].model if steps else None)


@one_thread
def decided(start: Start, progress: Progress = unheard) -> Decided:
    """Decide which effect a model is missing, as far as the measurements can tell.

    Parameters
    ----------
    start
        Measurements, base model and effects.
    progress
        Called with a text at the beginning of each step.

    Returns
    -------
    Decided
        With a reason in place of a verdict where runs or varied settings are too few.

    Raises
    ------
    FittingError
        If nothing usable was measured.
    """
    progress("fitting the base model")
    problem = Problem.of(start.measurements, start.base)
    reason = _insufficient(problem.judged.points)
    if not reason and len(problem.points) < 2:
        reason = "one measurement only"
    if reason:
        return Decided(problem, reason)
    progress("testing each effect")
    evidence = _evidence(problem, start.registry, start.without, start.seed, progress)
    return Decided(evidence.problem, "", evidence, decide(evidence))


@one_thread
def diagnosis_of(start: Start, progress: Progress = unheard) -> Diagnosis:
    """Find out which effect a model is missing, and collect everything that is reported about it.

    Parameters
    ----------
    start
        Measurements, base model and effects.
    progress
        Called with a text at the beginning of each step.

    Returns
    -------
    Diagnosis
        With the verdict `insufficient_data` where runs or varied settings are too few.

    Raises
    ------
    FittingError
        If nothing usable was measured.
    """
    found, without = decided(start, progress), start.without
    evidence, verdict = found.evidence, found.verdict
    if evidence is None or verdict is None:
        return _too_little(found.problem, found.reason, start.registry, without)
    progress("ranking")
    document = written.document_of(evidence, verdict, seed=start.seed)
    progress("what to measure next")
    proposed = proposals(evidence.found, verdict, start.limits)
    document["next_measurements"] = [asdict(p) for p in proposed]
    return Diagnosis(written.plain(document), evidence.problem, evidence, verdict)


@one_thread
def chance_of_nothing(start: Start) -> float:
    """Return the probability of data as odd as this if no effect were missing (`Search.p`).

    This is the first step of a diagnosis, and takes a hundredth of its time. Raises FittingError if nothing
    usable was measured.
    """
    judged = Problem.of(start.measurements, start.base).judged
    model = judged.vector.model(judged.vector.start)
    field = field_of(judged.points, model, start.registry, start.without)
    return search(judged.fitter, judged.fit, field, seed=start.seed, most=0).p


def _evidence(
    plain: Problem,
    known: Registry,
    without: Collection[str],
    seed: int,
    progress: Progress,
    bad: tuple[BadRun, ...] = (),
    first: Posterior | None = None,
) -> Evidence:
    """Collect all evidence that a verdict uses, without runs that do not belong to the others.

    Where there are such runs they are left out, and everything is computed again: `bad` are the runs left
    out so far, `first` are the probabilities with them.
    """
    fault = gauge_fault(plain, known, without)
    problem = plain if fault is None else plain.with_part(fault.part, fault.informed)
    judged = problem.judged
    model = judged.vector.model(judged.vector.start)
    field = field_of(judged.points, model, known, without)
    found = search(judged.fitter, judged.fit, field, seed=seed)
    posterior = posterior_of(found)
    more = bad_runs(found.fitter, found.ordered[0])
    if more and len(bad) + len(more) <= most_bad(judged.points.run_count + len(bad)):
        left = plain.without(np.concatenate([one.rows for one in more]))
        more, first = [*bad, *more], first or posterior
        return _evidence(left, known, without, seed, progress, tuple(more), first)
    progress("held-out error of each step")
    held = held_out(problem, found, posterior)
    misfit = misfit_of(found, posterior, held)
    return Evidence(problem, found, posterior, held, misfit, bad, first or posterior, fault)


def _too_little(
    problem: Problem, reason: str, known: Registry, without: Collection[str]
) -> Diagnosis:
    """The diagnosis of a table that is too small for one."""
    if len(problem.points) < 2:
        return Diagnosis(written.insufficient(problem, reason), problem)
    judged = problem.judged
    field = field_of(judged.points, judged.vector.model(judged.vector.start), known, without)
    return Diagnosis(written.insufficient(problem, reason, field), problem)


def _insufficient(points: Points) -> str:
    """Why these points do not suffice for a diagnosis; empty where they do."""
    runs = points.run_count
    if runs < FEWEST_RUNS:
        return (
            f"{runs} run{'s' if runs != 1 else ''}: with fewer than {FEWEST_RUNS} nothing can be "
            "distinguished from the scatter of the soil; rows of one run are repeats, not more runs"
        )
    if not points.varied:
        return "every setting is the same in all rows: vary at least the load"
    return ""
