# SPDX-License-Identifier: Apache-2.0
"""Whether a law is drafted, from the amount of data, permutations, and settings that the search never saw.

`seek` is the algorithm on one page, with the numbers of "How it decides" in docs/learn.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.arguments import unheard
from smallwheel_ros.common.threads import one_thread
from smallwheel_ros.diagnosis.competitors import independent
from smallwheel_ros.fitting import Base, FittingError, Problem
from smallwheel_ros.fitting.constants import FEWEST_RUNS
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors, cross_validate, in_sample
from smallwheel_ros.fitting.points import Points, points_of
from smallwheel_ros.fitting.variance import Scatter
from smallwheel_ros.learn.grammar import FEWEST_LEVELS, Driver
from smallwheel_ros.learn.law import LearntLaw
from smallwheel_ros.learn.search import FOLD, WHOLE, LawCandidate, LawSearch, TermGrid
from smallwheel_ros.learn.tangent import Tangent, Yardstick
from smallwheel_ros.measurements.columns import COLUMNS, is_bookkeeping, is_response
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import (
    LOAD_TOLERANCE,
    OF_RANGE,
    cluster,
    settings_of_rows,
)
from smallwheel_ros.model.model import Model

Array = NDArray[np.float64]
Index = NDArray[np.intp]

Progress = Callable[[str, int, int], object]

PERMUTATIONS = 199
SURE = 0.02  # p of a draft
_LOOKED_AT = 0.05  # p up to which held-out errors are computed at all
VAULT_FROM = 40  # settings from which some are kept apart from search and folds
_FEWEST_SETTINGS = 10
_FOLDS = 8
_ONE_BY_ONE = 20  # settings up to which each is left out alone
_VAULT_SHARE = 5  # one setting in so many is kept apart
_LEAST_FALL = 0.05  # of the held-out error
_LEAST_Z = 1.28  # standard errors of the held-out gain: one in ten by chance
_MAJORITY = 0.5  # of the folds
_STUDENT = 4.0  # degrees of freedom of the loss: one bad extrapolation does not decide


@dataclass(frozen=True)
class JudgedLaw:
    """The best law, fitted to all points, and its errors on settings that the search did not see.

    Attributes
    ----------
    law
        The law to draft: of the tied laws the one with the fewest drivers, then the shortest formula.
    tied
        All laws that fit equally well (within `TIE` nats), the best first.
    errors
        Held-out errors of the base model, and of the models with the folds' laws.
    laws
        The law that each fold chose; None where it chose none.
    vault
        Number of settings that were kept apart from search and folds; 0 in a small table.
    """

    law: LawCandidate
    tied: tuple[LawCandidate, ...]
    errors: Sequence[CvErrors]
    laws: Sequence[LearntLaw | None]
    vault: int


@dataclass(frozen=True)
class Sought:
    """Result of one search for a law.

    Attributes
    ----------
    verdict
        `law` if one is drafted; `unstable` if most folds chose other drivers or the law fails on settings
        kept apart; `weak` if the evidence is too little; `nothing` if no law gains more than chance would;
        `refused` if the data cannot show a law.
    reasons
        Sentences on why it is not `law`; empty if it is.
    problem
        All points, and the base model without the law; None if it could not be fitted.
    grid
        The grammar at the points; None if the search ended before it.
    p
        p value of the permutations; None if the search ended before them.
    best
        The best law; None if there is none to judge.
    """

    verdict: str
    reasons: tuple[str, ...]
    problem: Problem | None = None
    grid: TermGrid | None = None
    p: float | None = None
    best: JudgedLaw | None = None


@one_thread
def seek(
    measurements: Measurements, base: Base, *, seed: int = 0, progress: Progress = unheard
) -> Sought:
    """Search for one law that a model lacks. The same seed gives the same answer.

    Parameters
    ----------
    measurements
        The table.
    base
        The model without the law.
    seed
        Seed of the permutations, the folds and the choice of the settings that are kept apart.
    progress
        Called with the name of each step, the number of its parts done, and their total (0: not known).
    """
    # The comments' numbers are those of "How it decides" in docs/learn.md.
    try:  # 1, 2: points, and the base
        problem = Problem.of(_by_trial(measurements), base).judged
        if reason := too_little(problem.points):
            return Sought("refused", (reason,), problem)
        points, fitter, fit = problem.points, problem.fitter, problem.fit
    except FittingError as error:
        return Sought("refused", (str(error),))
    grid = TermGrid.of(points, fit.model)  # 3, 4: drivers and grammar
    if reason := nothing_to_follow(grid):
        return Sought("refused", (reason,), problem, grid)
    apart = vault_of(points, seed)  # 9
    if apart.any():
        fitter = fitter.of_values(~apart)
        fit = fitter.fit(fit.take(~apart))

    search = LawSearch(fitter, fit, grid)
    progress("permuting", 0, 1)
    p = chance(search, PERMUTATIONS, np.random.default_rng([seed, 0]))  # 8
    why = f"the best of all formulas gains no more than chance would (p {p:.2g}): nothing could be learnt"
    nothing = Sought("nothing", (why,), problem, grid, p)
    if p > _LOOKED_AT:
        return nothing
    progress("searching", 0, 1)
    found = search.run(WHOLE)  # 5, 6: score, tangent and refits
    draft = found.draft  # 7: tied laws
    if draft is None:
        return nothing
    if reason := cannot_be_told(draft.law, measurements):
        return Sought("refused", (reason,), problem, grid, p)

    folds = itertools.count(1)
    step = "searching without some settings"
    errors, laws = left_out(fitter, fit, grid, seed, lambda: progress(step, next(folds), 0))  # 9
    verdict, reasons = judge(p, errors, laws, fitter, draft)
    if apart.any():
        models = found.base.model, draft.fit.model
        errors, better = with_vault(errors, points.take(apart), models)
        if verdict == "law" and not better:
            verdict, reasons = "unstable", ("on the settings held back the error does not fall",)
    law, tied = _refitted(problem.fitter, draft, found.tied)
    kept = int(np.unique(points.setting[apart]).size)
    best = JudgedLaw(law, tied, errors, laws, kept)
    return Sought(verdict, reasons, problem, grid, p, best)


def _by_trial(measurements: Measurements) -> Measurements:
    """The table with each row as a run if it has a column `trial`; else unchanged.

    Trials are made on soil prepared anew, so trials under one name of a run are no repeats on one soil. A
    table with curves keeps its runs: rows along a curve are no trials.
    """
    if "trial" not in measurements.conditions.covariates or points_of(measurements).swept.any():
        return measurements
    rows = zip(measurements.run, measurements.line, strict=True)
    return replace(measurements, run=np.array([f"{run}, row {line}" for run, line in rows]))


def _refitted(
    fitter: Fitter, draft: LawCandidate, tied: Sequence[LawCandidate]
) -> tuple[LawCandidate, tuple[LawCandidate, ...]]:
    """Fit the draft and its scatter to all points, and the tied laws with that scatter.

    Returns both; a tied law whose fit fails is left out.
    """

    def fitted(candidate: LawCandidate, scatter: Scatter, **how: int) -> LawCandidate:
        """The law fitted to all points, beginning with this scatter. how: for `Fitter.fit`."""
        start = fitter.at(candidate.fit.vector, candidate.fit.theta, scatter)
        return replace(candidate, fit=fitter.fit(start, **how))

    law, made = fitted(draft, draft.fit.scatter), []
    for candidate in tied:
        with suppress(*FAILURES):
            made.append(law if candidate is draft else fitted(candidate, law.fit.scatter, turns=0))
    return law, tuple(made)


# --- Why no law can be learnt, in words


def too_little(points: Points) -> str:
    """Words for the lack of settings or runs; empty if there are enough."""
    settings = settings_in(points)
    if settings == 1:
        return "every run has the same setting: a law needs something that was varied"
    if settings < _FEWEST_SETTINGS:
        return f"{settings} settings, and a law needs {_FEWEST_SETTINGS} or more"
    if points.run_count < FEWEST_RUNS:
        return (
            f"{points.run_count} runs, and a law needs {FEWEST_RUNS} or more: settings of one run "
            "share its soil"
        )
    return ""


def settings_in(points: Points) -> int:
    """Number of settings among the rows that the points are made from."""
    used = np.concatenate(points.rows)
    return int(np.unique(settings_of_rows(points.measurements)[used]).size)


def nothing_to_follow(grid: TermGrid) -> str:
    """Words on why no setting can drive a law; empty if one can."""
    settings = [d for d in grid.drivers if d.columns]
    if any(d.levels >= FEWEST_LEVELS for d in settings):
        return ""
    why = "; ".join([*grid.notes, *map(_values, settings)])
    return f"there is nothing that a law could follow: {why or 'nothing was varied'}"


def cannot_be_told(law: LearntLaw, measurements: Measurements) -> str:
    """Words on why this table cannot decide for a law, though it fits best; empty if it can.

    It cannot if a column with blank cells may be what is missing, or if a driver has only two values.

    Parameters
    ----------
    law
        The law that fits best.
    measurements
        The table.
    """
    known = {*measurements.conditions.covariates, *measurements.channels, *COLUMNS}
    blank = [name for name, unit in measurements.units.items()
             if name not in known and not name.endswith("_std")
             and not is_response(name, unit) and not is_bookkeeping(name)]  # fmt: skip
    if blank:
        return (
            f"something is missing, and {' and '.join(blank)}, blank in some rows, may be what it "
            "follows: fill the cells in, or leave the column out"
        )
    few = [d for d in law.by_name.values() if d.levels < FEWEST_LEVELS]
    return f"what is missing follows {few[0].name}; {_values(few[0])}" if few else ""


def _values(driver: Driver) -> str:
    return f"{driver.name} has {driver.levels} values: a law needs {FEWEST_LEVELS} or more"


# --- How often errors without a law would gain as much


def chance(search: LawSearch, permutations: int, rng: np.random.Generator) -> float:
    """Compute by permutations the p value of the best gain of any term, between 1/(permutations + 1) and 1.

    The statistic is the gain of the best term of the whole grammar, by predictions linearised about the fit
    without a law, minus the nats of the term's description.

    Parameters
    ----------
    search
        A search that has not been run yet.
    permutations
        Number of permutations of the errors.
    rng
        Generator that draws them.
    """
    white = search.yardstick.white(search.observed - search.base.predicted)
    copies = np.column_stack([white, _permuted(white, search.fitter.points, permutations, rng)])
    tangent = Tangent(search.yardstick, copies, search.base.slopes)
    best = np.full(permutations + 1, -np.inf)
    for place in search.grid.places:
        terms = search.grid.allowed(place)
        gains, _ = tangent.gains(search.base_slopes[place.name], search.values(terms))
        worth = gains - (search.grid.cost[terms] + place.nats)[:, None]
        best = np.maximum(best, worth.max(axis=0))
    return float(1 + np.sum(best[1:] >= best[0])) / (permutations + 1)


def _permuted(white: Array, points: Points, count: int, rng: np.random.Generator) -> Array:
    """Copies of whitened errors with runs exchanged and signs flipped, shape (values, count).

    Under the null hypothesis the runs' errors could have come in any order and with either sign. Whole
    runs are exchanged, among those with as many values: what points of one run share stays with them.
    """
    alike: dict[tuple[int, ...], list[Index]] = {}
    for run in np.unique(points.run):
        mine = np.flatnonzero(points.run == run)
        mine = mine[np.lexsort((points.path[mine], points.channel[mine]))]
        alike.setdefault(tuple(points.channel[mine].tolist()), []).append(mine)
    found = np.empty((white.size, count))
    for b in range(count):
        for runs in alike.values():
            order = rng.permutation(len(runs))
            signs = rng.choice([-1.0, 1.0], len(runs))
            for i, mine in enumerate(runs):
                found[mine, b] = signs[i] * white[runs[order[i]]]
    return found


# --- Settings that the search never saw


def setting_of(points: Points) -> Index:
    """Number of the setting of each value, shape (values,).

    Only columns that vary independently count: a load that follows slip does not make two settings of one
    slip, and runs of one slip stay together.
    """
    codes = [
        cluster(np.log(c), LOAD_TOLERANCE) if n == "load" else cluster(c, OF_RANGE * float(np.ptp(c)))
        for n, c in independent(points).items()
    ]  # fmt: skip
    if not codes:
        return points.setting
    return np.unique(np.column_stack(codes), axis=0, return_inverse=True)[1].reshape(-1)


def vault_of(points: Points, seed: int) -> NDArray[np.bool_]:
    """Choose the values that neither search nor folds see: those of a fifth of the settings, drawn at random.

    Returns a mask, shape (values,). It is all False with fewer than `VAULT_FROM` settings.

    Parameters
    ----------
    points
        All points.
    seed
        Seed of the choice of settings.
    """
    setting = setting_of(points)
    settings = np.unique(setting)
    if settings.size < VAULT_FROM:
        return np.zeros(len(points), dtype=bool)
    kept = np.random.default_rng([seed, 1]).permutation(settings)[: settings.size // _VAULT_SHARE]
    return np.isin(setting, kept)


def left_out(
    fitter: Fitter, base: Fit, grid: TermGrid, seed: int, done: Callable[[], object]
) -> tuple[list[CvErrors], list[LearntLaw | None]]:
    """Cross-validate over settings: leave whole settings out in turn, and repeat the search without them.

    Parameters
    ----------
    fitter, base
        Fitter of the points, and the fit of the model without a law to all of them.
    grid
        The grammar at these points.
    seed
        Seed by which settings are dealt into folds.
    done
        Called after each fold.

    Returns
    -------
    errors : list of CvErrors
        Held-out errors of the model without a law, and of the models with the folds' laws.
    laws : list
        The law that each fold chose; None where it chose none.
    """
    points = fitter.points
    settings, code = np.unique(setting_of(points), return_inverse=True)
    count = settings.size if settings.size <= _ONE_BY_ONE else _FOLDS
    dealt = np.random.default_rng([seed, 2]).permutation(np.arange(settings.size) % count)
    fold = dealt[code.reshape(-1)]
    laws: list[LearntLaw | None] = []

    def search(_: Points) -> list[Model]:
        seen = fold != len(laws)
        fits = fitter.of_values(seen)
        plain = fits.fit(base.take(seen), turns=2)
        chosen = LawSearch(fits, plain, grid).run(FOLD).draft
        laws.append(chosen.law if chosen else None)
        done()
        return [plain.model, *([chosen.fit.model] if chosen else [])]

    return cross_validate(points, search, 2, fold), laws


def with_vault(
    errors: Sequence[CvErrors], vault: Points, models: Sequence[Model]
) -> tuple[list[CvErrors], bool]:
    """Test a law on the settings that were kept apart from the search (`vault_of`).

    Parameters
    ----------
    errors
        Held-out errors from the folds, of the model without the law and of that with it.
    vault
        The points that were kept apart.
    models
        These two models, fitted to the other points.

    Returns
    -------
    errors : list of CvErrors
        The same with the errors on the rows of `vault` filled in.
    better : bool
        Whether the rms error on `vault` is no larger with the law in at least one channel.
    """
    seen = [in_sample(vault, model) for model in models]
    before, after = (one.rmse() for one in seen)
    both = []
    for folds, one in zip(errors, seen, strict=True):
        known = {n: np.where(np.isfinite(e), e, folds.error[n]) for n, e in one.error.items()}
        both.append(CvErrors({**folds.error, **known}, folds.run))
    return both, any(after[name] <= before[name] for name in before)


def agreeing(laws: Sequence[LearntLaw | None], law: LearntLaw) -> float:
    """Share of the folds that chose the same drivers as this law, or for a constant law the same stage.

    Parameters
    ----------
    laws
        The law that each fold chose; None where it chose none.
    law
        The law that was chosen from all points.
    """
    same = [
        other is not None and other.columns == law.columns
        and (bool(law.columns) or other.place.stage == law.place.stage) for other in laws
    ]  # fmt: skip
    return float(np.mean(same))


def judge(
    p: float,
    errors: Sequence[CvErrors],
    laws: Sequence[LearntLaw | None],
    fitter: Fitter,
    draft: LawCandidate,
) -> tuple[str, tuple[str, ...]]:
    """Decide from p value, held-out errors and folds whether a law is drafted.

    Parameters
    ----------
    p
        p value of the permutations, 0 to 1.
    errors, laws
        As returned by `left_out`.
    fitter
        Fitter that fitted the draft.
    draft
        The law chosen from all points of the search; errors are whitened by its scatter.

    Returns
    -------
    verdict : str
        law, unstable or weak (`Sought.verdict`).
    reasons : tuple of str
        The evidence against the law, in sentences; empty for `law`.
    """
    fall, z = _gain(errors, fitter, draft.fit)
    against = []
    if p > SURE:
        against.append(f"such a gain comes by chance with p {p:.2g}, and a law needs {SURE:g}")
    if fall <= _LEAST_FALL:
        against.append("on settings that the search never saw the error hardly falls")
    elif z <= _LEAST_Z:
        against.append("the fall of the error on settings never seen is within its standard error")
    if against:
        return "weak", tuple(against)
    agree = agreeing(laws, draft.law)
    if agree < _MAJORITY:
        return "unstable", (f"only {100 * agree:.0f} % of the folds choose what it follows",)
    return "law", ()


def _gain(errors: Sequence[CvErrors], fitter: Fitter, fit: Fit) -> tuple[float, float]:
    """Relative fall of the held-out error by the law, and the mean gain of a setting over its standard error.

    The fall is that of the whitened rms, with large errors limited; the gain is that in log likelihood of
    Student's distribution. Both are positive if the law helps.
    """
    points, yardstick = fitter.points, Yardstick(fitter, fit)
    white = np.array([_by_point(yardstick, points, e.error) for e in errors])
    row = np.unique(points.row, return_index=True)[1]
    setting = np.unique(setting_of(points)[row], return_inverse=True)[1].reshape(-1)
    before, after = (_STUDENT + 1) / 2 * np.log1p(white**2 / _STUDENT).sum(axis=1)
    gap = np.bincount(setting, before - after)
    spread = float(np.std(gap, ddof=1)) / np.sqrt(gap.size)
    most = max(3.0 * float(np.sqrt(np.mean(white[0] ** 2))), 4.0)
    first, second = np.sqrt(np.mean(np.minimum(np.abs(white), most) ** 2, axis=(1, 2))).tolist()
    return 1.0 - second / first, float(gap.mean()) / max(spread, 1e-12)


def _by_point(yardstick: Yardstick, points: Points, errors: Mapping[str, Array]) -> Array:
    """Whitened mean errors of the points, shape (channels, points). errors: by channel, shape (rows,)."""
    names = [points.channels[c] for c in points.channel]
    mean = np.array(
        [np.mean(errors[name][rows]) for name, rows in zip(names, points.rows, strict=True)]
    )
    return yardstick.by_channel(yardstick.white(mean)[:, None])[:, :, 0]
