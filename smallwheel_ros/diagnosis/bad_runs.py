# SPDX-License-Identifier: Apache-2.0
"""Finds runs with gross errors: a digit too many, two swapped rows, a sensor that got stuck.

A run is compared with the other runs of its setting, and with the prediction by a model fitted to all runs,
conditional on the others: with S = V + J P^-1 J' and Q = S^-1, for the values G of a run,

    e_G - E(e_G | all others) = Q_GG^-1 (Q e)_G,     covariance Q_GG^-1

in units of the channel's own robust deviation of these. A curve counts once, by the root mean square of its
values, since they share their error. A stuck gauge shows a sinkage that does not rise with the load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Array
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.noise import (
    MOST_OUTLIERS,
    NORMAL,
    NoiseLine,
    furthest_off,
    outlier_limit,
)
from smallwheel_ros.fitting.points import Points, runs_of
from smallwheel_ros.fitting.variance import Scatter
from smallwheel_ros.measurements.display import number, words
from smallwheel_ros.measurements.measurements import Measurements

Index = NDArray[np.intp]

_FEWEST = 3  # runs of a setting, from which its middle is told from a bad one
_RISES = (
    0.2  # power of the load that a sinkage rises with at least: at n = 2.9 a wheel's still has 0.3
)
_TIMES = (
    2.0  # load of the upper over that of the lower third of a curve, from which that power is known
)
_SURELY = 2.0  # deviations by which a line through the table must rise by less
_SHALLOWEST = 1e-6  # m


@dataclass(frozen=True)
class BadRun:
    """A run whose values are grossly wrong.

    Attributes
    ----------
    name
        Name of the run.
    rows
        Numbers of its rows in the table, shape (rows,).
    channel
        The channel that is wrong.
    deviations
        Size of the error: robust standard deviations from the model, or a ratio to other values; `against`
        says which.
    against
        What `deviations` counts and what the run was compared with, in words that continue the number, such
        as `times the others of its setting`.
    """

    name: str
    rows: Index
    channel: str
    deviations: float
    against: str

    def words(self, measurements: Measurements) -> str:
        """Return a sentence that the run is left out, and why."""
        lines = ", ".join(str(line) for line in measurements.line[self.rows][:5])
        where = f"{measurements.source}, {measurements.place} {lines}"
        return (
            f"run {self.name} ({where}) is left out: its {words(self.channel)} "
            f"is {number(self.deviations, 2)} {self.against}. Look it up in the protocol"
        )


def bad_runs(fitter: Fitter, fit: Fit) -> list[BadRun]:
    """Find the runs that are grossly wrong.

    Stuck sensors come first. If there are none, runs are compared with repeats of their setting; if none of
    these is wrong, with the model.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`, of the base model or of a better one.

    Returns
    -------
    list of BadRun
        At most one run that is wrong only by comparison with the model; empty for tables of six runs or
        fewer.
    """
    if fitter.points.run_count <= 2 * _FEWEST:
        return []
    return _stuck_runs(fitter.points) or _off_repeats(fitter.points) or _off_model(fitter, fit)


class _Rise(NamedTuple):
    """How sinkage rises with the load.

    Attributes
    ----------
    times
        Factor by which the load rises.
    power
        Power of the load to which the sinkage is proportional.
    """

    times: float
    power: float


def stuck(points: Points) -> str:
    """Return a clause that the table's sinkage does not rise with the load; empty if it does.

    Also empty where the load was hardly varied.
    """
    if "sinkage" not in points.channels:
        return ""
    rises = [rise for _, rise in _rises(points)] or _rise_of_line(points)
    if not rises or float(np.median([rise.power for rise in rises])) > _RISES:
        return ""
    times = number(max(rise.times for rise in rises), 2)
    return (
        f"the sinkage does not rise while the load rises {times} fold: the gauge does not move, or the "
        f"ground of {points.measurements.source or 'the table'} is rigid"
    )


def _rises(points: Points) -> Iterator[tuple[int, _Rise]]:
    """Rise of the sinkage from the lower to the upper third of the loads of each run, with the run's index.

    Runs in which the load does not at least double are left out.
    """
    load, sinkage = points.measurements.conditions.load, points.measurements.channels["sinkage"]
    codes = runs_of(points.measurements)[1]
    for run in np.unique(points.run):
        rows = np.flatnonzero((codes == run) & np.isfinite(sinkage))
        if rows.size < 2 * _FEWEST:
            continue
        low, high = (rows[part] for part in _thirds(load[rows]))
        times = float(np.median(load[high]) / np.median(load[low]))
        if times >= _TIMES:
            deep, shallow = (
                max(float(np.median(sinkage[part])), _SHALLOWEST) for part in (high, low)
            )
            yield int(run), _Rise(times, float(np.log(deep / shallow) / np.log(times)))


def _thirds(values: Array) -> tuple[Index, Index]:
    """Places of the lower and of the upper third."""
    low, high = np.quantile(values, [1 / 3, 2 / 3])
    return np.flatnonzero(values <= low), np.flatnonzero(values >= high)


def _rise_of_line(points: Points) -> list[_Rise]:
    """Rise along a regression through a table without curves, with the upper limit of its power.

    Empty where the load was hardly varied.
    """
    mine = points.of_channel("sinkage") & (points.value > 0)
    load = points.column("load")[mine]
    if load.size <= 2 * _FEWEST or load.max() < _TIMES * load.min():
        return []
    given = points.value[mine], points.row[mine], points.conditions
    power, deviation = NoiseLine.through(*given).power_of_load(*given)
    return [_Rise(float(load.max() / load.min()), power + _SURELY * deviation)]


def _stuck_runs(points: Points) -> list[BadRun]:
    """Runs along which the sinkage does not rise with the load, while it does in most others."""
    if "sinkage" not in points.channels or stuck(points):
        return []
    found = []
    for run, (times, power) in _rises(points):
        if power < _RISES:
            mine = np.flatnonzero((points.run == run) & points.of_channel("sinkage"))
            against = (
                f"times as deep at {number(times, 2)} times the load, as if its gauge were stuck"
            )
            found.append(_run(points, int(mine[0]), times**power, against))
    return found if len(found) <= most_bad(points.run_count) else []


def most_bad(runs: int) -> float:
    """Largest number of bad runs that may be clerical errors; two that were swapped count as one."""
    return max(2.0, MOST_OUTLIERS * runs)


def _run(points: Points, value: int, deviations: float, against: str) -> BadRun:
    mine = np.flatnonzero(points.run == points.run[value])
    rows = np.unique(np.concatenate([points.rows[i] for i in mine]))
    channel = points.channels[points.channel[value]]
    return BadRun(points.runs[points.run[value]], rows, channel, deviations, against)


def _off_repeats(points: Points) -> list[BadRun]:
    """Runs far from the others of their setting, where that has at least `_FEWEST`."""
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
    """The run furthest from what the model predicts of it from the others, if it is grossly wrong.

    The scatter is that of all runs. Curves are few, and one of them may hide in the scatter that it causes:
    where none is far off, the scatter of all but the furthest is used (a studentised deviation: Cook and
    Weisberg 1982, ch. 2), and that run has to exceed the limit by it as well as by the robust deviation.
    """
    points = fitter.points
    worst, furthest, is_far = _furthest(fitter, fit, fit.scatter)
    if worst >= 0 and not is_far and points.swept.any():
        stays = points.run != points.run[worst]
        others, kept = fitter.of_values(stays), fit.take(stays)
        scatter = others.variance.fit(
            kept.away(others.points.value),
            kept.taken_up,
            kept.stiffness,
            others.variance.suited(fit.scatter),
        )
        worst, furthest, is_far = _furthest(fitter, fit, fitter.variance.suited(scatter), 1.0)
    return [_run(points, worst, furthest, "deviations off the best model")] if is_far else []


def _furthest(
    fitter: Fitter, fit: Fit, scatter: Scatter, least: float = 0.0
) -> tuple[int, float, bool]:
    """Find the run that is furthest from its prediction under a scatter.

    Returns the index of one of its values (-1 where no channel has enough runs), its distance in robust
    standard deviations, and whether that makes it grossly wrong. `least` is a lower limit of the robust
    deviation, in deviations of the scatter.
    """
    points = fitter.points
    s = fitter.variance.covariance(scatter, fit.stiffness, fit.taken_up)
    pulled, inverse = s.solve(fit.away(points.value)), s.solve(np.eye(len(points)))
    off = np.full(len(points), np.nan)
    for run in np.unique(points.run):
        place = np.flatnonzero(points.run == run)
        covariance = np.linalg.inv(inverse[np.ix_(place, place)])
        off[place] = covariance @ pulled[place] / np.sqrt(np.diag(covariance))
    worst, furthest, is_far = -1, 0.0, False
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & np.isfinite(off))
        if mine.size <= 2 * _FEWEST:
            continue
        # Of a curve one number, since its values are off together.
        runs, first, code = np.unique(points.run[mine], return_index=True, return_inverse=True)
        square = np.bincount(code.reshape(-1), off[mine] ** 2) / np.bincount(code.reshape(-1))
        mine, size = mine[first], np.sqrt(square)
        size /= max(NORMAL * float(np.median(size)), least)
        limit, largest = outlier_limit(runs.size), float(size.max())
        few = np.count_nonzero(size > limit) <= most_bad(runs.size)
        if few and (largest > limit, largest) > (is_far, furthest):
            worst, furthest, is_far = int(mine[np.argmax(size)]), largest, largest > limit
    return worst, furthest, is_far
