"""From measurements to a law, or to why there is none. Read it from the top; each line has a module.

points -> base -> drivers -> grammar -> tangent of the whole grammar -> refits in the model
-> description length -> tied laws -> permutations -> folds by setting -> draft
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.fitting import Base, FittingError, Problem
from smallwheel_ros.fitting.constants import FEWEST_RUNS
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.points import Points, points_of
from smallwheel_ros.learn.chance import chance
from smallwheel_ros.learn.drivers import FEWEST_LEVELS, Driver, drivers_of
from smallwheel_ros.learn.folds import HeldOut, Judgement, add_errors, judge, nested, vault_of
from smallwheel_ros.learn.grammar import terms_of
from smallwheel_ros.learn.law import places_for
from smallwheel_ros.learn.search import WHOLE, Candidate, Found, Grid, Search
from smallwheel_ros.measurements.columns import COLUMNS, is_bookkeeping, is_response
from smallwheel_ros.measurements.settings import settings_of_rows
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import predict

Array = NDArray[np.float64]

FEWEST_SETTINGS = 10
PERMUTATIONS = 199
SURE = 0.02  # p of a draft
LOOKED_AT = 0.05  # p up to which held-out errors are worked out at all
_LEAST_FALL = 0.05  # of the held-out error
_LEAST_Z = 1.28  # standard errors of the held-out gain: one in ten by chance
_MAJORITY = 0.5  # of the folds

Progress = Callable[[str, int, int], None]


def silent(step: str, done: int, total: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Sought:
    """What one search for a law found.

    verdict: law, unstable, weak, nothing or refused, with reasons in words. fitter, base: of all
    points. law: the draft, fitted to all points, where there is one; tied: all laws that do as well,
    the best first. p: of the permutations.
    """

    verdict: str
    reasons: tuple[str, ...]
    problem: Problem | None = None
    fitter: Fitter | None = None
    base: Fit | None = None
    grid: Grid | None = None
    p: float | None = None
    law: Candidate | None = None
    tied: tuple[Candidate, ...] = ()
    held_out: HeldOut | None = None
    judgement: Judgement | None = None
    vault: int = 0
    notes: tuple[str, ...] = field(default=())


def seek(
    measurements: Measurements, base: Base, *, seed: int = 0, progress: Progress = silent
) -> Sought:
    """Search for one law that a model lacks. The same seed gives the same answer."""
    try:
        problem = Problem.of(_by_trial(measurements), base).judged
        reason = _too_little(problem.points)
        if reason:
            return Sought("refused", (reason,), problem)
        fitter, fit = problem.fitter, problem.fit
    except FittingError as error:
        return Sought("refused", (str(error),))
    points = problem.points
    depth = predict(fit.model, points.conditions).true_sinkage
    drivers, notes = drivers_of(points, depth)
    if not [d for d in drivers if d.columns and d.levels >= FEWEST_LEVELS]:
        few = [_two_values(d) for d in drivers if d.columns]
        why = "; ".join([*notes, *few]) or "nothing was varied"
        return Sought("refused", (f"there is nothing that a law could follow: {why}",), problem)
    settings = np.unique(points.setting).size
    terms = terms_of(drivers, settings)
    values = np.column_stack([term(points.conditions, depth) for term in terms])
    grid = Grid(tuple(terms), places_for(points.channels), depth, values)
    sought = Sought("nothing", (), problem, fitter, fit, grid, notes=tuple(notes))

    apart = vault_of(points, seed)
    open_fitter, open_fit = fitter, fit
    if apart.any():
        open_fitter = fitter.of_values(points.take(~apart), ~apart)
        open_fit = open_fitter.fit(fit.vector, fit.theta, fit.scatter)
    progress("permuting", 0, 1)
    search = Search(open_fitter, open_fit, grid)
    p = chance(search, PERMUTATIONS, np.random.default_rng([seed, 0]))
    progress("searching", 0, 1)
    found = search.run(WHOLE)
    sought = replace(sought, p=p)
    draft = found.draft
    if draft is None or p > LOOKED_AT or found.gain <= 0.0:
        return replace(sought, reasons=(_nothing(p),))
    unknown = _with_gaps(measurements)
    if unknown:
        return replace(sought, verdict="refused", reasons=(unknown,))
    coarse = [d for t in draft.law.terms for d, _ in t.factors if d.levels < FEWEST_LEVELS]
    if coarse:
        why = f"what is missing follows {coarse[0].name}; {_two_values(coarse[0])}"
        return replace(sought, verdict="refused", reasons=(why,))
    folds = _Counter(progress, "searching without some settings")
    held_out = nested(open_fitter, open_fit, grid, seed, folds.one)
    judgement = judge(held_out, draft.law, open_fitter, draft.fit)
    verdict, reasons = _decide(p, judgement)
    if apart.any():
        verdict, reasons = _opened(verdict, reasons, held_out, points.take(apart), found)
    law = _final(fitter, draft)
    tied = _refitted(fitter, law, found)
    return replace(
        sought, verdict=verdict, reasons=reasons, law=law, tied=tied, held_out=held_out,
        judgement=judgement, vault=int(np.unique(points.setting[apart]).size),
    )  # fmt: skip


def _with_gaps(measurements: Measurements) -> str:
    """Say which settings are blank in some rows, "" where none is: the law may follow one of them."""
    known = {*measurements.conditions.covariates, *measurements.channels, *COLUMNS}
    blank = [name for name, unit in measurements.units.items()
             if name not in known and not name.endswith("_std")
             and not is_response(name, unit) and not is_bookkeeping(name)]  # fmt: skip
    if not blank:
        return ""
    return (
        f"something is missing, and {' and '.join(blank)}, blank in some rows, may be what it follows: "
        "fill the cells in, or leave the column out"
    )


def _two_values(driver: Driver) -> str:
    return f"{driver.name} has {driver.levels} values: a law needs {FEWEST_LEVELS} or more"


def _by_trial(measurements: Measurements) -> Measurements:
    """The table with each of its trials as a run of its own, where it numbers trials.

    Trials are made on soil prepared anew, so rows of one run that are trials are no repeats on one
    soil. Curves keep their runs: rows along a curve are no trials.
    """
    if "trial" not in measurements.conditions.covariates or points_of(measurements).swept.any():
        return measurements
    names = [
        f"{run}, row {line}" for run, line in zip(measurements.run, measurements.line, strict=True)
    ]
    return replace(measurements, run=np.array(names))


class _Counter:
    """Counts folds for the progress; their number is known when the first is done."""

    def __init__(self, progress: Progress, step: str) -> None:
        self._progress, self._step, self._done = progress, step, 0

    def one(self) -> None:
        self._done += 1
        self._progress(self._step, self._done, 0)


def _too_little(points: Points) -> str:
    settings = settings_in(points)
    if settings == 1:
        return "every run has the same setting: a law needs something that was varied"
    if settings < FEWEST_SETTINGS:
        return f"{settings} settings, and a law needs {FEWEST_SETTINGS} or more"
    if points.run_count < FEWEST_RUNS:
        return (
            f"{points.run_count} runs, and a law needs {FEWEST_RUNS} or more: settings of one run "
            "share its soil"
        )
    return ""


def settings_in(points: Points) -> int:
    """How many settings the rows have that are used."""
    used = np.unique(np.concatenate(points.rows))
    return int(np.unique(settings_of_rows(points.measurements)[used]).size)


def _nothing(p: float) -> str:
    return f"the best of all formulas gains no more than chance would (p {p:.2g}): nothing could be learnt"


def _decide(p: float, judgement: Judgement) -> tuple[str, tuple[str, ...]]:
    """The verdict, and what speaks against a law."""
    against = []
    if p > SURE:
        against.append(f"such a gain comes by chance with p {p:.2g}, and a law needs {SURE:g}")
    if judgement.reduction <= _LEAST_FALL:
        against.append("on settings that the search never saw the error hardly falls")
    elif judgement.z <= _LEAST_Z:
        against.append("the fall of the error on settings never seen is within its standard error")
    if against:
        return "weak", tuple(against)
    if judgement.agreeing < _MAJORITY:
        share = f"{100 * judgement.agreeing:.0f} %"
        return "unstable", (f"only {share} of the folds choose what it follows",)
    return "law", ()


def _opened(
    verdict: str, reasons: tuple[str, ...], held_out: HeldOut, left: Points, found: Found
) -> tuple[str, tuple[str, ...]]:
    """The verdict after the vault was opened; its errors join those of the folds."""
    draft = found.draft
    assert draft is not None
    add_errors(held_out.before, left, found.base.model)
    add_errors(held_out.after, left, draft.fit.model)
    worse = []
    for name in left.channels:
        rows = np.concatenate(
            [r for r, c in zip(left.rows, left.channel, strict=True) if left.channels[c] == name]
        )
        size = [float(np.mean(e[name][rows] ** 2)) for e in (held_out.before, held_out.after)]
        worse += [name] if size[1] > size[0] else []
    if verdict == "law" and len(worse) == len(left.channels):
        return "unstable", (*reasons, "on the settings in the vault the error does not fall")
    return verdict, reasons


def _final(fitter: Fitter, draft: Candidate) -> Candidate:
    """The draft, fitted to all points with the scatter."""
    fit = fitter.fit(draft.fit.vector, draft.fit.theta, draft.fit.scatter)
    return replace(draft, fit=fit)


def _refitted(fitter: Fitter, law: Candidate, found: Found) -> tuple[Candidate, ...]:
    """The tied laws, fitted to all points; law: the draft, which is already."""
    made = []
    for c in found.tied:
        if c.law.key == law.law.key:
            made.append(law)
            continue
        try:
            fit = fitter.fit(c.fit.vector, c.fit.theta, law.fit.scatter, turns=0)
        except FAILURES:
            continue
        made.append(replace(c, fit=fit))
    return tuple(made)


def without_effects(base: Base, ids: Collection[str]) -> Base:
    """The base without these effects."""
    return replace(
        base,
        effects=tuple(e for e in base.effects if e.id not in ids),
        parts=tuple(p for p in base.parts if p.id not in ids),
    )
