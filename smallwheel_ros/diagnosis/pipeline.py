"""The diagnosis from measurements to document; each step is in a module of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smallwheel_ros.diagnosis.apply import without_corrections
from smallwheel_ros.diagnosis.blocks import condense
from smallwheel_ros.diagnosis.candidates import Family, list_families, measured_forces
from smallwheel_ros.diagnosis.document import (
    SCHEMA,
    insufficient,
    plain,
    proposal_entry,
    ranking_entry,
    region_entry,
)
from smallwheel_ros.diagnosis.geometry import (
    FREE_SOIL,
    judge_geometry,
    on_the_integral,
    with_geometry,
    with_row,
)
from smallwheel_ros.diagnosis.geometry import NAME as GEOMETRY
from smallwheel_ros.diagnosis.held_out import Errors, noise_floor, refitted
from smallwheel_ros.diagnosis.next_measurement import Proposal, propose
from smallwheel_ros.diagnosis.ranking import Row, rank
from smallwheel_ros.diagnosis.regions import where_it_fails
from smallwheel_ros.diagnosis.search import ALARM, Search, search
from smallwheel_ros.diagnosis.ties import Tie, drivers, find_ties
from smallwheel_ros.diagnosis.verdict import Finding, decide
from smallwheel_ros.diagnosis.workbench import Base, Explanation, Workbench
from smallwheel_ros.effects.registry import Registry
from smallwheel_ros.fitting.calibrate import Calibration, calibrate
from smallwheel_ros.fitting.observations import Observations, observe
from smallwheel_ros.fitting.result import FitResult, result_of
from smallwheel_ros.measurements.noise_floor import repeatability
from smallwheel_ros.measurements.table import Measurements

FEWEST_RUNS = 6
_MOST_PROPOSALS = 3

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """The base (added None) or an effect that was added, with the held-out errors after it."""

    added: str | None
    explanation: Explanation
    errors: Errors


@dataclass(frozen=True)
class Diagnosis:
    """A diagnosis. document: what the JSON holds. The rest is what the document was made from.

    search, finding and workbench are None, and steps empty, where the data is insufficient;
    calibration too where there is one measurement only.
    """

    document: dict[str, Any]
    measurements: Measurements
    calibration: Calibration | None = None
    workbench: Workbench | None = None
    search: Search | None = None
    finding: Finding | None = None
    steps: tuple[Step, ...] = ()

    def fitted(self, step: int) -> FitResult:
        """The model of a step as a fit of its own, its noise and outliers estimated with it."""
        assert self.calibration is not None
        explanation = self.steps[step].explanation
        return result_of(without_corrections(self.calibration.observations, explanation))


def diagnose(
    measurements: Measurements,
    base: Base | None = None,
    *,
    registry: Registry | None = None,
    seed: int = 0,
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
        Of everything random (bootstrap, permutations): the same seed gives the same document.
    progress
        Told each step in words.

    Raises
    ------
    FittingError
        Where nothing usable was measured.
    """
    asked = base or Base()
    base = asked if asked.geometry == "contact_integral" else on_the_integral(asked)
    measurements = condense(measurements)
    observations = observe(measurements)
    present = [effect.id for effect in base.effects]
    results = measured_forces(measurements.units)
    families = list_families(observations, present, base.geometry, registry, results)
    progress("fitting the base model")
    reason = _insufficient(observations)
    if len(observations) < 2:  # not even a fit
        none = _not_testable(families, reason)
        return Diagnosis(
            insufficient(reason, {}, {}, none, measurements.notes, measurements.warnings),
            measurements,
        )
    calibration = calibrate(observations, base.layout(observations))
    if reason:
        return _too_little(measurements, calibration, families, reason)
    workbench = Workbench(calibration, base)
    progress("testing each effect")
    found = search(workbench, families, seed)
    ties = find_ties(observations)
    finding = decide(found, families, ties)
    progress("held-out error of each step")
    steps = _steps(workbench, found, finding)
    progress("ranking")
    rows = rank(found, families, finding)
    lack_of_fit = _lack_of_fit(found)
    notes = _notes(calibration, measurements, base)
    if asked is not base:
        notes.append(FREE_SOIL)
        geometry = judge_geometry(workbench, asked, steps[-1].explanation)
        finding, rows = with_geometry(finding, geometry), with_row(rows, geometry)
        lack_of_fit["p_value"] = min(lack_of_fit["p_value"], geometry.p)
        if finding.named[:1] == (GEOMETRY,):
            first = Step(None, geometry.base, geometry.errors)
            steps = [first, replace(steps[0], added=GEOMETRY), *steps[1:]]
    regions = where_it_fails(
        workbench.observations,
        steps[0].errors,
        seed,
        results,
        certain=lack_of_fit["p_value"] < ALARM,
    )
    proposals = _proposals(workbench, found, finding, families, ties)
    floors = noise_floor(workbench, found.best)
    repeats = repeatability(measurements)
    document = {
        "schema": SCHEMA,
        "verdict": finding.verdict,
        "reason": "; ".join(finding.reasons),
        "missing_effects": list(finding.named),
        "candidates": list(finding.candidates),
        "channels": _channels(calibration, steps[0].errors, floors, repeats),
        "lack_of_fit": lack_of_fit,
        "where_it_fails": [region_entry(region) for region in regions],
        "ranking": [ranking_entry(row) for row in rows],
        "steps": [{"added": s.added, "held_out_rmse": s.errors.rmse()} for s in steps],
        "next_measurements": [proposal_entry(proposal) for proposal in proposals],
        "ties": [
            {"settings": [t.first, t.second], "correlation": t.correlation}
            for t in ties
            if t.first < t.second
            or not any((u.first, u.second) == (t.second, t.first) for u in ties)
        ],
        "run_scatter": dict(
            zip(workbench.effects.names, found.best.fit.scatter.tau.tolist(), strict=True)
        ),
        "notes": notes,
        "warnings": list(measurements.warnings),
    }
    return Diagnosis(
        plain(document), measurements, calibration, workbench, found, finding, tuple(steps)
    )


def _insufficient(observations: Observations) -> str:
    runs = np.unique(observations.run).size
    if runs < FEWEST_RUNS:
        return (
            f"{runs} run{'s' if runs != 1 else ''}: under {FEWEST_RUNS} runs nothing can be told from the "
            "scatter of the soil; rows of one run are repeats, not more runs"
        )
    if not drivers(observations):
        return "every setting is the same in all rows: vary at least the load"
    return ""


def _not_testable(families: Sequence[Family], reason: str) -> list[Row]:
    return [Row(f.name, "not_testable", f.blocked or reason) for f in families]


def _too_little(
    measurements: Measurements, calibration: Calibration, families: Sequence[Family], reason: str
) -> Diagnosis:
    observations = calibration.kept_observations
    residual = observations.value - calibration.fit.solution.predicted
    errors = Errors(
        residual,
        calibration.effects.variance,
        observations.run,
        observations.channel,
        observations.channels,
    )
    rows = _not_testable(families, reason)
    notes = [
        "the errors given here are in sample: with so little data nothing was held out",
        *result_of(calibration).notes,
        *measurements.notes,
    ]
    document = insufficient(
        reason,
        _channels(calibration, errors, {}, {}),
        errors.rmse(),
        rows,
        notes,
        measurements.warnings,
    )
    return Diagnosis(document, measurements, calibration)


def _steps(workbench: Workbench, found: Search, finding: Finding) -> list[Step]:
    steps = [Step(None, found.base, refitted(workbench, found.base))]
    forms = {form.family: form for form in found.best.forms}
    near = found.base
    for i, name in enumerate(finding.named):
        near = workbench.fit([forms[n] for n in finding.named[: i + 1]], near=found.best)
        steps.append(Step(name, near, refitted(workbench, near)))
    return steps


def _proposals(
    workbench: Workbench,
    found: Search,
    finding: Finding,
    families: Sequence[Family],
    ties: Sequence[Tie],
) -> list[Proposal]:
    follows = {family.name: family.drivers for family in families}
    proposals = []
    for first, second in finding.pairs[: 2 * _MOST_PROPOSALS]:
        rest = found.best.without(first)
        lead = found.first.lead(second)
        if lead is None:
            continue
        options = [
            e
            for e in workbench.known()
            if second in e.families
            and sorted(e.families) == sorted((*(f.family for f in rest), second))
        ]
        if options:
            rival = min(options, key=lambda e: e.cost)
        else:
            rival = workbench.fit((*rest, lead.form), near=found.base)
        between = [
            tie
            for tie in ties
            if (tie.first in follows[first] and tie.second in follows[second])
            or (tie.second in follows[first] and tie.first in follows[second])
        ]
        proposal = propose(workbench, found.best, rival, (first, second), between)
        if proposal is not None:
            proposals.append(proposal)
    return proposals[:_MOST_PROPOSALS]


def _channels(
    calibration: Calibration,
    errors: Errors,
    floors: Mapping[str, float],
    repeats: Mapping[str, float],
) -> dict[str, dict[str, Any]]:
    rmse, bias = errors.rmse(), errors.bias()
    found = {}
    for name in calibration.observations.channels:
        noise = calibration.noise.channels[name]
        known = noise.source in ("repeats", "declared")
        found[name] = {
            "rows": int(calibration.observations.of_channel(name).sum()),
            "rmse": rmse[name],
            "bias": bias[name],
            "noise_floor": floors.get(name) if known else None,
            "noise_floor_source": noise.source if known and name in floors else None,
            "repeatability": repeats.get(name),
            "noise": {"absolute": noise.absolute, "relative": noise.relative},
        }
    return found


def _lack_of_fit(found: Search) -> dict[str, Any]:
    first, last = found.first, found.last
    return {
        "p_value": min(1.0, 3.0 * min(first.p_any, first.p_generic, first.p_soil)),
        "effects_p_value": first.p_any,
        "any_condition_p_value": first.p_generic,
        "strongest_condition": first.generic,
        "soil_p_value": first.p_soil,
        "after_steps": {
            "effects_p_value": last.p_any,
            "any_condition_p_value": last.p_generic,
            "strongest_condition": last.generic,
        },
    }


def _notes(calibration: Calibration, measurements: Measurements, base: Base) -> list[str]:
    notes = [*result_of(calibration).notes, *measurements.notes]
    if base.priors:
        names = ", ".join(base.priors)
        notes.append(
            f"the soil ({names}) was known beforehand; it was refitted within its covariance"
        )
    flagged = np.flatnonzero(~calibration.kept)
    if flagged.size:
        lines = measurements.line[calibration.observations.row[flagged]]
        shown = ", ".join(str(line) for line in np.unique(lines)[:20])
        notes.append(f"outliers are in lines {shown}")
    return notes
