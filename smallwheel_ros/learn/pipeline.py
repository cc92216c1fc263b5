# SPDX-License-Identifier: Apache-2.0
"""From measurements to a law, or to why there is none. Read it from the top; each line has a module.

points -> base -> drivers -> grammar -> tangent of the whole grammar -> refits in the model
-> description length -> tied laws -> permutations -> folds by setting -> draft
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.fitting import Base, FittingError, Problem
from smallwheel_ros.fitting.fit import Fitter, one_thread
from smallwheel_ros.fitting.points import points_of
from smallwheel_ros.learn.candidate import Candidate
from smallwheel_ros.learn.chance import chance
from smallwheel_ros.learn.folds import HeldOut, nested, vault_of
from smallwheel_ros.learn.grid import Grid
from smallwheel_ros.learn.refused import cannot_be_told, nothing_to_follow, too_little
from smallwheel_ros.learn.search import WHOLE, Search
from smallwheel_ros.learn.verdict import Judgement
from smallwheel_ros.measurements.table import Measurements

Array = NDArray[np.float64]

PERMUTATIONS = 199
LOOKED_AT = 0.05  # p up to which held-out errors are worked out at all

Progress = Callable[[str, int, int], None]


def silent(step: str, done: int, total: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Judged:
    """The best law, fitted to all points, and how it did on what the search did not see.

    problem: all points, and the base without the law. tied: all laws that do as well, the best first.
    vault: how many settings were kept apart.
    """

    problem: Problem
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


@one_thread
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
    grid = Grid.of(points, fit.model)
    reason = nothing_to_follow(grid.drivers, grid.notes)
    sought = Sought("refused", (reason,), problem, grid)
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
    if draft is None:
        return nothing
    reason = cannot_be_told(draft.law, measurements)
    if reason:
        return replace(sought, reasons=(reason,), p=p)

    folds = itertools.count(1)
    held_out = nested(
        fitter, fit, grid, seed, lambda: progress("searching without some settings", next(folds), 0)
    )
    judgement = Judgement.of(held_out, draft.law, fitter, draft.fit)
    verdict, reasons = judgement.verdict(p)
    if apart.any():
        better = held_out.add(points.take(apart), found.base.model, draft.fit.model)
        if verdict == "law" and not better:
            verdict, reasons = "unstable", ("on the settings in the vault the error does not fall",)
    law, tied = _refitted(problem.fitter, draft, found.tied)
    kept = int(np.unique(points.setting[apart]).size)
    best = Judged(problem, law, tied, held_out, judgement, kept)
    return Sought(verdict, reasons, problem, grid, p, best)


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
