# SPDX-License-Identifier: Apache-2.0
"""What is no matter of the soil: runs that do not belong to the others, and a fault of the shown sinkage.

A bad run has a digit too many, two rows swapped, a sensor that stuck. A run is held against the other runs of
its setting, and against what a model, fitted to all, predicts of it from the others: with S = V + J P^-1 J'
and Q = S^-1, for the values G of a run,

    e_G - E(e_G | all others) = Q_GG^-1 (Q e)_G,     covariance Q_GG^-1

in units of the channel's own robust deviation of these.

The instrument that shows the sinkage is judged by pull and torque. Their law needs the sinkage and not what
made it: at the sinkage that is shown, less its fault, it has to hold. So a fault is judged without any law of
sinkage, by the evidence of pull and torque with it over that without. A table of one load, whose sinkage a
soil can always imitate, has no other witness.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Array, Effect
from smallwheel_ros.effects.registry import Registry
from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors, compare_cv
from smallwheel_ros.fitting.noise import MOST_OUTLIERS, NORMAL, furthest_off, outlier_limit
from smallwheel_ros.fitting.parameters import EffectPart, Prior, part_of, with_values
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.measurements.display import number, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.physics.conditions import Conditions

Index = NDArray[np.intp]

_FEWEST = 3  # runs of a setting, from which its middle is told from a bad one
_SHOWN = "shown_sinkage"  # the column in which a point carries what its instrument showed
_LEAST = 1e-4  # m: a wheel on the ground
_STARTS = (0.0, -1.0, 1.0)  # prior deviations


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


# --- A fault of the shown sinkage


@dataclass(frozen=True)
class Witness:
    """A fault of the shown sinkage that pull and torque ask for.

    part: the effect under its prior. told: the same, with what they know of its number as its prior, for
    channels that do not include them. evidence: nats with it over without. probability: of it, before
    anything else is looked at. base, errors: the model without it, and its held-out errors.
    """

    part: EffectPart
    told: EffectPart
    evidence: float
    probability: float
    base: Fit
    errors: CvErrors


@dataclass(frozen=True)
class _AsShown(Effect):
    """The sinkage that the instrument showed, less its fault: in the place of every law of sinkage."""

    id = "as_shown"
    needs: ClassVar[tuple[str, ...]] = (_SHOWN,)
    fault: Effect | None = None

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        shown = conditions[_SHOWN]
        if self.fault is not None:
            zero, one = (
                self.fault.measured_sinkage(np.full_like(shown, z), conditions) for z in (0.0, 1.0)
            )
            shown = (shown - zero) / (one - zero)
        return np.maximum(shown, _LEAST)


def fault_told(problem: Problem, registry: Registry, without: Collection[str]) -> Witness | None:
    """The fault of the shown sinkage that pull and torque name, and that lowers a held-out error."""
    points = problem.points
    if points.run_count < constants.FEWEST_RUNS or "sinkage" not in points.channels:
        return None
    if not points.forces or len(mine := _as_measured(points)) < 2:
        return None
    alone = Problem(mine, Base(effects=(_AsShown(),)), judging=True)
    fitter, none = alone.fitter, alone.fit
    share = constants.EXPECTED_EFFECTS / len(registry.families)
    faults = _faults(registry, {*without, *problem.base.names})
    made = [one for fault in faults if (one := _with(fitter, none, fault)) is not None]
    part, told, evidence = max(made, key=lambda one: one[-1], default=(None, None, -np.inf))
    odds = share * float(np.exp(min(evidence, 50.0)))
    probability = odds / (1.0 + odds)
    if part is None or told is None or probability < constants.NAMED:
        return None
    before, after = problem.held_out(), problem.with_part(part, told).held_out()
    if before is None or after is None or not compare_cv(before, after).helps:
        return None
    return Witness(part, told, evidence, probability, problem.judged.fit, before)


def _faults(registry: Registry, blocked: Collection[str]) -> Iterator[Effect]:
    """Effects of one number that change what the instrument shows, in proportion or by a constant."""
    for form in (form for forms in registry.families.values() for form in forms):
        alone = form.stage == "measured_sinkage" and not form.needs and form.id not in blocked
        if form.kind == "instrument" and alone and len(form.parameters()) == 1:
            yield form()


def _as_measured(points: Points) -> Points:
    """Pull and torque where the sinkage was measured too, with it as a column."""
    shown = np.full(len(points.conditions), np.nan)
    mine = points.of_channel("sinkage")
    shown[points.row[mine]] = points.value[mine]
    forces = np.any([points.of_channel(name) for name in points.forces], axis=0)
    kept = points.take(forces & np.isfinite(shown)[points.row]).only(points.forces)
    column = np.where(np.isfinite(shown), shown, _LEAST)
    covariates = {**points.conditions.covariates, _SHOWN: column}
    return replace(kept, conditions=replace(points.conditions, covariates=covariates))


def _with(fitter: Fitter, none: Fit, effect: Effect) -> tuple[EffectPart, EffectPart, float] | None:
    """One fault under its prior and as it is told, and its evidence; None where it cannot be fitted."""
    (known,) = effect.parameters()
    middle = float(known.neutral or 0.0)
    wide = constants.SHOWN_SINKAGE if known.unit == "m" else constants.INSTRUMENT
    plain = part_of(effect, {known.name: Prior(middle, wide, *known.bounds)})
    part = replace(plain, build=lambda numbers: _AsShown(with_values(effect, numbers)))
    vector = replace(none.vector, fixed=(), parts=(part,))
    fits = []
    for start in _STARTS:
        theta = vector.begun_at(none.vector, none.theta)
        theta[-1] = np.clip(middle + start * wide, *known.bounds)
        try:
            fits.append(fitter.fit(fitter.at(vector, theta, none.scatter)))
        except FAILURES:
            continue
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.evidence)
    told = Prior(float(best.theta[-1]), float(np.sqrt(best.covariance[-1, -1])), *known.bounds)
    return plain, part_of(effect, {known.name: told}), best.evidence - none.evidence
