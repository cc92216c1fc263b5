# SPDX-License-Identifier: Apache-2.0
"""The diagnosis from measurements to document; each step is in a module of its own."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.common.results import Result, Writer
from smallwheel_ros.diagnosis import document as written
from smallwheel_ros.diagnosis.candidate import CandidateFit
from smallwheel_ros.diagnosis.competitors import field_of
from smallwheel_ros.diagnosis.curves import curve_shown
from smallwheel_ros.diagnosis.held_out import nested, of_model, staircase, with_forces
from smallwheel_ros.diagnosis.misfit import of_channels, with_misfit
from smallwheel_ros.diagnosis.next_measurement import Limits, proposals
from smallwheel_ros.diagnosis.residuals import (
    residuals_left,
    where_it_fails,
    worst_left,
)
from smallwheel_ros.diagnosis.search import Search, search
from smallwheel_ros.diagnosis.text import verdict_sentences
from smallwheel_ros.diagnosis.verdict import Verdict, Word, decide, demoted, no_help
from smallwheel_ros.diagnosis.zero import Witness, witness
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.bad_runs import BadRun, bad_runs, most_bad
from smallwheel_ros.fitting.constants import (
    ALARM,
    FEWEST_RUNS,
    USEFUL,
)
from smallwheel_ros.fitting.fit import one_thread
from smallwheel_ros.fitting.held_out import CvErrors, compare_cv
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.result import expected_error
from smallwheel_ros.measurements.display import listed, number, words
from smallwheel_ros.measurements.table import Measurements

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from smallwheel_ros.model.model_file import CalibratedModel

_LISTED = 5  # families whose held-out error is worked out for the ranking

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """The base (added None) or an effect that was added, with the held-out errors after it."""

    added: str | None
    model: CandidateFit
    errors: CvErrors


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
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
        return replace(self.problem.result(self.steps[step].model.fit), held_out=held_out)

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
    progress("fitting the base model")
    problem = Problem.of(measurements, base)
    judged = problem.judged
    reason = _insufficient(judged.points)
    if len(problem.points) < 2:
        return Diagnosis(written.insufficient(problem, reason or "one measurement only"), problem)
    if reason:
        field = field_of(judged.points, judged.vector.model(judged.vector.start), known, without)
        return Diagnosis(written.insufficient(problem, reason, field), problem)
    progress("testing each effect")
    plain, told = problem.base, _fault_told(problem, known, without)
    if told is not None:
        problem = problem.with_part(told.part, told.told)
    found = _searched(problem, known, without, seed)
    with_all = verdict = decide(found)
    bad: list[BadRun] = []
    while more := bad_runs(found.fitter, found.ordered[0].fit):
        if len(bad) + len(more) > most_bad(judged.points.run_count):
            break
        bad += more
        problem = problem.without(np.concatenate([one.rows for one in more]))
        found = _searched(problem, known, without, seed)
        verdict = decide(found)
    for one in bad:
        verdict = verdict.saying(_bad_words(one, measurements))
    if bad:
        verdict = verdict.saying(_changes(with_all, verdict, len(bad)))
    progress("held-out error of each step")
    verdict, steps = _steps(problem, found, verdict)
    if told is not None:
        verdict, steps = _with_fault(replace(problem, base=plain), verdict, steps, told)
    progress("ranking")
    document = _document(problem, found, verdict, steps, seed)
    if told is not None:
        document["ranking"] = _ranked(document["ranking"], steps, problem, told)
    document["bad_runs"] = [
        {"run": one.name, "lines": measurements.line[one.rows], "channel": one.channel,
         "size": one.deviations, "against": one.against}
        for one in bad
    ]  # fmt: skip
    if verdict.word == "unknown_effect":
        document["notes"].insert(0, _may_learn(measurements, without))
    progress("what to measure next")
    document["next_measurements"] = [asdict(p) for p in proposals(found, verdict, limits or {})]
    return Diagnosis(written.plain(document), problem, found, verdict, tuple(steps))


def _searched(problem: Problem, known: Registry, without: Collection[str], seed: int) -> Search:
    judged = problem.judged
    field = field_of(judged.points, judged.vector.model(judged.vector.start), known, without)
    return search(judged.fitter, judged.fit, field, seed=seed)


def _fault_told(problem: Problem, known: Registry, without: Collection[str]) -> Witness | None:
    """A fault of the shown sinkage that pull and torque name, and that lowers a held-out error."""
    told = witness(problem.points, known, frozenset({*without, *problem.base.names}))
    if told is None or not told.named or problem.points.run_count < FEWEST_RUNS:
        return None
    before, after = problem.held_out(), problem.with_part(told.part, told.told).held_out()
    useful = before is not None and after is not None and compare_cv(before, after).helps
    return told if useful else None


def _with_fault(
    plain: Problem, verdict: Verdict, steps: list[Step], told: Witness
) -> tuple[Verdict, list[Step]]:
    """The verdict and its steps with the fault that pull and torque name as the first of them.

    plain: the problem without it.
    """
    name = told.part.id
    errors = plain.held_out()
    assert errors is not None  # as it was named
    none = CandidateFit((), plain.judged.fit, plain.judged.fit.evidence)
    word: Word = "missing_effect" if verdict.word == "adequate" else verdict.word
    verdict = replace(
        verdict,
        word=word,
        named=(name, *verdict.named),
        probabilities={**verdict.probabilities, name: told.probability},
    ).saying(
        f"{words(name)} is told by {listed([words(n) for n in plain.points.forces])}: their law holds at the "
        f"sinkage as it is shown {number(told.evidence, 2)} nats worse than at one that is corrected"
    )
    first = replace(steps[0], added=name)
    return verdict, [Step(None, none, errors), first, *steps[1:]]


def _ranked(
    ranking: list[dict[str, Any]], steps: list[Step], problem: Problem, told: Witness
) -> list[dict[str, Any]]:
    """The ranking with the fault that pull and torque name at its head."""
    name, kind = told.part.id, problem.with_all_channels(steps[-1].model.fit)
    before, after = steps[0].errors, steps[1].errors
    effect = next(e for e in kind.model.effects if e.id == name)
    places = kind.vector.places(name)
    parameters = {
        kind.vector.free[j].field: {
            "value": float(kind.theta[j]), "std": float(np.sqrt(kind.covariance[j, j])),
            "unit": kind.vector.free[j].unit, "published_range": None, "plausible": None,
        }
        for j in places
    }  # fmt: skip
    row = {
        "effect": name, "kind": "instrument", "status": "significant",
        "reason": f"{words(name)}: pull and torque speak of it, {number(told.evidence, 2)} nats",
        "probability": told.probability, "p_value": None, "held_out_rmse": after.rmse(),
        "reduction": written.reduction(before, after), "form": effect.form,
        "forms_not_told_apart": [], "summary": effect.summary, "next_step": effect.next_step,
        "parameters": parameters, "confounded_with": [],
    }  # fmt: skip
    return [row, *(other for other in ranking if other["effect"] != name)]


def _bad_words(bad: BadRun, measurements: Measurements) -> str:
    lines = ", ".join(str(line) for line in measurements.line[bad.rows][:5])
    return (
        f"run {bad.name} ({measurements.source}, line {lines}) is left out: its {words(bad.channel)} is "
        f"{number(bad.deviations, 2)} {bad.against}. Look it up in the protocol"
    )


def _changes(before: Verdict, after: Verdict, count: int) -> str:
    """Whether bad runs would change the verdict, in words."""
    those = "it" if count == 1 else "them"
    if (before.word, set(before.named)) == (after.word, set(after.named)):
        return f"with {those} the verdict would be the same"
    named = f" of {listed(before.named)}" if before.named else ""
    return f"with {those} the verdict would be '{words(before.word)}'{named}"


def _may_learn(measurements: Measurements, without: Collection[str]) -> str:
    """What to run where no known effect explains what is missing."""
    taken_out = f" --without {','.join(without)}" if without else ""
    table = shlex.quote(measurements.source or "TABLE")
    return (
        f"to look for a law that explains it: `smallwheel learn {table}{taken_out} -o "
        "law.py`, with the same --model if one was given"
    )


def _insufficient(points: Points) -> str:
    runs = points.run_count
    if runs < FEWEST_RUNS:
        return (
            f"{runs} run{'s' if runs != 1 else ''}: under {FEWEST_RUNS} runs nothing can be told from "
            "the scatter of the soil; rows of one run are repeats, not more runs"
        )
    if not points.varied:
        return "every setting is the same in all rows: vary at least the load"
    return ""


def _steps(problem: Problem, found: Search, verdict: Verdict) -> tuple[Verdict, list[Step]]:
    """Held-out errors of the base and of it with each name.

    A name that helps no channel on runs that the choice never saw is a candidate and no name; a channel
    that gets worse is said.
    """
    models = staircase(found, verdict)
    errors = nested(problem.judged, found, [m.families for m in models])
    added = [next(iter(b.families - a.families)) for a, b in itertools.pairwise(models)]
    changes = [compare_cv(a, b) for a, b in itertools.pairwise(errors)]
    useless = [name for name, change in zip(added, changes, strict=True) if not change.helps]
    if useless:
        return _steps(problem, found, demoted(found, verdict, useless))
    if verdict.word == "indistinguishable" and not _any_helps(
        problem.judged, found, verdict.rivals
    ):
        verdict = verdict.not_described(no_help(verdict.rivals))
    worse = compare_cv(errors[0], errors[-1]).worse
    if worse:
        verdict = verdict.saying(
            f"on runs that the choice never saw, the error of {listed(worse)} rises with what is named: "
            "its law does not carry over to settings outside those measured"
        )
    errors = with_forces(problem, models, errors)
    if problem.judged is not problem:
        worse = tuple(
            n for n in compare_cv(errors[0], errors[-1]).worse if n in problem.points.forces
        )
        if worse:
            verdict = verdict.saying(
                f"the held-out error of {listed([words(name) for name in worse])} rises with what is named"
            )
    verdict = replace(verdict, named=tuple(added) or verdict.named)
    steps = [Step(*step) for step in zip([None, *added], models, errors, strict=True)]
    verdict = with_misfit(found, verdict)
    return verdict, steps if verdict.named else steps[:1]


def _any_helps(judged: Problem, found: Search, rivals: Collection[str]) -> bool:
    """Whether with one of the rivals a held-out error falls, be it within its standard error."""
    best = {f: next((m for m in found.ordered if f in m.families), found.none) for f in rivals}
    base, *errors = of_model(judged, [found.none, *best.values()])
    falls = [fall for e in errors for fall in compare_cv(base, e).reduction.values()]
    return max(falls, default=0.0) >= USEFUL


def _document(
    problem: Problem, found: Search, verdict: Verdict, steps: list[Step], seed: int
) -> dict[str, Any]:
    judged = problem.judged
    points, fitter = judged.points, judged.fitter
    base = steps[0].errors
    best = (verdict.best if verdict.named else found.ordered[0]).fit
    findings = of_channels(found, verdict, [s.errors for s in steps], points.channels)
    learnt = learnt_here(found, problem.measurements)
    left = residuals_left(fitter, best)
    worst = worst_left(left, problem.measurements)
    return written.head(problem, verdict.word, "; ".join(verdict.reasons)) | {
        "missing_effects": list(verdict.named),
        "candidates": list(verdict.rivals),
        "unknown": list(verdict.unknown),
        "closest": list(verdict.closest),
        "channels": written.channels(problem, base, expected_error(fitter, best), findings),
        "lack_of_fit": {
            "p_value": None if learnt & {*verdict.named} else found.p,
            "probability_of_none": found.probabilities[()],
        },
        "where_it_fails": where_it_fails(
            points, base, fitter.level, seed, certain=found.p <= ALARM
        ),
        "ranking": written.ranking(found, verdict, _alone(judged, found, verdict), base, learnt),
        "steps": [{"added": s.added, "held_out_rmse": s.errors.rmse()} for s in steps],
        "run_scatter": best.scatter.as_dict(fitter.variance),
        "residuals_left": left,
        "curves": [
            curve_shown(c.part, c.stage, c.span, points.column(c.span.column), found.ordered[0].fit)
            for c in found.ordered[0].competitors
            if c.span is not None and c.stage != "pressure"
        ],
        "notes": [
            *problem.result(steps[-1].model.fit).notes,
            *problem.measurements.notes,
            *(
                f"{name} was learnt from this very data, so it has no p here: other data must judge it"
                for name in sorted(learnt)
            ),
            *([f"after the best explanation {worst}"] if worst else []),
        ],
    }


def learnt_here(found: Search, measurements: Measurements) -> frozenset[str]:
    """Families with a law that was learnt from this very table: it cannot speak for them."""
    return frozenset(
        c.family
        for c in found.field.competitors
        if c.effect is not None and c.effect.learnt_from == measurements.sha256 != ""
    )


def _alone(judged: Problem, found: Search, verdict: Verdict) -> dict[str, CvErrors]:
    """Held-out errors of the most probable families, each alone in its best form."""
    families = sorted(found.field.kinds, key=lambda f: -verdict.probabilities.get(f, 0.0))
    models = [(f, m) for f in families if (m := found.alone(f)) is not None][:_LISTED]
    errors = of_model(judged, [m for _, m in models]) if models else []
    return {f: e for (f, _), e in zip(models, errors, strict=True)}
