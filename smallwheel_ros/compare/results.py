# SPDX-License-Identifier: Apache-2.0
"""What each model of a comparison says of the measurements: fitted and held out, or as it stands."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.compare.contenders import Constant, Contender
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.held_out import (
    CvErrors,
    folds_of,
    in_sample,
    row_errors,
    rows_of,
)
from smallwheel_ros.fitting.points import Points, filled, runs_of
from smallwheel_ros.measurements.columns import Mask
from smallwheel_ros.measurements.settings import repeatability, runs_of_rows
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model.model import Model, ModelError, predict

Index = NDArray[np.intp]
Reasons = tuple[tuple[str, Index], ...]
_ASK_DIAGNOSE = (
    "how low the error could get is not known before what is missing is: "
    "`smallwheel diagnose` works it out"
)
_REPEAT = "how well a row repeats is not known: repeat a few runs, or state {}_std"
Progress = Callable[[int, int], object]  # fits done, fits needed


@dataclass(frozen=True)
class Floor:
    """The expected error of a true model on held-out runs, by channel, m or N.

    value, source: from a diagnosis of the same data; None where there is none. reason: how it was
    found, or why it was not.
    repeatability: what rows of one run differ by, None where nothing was repeated.
    """

    value: float | None
    source: str | None
    reason: str
    repeatability: float | None = None


@dataclass(frozen=True)
class ModelResult:
    """One model of a comparison.

    model: with the parameters of a fit to all rows, None for a constant. in_sample: errors of that model.
    held_out: of each run by a fit without it, None for a model that stands as it is and where there is one
    run. unseen: errors on runs that the model was not fitted to, None where that is not known.
    not_predicted: rows that it has no prediction for, with the reason.
    """

    contender: Contender
    model: Model | None
    in_sample: CvErrors
    held_out: CvErrors | None = None
    unseen: CvErrors | None = None
    not_predicted: Reasons = ()
    notes: tuple[str, ...] = ()


def results_of(
    contenders: Sequence[Contender], problem: Problem, folds: int, progress: Progress
) -> list[ModelResult]:
    """Fit or take each model as it is. Raises FittingError where there are too few values."""
    needed = (1 + folds) * sum(c.fitted for c in contenders)
    counted = itertools.count()

    def count() -> None:
        progress(next(counted), needed)

    count()
    found = []
    for contender in contenders:
        model = contender.model
        if isinstance(model, Base):
            found.append(_fitted(contender, replace(problem, base=model), count))
        elif isinstance(model, Constant):
            found.append(_constant(contender, problem.points, folds, count))
        else:
            found.append(_standing(contender, model, problem.points))
    return found


def _constant(
    contender: Contender, points: Points, folds: int, count: Callable[[], None]
) -> ModelResult:
    """Rows less the mean of all in sample, less the mean of the other folds' rows held out."""
    data, run = points.measurements, runs_of(points.measurements)[1]
    fold = folds_of(points)[run] if folds else np.zeros(len(data), dtype=np.intp)
    inside, outside = {}, {}
    for name, rows in rows_of(points).items():
        value = data.channels[name]
        inside[name], outside[name] = np.full((2, len(data)), np.nan)
        inside[name][rows] = value[rows] - value[rows].mean()
        for number in np.unique(fold[rows]):
            mine, others = rows[fold[rows] == number], rows[fold[rows] != number]
            if others.size:
                outside[name][mine] = value[mine] - value[others].mean()
    for _ in range(1 + folds):
        count()
    held_out = CvErrors(outside, run) if folds else None
    return ModelResult(contender, None, CvErrors(inside, run), held_out, held_out)


def _fitted(contender: Contender, problem: Problem, count: Callable[[], None]) -> ModelResult:
    fit = problem.fit
    count()
    errors = in_sample(problem.points, fit.model)
    held_out = problem.held_out(count)
    return ModelResult(contender, fit.model, errors, held_out, held_out)


def floors_of(points: Points) -> dict[str, Floor]:
    """What rows of one run differ by, by channel. What a true model would leave is for a diagnosis to say."""
    repeats = repeatability(points.measurements)
    return {
        name: Floor(
            None,
            None,
            _ASK_DIAGNOSE if name in repeats else _REPEAT.format(name),
            repeats.get(name),
        )
        for name in points.channels
    }


def _standing(contender: Contender, model: Model, points: Points) -> ModelResult:
    data = points.measurements
    able, reasons = _known_soil(model, data)
    rows = {name: index[able[index]] for name, index in rows_of(points).items()}
    rows = {name: index for name, index in rows.items() if index.size}
    error = {}
    try:
        error = row_errors(data, model, rows) if rows else {}
    except ModelError as refused:
        reasons.append((str(refused), np.unique(np.concatenate(list(rows.values())))))
    errors = CvErrors(error, runs_of_rows(data)[1])
    notes = [_origin(contender, data)]
    if error:
        used = np.unique(np.concatenate(list(rows.values())))
        sunk = int(predict(model, filled(data.conditions).take(used)).immobilised.sum())
        if sunk:
            notes.append(
                f"sinks to the axle in {sunk} rows: there it has no prediction but a continuation, "
                "whose error counts"
            )
    other = bool(contender.fitted_to) and contender.fitted_to != data.sha256
    return ModelResult(
        contender, model, errors, None, errors if other else None, tuple(reasons), tuple(notes)
    )


def _origin(contender: Contender, data: Measurements) -> str:
    if contender.fitted_to and contender.fitted_to == data.sha256:
        return "was fitted to this very file: its error is in sample, nothing was held out"
    if contender.fitted_to:
        return "was fitted to another file and stands as it is: nothing had to be held out"
    return "stands as it is; what it was fitted to is not known, so nothing is called held out"


def _known_soil(model: Model, data: Measurements) -> tuple[Mask, list[tuple[str, Index]]]:
    """The rows whose soil the model has, and why not the others; of one soil all rows are."""
    known = [soil.name for soil in model.soils]
    able = np.isin(data.soil, known) | (len(known) == 1)
    reasons = []
    for name in np.unique(data.soil[~able]):
        why = f"the model has no soil '{name}'"
        if not name:
            why = f"the rows name no soil, expected one of {', '.join(known)}"
        reasons.append((why, np.flatnonzero(~able & (data.soil == name))))
    return able, reasons
