# SPDX-License-Identifier: Apache-2.0
"""Runs that do not belong to the others: a digit too many, two rows swapped, a sensor that stuck.

A run is held against the other runs of its setting, and against what a model, fitted to all, predicts of
it from the others: with S = V + J P^-1 J' and Q = S^-1, for the values G of a run,

    e_G - E(e_G | all others) = Q_GG^-1 (Q e)_G,     covariance Q_GG^-1

in units of the channel's own robust deviation of these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.fit import Fit, Fitter, stiffness, taken_up
from smallwheel_ros.fitting.noise import MOST_OUTLIERS, NORMAL, furthest_off, outlier_limit
from smallwheel_ros.fitting.points import Points

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_FEWEST = 3  # runs of a setting, from which its middle is told from a bad one


@dataclass(frozen=True)
class BadRun:
    """A run that lies far off. rows: of the table. deviations: robust, of `channel`. against: of what."""

    name: str
    rows: Index
    channel: str
    deviations: float
    against: str


def bad_runs(fitter: Fitter, fit: Fit) -> list[BadRun]:
    """The runs that lie grossly off, the worst of the repeated settings and the worst of the model."""
    points = fitter.points
    found = _off_repeats(points) or _off_model(fitter, fit)
    return found if points.run_count > 2 * _FEWEST else []


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
    for c in range(len(points.channels)):
        mine = np.flatnonzero((points.channel == c) & ~points.swept)
        settings = np.unique(points.setting[mine])
        members = [mine[points.setting[mine] == s] for s in settings]
        members = [m for m in members if m.size >= _FEWEST]
        if not members:
            continue
        for g, i in furthest_off([points.value[m] for m in members]):
            others = np.delete(points.value[members[g]], i)
            ratio = float(points.value[members[g][i]] / np.median(others))
            bad = _run(points, int(members[g][i]), ratio, "times the others of its setting")
            found[bad.name] = bad
    return list(found.values())


def _off_model(fitter: Fitter, fit: Fit) -> list[BadRun]:
    """The run that lies furthest off what the model predicts of it from the others."""
    points = fitter.points
    stiff = stiffness(fit.vector, fit.slopes)
    v = fitter.variance.covariance(fit.scatter, stiff, taken_up(fit.vector, fit.theta, fit.slopes))
    pulled = v.solve(points.value - fit.predicted + fit.slopes @ (fit.theta - fit.vector.centre))
    off = np.full(len(points), np.nan)
    for index, parts in zip(fitter.variance.blocks, v.inverse_parts(), strict=True):
        for block, part in zip(index, parts, strict=True):
            for run in np.unique(points.run[block]):
                place = np.flatnonzero((points.run[block] == run) & ~points.swept[block])
                if place.size:
                    covariance = np.linalg.inv(part[np.ix_(place, place)])
                    away = covariance @ pulled[block[place]]
                    off[block[place]] = away / np.sqrt(np.diag(covariance))
    worst, furthest = -1, 0.0
    for c in range(len(points.channels)):
        mine = np.flatnonzero((points.channel == c) & np.isfinite(off))
        if mine.size <= 2 * _FEWEST:
            continue
        size = np.abs(off[mine]) / (NORMAL * float(np.median(np.abs(off[mine]))))
        limit = outlier_limit(mine.size)
        few = np.count_nonzero(size > limit) <= most_bad(mine.size)
        if few and size.max() > max(limit, furthest):
            worst, furthest = int(mine[np.argmax(size)]), float(size.max())
    return [] if worst < 0 else [_run(points, worst, furthest, "deviations off the best model")]
