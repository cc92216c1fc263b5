# SPDX-License-Identifier: Apache-2.0
"""Faults of the instrument that measures sinkage, as pull and torque reveal them.

The law of pull and torque needs the sinkage, whatever its cause: it must hold at the shown sinkage
minus the instrument's fault. A fault is therefore judged without any law of sinkage, by the
evidence of pull and torque with the fault over that without. In a table with one load, whose
sinkage some soil can always imitate, there is no other evidence of a fault.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from smallwheel_ros.effects.base import Array, Effect
from smallwheel_ros.effects.registry import Registry
from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors, compare_cv
from smallwheel_ros.fitting.parameters import (
    EffectPart,
    Prior,
    instrument_prior,
    part_of,
    with_values,
)
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.physics.conditions import Conditions

_SHOWN = "shown_sinkage"  # the column in which a point carries what its instrument showed
_LEAST = 1e-4  # m: a wheel on the ground
_STARTS = (0.0, -1.0, 1.0)  # prior deviations


@dataclass(frozen=True)
class Witness:
    """A fault of the shown sinkage that pull and torque indicate.

    Attributes
    ----------
    part
        The fault as an effect with its usual prior.
    informed
        The same effect with another prior, the posterior that pull and torque gave; for fits without these
        channels.
    evidence
        ln evidence of pull and torque with the fault minus that without it, nats.
    probability
        Probability of the fault, from pull and torque alone.
    base, errors
        The model without the fault, and its held-out errors.
    """

    part: EffectPart
    informed: EffectPart
    evidence: float
    probability: float
    base: Fit
    errors: CvErrors


@dataclass(frozen=True)
class _AsShown(Effect):
    """Sinkage as the instrument showed it, corrected for a fault, in place of every law of sinkage."""

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


def gauge_fault(problem: Problem, registry: Registry, without: Collection[str]) -> Witness | None:
    """Find a fault of the sinkage gauge that pull and torque support and that lowers a held-out error.

    Parameters
    ----------
    problem
        The table and the base model.
    registry
        All effects; the faults are those of one parameter that change the shown sinkage.
    without
        Ids of effects that do not compete.

    Returns
    -------
    Witness or None
        None where there is no such fault, or the table cannot show one: without sinkage, without pull and
        torque, or with fewer than `FEWEST_RUNS` runs.
    """
    points = problem.points
    if points.run_count < constants.FEWEST_RUNS or "sinkage" not in points.channels:
        return None
    if not points.forces or len(mine := _as_measured(points)) < 2:
        return None
    alone = Problem(mine, Base(effects=(_AsShown(),)), judging=True)
    fitter, none = alone.fitter, alone.fit
    faults = _faults(registry, {*without, *problem.base.names})
    made = [one for fault in faults if (one := _with(fitter, none, fault)) is not None]
    part, informed, evidence = max(made, key=lambda one: one[-1], default=(None, None, -np.inf))
    probability = _probability(evidence, len(registry.families))
    if part is None or informed is None or probability < constants.NAMED:
        return None
    before, after = problem.held_out(), problem.with_part(part, informed).held_out()
    if before is None or after is None or not compare_cv(before, after).helps:
        return None
    return Witness(part, informed, evidence, probability, problem.judged.fit, before)


def _probability(evidence: float, families: int) -> float:
    """Probability of one fault from its evidence (nats) and its prior odds, `EXPECTED_EFFECTS` / families."""
    odds = constants.EXPECTED_EFFECTS / families * float(np.exp(min(evidence, 50.0)))
    return odds / (1.0 + odds)


def _faults(registry: Registry, blocked: Collection[str]) -> Iterator[Effect]:
    """Effects of one number that change what the instrument shows, in proportion or by a constant."""
    for form in (form for forms in registry.families.values() for form in forms):
        alone = form.stage == "measured_sinkage" and not form.needs and form.id not in blocked
        if form.kind == "instrument" and alone and len(form.parameters()) == 1:
            yield form()


def _as_measured(points: Points) -> Points:
    """Values of pull and torque at points with a measured sinkage, which is added as a column."""
    shown = np.full(len(points.conditions), np.nan)
    mine = points.of_channel("sinkage")
    shown[points.row[mine]] = points.value[mine]
    forces = np.any([points.of_channel(name) for name in points.forces], axis=0)
    kept = points.take(forces & np.isfinite(shown)[points.row]).only(points.forces)
    column = np.where(np.isfinite(shown), shown, _LEAST)
    covariates = {**points.conditions.covariates, _SHOWN: column}
    return replace(kept, conditions=replace(points.conditions, covariates=covariates))


def _with(fitter: Fitter, none: Fit, effect: Effect) -> tuple[EffectPart, EffectPart, float] | None:
    """Fit one fault to pull and torque; None where it cannot be fitted.

    Returns the effect with its prior, with its posterior as prior, and its evidence over none (nats).
    """
    (known,) = effect.parameters()
    prior = instrument_prior(known, 1.0)
    plain = part_of(effect, {known.name: prior})
    part = replace(plain, build=lambda numbers: _AsShown(with_values(effect, numbers)))
    vector = replace(none.vector, fixed=(), parts=(part,))
    fits = []
    for start in _STARTS:
        theta = vector.begun_at(none.vector, none.theta)
        theta[-1] = np.clip(prior.centre + start * prior.deviation, *known.bounds)
        try:
            fits.append(fitter.fit(fitter.at(vector, theta, none.scatter)))
        except FAILURES:
            continue
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.evidence)
    posterior = Prior(float(best.theta[-1]), float(np.sqrt(best.covariance[-1, -1])), *known.bounds)
    return plain, part_of(effect, {known.name: posterior}), best.evidence - none.evidence
