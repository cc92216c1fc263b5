# SPDX-License-Identifier: Apache-2.0
"""The diagnosis as plain values, which are written as JSON: a contract with its readers."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from smallwheel_ros.common.tables import each
from smallwheel_ros.diagnosis.bad_runs import stuck
from smallwheel_ros.diagnosis.competitors import Competitor, Field
from smallwheel_ros.diagnosis.curves import curve_shown
from smallwheel_ros.diagnosis.faults import Witness
from smallwheel_ros.diagnosis.held_out import Step, errors_alone
from smallwheel_ros.diagnosis.misfit import at_an_end, residuals_left, where_it_fails, worst_left
from smallwheel_ros.diagnosis.search import Search
from smallwheel_ros.diagnosis.verdict import Evidence, Verdict
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.constants import ALARM, NAMED, TIE
from smallwheel_ros.fitting.fit import Fit
from smallwheel_ros.fitting.held_out import CvErrors, compare_cv, in_sample
from smallwheel_ros.fitting.measured import tied_settings
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.posterior import posterior_covariance
from smallwheel_ros.fitting.result import expected_error, off_by, strays
from smallwheel_ros.measurements.display import number, probability_text, shown_value, words
from smallwheel_ros.measurements.settings import repeatability

Entry = dict[str, Any]

SCHEMA = 1
_DIGITS = 6
_ALIKE = 0.9  # cosine from which two effects act alike on this data
_SHOWN = 0.001  # probability under which a curve without a name is not listed


_AS_GOOD = 1.1  # of what a true model leaves: a held-out error is known to a tenth at best


def plain(value: Any) -> Any:
    """Convert to plain values with six significant digits, at any depth; NaN and infinity become None."""
    return each(value, _short)


def _short(value: Any) -> Any:
    if value is None or isinstance(value, (bool, str, int)):
        return value
    number = float(value)
    return float(f"{number:.{_DIGITS}g}") if math.isfinite(number) else None


def _head(problem: Problem, word: str, reason: str) -> Entry:
    """Entries that every document has, without a result."""
    measurements = problem.points.measurements
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
    """Make the document of a diagnosis for which there is too little data.

    Parameters
    ----------
    problem
        The table and the base model.
    reason
        What is lacking, in words.
    field
        The competitors, to list them as not testable; None where the base model cannot be fitted either.

    Returns
    -------
    dict
        As `document_of`, with the verdict `insufficient_data`; its errors are in sample.
    """
    document = _head(problem, "insufficient_data", reason)
    if field is not None:
        errors = in_sample(problem.points, problem.fit.model)
        kinds = sorted(name for name, kind in field.kinds.items() if kind != "unknown")
        document |= {
            "channels": _channels(problem, errors, {}, {}),
            "steps": [{"added": None, "held_out_rmse": errors.rmse()}],
            "ranking": [_blocked(field, name, reason) for name in kinds],
            "notes": [
                "the errors given here are in sample: with so little data nothing was held out",
                *problem.result().notes,
                *document["notes"],
            ],
        }
    return dict(plain(document))


def document_of(evidence: Evidence, verdict: Verdict, *, seed: int) -> Entry:
    """Make the document of a diagnosis, without the proposals of what to measure next.

    Parameters
    ----------
    evidence
        Everything that was computed about the table.
    verdict
        The verdict that was reached from it.
    seed
        Seed of the test of where the base model fails.

    Returns
    -------
    dict
        The content of the JSON, described in docs/diagnosis.md; SI units. Some values are still arrays, which
        `plain` makes lists.
    """
    problem, found, fault = evidence.problem, evidence.found, evidence.gauge_fault
    judged, measurements = problem.judged, problem.points.measurements
    points, fitter = judged.points, judged.fitter
    base, explained = verdict.steps[0].errors, found.ordered[0]
    best = verdict.best if verdict.named else explained
    learnt = found.field.learnt_from(measurements)
    fitted = problem.result(verdict.steps[-1].model)
    # What a gauge shows that does not move, no other settings make better known.
    still = bool(stuck(problem.points))
    of_fit = strays(fitted) if still else fitted.notes
    left, floors = residuals_left(fitter, best), expected_error(fitter, best)
    worst = worst_left(left, measurements)
    alone = errors_alone(problem, found, evidence.held_out, verdict.probabilities)
    ranking = _ranking(found, verdict, alone, base, learnt)
    if fault is not None:
        others = [row for row in ranking if row["effect"] != fault.part.id]
        ranking = [_fault_row(problem, verdict.steps, fault), *others]
    return _head(problem, verdict.word, "; ".join(verdict.reasons)) | {
        "missing_effects": list(verdict.named),
        "candidates": list(verdict.rivals),
        "unknown": list(verdict.unknown),
        "tied": [{"settings": [one.setting, one.other]} for one in tied_settings(problem.points)],
        "closest": list(verdict.closest),
        "stuck_gauge": still,
        "channels": _channels(problem, base, floors, _findings(verdict, points, floors)),
        "lack_of_fit": {
            "p_value": None if learnt & {*verdict.named} else found.p,
            "probability_of_none": found.probabilities[found.none.key],
        },
        "where_it_fails": where_it_fails(
            points, base, fitter.level, seed, certain=found.p <= ALARM
        ),
        "ranking": ranking,
        "steps": [{"added": s.added, "held_out_rmse": s.errors.rmse()} for s in verdict.steps],
        "run_scatter": best.scatter.deviations,
        "residuals_left": left,
        "curves": [
            curve_shown(c.part, c.stage, c.span, points.column(c.span.column), explained)
            for c in explained.competitors
            if c.span is not None and c.stage != "pressure"
        ],
        "bad_runs": [
            {
                "run": one.name,
                "lines": measurements.line[one.rows],
                "channel": one.channel,
                "size": one.deviations,
                "against": one.against,
            }
            for one in evidence.bad
        ],
        "notes": [
            *of_fit,
            *measurements.notes,
            *(
                f"{name} was learnt from this very data, so it has no p here: other data must judge it"
                for name in sorted(learnt)
            ),
            *([f"after the best explanation {worst}"] if worst else []),
        ],
    }


def _findings(verdict: Verdict, points: Points, floors: Mapping[str, float]) -> dict[str, str]:
    """State the verdict for each channel in words.

    `points` are those of the channels that decided, `floors` the errors that a true model would leave, by
    channel.
    """
    first, last_errors = verdict.steps[0].errors, verdict.steps[-1].errors
    before, falls = first.rmse(), compare_cv(first, last_errors).reduction
    conditions, said = points.measurements.conditions, {}
    for name, last in last_errors.rmse().items():
        if name not in points.channels:
            said[name] = off_by(last_errors.error[name], conditions, name)[0]
        elif falls.get(name, 0.0) > 0.0 and verdict.named:
            said[name] = (
                f"{shown_value(name, before[name])} -> {shown_value(name, last)} with what is named"
            )
        elif verdict.word in ("adequate", "missing_effect") or last <= _AS_GOOD * floors.get(
            name, 0.0
        ):
            said[name] = "nothing missing" + (" besides" if verdict.named else "")
        else:
            off = f"off by {shown_value(name, last)} on held-out runs"
            noise = "; what noise leaves is not known without repeated rows"
            said[name] = f"not explained, {off}" if name in floors else off + noise
        far = at_an_end(points, last_errors, name) if name in points.channels else ""
        said[name] += f"; {far}" if far else ""
    return said


def _channels(
    problem: Problem, errors: CvErrors, floors: Mapping[str, float], findings: Mapping[str, str]
) -> Entry:
    """Errors of each channel beside the noise; `floors` are the errors that the true model would leave."""
    repeats = repeatability(problem.points.measurements)
    found = {}
    for name, score in errors.scores().items():
        noise = problem.fitter.repeats.channels[name]
        found[name] = {
            "finding": findings.get(name, ""),
            "rows": score.rows,
            "rmse": score.rmse,
            "bias": score.bias,
            "noise_floor": floors.get(name),
            "noise_floor_source": noise.source if name in floors else None,
            "repeatability": repeats.get(name),
            "noise": {"absolute": noise.absolute, "relative": noise.relative},
        }
    return found


# --- The ranking: a row for each effect


def _ranking(
    found: Search,
    verdict: Verdict,
    errors: Mapping[str, CvErrors],
    base: CvErrors,
    learnt: Collection[str],
) -> list[Entry]:
    """One row for every effect that competed or could not be tested, the most probable first.

    `errors` are held-out errors of families alone, where they were computed; `learnt` are families that
    were learnt from this data, which have no p-value.
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
    names, cosines = found.screen.cosines()
    rows = []
    for name in listed:
        row = _row(found, verdict, name, errors.get(name), base)
        if name in learnt:
            row |= {"p_value": None, "reason": f"{row['reason']}; it was learnt from this data"}
        alike = zip(names, cosines[names.index(name)], strict=True) if name in names else ()
        near = sorted((o for o in alike if o[0] != name and o[1] >= _ALIKE), key=lambda o: -o[1])
        row["confounded_with"] = [{"effect": other, "similarity": c} for other, c in near]
        rows.append(row)
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
    elif name in verdict.rivals and len(verdict.rivals) > 1:
        status = "confounded"
    close = found.all_alone(name, within=TIE)
    model = verdict.best if name in verdict.best.families else next(iter(close), None)
    competitor, law, parameters, form = None, None, {}, ""
    if model is not None:
        competitor = next(c for c in model.competitors if c.family == name)
        law, form = competitor.effect, competitor.form
        covariance = posterior_covariance(found.fitter, model, model.scatter)
        parameters = _parameters(model, covariance, competitor.part.id, law)
    probability = verdict.probabilities.get(name, 0.0)
    return _entry(law, parameters, base, errors, found.fitter.points.channels) | {
        "effect": name,
        "kind": found.field.kinds[name],
        "status": status,
        "reason": _reason(status, probability, competitor, parameters),
        "probability": probability,
        "p_value": found.p_values.get(name),
        "form": form,
        "forms_not_told_apart": sorted({m.competitors[0].form for m in close} - {form}),
    }


def _fault_row(problem: Problem, steps: Sequence[Step], fault: Witness) -> Entry:
    """The ranking's row of the fault that pull and torque indicate, which is the first of the steps."""
    name, fit = fault.part.id, problem.refitted(steps[-1].model)
    law = next(e for e in fit.model.effects if e.id == name)
    parameters = _parameters(fit, fit.covariance, name, None)
    before, after = steps[0].errors, steps[1].errors
    return _entry(law, parameters, before, after, problem.points.channels) | {
        "effect": name,
        "kind": "instrument",
        "status": "significant",
        "reason": f"{words(name)}: pull and torque favour it by {number(fault.evidence, 2)} nats",
        "probability": fault.probability,
        "p_value": None,
        "form": law.form,
        "forms_not_told_apart": [],
        "confounded_with": [],
    }


def _entry(
    law: Effect | None,
    parameters: Entry,
    before: CvErrors,
    after: CvErrors | None,
    channels: Sequence[str],
) -> Entry:
    """What a row of the ranking says of the law, and of the held-out error without and with the effect.

    `channels` are those that decide. `reduction` is 1 minus the root mean square, over these, of the ratio
    of the error with the effect to that without.
    """
    first, second = before.rmse(), {} if after is None else after.rmse()
    ratios = [second[c] / first[c] for c in channels if first.get(c, 0.0) > 0 and c in second]
    fall = 1.0 - float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 0.0
    return {
        "held_out_rmse": second,
        "reduction": None if after is None else fall,
        "summary": "" if law is None else law.summary,
        "next_step": "" if law is None else law.next_step,
        "parameters": parameters,
    }


def _parameters(fit: Fit, covariance: Any, part: str, law: Effect | None) -> Entry:
    """Value, standard deviation and published range of each parameter of a part of a fit.

    `covariance` is that of theta, `law` the effect whose published ranges are shown.
    """
    published = {} if law is None else {p.name: p.published for p in law.parameters()}
    found = {}
    for j in fit.vector.places(part):
        free, value = fit.vector.free[j], float(fit.theta[j])
        known = published.get(free.field)
        found[free.field] = {
            "value": value,
            "std": None if fit.at_bound[j] else float(np.sqrt(covariance[j, j])),
            "unit": free.unit,
            "published_range": None if known is None else list(known),
            "plausible": None if known is None else known[0] <= value <= known[1],
        }
    return found


def _reason(
    status: str, probability: float, competitor: Competitor | None, parameters: Mapping[str, Any]
) -> str:
    said = f"probability {probability_text(probability)}"
    if status == "confounded":
        said += "; this data cannot tell it from the other candidates"
    if competitor is not None and competitor.replaces and status != "not_significant":
        said += "; the model has it, with another strength or law"
    if status == "not_significant" and probability >= NAMED:
        said += ": probable, but no error on held-out runs falls with it by more than chance"
    elif status == "not_significant" and probability > 0.5:
        said += ": probable, but below the 95 % needed to name it"
    outside = [name for name, p in parameters.items() if p["plausible"] is False]
    if outside and status != "not_significant":
        said += f"; {', '.join(outside)} outside the published range"
    return said


def failing_settings(
    document: Mapping[str, Any], settings: Collection[str]
) -> list[tuple[str, str]]:
    """Return the channel and setting of each region in which a diagnosis says that the model fails.

    Parameters
    ----------
    document
        Document of the diagnosis.
    settings
        Names of the table's settings; regions of other columns are left out.

    Returns
    -------
    list of (str, str)
        Channel and setting, the clearest failure first, without repeats.
    """
    found = []
    for region in document.get("where_it_fails") or []:
        text = str(region["region"]).lstrip("|")  # |slip| > 0.5 is a region of slip
        meant = [name for name in settings if text.startswith(name)]
        if meant:
            found.append((str(region["channel"]), max(meant, key=len)))
    return list(dict.fromkeys(found))
