# SPDX-License-Identifier: Apache-2.0
"""Where a fit starts: a coarse grid for the soil, and the size of each value, the noise's level."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.forces import of_load
from smallwheel_ros.fitting.noise import repeats_of
from smallwheel_ros.fitting.parameters import Array, ParameterVector
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.fitting.predictor import Predictor
from smallwheel_ros.measurements.columns import FORCES

_SMALLEST = 0.05  # of a channel's median: least level of a value
_LEVELS = 2  # times that the levels are taken from the fit itself


def opening(points: Points, vector: ParameterVector) -> Array:
    """Where to start: the best of a coarse grid in ln p_ref and n, by logarithms, for each soil.

    Newton's steps in metres stray from a start that is a decade off.
    """
    theta = vector.start
    channel = next((n for n in points.channels if n not in FORCES), None)
    mine = {(p.owner, p.field): j for j, p in enumerate(vector.of_soils)}
    if channel is None:
        return theta
    grid = [(p, n) for n in (0.3, 0.5, 0.7, 1.0, 1.4, 1.9) for p in np.arange(7.0, 15.1, 1.0)]
    thetas = np.tile(theta, (len(grid), 1))
    for (_, field), j in mine.items():
        at = {"log_reference_pressure": 0, "n": 1}.get(field)
        if at is not None:
            thetas[:, j] = np.clip([g[at] for g in grid], vector.low[j], vector.high[j])
    predicted = Predictor.of(points).many(vector, thetas)
    mask = points.of_channel(channel) & (points.value > 0)
    said = np.log(np.maximum(predicted[:, mask], 1e-9))
    off = np.abs(said - np.log(points.value[mask]))
    named = points.conditions.soil
    for soil in {owner for owner, _ in mine}:
        here = np.ones(int(mask.sum()), dtype=bool)
        if named is not None:
            here = named[points.row[mask]] == soil
        if here.any():
            best = int(np.argmin(off[:, here].mean(axis=1)))
            for field in ("log_reference_pressure", "n"):
                theta[mine[soil, field]] = thetas[best, mine[soil, field]]
    return theta


def first_levels(points: Points) -> Array:
    """The size of each value before any fit: as measured, a curve by its own power law of the load.

    A curve along which the load hardly changes (slip was swept) has one size: were each value its own,
    a model that predicts nothing would have the same relative error all along, and that is what a run
    may be off by as a whole.
    """
    level = _of_setting(points)
    loads = points.column("load")
    for channel in range(len(points.channels)):
        mine = points.channel == channel
        if points.channels[channel] in FORCES:
            level[mine] = of_load(points.conditions, points.channels[channel])[points.row[mine]]
            continue
        for run in np.unique(points.run[mine & points.swept]):
            curve = np.flatnonzero(mine & points.swept & (points.run == run) & (points.value > 0))
            if curve.size > 2:
                load, value = np.log(loads[curve]), np.log(points.value[curve])
                line = np.polyfit(load, value, 1) if np.ptp(load) > 0.1 else [value.mean()]
                level[curve] = np.exp(np.polyval(line, load))
    return _floored(points, level)


def _of_setting(points: Points) -> Array:
    """Mean size of the values of one setting and channel, shape (values,); of a curve each its own.

    Not each value's own: relative errors of a model that predicts nothing would all be one.
    """
    size = np.maximum(np.abs(points.value), 1e-12)
    key = points.setting * len(points.channels) + points.channel
    code = np.unique(key, return_inverse=True)[1].reshape(-1)
    mean = np.exp(np.bincount(code, np.log(size)) / np.bincount(code))
    return np.where(points.swept, size, mean[code])


def _floored(points: Points, level: Array) -> Array:
    for channel in range(len(points.channels)):
        mine = points.channel == channel
        least = _SMALLEST * float(np.median(level[mine]))
        level[mine] = np.maximum(level[mine], max(least, 1e-9))
    return level


def levels_from(points: Points, predicted: Array) -> Array:
    """The size of each value as a model has it; of pull the load, of torque that times the radius."""
    level = np.abs(predicted)
    for name in points.forces:
        mine = points.of_channel(name)
        level[mine] = of_load(points.conditions, name)[points.row[mine]]
    return _floored(points, level)


def make_fitter(
    points: Points, vector: ParameterVector, start: Array | None = None, *, working: bool = False
) -> tuple[Fitter, Fit]:
    """A fitter whose levels suit these points, and the fit of that model with it. working: see `Fitter`.

    Raises FittingError where there are too few values.
    """
    if len(points) < 2:
        raise FittingError("one measurement cannot be fitted: measure at least a few loads")
    level = first_levels(points)
    fitter = Fitter(points, level, repeats_of(points, level), working=working)
    fit = fitter.fit(vector, opening(points, vector) if start is None else start, turns=1)
    return fitter, fitter.fit(vector, fit.theta, fit.scatter)


def fit_points(
    points: Points, vector: ParameterVector, start: Array | None = None
) -> tuple[Fitter, Fit]:
    """Fit one model for people, with the levels of the noise from its own predictions. start: theta.

    Raises FittingError where there are too few values.
    """
    fitter, fit = make_fitter(points, vector, start, working=True)
    for _ in range(_LEVELS):
        level = levels_from(points, fit.predicted)
        fitter = Fitter(points, level, repeats_of(points, level), working=True)
        fit = fitter.fit(vector, fit.theta, fit.scatter)
    return fitter, fit
