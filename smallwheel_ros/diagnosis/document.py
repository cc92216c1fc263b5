# SPDX-License-Identifier: Apache-2.0
"""The diagnosis as plain values, by contract: what is written as JSON."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from smallwheel_ros.common.tables import each
from smallwheel_ros.diagnosis.candidate import CandidateFit, Competitor
from smallwheel_ros.diagnosis.competitors import Field
from smallwheel_ros.diagnosis.screen import Screen
from smallwheel_ros.diagnosis.search import Search
from smallwheel_ros.diagnosis.verdict import Verdict
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.held_out import CvErrors, in_sample
from smallwheel_ros.fitting.result import posterior_covariance
from smallwheel_ros.measurements.settings import repeatability

Entry = dict[str, Any]

SCHEMA = 1
_DIGITS = 6
_ALIKE = 0.9  # cosine from which two effects act alike on this data
_SHOWN = 0.001  # probability under which a curve without a name is not listed


def plain(value: Any) -> Any:
    """Plain values with six digits; what is not finite becomes null."""
    return each(value, _short)


def _short(value: Any) -> Any:
    if isinstance(value, bool) or value is None or isinstance(value, (str, int)):
        return value
    number = float(value)
    return float(f"{number:.{_DIGITS}g}") if math.isfinite(number) else None


def head(problem: Problem, word: str, reason: str) -> Entry:
    """What every document has, before there is a result."""
    measurements = problem.measurements
    return {
        "schema": SCHEMA,
        "verdict": word,
        "reason": reason,
        "table": measurements.source,
        "missing_effects": [],
        "candidates": [],
        "closest": [],
        "channels": {},
        "lack_of_fit": {"p_value": None},
        "where_it_fails": [],
        "ranking": [],
        "steps": [{"added": None, "held_out_rmse": {}}],
        "next_measurements": [],
        "notes": list(measurements.notes),
        "warnings": list(measurements.warnings),
    }


def insufficient(problem: Problem, reason: str, field: Field | None = None) -> Entry:
    """The document where there is too little data. field: where the base can be fitted at least."""
    document = head(problem, "insufficient_data", reason)
    if field is not None:
        errors = in_sample(problem.points, problem.fit.model)
        kinds = sorted((name, kind) for name, kind in field.kinds.items() if kind != "unknown")
        document |= {
            "channels": channels(problem, errors, {}),
            "steps": [{"added": None, "held_out_rmse": errors.rmse()}],
            "ranking": [_blocked(field, name, reason) for name, _ in kinds],
            "notes": [
                "the errors given here are in sample: with so little data nothing was held out",
                *problem.result().notes,
                *document["notes"],
            ],
        }
    return dict(plain(document))


def channels(
    problem: Problem,
    errors: CvErrors,
    floors: Mapping[str, float],
    findings: Mapping[str, str] | None = None,
) -> Entry:
    """Errors of each channel beside the noise. floors: what the true model would leave."""
    repeats = repeatability(problem.measurements)
    found = {}
    for name, score in errors.scores().items():
        noise = problem.fitter.repeats.channels[name]
        found[name] = {
            "finding": (findings or {}).get(name, ""),
            "rows": score.rows,
            "rmse": score.rmse,
            "bias": score.bias,
            "noise_floor": floors.get(name),
            "noise_floor_source": noise.source if name in floors else None,
            "repeatability": repeats.get(name),
            "noise": {"absolute": noise.absolute, "relative": noise.relative},
        }
    return found


def ranking(
    found: Search,
    verdict: Verdict,
    errors: Mapping[str, CvErrors],
    base: CvErrors,
    learnt: Collection[str] = (),
) -> list[Entry]:
    """Every effect that competed or could not, the most probable first.

    errors: held-out errors of families alone, where they were worked out. learnt: families that were
    learnt from this data, and have no p.
    """
    field, chance = found.field, verdict.probabilities
    listed = [
        n for n, kind in field.kinds.items() if n not in field.blocked
        and (kind != "unknown" or chance.get(n, 0.0) > _SHOWN or n in verdict.unknown)
    ]  # fmt: skip
    place = {name: i for i, name in enumerate(verdict.named)}
    listed.sort(
        key=lambda n: (place.get(n, 99), -chance.get(n, 0.0), found.p_values.get(n, 1.0), n)
    )
    alike = {} if found.screen is None else _alike(found.screen)
    rows = [_row(found, verdict, n, errors.get(n), base) for n in listed]
    for row in rows:
        if row["effect"] in learnt:
            row["p_value"] = None
            row["reason"] += "; it was learnt from this data"
        row["confounded_with"] = alike.get(row["effect"], [])
    blind = [name for name in sorted(field.blocked) if not name.startswith("unknown:")]
    return rows + [_blocked(field, name, "") for name in blind]


def _blocked(field: Field, name: str, reason: str) -> Entry:
    return {
        "effect": name,
        "kind": field.kinds.get(name, "soil"),
        "status": "not_testable",
        "reason": field.blocked.get(name, reason),
    }


def _row(
    found: Search, verdict: Verdict, name: str, errors: CvErrors | None, base: CvErrors
) -> Entry:
    status = "not_significant"
    if name in verdict.named or (name in verdict.unknown and verdict.word == "unknown_effect"):
        status = "significant"
    elif name in verdict.rivals:
        status = "confounded"
    alone = found.alone(name)
    model = verdict.best if name in verdict.best.families else alone
    competitor, parameters, next_step, summary = None, {}, "", ""
    if model is not None:
        competitor = next(c for c in model.competitors if c.family == name)
        parameters = _parameters(found, model, competitor)
        if competitor.effect is not None:
            next_step, summary = type(competitor.effect).next_step, type(competitor.effect).summary
    form = "" if competitor is None else competitor.form
    close = found.all_alone(name, within=TIE)
    probability = verdict.probabilities.get(name, 0.0)
    return {
        "effect": name,
        "kind": found.field.kinds[name],
        "status": status,
        "reason": _reason(status, probability, competitor, parameters),
        "probability": probability,
        "p_value": found.p_values.get(name),
        "held_out_rmse": {} if errors is None else errors.rmse(),
        "reduction": None if errors is None else reduction(base, errors),
        "form": form,
        "forms_not_told_apart": sorted({m.competitors[0].form for m in close} - {form}),
        "summary": summary,
        "next_step": next_step,
        "parameters": parameters,
    }


def reduction(before: CvErrors, after: CvErrors) -> float:
    """Relative fall of the error, root mean square over the channels of each one's ratio."""
    first, second = before.rmse(), after.rmse()
    ratios = [second[c] / first[c] for c in first if first[c] > 0 and c in second]
    return 1.0 - float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 0.0


def _parameters(search: Search, model: CandidateFit, competitor: Competitor) -> dict[str, Any]:
    fit = model.fit
    covariance = posterior_covariance(search.fitter, fit)
    known = {} if competitor.effect is None else {p.name: p for p in competitor.effect.parameters()}
    found = {}
    for j in fit.vector.places(competitor.part.id):
        free, value = fit.vector.free[j], float(fit.theta[j])
        published = known[free.field].published if free.field in known else None
        plausible = None if published is None else published[0] <= value <= published[1]
        found[free.field] = {
            "value": value,
            "std": None if fit.at_bound[j] else float(np.sqrt(covariance[j, j])),
            "unit": free.unit,
            "published_range": None if published is None else list(published),
            "plausible": plausible,
        }
    return found


def _reason(
    status: str,
    probability: float,
    competitor: Competitor | None,
    parameters: Mapping[str, Any],
) -> str:
    said = f"probability {probability:.2f}" if 0.01 <= probability <= 0.99 else (
        "probability under 0.01" if probability < 0.01 else "probability over 0.99"
    )  # fmt: skip
    if status == "confounded":
        said += "; this data cannot tell it from the other candidates"
    if competitor is not None and competitor.replaces and status != "not_significant":
        said += "; the model has it, with another strength or law"
    if status == "not_significant" and probability > 0.5:
        said += ": more likely than not, and under what a name needs"
    outside = [name for name, p in parameters.items() if p["plausible"] is False]
    if outside and status != "not_significant":
        said += f"; {', '.join(outside)} outside the published range"
    return said


def _alike(screen: Screen) -> dict[str, list[Entry]]:
    """By effect, the others that act alike on this data after the base is refitted."""
    names, cosines = screen.cosines()
    found = {}
    for i, name in enumerate(names):
        others = [(float(c), o) for o, c in zip(names, cosines[i], strict=True) if o != name]
        near = sorted((o for o in others if o[0] >= _ALIKE), key=lambda o: -o[0])
        found[name] = [{"effect": other, "similarity": c} for c, other in near]
    return found


def failing_settings(
    document: Mapping[str, Any], settings: Collection[str]
) -> list[tuple[str, str]]:
    """Channel and setting of each region in which a diagnosis says that the model fails."""
    found = []
    for region in document.get("where_it_fails") or []:
        text = str(region["region"]).lstrip("|")  # |slip| > 0.5 is a region of slip
        meant = [name for name in settings if text.startswith(name)]
        if meant:
            found.append((str(region["channel"]), max(meant, key=len)))
    return list(dict.fromkeys(found))
