# SPDX-License-Identifier: Apache-2.0
"""The diagnosis from measurements to document; each step is in a module of its own."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.common.results import Result, Writer
from smallwheel_ros.diagnosis import document as written
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.held_out import Step, steps_of
from smallwheel_ros.diagnosis.misfit import BadRun, bad_runs, most_bad
from smallwheel_ros.diagnosis.next_measurement import Limits, proposals
from smallwheel_ros.diagnosis.search import Search, search
from smallwheel_ros.diagnosis.text import verdict_sentences
from smallwheel_ros.diagnosis.verdict import Verdict, Word, decide
from smallwheel_ros.diagnosis.zero import fault_told, with_fault
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.constants import FEWEST_RUNS
from smallwheel_ros.fitting.fit import one_thread
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.display import listed, words
from smallwheel_ros.measurements.table import Measurements

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from smallwheel_ros.model.model_file import CalibratedModel

Progress = Callable[[str], None]


@dataclass(frozen=True, repr=False)
class Diagnosis(Result, shown="views.diagnosis"):
    """A diagnosis. document: what the JSON holds. The rest is what the document was made from.

    search and decision are None, and steps empty, where the data is insufficient.
    """

    document: dict[str, Any]
    problem: Problem
    search: Search | None = None
    decision: Verdict | None = None
    steps: tuple[Step, ...] = ()

    @property
    def measurements(self) -> Measurements:
        """The table."""
        return self.problem.measurements

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
        """Effects of which one is missing, and this data cannot tell which."""
        return list(self.document["candidates"])

    @cached_property
    def fit(self) -> FitResult:
        """The base with everything that the verdict names, fitted to all runs and channels."""
        return self.fitted(-1) if self.steps else self.problem.result()

    @property
    def model(self) -> CalibratedModel:
        """The model with everything that the verdict names."""
        return self.fit.model

    def fitted(self, step: int) -> FitResult:
        """The model of a step fitted to all runs and channels, for people and for model files."""
        held_out = self.document["steps"][step]["held_out_rmse"]
        return replace(self.problem.result(self.steps[step].model), held_out=held_out)

    def headline(self) -> str:
        """The verdict in a sentence."""
        return verdict_sentences(self.document)[0]

    def to_dict(self) -> dict[str, Any]:
        """As `smallwheel diagnose --json` writes it."""
        return dict(written.plain(self.document))

    def rows(self) -> list[dict[str, Any]]:
        """The effects, the most probable first."""
        names = ("effect", "kind", "status", "probability", "p_value", "reduction", "reason")
        return [{name: row.get(name) for name in names} for row in self.document["ranking"]]

    def plot(self, ax: Axes | None = None, channel: str | None = None) -> Axes:
        """Draw the held-out error after each step. channel: the first that was measured if not given."""
        return self._drawn(ax, channel)

    def _writers(self) -> dict[str, Writer]:
        return super()._writers() | {".yaml": lambda path: self.model.save(path)}


@one_thread
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

    def searched(problem: Problem) -> Search:
        judged = problem.judged
        model = judged.vector.model(judged.vector.start)
        field = field_of(judged.points, model, known, without)
        return search(judged.fitter, judged.fit, field, seed=seed)

    progress("fitting the base model")
    problem = Problem.of(measurements, base)
    reason = _insufficient(problem.judged.points)
    if reason or len(problem.points) < 2:
        return _too_little(problem, reason, known, without)
    progress("testing each effect")
    plain, told = problem, fault_told(problem, known, without)
    if told is not None:
        problem = problem.with_part(told.part, told.told)
    most = most_bad(problem.judged.points.run_count)
    found = searched(problem)
    with_all = verdict = decide(found)
    bad: list[BadRun] = []
    while (more := bad_runs(found.fitter, found.ordered[0])) and len(bad) + len(more) <= most:
        bad += more
        rows = np.concatenate([one.rows for one in more])
        plain, problem = plain.without(rows), problem.without(rows)
        found = searched(problem)
        verdict = decide(found)
    for one in bad:
        verdict = verdict.saying(one.words(measurements))
    if bad:
        verdict = verdict.saying(_changes(with_all, verdict, len(bad)))
    progress("held-out error of each step")
    verdict, steps = steps_of(problem, found, verdict)
    if told is not None:
        verdict, steps = with_fault(plain, verdict, steps, told)
    progress("ranking")
    document = written.document_of(
        problem, found, verdict, steps, seed=seed, bad=bad, told=told, without=without
    )
    progress("what to measure next")
    document["next_measurements"] = [asdict(p) for p in proposals(found, verdict, limits or {})]
    return Diagnosis(written.plain(document), problem, found, verdict, tuple(steps))


def _too_little(
    problem: Problem, reason: str, known: Registry, without: Collection[str]
) -> Diagnosis:
    """The diagnosis of a table that nothing can be told from."""
    if len(problem.points) < 2:
        return Diagnosis(written.insufficient(problem, reason or "one measurement only"), problem)
    judged = problem.judged
    field = field_of(judged.points, judged.vector.model(judged.vector.start), known, without)
    return Diagnosis(written.insufficient(problem, reason, field), problem)


def _changes(before: Verdict, after: Verdict, count: int) -> str:
    """Whether bad runs would change the verdict, in words."""
    those = "it" if count == 1 else "them"
    if (before.word, set(before.named)) == (after.word, set(after.named)):
        return f"with {those} the verdict would be the same"
    named = f" of {listed(before.named)}" if before.named else ""
    return f"with {those} the verdict would be '{words(before.word)}'{named}"


def _insufficient(points: Points) -> str:
    """Why nothing can be told from these points, "" where it can."""
    runs = points.run_count
    if runs < FEWEST_RUNS:
        return (
            f"{runs} run{'s' if runs != 1 else ''}: under {FEWEST_RUNS} runs nothing can be told from "
            "the scatter of the soil; rows of one run are repeats, not more runs"
        )
    if not points.varied:
        return "every setting is the same in all rows: vary at least the load"
    return ""
