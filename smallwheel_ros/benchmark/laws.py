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
    group, of_depths = _parts(task, points), _parts(task, depths)
    found = []
    # Of bodies of one size all four are the same law of depth.
    one = not {"diameter", "width"} & set(depths.varied)
    problem = Problem(depths, np.zeros(0, dtype=np.intp), Base(geometry="closed_form"))
    fitter, fit = fit_points(depths, problem.vector)
    for law in SIZE_LAWS[-1:] if one else SIZE_LAWS:
        progress(law.name)
        name = ONE_SIZE if one else law.name
        predicted = _of_law(law, fitter, fit, of_depths)
        found += _summary(task, name, depths, of_depths, predicted)
    constant, stresses, alone, named = np.full((4, len(points)), np.nan)
    effects: dict[str, tuple[str, ...]] = {}
    for part, name in enumerate(task.names):
        progress(f"diagnosis without {task.what} {name}")
        others = task.measurements.take(np.flatnonzero(task.part != part))
        mine = group == part
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
    found += _summary(task, CONSTANT, points, group, constant)
    if points.forces:
        found += _summary(task, WONG_REECE, points, group, stresses)
    found += _summary(task, INTEGRAL, points, group, alone)
    found += _summary(task, FOUND, points, group, named, effects)
    return found


def _parts(task: Task, points: Points) -> NDArray[np.intp]:
    """The part of each value, shape (values,)."""
    return np.array([task.part[rows[0]] for rows in points.rows], dtype=np.intp)


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
    group: NDArray[np.intp],
    predicted: Array,
    effects: dict[str, tuple[str, ...]] | None = None,
) -> list[LawError]:
    """The law's errors on each channel of the points."""
    found = []
    for c, channel in enumerate(points.channels):
        error = np.where(points.channel == c, predicted - points.value, np.nan)
        by_part = {name: _rms(error[group == part]) for part, name in enumerate(task.names)}
        rmse = _rms(error) or float("nan")
        found.append(LawError(law, channel, rmse, by_part, effects or {}))
    return found


def _rms(error: Array) -> float | None:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None
