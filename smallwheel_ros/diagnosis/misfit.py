# SPDX-License-Identifier: Apache-2.0
"""What a verdict may not be calm over: bad runs, a model's misfit to its repeats, a sensor at its end.

Bad runs do not belong to the others: a digit too many, two rows swapped, a sensor that stuck. A run is held
against the other runs of its setting, and against what a model, fitted to all, predicts of it from the
others: with S = V + J P^-1 J' and Q = S^-1, for the values G of a run,

    e_G - E(e_G | all others) = Q_GG^-1 (Q e)_G,     covariance Q_GG^-1

in units of the channel's own robust deviation of these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from smallwheel_ros.diagnosis.held_out import HeldOut
from smallwheel_ros.diagnosis.posterior import Posterior
from smallwheel_ros.diagnosis.residuals import setting_of
from smallwheel_ros.diagnosis.search import Search
from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.noise import MOST_OUTLIERS, NORMAL, furthest_off, outlier_limit
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.measurements.display import number, words
from smallwheel_ros.measurements.table import Measurements

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_FEWEST = 3  # runs of a setting, from which its middle is told from a bad one
_PLATEAU = 4  # values at least
_DRAWS = 999


@dataclass(frozen=True)
class BadRun:
    """A run that lies far off. rows: of the table. deviations: robust, of `channel`. against: of what."""

    name: str
    rows: Index
    channel: str
    deviations: float
    against: str

    def words(self, measurements: Measurements) -> str:
        """That it is left out, and why."""
        lines = ", ".join(str(line) for line in measurements.line[self.rows][:5])
        where = f"{measurements.source}, {measurements.place} {lines}"
        return (
            f"run {self.name} ({where}) is left out: its {words(self.channel)} "
            f"is {number(self.deviations, 2)} {self.against}. Look it up in the protocol"
        )


def bad_runs(fitter: Fitter, fit: Fit) -> list[BadRun]:
    """The runs that lie grossly off, the worst of the repeated settings and the worst of the model."""
    if fitter.points.run_count <= 2 * _FEWEST:
        return []
    return _off_repeats(fitter.points) or _off_model(fitter, fit)


def most_bad(runs: int) -> float:
    """How many runs may be bad: more are no slips of the pen. Two that were swapped are one."""
    return max(2.0, MOST_OUTLIERS * runs)


def _run(points: Points, value: int, deviations: float, against: str) -> BadRun:
    mine = np.flatnonzero(points.run == points.run[value])
    rows = np.unique(np.concatenate([points.rows[i] for i in mine]))
    channel = points.channels[points.channel[value]]
    return BadRun(points.runs[points.run[value]], rows, channel, deviations, against)


def _off_repeats(points: Points) -> list[BadRun]:
    """Runs far off the others of their setting, where that has at least `_FEWEST`."""
    found = {}
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & ~points.swept)
        members = [mine[points.setting[mine] == s] for s in np.unique(points.setting[mine])]
        members = [m for m in members if m.size >= _FEWEST]
        for g, i in furthest_off([points.value[m] for m in members]) if members else ():
            others = np.delete(points.value[members[g]], i)
            ratio = float(points.value[members[g][i]] / np.median(others))
            bad = _run(points, int(members[g][i]), ratio, "times the others of its setting")
            found[bad.name] = bad
    return list(found.values())


def _off_model(fitter: Fitter, fit: Fit) -> list[BadRun]:
    """The run that lies furthest off what the model predicts of it from the others."""
    points = fitter.points
    s = fitter.covariance(fit, fit.taken_up)
    pulled, inverse = s.solve(fit.away(points.value)), s.solve(np.eye(len(points)))
    off = np.full(len(points), np.nan)
    for run in np.unique(points.run[~points.swept]):
        place = np.flatnonzero((points.run == run) & ~points.swept)
        covariance = np.linalg.inv(inverse[np.ix_(place, place)])
        off[place] = covariance @ pulled[place] / np.sqrt(np.diag(covariance))
    worst, furthest = -1, 0.0
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & np.isfinite(off))
        if mine.size <= 2 * _FEWEST:
            continue
        size = np.abs(off[mine]) / (NORMAL * float(np.median(np.abs(off[mine]))))
        limit = outlier_limit(mine.size)
        few = np.count_nonzero(size > limit) <= most_bad(mine.size)
        if few and size.max() > max(limit, furthest):
            worst, furthest = int(mine[np.argmax(size)]), float(size.max())
    return [] if worst < 0 else [_run(points, worst, furthest, "deviations off the best model")]


@dataclass(frozen=True)
class LackOfFit:
    """What a model leaves of a channel's settings against what runs of one setting differ by.

    ratio: root of F, the misfit in deviations of a setting's mean. misfit: root mean square relative
    misfit of the settings. at: the setting that is furthest off, in words.
    """

    ratio: float
    p: float
    misfit: float
    at: str


def lack_of_fit(fitter: Fitter, fit: Fit) -> dict[str, LackOfFit]:
    """The F test of lack of fit (Fisher 1922; Draper and Smith 1998, ch. 2) by channel.

    F = sum n m^2 / (settings - parameters)  over  sum (r - m)^2 / (runs - settings) + n u^2,
    r the relative residual of a run, m the mean of a setting's n runs. No law is exact: u is what laws
    are usually off by, at most. Only channels with settings that several runs repeat.
    """
    points, found = fitter.points, {}
    share = (points.value - fit.predicted) / fitter.level
    pulled = fitter.covariance(fit).solve(fit.slopes)
    leverage = np.sum((fit.slopes @ fit.covariance) * pulled, axis=1)
    usual = constants.LACK_OF_FIT * np.exp(constants.SPREAD)
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & ~points.swept)
        setting = np.unique(points.setting[mine], return_inverse=True)[1].reshape(-1)
        count = np.bincount(setting)
        spare = count.size - float(leverage[mine].sum())
        repeats = mine.size - count.size
        if repeats < 1 or spare < 1.0:
            continue
        mean = np.bincount(setting, share[mine]) / count
        off = float(np.sum(count * mean**2)) / spare
        apart = float(np.sum((share[mine] - mean[setting]) ** 2)) / repeats
        noise = apart + float(count.mean()) * usual**2
        worst = mine[setting == int(np.argmax(np.abs(mean) * np.sqrt(count)))]
        found[name] = LackOfFit(
            float(np.sqrt(off / noise)),
            float(fdtrc(spare, repeats, off / noise)),
            float(np.sqrt(np.mean(mean**2))),
            setting_of(points, worst),
        )
    return found


@dataclass(frozen=True)
class Plateau:
    """The largest values of a channel, which lie closer together than scatter lets values do."""

    count: int
    value: float
    span: float
    p: float


def plateaus(fitter: Fitter, fit: Fit) -> dict[str, Plateau]:
    """By channel of positive values, how close its largest are: a sensor at its end shows one and the same.

    The statistic is the largest of -ln(variance of ln y over the k largest values), k up to half of them,
    each standardised; its law comes from data drawn from the fit with its scatter, in steps of the data's
    resolution.
    """
    points, found = fitter.points, {}
    deviation = np.sqrt(np.diag(fitter.covariance(fit).matrix))
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & ~points.swept)
        measured, predicted = points.value[mine], fit.predicted[mine]
        if name in FORCES or mine.size < 2 * _PLATEAU:
            continue
        if min(measured.min(), predicted.min()) <= 0.0:
            continue
        resolution = float(np.diff(np.unique(measured), prepend=0.0).min())
        noise = np.random.default_rng(17).normal(size=(_DRAWS, measured.size))
        drawn = predicted * np.exp(deviation[mine] / predicted * noise)
        drawn = np.maximum(np.rint(drawn / resolution), 1.0) * resolution
        top = np.log(
            np.sort(np.vstack([measured, drawn]), axis=1)[:, : -measured.size // 2 - 1 : -1]
        )
        count = np.arange(1, top.shape[1] + 1)
        apart = top - top[:, :1]
        spread = np.cumsum(apart**2, axis=1) / count - (np.cumsum(apart, axis=1) / count) ** 2
        rounding = (resolution / measured.max()) ** 2 / 12.0
        close = -np.log(np.maximum(spread, 0.0) + rounding)[:, _PLATEAU - 1 :]
        flat = (close - close[1:].mean(axis=0)) / close[1:].std(axis=0)
        best = flat.max(axis=1)
        k = int(np.argmax(flat[0])) + _PLATEAU
        p = float((1 + np.sum(best[1:] >= best[0])) / (1 + _DRAWS))
        value, span = float(np.exp(top[0, :k].mean())), float(np.expm1(-apart[0, k - 1]))
        found[name] = Plateau(k, value, span, p)
    return found


@dataclass(frozen=True)
class Misfit:
    """What the best explanation leaves that chance does not. lack_of_fit, plateaus: by channel."""

    lack_of_fit: Mapping[str, LackOfFit]
    plateaus: Mapping[str, Plateau]
    scatter: Mapping[str, float]


def misfit_of(found: Search, posterior: Posterior, held: HeldOut) -> Misfit:
    """Of the model with what is named, where no more is open; of the base, where nothing is missing."""
    rivals = posterior.rivals or held.useless
    named_alone = held.named and not rivals and not posterior.unknown
    model = held.best if named_alone else found.ordered[0]
    judged = found.none if posterior.word == "adequate" else model
    return Misfit(
        lack_of_fit(found.fitter, judged),
        plateaus(found.fitter, judged),
        model.scatter.deviations,
    )
