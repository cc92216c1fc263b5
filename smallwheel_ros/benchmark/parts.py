# SPDX-License-Identifier: Apache-2.0
"""What is left out in turn: one size of a plate, one level of slip, or one run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.points import FittingError, points_of, runs_of
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.settings import DIAMETER_TOLERANCE, cluster
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import CONTACTS

Index = NDArray[np.intp]
What = Literal["size", "slip", "run"]

_FEWEST = 3  # parts: with two, all that is left is one size or one level


@dataclass(frozen=True)
class Task:
    """One kind of contact in one soil, and the part of its rows that each is left out with.

    what: of which the parts are. names: of the parts; part: code of each row, shape (rows,).
    """

    contact: str
    soil: str
    measurements: Measurements
    what: What
    names: tuple[str, ...]
    part: Index


def tasks_of(measurements: Measurements) -> Iterator[Task]:
    """The contacts and soils of a table, each with the parts that say most of a law.

    A size of plate, where three were pressed; else a level of slip, where the wheel rolled at three;
    else a run. A contact with fewer than three runs is left out.
    """
    contact = measurements.conditions.contact
    for name in dict.fromkeys(measurements.soil.tolist()):
        for kind in CONTACTS:
            rows = np.flatnonzero((measurements.soil == name) & (contact == kind))
            if rows.size:
                task = _task(measurements.take(rows), kind, name or "soil")
                if task is not None:
                    yield task


def _task(measurements: Measurements, contact: str, soil: str) -> Task | None:
    try:
        points = points_of(measurements)
    except FittingError:
        return None
    if "sinkage" not in points.channels or points.run_count < _FEWEST:
        return None
    conditions = measurements.conditions
    found: tuple[What, Index, NDArray[np.float64]] | None = None
    if contact != "rolling":
        diameter = conditions.diameter
        found = "size", cluster(np.log(diameter), DIAMETER_TOLERANCE), diameter
    elif "slip" in conditions and np.isfinite(conditions["slip"]).all():
        found = "slip", cluster(conditions["slip"], COLUMNS["slip"].same), conditions["slip"]
    if found is None or found[1].max() + 1 < _FEWEST:
        names, runs = runs_of(measurements)
        return Task(contact, soil, measurements, "run", names, runs)
    what, part, values = found
    means = [float(values[part == code].mean()) for code in range(int(part.max()) + 1)]
    names = tuple(f"{1e3 * v:.3g} mm" if what == "size" else f"{v:.2f}" for v in means)
    return Task(contact, soil, measurements, what, names, part)
