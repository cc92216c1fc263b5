# SPDX-License-Identifier: Apache-2.0
"""Errors of the laws on parts that they were not fitted to.

Each law of size is fitted to the runs of the other parts, wheels by the closed form. Besides them: the
contact integral, alone and with the effects that a diagnosis of the other parts names.
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
from smallwheel_ros.fitting.levels import fit_points
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.lab.plate_laws import UnderLaw, law_vector, left_out, reference_size
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.contact import AXLE_RATIO
from smallwheel_ros.physics.plates import BERNSTEIN_GORIATCHKIN, LAWS, PlateLaw

Array = NDArray[np.float64]

INTEGRAL = "Meirion-Griffith & Spenko, integral"
FOUND = "... and the effects found"
# The law that this package stands for is the last of them.
SIZE_LAWS = (BERNSTEIN_GORIATCHKIN, *LAWS[1:], LAWS[0])
ONE_SIZE = "Any of the four laws of size (one size)"


@dataclass(frozen=True)
class LawError:
    """Errors of one law. by_part: sinkage (rms, m) of each part by its name, None where it has none.

    rmse: of all parts, m. effects: by part, what the diagnosis of the others named.
    """

    law: str
    rmse: float
    by_part: dict[str, float | None]
    effects: dict[str, tuple[str, ...]]


def errors_of(task: Task, progress: Callable[[str], object]) -> list[LawError]:
    """Every law on every part. progress: told what is fitted next.

    Raises FittingError where the points are too few.
    """
    points = Problem.of(task.measurements, Base()).points
    for channel in points.channels:
        if channel != "sinkage":
            points = points.without_channel(channel)
    group = np.array([task.part[rows[0]] for rows in points.rows], dtype=np.intp)
    found = []
    # Of bodies of one size all four are the same law of depth.
    one = not {"diameter", "width"} & set(points.varied)
    problem = Problem(points, np.zeros(0, dtype=np.intp), Base(geometry="closed_form"))
    fitter, fit = fit_points(points, problem.vector)
    for law in SIZE_LAWS[-1:] if one else SIZE_LAWS:
        progress(law.name)
        name = ONE_SIZE if one else law.name
        found.append(_summary(task, name, points, group, _of_law(law, fitter, fit, group)))
    alone, named = np.full(len(points), np.nan), np.full(len(points), np.nan)
    effects: dict[str, tuple[str, ...]] = {}
    for part, name in enumerate(task.names):
        progress(f"diagnosis without {task.what} {name}")
        others = task.measurements.take(np.flatnonzero(task.part != part))
        mine = group == part
        try:
            diagnosis = diagnose(others)
        except FittingError:
            continue
        alone[mine] = _predicted(points, diagnosis.problem.result().model.model)[mine]
        named[mine] = _predicted(points, diagnosis.model.model)[mine]
        effects[name] = tuple(diagnosis.missing_effects)
    found.append(_summary(task, INTEGRAL, points, group, alone))
    found.append(_summary(task, FOUND, points, group, named, effects))
    return found


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
    """Sinkage (m) of each value; of a wheel that would be sunk to its axle, the axle's depth."""
    sinkage = np.asarray(predict(model, points.conditions).sinkage)
    limit = np.where(points.conditions.plate, np.inf, AXLE_RATIO * points.conditions.diameter)
    return np.asarray(np.fmin(sinkage, limit)[points.row])


def _summary(
    task: Task,
    law: str,
    points: Points,
    group: NDArray[np.intp],
    predicted: Array,
    effects: dict[str, tuple[str, ...]] | None = None,
) -> LawError:
    error = predicted - points.value
    by_part = {name: _rms(error[group == part]) for part, name in enumerate(task.names)}
    return LawError(law, _rms(error) or float("nan"), by_part, effects or {})


def _rms(error: Array) -> float | None:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None
