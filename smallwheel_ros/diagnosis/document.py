"""The diagnosis as plain values, by contract: what is written as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import Competitor
from smallwheel_ros.diagnosis.next_measurement import Proposal
from smallwheel_ros.diagnosis.regions import Region
from smallwheel_ros.diagnosis.search import CandidateFit, Search
from smallwheel_ros.diagnosis.verdict import Verdict
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.fitting.result import posterior_covariance

SCHEMA = 1
_DIGITS = 6
_ALIKE = 0.9  # cosine from which two effects act alike on this data
_SHOWN = 0.001  # probability under which a curve without a name is not listed


def plain(value: Any) -> Any:
    """Plain values with six digits; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value.tolist()]
    if isinstance(value, bool) or value is None or isinstance(value, (str, int)):
        return value
    number = float(value)
    return float(f"{number:.{_DIGITS}g}") if math.isfinite(number) else None


def region_entry(region: Region) -> dict[str, Any]:
    """One region in which the model fails."""
    return {
        "region": region.region,
        "rows": region.rows,
        "channel": region.channel,
        "bias": region.bias,
        "rmse": region.rmse,
        "rmse_elsewhere": region.rmse_elsewhere,
        "p_value": region.p,
    }


def proposal_entry(proposal: Proposal) -> dict[str, Any]:
    """One measurement to make next."""
    return {
        "settings": proposal.settings,
        "separates": list(proposal.separates),
        "runs": proposal.runs,
        "expected_power": proposal.power,
        "text": proposal.text,
    }


def best_of_family(search: Search, family: str) -> CandidateFit | None:
    """The family alone, in its best form; None where it was not refitted."""
    alone = [m for m in search.ordered if m.families == {family} and len(m.competitors) == 1]
    return alone[0] if alone else None


def ranking(
    search: Search,
    verdict: Verdict,
    errors: Mapping[str, CvErrors],
    base: CvErrors,
    alike: Mapping[str, Sequence[tuple[str, float]]],
) -> list[dict[str, Any]]:
    """Every effect that competed or could not, the most probable first.

    errors: held-out errors of families alone, where they were worked out.
    """
    listed = [name for name in search.field.kinds if name not in search.field.blocked]
    chance = verdict.probabilities
    listed = [
        n for n in listed
        if search.field.kinds[n] != "unknown" or chance.get(n, 0.0) > _SHOWN or n in verdict.unknown
    ]  # fmt: skip
    place = {name: i for i, name in enumerate(verdict.named)}
    listed.sort(
        key=lambda n: (place.get(n, 99), -chance.get(n, 0.0), search.p_values.get(n, 1.0), n)
    )
    rows = [_row(search, verdict, name, errors.get(name), base, alike) for name in listed]
    blocked = [
        {
            "effect": name,
            "kind": search.field.kinds.get(name, "soil"),
            "status": "not_testable",
            "reason": reason,
        }
        for name, reason in sorted(search.field.blocked.items())
        if not name.startswith("unknown:")
    ]
    return rows + blocked


def _row(
    search: Search,
    verdict: Verdict,
    name: str,
    errors: CvErrors | None,
    base: CvErrors,
    alike: Mapping[str, Sequence[tuple[str, float]]],
) -> dict[str, Any]:
    status = "not_significant"
    if name in verdict.named or (name in verdict.unknown and verdict.word == "unknown_effect"):
        status = "significant"
    elif name in verdict.rivals:
        status = "confounded"
    alone = best_of_family(search, name)
    model = verdict.best if name in verdict.best.families else alone
    competitor = None
    if model is not None:
        competitor = next(c for c in model.competitors if c.family == name)
    probability = verdict.probabilities.get(name, 0.0)
    parameters = (
        {} if model is None or competitor is None else _parameters(search, model, competitor)
    )
    forms = sorted(
        {c.form for m in search.ordered for c in m.competitors
         if c.family == name and alone is not None and len(m.competitors) == 1
         and m.weight > alone.weight - 3.0}
    )  # fmt: skip
    return {
        "effect": name,
        "kind": search.field.kinds[name],
        "status": status,
        "reason": _reason(status, probability, competitor, parameters, model),
        "probability": probability,
        "p_value": search.p_values.get(name),
        "held_out_rmse": {} if errors is None else errors.rmse(),
        "reduction": None if errors is None else _reduction(base, errors),
        "form": "" if competitor is None else competitor.form,
        "forms_not_told_apart": [f for f in forms if competitor is None or f != competitor.form],
        "next_step": "" if competitor is None or competitor.effect is None
        else type(competitor.effect).next_step,
        "parameters": parameters,
        "confounded_with": [{"effect": o, "similarity": s} for o, s in alike.get(name, ())],
    }  # fmt: skip


def _reduction(before: CvErrors, after: CvErrors) -> float:
    """Relative fall of the error, root mean square over the channels of each one's ratio."""
    first, second = before.rmse(), after.rmse()
    ratios = [second[c] / first[c] for c in first if first[c] > 0 and c in second]
    return 1.0 - float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 0.0


def _parameters(search: Search, model: CandidateFit, competitor: Competitor) -> dict[str, Any]:
    fit = model.fit
    covariance = posterior_covariance(search.fitter, fit)
    known = {} if competitor.effect is None else {p.name: p for p in competitor.effect.parameters()}
    found = {}
    for j, free in enumerate(fit.vector.free):
        if not (free.of_effect and free.owner == competitor.part.id):
            continue
        value = float(fit.theta[j])
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
    model: CandidateFit | None,
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


def similar(
    names: Sequence[str], cosines: NDArray[np.float64]
) -> dict[str, list[tuple[str, float]]]:
    """By effect, the others that act alike on this data after the base is refitted."""
    found: dict[str, list[tuple[str, float]]] = {}
    for i, name in enumerate(names):
        others = [(names[j], float(c)) for j, c in enumerate(cosines[i]) if j != i and c >= _ALIKE]
        found[name] = sorted(others, key=lambda o: -o[1])
    return found
