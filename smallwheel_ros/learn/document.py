# SPDX-License-Identifier: Apache-2.0
"""What was learnt: as plain values, which are the content of the JSON; and in words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.document import plain
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.result import expected_error
from smallwheel_ros.learn.draft import Number, numbers_of
from smallwheel_ros.learn.law import CONSTANT, SOUGHT, LearntLaw, Place, places_for
from smallwheel_ros.learn.search import LawCandidate
from smallwheel_ros.learn.verdict import PERMUTATIONS, JudgedLaw, Sought, agreeing, settings_in
from smallwheel_ros.measurements.display import number, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Entry = dict[str, Any]

SCHEMA = 1
_CURVE = 41  # points of the drafted curve
_TWO = 2.0  # deviations: the band of a curve, the interval of a constant
_SHOWN = 40  # tied formulas in the document
_STEPS = 12  # of Newton's method
_STRIDE = 0.25  # of the furthest shift: longest step
_FAR = 3.0  # ln factor from which on a measurement says nothing about the place
_ENOUGH = 0.5  # share of the points in which both channels must say something
_DULL = 0.02  # d ln value / d ln factor under which a channel says nothing about the place


def document(measurements: Measurements, sought: Sought, name: str) -> Entry:
    """Make the document of `smallwheel learn --json` from the result of a search.

    Parameters
    ----------
    measurements
        The table.
    sought
        The result of a search.
    name
        Id of the law.

    Returns
    -------
    dict
        Plain values, SI units: `verdict`, `reasons`, `data`, `search` (size, p value), `held_out` errors by
        channel, the `law` (None if none is drafted), the `tied` formulas, their `places`, the curve `shape`
        (`shape_of`), the corrections `implied` by single points, `notes` and `warnings`. `measure_next` and
        `file` are None, and laws that were learnt after this one are absent: the caller adds them.
    """
    problem, grid, best = sought.problem, sought.grid, sought.best
    found: Entry = {
        "schema": SCHEMA,
        "verdict": sought.verdict,
        "reasons": list(sought.reasons),
        "data": {
            "file": measurements.source,
            "sha256": measurements.sha256,
            "rows": len(measurements),
            "runs": int(measurements.runs.size),
            "settings": settings_in(problem.points) if problem else 0,
        },
        "search": {
            "formulas": sum(grid.allowed(p).size for p in grid.places) if grid else 0,
            "stages": list(dict.fromkeys(p.stage for p in grid.places)) if grid else [],
            "drivers": [d.name for d in grid.drivers] if grid else [],
            "p": sought.p,
            "permutations": PERMUTATIONS if sought.p is not None else 0,
            "folds": len(best.laws) if best else 0,
            "folds_agreeing": agreeing(best.laws, best.law.law) if best else None,
            "vault_settings": best.vault if best else 0,
        },
        "held_out": {},
        "law": None,
        "places": [],
        "tied": [],
        "implied": [],
        "shape": None,
        "stage_disagreement": {},
        "measure_next": None,
        "file": None,
        "notes": [*(grid.notes if grid else ()), *measurements.notes],
        "warnings": list(measurements.warnings),
    }
    if problem and best:
        found |= _of_law(problem.fitter, best, name if sought.verdict == "law" else None)
    return dict(plain(found))


def _of_law(fitter: Fitter, best: JudgedLaw, name: str | None) -> Entry:
    """Entries of the document that need a best law. name: id of the law; None if it is not drafted."""
    (before, after), floors = (e.rmse() for e in best.errors), expected_error(fitter, best.law.fit)
    shape = shape_of(fitter, best)
    stages = dict.fromkeys((c.law.place.stage, c.law.drivers) for c in best.tied)
    return {
        "held_out": {
            channel: {"before": before[channel], "after": after[channel], "floor": floors.get(channel)}
            for channel in before
        },
        "law": None if name is None else _law(fitter, best, name),
        "places": [{"stage": stage, "drivers": list(drivers)} for stage, drivers in stages],
        "tied": [
            {
                "formula": c.law.formula(c.numbers),
                "stage": c.law.place.stage,
                "drivers": list(c.law.drivers),
                "nats": c.score - best.tied[0].score,
            }
            for c in best.tied[:_SHOWN]
        ],
        "implied": _implied(fitter, best.law),
        "shape": shape and shape[0],
        "stage_disagreement": _disagreements(fitter, best),
    }  # fmt: skip


def _law(fitter: Fitter, best: JudgedLaw, name: str) -> Entry:
    law, constants = best.law.law, []
    for n in numbers_of(fitter, best.law):
        low, high = _interval(n, best)
        known = {"name": n.name, "value": n.value, "std": n.std, "unit": n.unit}
        constants.append(known | {"low": low, "high": high})
    ranges = {d.name: [d.reference + d.low, d.reference + d.high] for d in law.by_name.values()}
    return {
        "id": name,
        "stage": law.place.stage,
        "drivers": list(law.drivers),
        "formula": law.formula(best.law.numbers),
        "constants": constants,
        "range": ranges,
    }


def _interval(number: Number, best: JudgedLaw) -> tuple[float, float]:
    """Interval of a number: two deviations each way, enclosing those of the tied laws with the same terms.

    A constant of shape means the same at any place, a strength only at one place with one link.
    """
    mine, ends = best.law.law, []
    for candidate in best.tied:
        law, vector = candidate.law, candidate.fit.vector
        if [t.kind for t in law.terms] != [t.kind for t in mine.terms]:
            continue
        if number.strength and (law.place, law.link) != (mine.place, mine.link):
            continue
        j = next(j for j in vector.places(SOUGHT) if vector.free[j].field == number.name)
        std = float(np.sqrt(candidate.fit.covariance[j, j]))
        ends += [float(candidate.fit.theta[j]) + s * _TWO * std for s in (-1.0, 1.0)]
    return min(ends), max(ends)


# --- The law as a curve


def shape_of(fitter: Fitter, best: JudgedLaw) -> tuple[Entry, list[Array]] | None:
    """Compute the curve of a law over its one driver, and those of the laws that fit equally well.

    Parameters
    ----------
    fitter
        Fitter that fitted the laws.
    best
        The law, and the laws that fit equally well (`tied`).

    Returns
    -------
    shape : dict
        Arrays of shape (points of the curve,): `x`, values of the driver over its measured range, SI;
        `factor`, the law's factor there, or what it adds (in the unit of `Place.unit`) if `Place.added`;
        `low` and `high`, a band of two standard deviations about the law and the tied laws that act at the
        same place and have the same driver.
    curves : list of ndarray
        The factor, or what is added, of each of these tied laws except the law itself, as `factor`.

    None in place of both if the law depends on no driver, on several, or on the depth.
    """
    law, points = best.law.law, fitter.points
    if len(law.drivers) != 1 or not law.columns:
        return None
    (driver,) = law.by_name.values()
    measured = driver.values(points.conditions)[np.unique(points.row)]
    u = np.linspace(measured.min(), measured.max(), _CURVE)
    alike = [c for c in best.tied if (c.law.place, c.law.drivers) == (law.place, law.drivers)]
    curves = [_curve(c, u) for c in alike]
    mine, shown = _curve(best.law, u)[0], np.asarray if law.place.added else np.exp
    shape = {
        "x": u + driver.reference,
        "factor": shown(mine),
        "low": shown(np.min([curve - _TWO * std for curve, std in curves], axis=0)),
        "high": shown(np.max([curve + _TWO * std for curve, std in curves], axis=0)),
    }
    return shape, [shown(curve) for curve, _ in curves if not np.array_equal(curve, mine)]


def _curve(candidate: LawCandidate, u: Array) -> tuple[Array, Array]:
    """ln factor (or shift) of a law at values u of its one driver, and its standard deviation; shape of u."""
    law, fit, numbers = candidate.law, candidate.fit, candidate.numbers

    def at(changed: dict[str, float]) -> Array:
        change = law.change(numbers | changed, lambda driver: u)
        return np.asarray(change if law.place.added else np.log(change))

    places = fit.vector.places(SOUGHT)
    middle, slopes = at({}), []
    for j in places:
        name, step = fit.vector.free[j].field, 0.1 * float(np.sqrt(fit.covariance[j, j])) + 1e-12
        slopes.append((at({name: numbers[name] + step}) - middle) / step)
    covariance = fit.covariance[np.ix_(places, places)]
    return middle, np.sqrt(np.einsum("ip,ij,jp->p", slopes, covariance, slopes))


# --- The correction that each point asks for at a place: the ln factor (for n and R the shift) with which the
# model without the law predicts its measurement. Sinkage and resistance ask for one each; at the place where
# a law truly acts both ask for the same.


def _implied(fitter: Fitter, best: LawCandidate) -> list[Entry]:
    """The factor or shift that each point asks for at the law's place, by channel, with its deviation."""
    law, points = best.law, fitter.points
    asks = _asked_of(fitter, best.fit, law.place)
    x: Array = np.zeros(len(points.conditions))
    if law.drivers and (first := law.by_name[law.drivers[0]]).columns:
        x = first.values(points.conditions) + first.reference
    rows, at = np.unique(points.row, return_index=True)
    columns: Entry = {"run": [points.runs[run] for run in points.run[at]], "x": x[rows]}
    for channel, key in (("sinkage", "std"), ("resistance", "resistance_std")):
        value, std = asks.get(channel, np.full((2, rows.size), np.nan))
        if not law.place.added:
            value = np.exp(value)
            std = value * std
        columns |= {channel: value, key: std}
    return [dict(zip(columns, point, strict=True)) for point in zip(*columns.values(), strict=True)]


def _disagreements(fitter: Fitter, best: JudgedLaw) -> dict[str, float | None]:
    """By stage, the disagreement of sinkage and resistance on the correction; about 1 at the true stage.

    It is the mean of the squared difference over its variance; None if too few points say both. The soil is
    that of the stage's own best tied law if there is one, else that of the draft.
    """
    found: dict[str, float | None] = {}
    for place in places_for(fitter.points.channels):
        if place.stage in ("R", "z without resistance") or place.stage in found:
            continue
        mine = next((c for c in best.tied if c.law.place.stage == place.stage), best.law)
        asks = _asked_of(fitter, mine.fit, place)
        found[place.stage] = None
        if len(asks) == 2:
            (a, sa), (b, sb) = asks.values()
            off = (a - b) ** 2 / (sa**2 + sb**2)
            known = off[np.isfinite(off)]
            if known.size >= _ENOUGH * off.size:
                found[place.stage] = float(np.mean(known))
    return found


def _asked_of(fitter: Fitter, fit: Fit, place: Place) -> dict[str, tuple[Array, Array]]:
    """By channel, the ln factor or shift that each point asks for and its deviation, shape (points,) each.

    NaN where the measurement says nothing about the place. fit: that of the model with its law; the law is
    taken out and the soil kept, so that the points ask for all that the law should be.
    """
    points, with_law = fitter.points, fit.model
    others = [e for e in with_law.effects if e.id != SOUGHT]
    model = Model(with_law.soils, with_law.geometry, others, with_law.thrust_form)
    deviation = np.sqrt(np.diag(fitter.covariance(fit).matrix))
    # A resistance is added to, as it is; any other answer is linear in a ln factor only nearby.
    far, dull = (np.inf, 0.0) if place.stage == "R" else (_FAR, _DULL)
    rows = np.unique(points.row)
    found = {}
    for c, name in enumerate(points.channels):
        mine = points.channel == c
        measured, spread = np.full((2, len(points.conditions)), np.nan)
        measured[points.row[mine]] = points.value[mine]
        spread[points.row[mine]] = deviation[mine]
        shift, slope = _solve(model, points.conditions, place, name, measured, far)
        with np.errstate(invalid="ignore"):
            says = (np.abs(slope) > dull * np.abs(measured)) & (np.abs(shift) < far)
        if says.any():
            size = np.where(says, np.abs(slope), np.nan)
            found[name] = np.where(says, shift, np.nan)[rows], (spread / size)[rows]
    return found


def _solve(
    model: Model, conditions: Conditions, place: Place, channel: str, measured: Array, far: float
) -> tuple[Array, Array]:
    """ln factor or shift at which each row's prediction is `measured`, and d prediction / d it.

    Shape (rows,) each. far: limit of the shift, either way.
    """

    def at(shift: Array) -> Array:
        asked = LearntLaw(place, "exponential", (CONSTANT,)).effect({"a1": shift})
        return np.asarray(getattr(predict(model + asked, conditions), channel))

    step = 1.0 if place.stage == "R" else 1e-3
    most = far * _STRIDE
    shift: Array = np.zeros(measured.size)
    for _ in range(_STEPS):
        now = at(shift)
        slope = (at(shift + step) - now) / step
        with np.errstate(all="ignore"):
            move = np.nan_to_num((measured - now) / slope, posinf=0.0, neginf=0.0)
        move = np.clip(move, -most, most)
        shift = np.clip(shift + move, -far, far)
        if np.all(np.abs(move) < 1e-8 * np.maximum(np.abs(shift), 1.0)):
            break
    return shift, slope


# --- In words

_STAGES = {
    "k": "The soil's stiffness k",
    "z": "Sinkage",
    "z without resistance": "Sinkage, but not resistance,",
    "n": "The exponent n",
    "D": "The diameter that the soil meets",
    "R": "Resistance",
}
_NOTHING = {
    "nothing": "Nothing could be learnt.",
    "refused": "Nothing was searched for: this data is too little for a law.",
}


def headline(document: Entry) -> str:
    """The answer in a sentence."""
    verdict = document["verdict"]
    if verdict in _NOTHING:
        return _NOTHING[verdict]
    if verdict == "law":
        return grows(document)
    followed = " and ".join(words(d) for d in document["places"][0]["drivers"]) or "no setting"
    lead = "Something" if verdict == "unstable" else "Perhaps something"
    return f"{lead} depends on {followed}; no law is drafted."


def grows(document: Entry) -> str:
    """What the law does, in a sentence: "Sinkage grows with slip and levels off (x 1.50 from 0 to 0.45)."."""
    law, shape = document["law"], document["shape"]
    what, followed = _STAGES[law["stage"]], " and ".join(words(d) for d in law["drivers"])
    if not law["drivers"]:
        return f"{what} has a part that the model lacks, whatever the setting."
    if shape is None:
        return f"{what} depends on {followed}."
    x, y = shape["x"], shape["factor"]
    edge, third = len(y) // 10, len(y) // 3
    for kind, at in (("maximum", y.index(max(y))), ("minimum", y.index(min(y)))):
        if edge <= at < len(y) - edge:
            return f"{what} follows {followed}: it has a {kind} at {followed} {number(x[at])}."
    early, late = abs(y[third] - y[0]), abs(y[-1] - y[-1 - third])
    tail = " and levels off" if late < 0.4 * early else ""
    text = f"{what} {'grows' if y[-1] > y[0] else 'falls'} with {followed}{tail}"
    if law["stage"] in ("n", "R") or y[0] <= 0:
        return f"{text}."
    return f"{text} (x {y[-1] / y[0]:.2f} from {number(x[0])} to {number(x[-1])})."


def origin(document: Entry) -> str:
    """Words on the settings and ranges that a law was learnt from, and that it is not published."""
    ranges = document["law"]["range"].items()
    where = "".join(f", {words(n)} {number(a)} to {number(b)}" for n, (a, b) in ranges)
    return f"Learnt from {document['data']['settings']} settings{where}; not published"


def trust(document: Entry) -> str:
    """A sentence on where the law can be trusted: in the range that it was learnt from."""
    return f"{origin(document)}; beyond that it is a guess."
