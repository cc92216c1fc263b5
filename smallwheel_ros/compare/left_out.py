# SPDX-License-Identifier: Apache-2.0
"""The ways of leaving rows out: a size of plate, a level of slip, a wheel, a run, or a soil in turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.constants import FOLDS
from smallwheel_ros.fitting.held_out import folds_of, leave_out
from smallwheel_ros.fitting.points import FittingError, points_of, runs_of
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.measurements import Measurements, codes_of
from smallwheel_ros.measurements.settings import DIAMETER_TOLERANCE, cluster
from smallwheel_ros.physics.conditions import CONTACTS, ROLLING

Index = NDArray[np.intp]
What = Literal["size", "slip", "wheel", "run", "soil"]

# Without one of two sizes, levels or runs, one is left, to which every law fits as a constant. Of two wheels
# or soils the other one was measured at many settings.
_FEWEST: dict[What, int] = {"size": 3, "slip": 3, "wheel": 2, "run": 3, "soil": 2}


@dataclass(frozen=True)
class Task:
    """Rows of one kind of contact in one soil (or in all), and one way of leaving parts of them out.

    Attributes
    ----------
    contact
        rolling, pressed or plate.
    soil
        Name of the soil, or "all soils".
    measurements
        The rows.
    what
        What the parts are: a size of plate, a level of slip, a wheel, a run or a soil each.
    names, part
        Names of the parts; index of each row's part, shape (rows,).
    fold
        Number of each row's fold, shape (rows,); the rows of one fold are left out together.
    """

    contact: str
    soil: str
    measurements: Measurements
    what: What
    names: tuple[str, ...]
    part: Index
    fold: Index

    def folds(self) -> Iterator[tuple[NDArray[np.bool_], Index]]:
        """Yield for each fold the mask of its rows, shape (rows,), and the indices of its training rows.

        The training rows exclude the other rows of runs that have a row in the fold, as they would reveal
        too much.
        """
        run = runs_of(self.measurements)[1]
        for out in leave_out(self.fold):
            yield out, np.flatnonzero(~np.isin(run, run[out]))


def tasks_of(measurements: Measurements) -> Iterator[Task]:
    """Yield each contact in each soil of a table, with every way of leaving rows out that allows a fit."""
    names = list(dict.fromkeys(measurements.soil.tolist()))
    for soil in [*names, *([None] if len(names) > 1 else [])]:
        in_soil = np.full(len(measurements), True) if soil is None else measurements.soil == soil
        for contact in CONTACTS:
            rows = np.flatnonzero(in_soil & (measurements.conditions.contact == contact))
            if rows.size:
                yield from _tasks(measurements.take(rows), contact, soil)


def _tasks(measurements: Measurements, contact: str, soil: str | None) -> Iterator[Task]:
    """Yield the ways of leaving rows out. soil: None for all soils, of which each is left out in turn."""
    try:
        points = points_of(measurements)
    except FittingError:
        return
    known: list[list[int]] = []
    name = "all soils" if soil is None else soil or "soil"
    # A law is fitted as if all soils were one: it knows nothing of the soil that is left out.
    one = replace(measurements, conditions=replace(measurements.conditions, soil=None))
    for what, names, part in _of_soils(measurements) if soil is None else _in_soil(measurements):
        pattern = codes_of(part)[1].tolist()
        fold = folds_of(points)[part] if what == "run" else _dealt(part)
        data = one if soil is None else measurements
        task = Task(contact, name, data, what, tuple(names), part, fold)
        enough = len(names) >= _FEWEST[what] and all(seen.size for _, seen in task.folds())
        if enough and pattern not in known:
            known.append(pattern)
            yield task


def _dealt(part: Index) -> Index:
    """Number of each row's fold: one part each if there are few, else `FOLDS` folds of shuffled parts."""
    count = int(part.max()) + 1
    if count <= 2 * FOLDS:
        return part
    return np.random.default_rng(5).permutation(np.arange(count) % FOLDS)[part]


Ways = Iterator[tuple[What, list[str], Index]]


def _of_soils(measurements: Measurements) -> Ways:
    yield "soil", *codes_of(measurements.soil)


def _in_soil(measurements: Measurements) -> Ways:
    conditions = measurements.conditions
    if conditions.contact[0] != ROLLING:
        size = cluster(np.log(conditions.diameter), DIAMETER_TOLERANCE)
        yield "size", [f"{1e3 * v:.3g} mm" for v in _means(conditions.diameter, size)], size
    elif "slip" in conditions and np.isfinite(conditions["slip"]).all():
        level = cluster(conditions["slip"], COLUMNS["slip"].same)
        means = _means(conditions["slip"], level)
        yield "slip", [f"{round(v, 2) + 0.0:.2f}" for v in means], level
    if conditions.contact[0] == ROLLING:
        yield "wheel", *codes_of(measurements.wheel)
    names, run = runs_of(measurements)
    yield "run", list(names), run


def _means(values: NDArray[np.float64], code: Index) -> list[float]:
    return [float(values[code == one].mean()) for one in range(int(code.max()) + 1)]
