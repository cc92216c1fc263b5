# SPDX-License-Identifier: Apache-2.0
"""From measurements to a law, or to why there is none. Read it from the top; each line has a module.

points -> base -> drivers -> grammar -> tangent of the whole grammar -> refits in the model
-> description length -> tied laws -> permutations -> folds by setting -> draft
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.fitting import Base, FittingError, Problem
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.points import Points, points_of
from smallwheel_ros.learn.chance import chance
from smallwheel_ros.learn.drivers import drivers_of
from smallwheel_ros.learn.folds import (
    HeldOut,
    Judgement,
    add_errors,
    judge,
    nested,
    rows_of,
    vault_of,
)
from smallwheel_ros.learn.grammar import terms_of
from smallwheel_ros.learn.law import places_for
from smallwheel_ros.learn.refused import cannot_be_told, nothing_to_follow, too_little
from smallwheel_ros.learn.search import WHOLE, Candidate, Found, Grid, Search
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import predict

Array = NDArray[np.float64]

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
class Judged:
    """The best law, fitted to all points, and how it did on what the search did not see.

    fitter, base: of all points, without the law. tied: all laws that do as well, the best first.
    vault: how many settings were kept apart.
    """

    fitter: Fitter
    base: Fit
    grid: Grid
    law: Candidate
    tied: tuple[Candidate, ...]
    held_out: HeldOut
    judgement: Judgement
    vault: int


@dataclass(frozen=True)
class Sought:
    """What one search for a law found.

    verdict: law, unstable, weak, nothing or refused, with reasons in words. p: of the permutations,
    None where it did not come to them; best: None where there is nothing to judge.
    """

    verdict: str
    reasons: tuple[str, ...]
    problem: Problem | None = None
    grid: Grid | None = None
    p: float | None = None
    best: Judged | None = None
    notes: tuple[str, ...] = ()


def seek(
    measurements: Measurements, base: Base, *, seed: int = 0, progress: Progress = silent
) -> Sought:
    """Search for one law that a model lacks. The same seed gives the same answer."""
    try:
        problem = Problem.of(_by_trial(measurements), base).judged
        reason = too_little(problem.points)
        if reason:
            return Sought("refused", (reason,), problem)
        points, fitter, fit = problem.points, problem.fitter, problem.fit
    except FittingError as error:
        return Sought("refused", (str(error),))
    grid, reason, notes = _grid(points, fit)
    sought = Sought("refused", (reason,), problem, grid, notes=notes)
    if reason:
        return sought

    apart = vault_of(points, seed)
    if apart.any():
        fitter = fitter.of_values(points.take(~apart), ~apart)
        fit = fitter.fit(fit.vector, fit.theta, fit.scatter)
    search = Search(fitter, fit, grid)
    progress("permuting", 0, 1)
    p = chance(search, PERMUTATIONS, np.random.default_rng([seed, 0]))
    why = f"the best of all formulas gains no more than chance would (p {p:.2g}): nothing could be learnt"
    nothing = replace(sought, verdict="nothing", reasons=(why,), p=p)
    if p > LOOKED_AT:
        return nothing
    progress("searching", 0, 1)
    found = search.run(WHOLE)
    draft = found.draft
    if draft is None or found.gain <= 0.0:
        return nothing
    reason = cannot_be_told(draft.law, measurements)
    if reason:
        return replace(sought, reasons=(reason,), p=p)

    step, folds = "searching without some settings", itertools.count(1)
    held_out = nested(fitter, fit, grid, seed, lambda: progress(step, next(folds), 0))
    judgement = judge(held_out, draft.law, fitter, draft.fit)
    verdict, reasons = _decide(p, judgement)
    if apart.any():
        verdict, reasons = _opened(verdict, reasons, held_out, points.take(apart), found)
    law, tied = _refitted(problem.fitter, draft, found.tied)
    kept = int(np.unique(points.setting[apart]).size)
    best = Judged(problem.fitter, problem.fit, grid, law, tied, held_out, judgement, kept)
    return Sought(verdict, reasons, problem, grid, p, best, notes)


def _grid(points: Points, base: Fit) -> tuple[Grid, str, tuple[str, ...]]:
    """Every term at each point, why there are none worth trying, and notes on settings."""
    depth = predict(base.model, points.conditions).true_sinkage
    drivers, notes = drivers_of(points, depth)
    terms = terms_of(drivers, np.unique(points.setting).size)
    values = np.column_stack([term.at(points.conditions, depth) for term in terms])
    grid = Grid(tuple(terms), places_for(points.channels), depth, values)
    return grid, nothing_to_follow(drivers, notes), tuple(notes)


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
    rows = rows_of(left)
    worse = [
        np.mean(held_out.after[name][mine] ** 2) > np.mean(held_out.before[name][mine] ** 2)
        for name, mine in rows.items()
    ]
    if verdict == "law" and all(worse):
        return "unstable", (*reasons, "on the settings in the vault the error does not fall")
    return verdict, reasons


def _refitted(
    fitter: Fitter, draft: Candidate, tied: Sequence[Candidate]
) -> tuple[Candidate, tuple[Candidate, ...]]:
    """The draft, fitted to all points with the scatter, and the tied laws under that scatter."""
    fit = fitter.fit(draft.fit.vector, draft.fit.theta, draft.fit.scatter)
    law = replace(draft, fit=fit)
    made = []
    for c in tied:
        if c.law.key == draft.law.key:
            made.append(law)
            continue
        try:
            own = fitter.fit(c.fit.vector, c.fit.theta, fit.scatter, turns=0)
        except FAILURES:
            continue
        made.append(replace(c, fit=own))
    return law, tuple(made)


def without_effects(base: Base, ids: Collection[str]) -> Base:
    """The base without these effects."""
    return replace(
        base,
        effects=tuple(e for e in base.effects if e.id not in ids),
        parts=tuple(p for p in base.parts if p.id not in ids),
    )
