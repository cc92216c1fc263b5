# SPDX-License-Identifier: Apache-2.0
"""Errors of the laws on parts that they were not fitted to.

Each law of size is fitted to the runs of the other parts, wheels by the closed form, and predicts sinkage.
Besides them, for every channel: the mean of the other parts; the contact integral with pull and torque by
the balance of stresses, alone and with the effects that a diagnosis of the other parts names; and where
pull or torque was measured the law of Wong and Reece (1967).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.benchmark.parts import Task
from smallwheel_ros.diagnosis.pipeline import diagnose
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import leave_out
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.fitting.problem import Base, Problem, fit_points
from smallwheel_ros.lab.plates import UnderLaw, law_vector, left_out, reference_size
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.contact import AXLE_RATIO
from smallwheel_ros.physics.plates import BERNSTEIN_GORIATCHKIN, LAWS, PlateLaw

Array = NDArray[np.float64]

INTEGRAL = "Meirion-Griffith & Spenko, integral"
FOUND = "... and the effects found"
# The law that this package stands for is the last of them.
SIZE_LAWS = (BERNSTEIN_GORIATCHKIN, *LAWS[1:], LAWS[0])
CONSTANT = "The mean of the other parts"
WONG_REECE = "Wong and Reece, peak moves with slip"
ONE_SIZE = "Any of the four laws of size (one size)"


@dataclass(frozen=True)
class LawError:
    """Errors of one law on one channel, rms, SI. by_part: of each part by its name, None where it has none.

    rmse: of all parts. effects: by part, what the diagnosis of the others named.
    """

    law: str
    channel: str
    rmse: float
    by_part: dict[str, float | None]
    effects: dict[str, tuple[str, ...]]


def errors_of(task: Task, progress: Callable[[str], object]) -> list[LawError]:
    """Every law on every part. progress: told what is fitted next.

    Raises FittingError where the points are too few.
    """
    points = Problem.of(task.measurements, Base()).points
    depths = points.only(("sinkage",))
    found = []
    # Of bodies of one size all four are the same law of depth.
    one = not {"diameter", "width"} & set(depths.varied)
    problem = Problem(depths, np.zeros(0, dtype=np.intp), Base(geometry="closed_form"))
    fitter, fit = fit_points(depths, problem.vector)
    for law in SIZE_LAWS[-1:] if one else SIZE_LAWS:
        progress(law.name)
        predicted = _of_law(law, fitter, fit, task.part[_first(depths)])
        found += _summary(task, ONE_SIZE if one else law.name, depths, predicted)
    constant, stresses, alone, named = np.full((4, len(points)), np.nan)
    effects: dict[str, tuple[str, ...]] = {}
    for out in leave_out(task.part):
        name = task.names[task.part[out][0]]
        progress(f"diagnosis without {task.what} {name}")
        others, mine = task.measurements.take(np.flatnonzero(~out)), out[_first(points)]
        for c in range(len(points.channels)):
            of_channel = points.channel == c
            if (of_channel & ~mine).any():
                constant[of_channel & mine] = points.value[of_channel & ~mine].mean()
        try:
            if points.forces:
                law_of_slip = Problem.of(others, Base(thrust_form="wong_reece")).fit.model
                stresses[mine] = _predicted(points, law_of_slip)[mine]
            diagnosis = diagnose(others)
        except FittingError:
            continue
        alone[mine] = _predicted(points, diagnosis.problem.result().model.model)[mine]
        named[mine] = _predicted(points, diagnosis.model.model)[mine]
        effects[name] = tuple(diagnosis.missing_effects)
    found += _summary(task, CONSTANT, points, constant)
    if points.forces:
        found += _summary(task, WONG_REECE, points, stresses)
    found += _summary(task, INTEGRAL, points, alone)
    return found + _summary(task, FOUND, points, named, effects)


def _first(points: Points) -> NDArray[np.intp]:
    """The first row of each value, shape (values,): all of them are in one part."""
    return np.array([rows[0] for rows in points.rows], dtype=np.intp)


def _of_law(law: PlateLaw, fitter: Fitter, fit: Fit, group: NDArray[np.intp]) -> Array:
    """Sinkage (m) of each value by a fit to the other parts, shape (values,).

    fitter, fit: of the closed form on all points; its noise and scatter are those of all laws.
    """
    points = fitter.points
    under = fitter.under(partial(UnderLaw, law, reference_size(law, points)))
    vector = law_vector(law, "soil")
    best = under.fit(vector, vector.start, fit.scatter)
    return np.asarray(points.value * np.exp(left_out(under, best, group)))


def _predicted(points: Points, model: Model) -> Array:
    """What is predicted of each value; a wheel that would be sunk to its axle has the axle's depth."""
    prediction = predict(model, points.conditions)
    limit = np.where(points.conditions.plate, np.inf, AXLE_RATIO * points.conditions.diameter)
    found = np.empty(len(points))
    for c, name in enumerate(points.channels):
        values = np.asarray(getattr(prediction, name))
        values = np.fmin(values, limit) if name == "sinkage" else values
        found[points.channel == c] = values[points.row[points.channel == c]]
    return found


def _summary(
    task: Task,
    law: str,
    points: Points,
    predicted: Array,
    effects: dict[str, tuple[str, ...]] | None = None,
) -> list[LawError]:
    """The law's errors on each channel of the points."""
    found, group = [], task.part[_first(points)]
    for c, channel in enumerate(points.channels):
        error = np.where(points.channel == c, predicted - points.value, np.nan)
        by_part = {name: _rms(error[group == part]) for part, name in enumerate(task.names)}
        rmse = _rms(error) or float("nan")
        found.append(LawError(law, channel, rmse, by_part, effects or {}))
    return found


def _rms(error: Array) -> float | None:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None
