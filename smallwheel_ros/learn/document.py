# SPDX-License-Identifier: Apache-2.0
"""What was learnt as plain values, by contract: what is written as JSON."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.document import plain
from smallwheel_ros.fitting.result import expected_error
from smallwheel_ros.learn.candidate import Candidate
from smallwheel_ros.learn.draft import Number, numbers_of
from smallwheel_ros.learn.implied import disagreements, implied
from smallwheel_ros.learn.law import SOUGHT
from smallwheel_ros.learn.pipeline import PERMUTATIONS, Judged, Sought
from smallwheel_ros.learn.refused import settings_in
from smallwheel_ros.measurements.table import Measurements

Array = NDArray[np.float64]
Entry = dict[str, Any]

SCHEMA = 1
_CURVE = 41  # points of the drafted curve
_TWO = 2.0  # deviations: the band of a curve, the interval of a constant
_SHOWN = 40  # tied formulas in the document


@dataclass(frozen=True)
class Shape:
    """A law over its first driver, other drivers in their middle; arrays of shape (points,).

    factor: of the draft (a shift of n, a resistance in N per carrier). low, high: over all tied laws
    of that stage and drivers, two deviations each way. tied: their curves.
    """

    x: Array
    factor: Array
    low: Array
    high: Array
    tied: tuple[Array, ...]


def document(measurements: Measurements, sought: Sought, name: str) -> Entry:
    """The whole document but `measure_next`, `file` and laws learnt after this one."""
    settings = 0 if sought.problem is None else settings_in(sought.problem.points)
    found: Entry = {
        "schema": SCHEMA,
        "verdict": sought.verdict,
        "reasons": list(sought.reasons),
        "data": {
            "file": measurements.source,
            "sha256": measurements.sha256,
            "rows": len(measurements),
            "runs": int(measurements.runs.size),
            "settings": int(settings),
        },
        "search": _search(sought),
        "held_out": {},
        "law": None,
        "places": [],
        "tied": [],
        "implied": [],
        "shape": None,
        "stage_disagreement": {},
        "measure_next": None,
        "file": None,
        "notes": [*(sought.grid.notes if sought.grid else ()), *measurements.notes],
        "warnings": list(measurements.warnings),
    }
    best = sought.best
    if best is None:
        return dict(plain(found))
    shape = shape_of(best)
    found |= {
        "held_out": held_out(best),
        "law": _law(best, name) if sought.verdict == "law" else None,
        "places": _places(best),
        "tied": [_tied(c, best.tied[0]) for c in best.tied[:_SHOWN]],
        "implied": _implied(best),
        "shape": shape and {k: v for k, v in asdict(shape).items() if k != "tied"},
        "stage_disagreement": disagreements(best.problem.fitter, best.tied, best.law),
    }
    return dict(plain(found))


def _search(sought: Sought) -> Entry:
    grid, best = sought.grid, sought.best
    return {
        "formulas": 0 if grid is None else sum(grid.allowed(p).size for p in grid.places),
        "stages": [] if grid is None else list(dict.fromkeys(p.stage for p in grid.places)),
        "drivers": [] if grid is None else [d.name for d in grid.drivers],
        "p": sought.p,
        "permutations": PERMUTATIONS if sought.p is not None else 0,
        "folds": 0 if best is None else len(best.held_out.choices),
        "folds_agreeing": None if best is None else best.judgement.agreeing,
        "vault_settings": 0 if best is None else best.vault,
    }


def held_out(best: Judged) -> Entry:
    """Held-out error of each channel without and with the law, and what the noise leaves; SI."""
    floors = expected_error(best.problem.fitter, best.law.fit)
    found = {}
    for name in best.held_out.before:
        before, after = (
            float(np.sqrt(np.nanmean(errors[name] ** 2)))
            for errors in (best.held_out.before, best.held_out.after)
        )
        found[name] = {"before": before, "after": after, "floor": floors.get(name)}
    return found


def _law(best: Judged, name: str) -> Entry:
    law = best.law.law
    constants = []
    for n in numbers_of(best.problem.fitter, best.law):
        low, high = _interval(n, best)
        known = {"name": n.name, "value": n.value, "std": n.std, "unit": n.unit}
        constants.append(known | {"low": low, "high": high})
    return {
        "id": name,
        "stage": law.place.stage,
        "drivers": list(law.drivers),
        "formula": law.formula(best.law.numbers),
        "constants": constants,
        "range": {
            d.name: [d.reference + d.low, d.reference + d.high] for d in law.by_name.values()
        },
    }


def _interval(number: Number, best: Judged) -> tuple[float, float]:
    """Two deviations each way, over the draft and the tied laws of its shape.

    A constant of shape means the same at any place; a strength only at its own, under its link.
    """
    mine = best.law.law
    ends = []
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


def _places(best: Judged) -> list[Entry]:
    """Stages and drivers that the tied laws have, each once, the best first."""
    seen = dict.fromkeys((c.law.place.stage, c.law.drivers) for c in best.tied)
    return [{"stage": stage, "drivers": list(drivers)} for stage, drivers in seen]


def _tied(candidate: Candidate, best: Candidate) -> Entry:
    return {
        "formula": candidate.law.formula(candidate.numbers),
        "stage": candidate.law.place.stage,
        "drivers": list(candidate.law.drivers),
        "nats": candidate.score - best.score,
    }


def _implied(best: Judged) -> list[Entry]:
    """What each point asks of the law's stage: factors, or shifts of n and of resistance."""
    law, points = best.law, best.problem.fitter.points
    asks = implied(best.problem.fitter, law.fit, law.law.place)
    driver = law.law.first_driver
    x: Array = np.zeros(len(points.conditions))
    if driver is not None and driver.columns:
        x = driver.values(points.conditions) + driver.reference
    run = {int(r): points.runs[points.run[np.flatnonzero(points.row == r)[0]]] for r in asks.row}
    found = []
    for i, row in enumerate(asks.row):
        entry: Entry = {"run": run[int(row)], "x": float(x[row])}
        for channel, key in (("sinkage", "std"), ("resistance", "resistance_std")):
            entry[channel] = entry[key] = None
            if channel in asks.value and np.isfinite(asks.value[channel][i]):
                value, std = asks.value[channel][i], asks.std[channel][i]
                if not law.law.place.added:
                    value = np.exp(value)
                    std = value * std
                entry[channel], entry[key] = float(value), float(std)
        found.append(entry)
    return found


def shape_of(best: Judged) -> Shape | None:
    """The law over its driver; None where it follows nothing, several, or the depth itself."""
    law, points = best.law.law, best.problem.fitter.points
    driver = law.first_driver
    if len(law.drivers) != 1 or driver is None or not driver.columns:
        return None
    measured = driver.values(points.conditions)[np.unique(points.row)]
    u = np.linspace(measured.min(), measured.max(), _CURVE)
    curves, ends = [], []
    for c in best.tied:
        if (c.law.place, c.law.drivers) == (law.place, law.drivers):
            curve, std = _curve(c, u)
            ends += [curve - _TWO * std, curve + _TWO * std]
            curves.append(curve)
    mine = _curve(best.law, u)[0]
    shown: Callable[[Array], Array] = np.asarray if law.place.added else np.exp
    return Shape(
        u + driver.reference, shown(mine), shown(np.min(ends, axis=0)),
        shown(np.max(ends, axis=0)), tuple(shown(c) for c in curves if not np.array_equal(c, mine)),
    )  # fmt: skip


def _curve(candidate: Candidate, u: Array) -> tuple[Array, Array]:
    """ln factor (or shift) of a law where its one driver is u, with its standard deviation."""
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
