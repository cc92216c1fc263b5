# SPDX-License-Identifier: Apache-2.0
"""Which settings of a table an effect can follow: those that were varied, and not as answers to others."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.constants import ANSWERS, SAME_ORDER, WAVERS
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.settings import cluster

Array = NDArray[np.float64]

# Settings that have effects of their own: any other column has no law.
SETTINGS = ("slip", "slip_angle", "slope", "speed", "pass_number", "grouser_height")
_ONE_RANK = 0.01  # of a column's range


def independent(points: Points) -> dict[str, Array]:
    """The settings that were varied and are no answers to others, by name, at each value."""
    columns = points.varied
    wavers = _wavers(points)
    return {
        name: column
        for name, column in columns.items()
        if name in (*SETTINGS, "diameter", "width")
        or (name == "load" and not wavers)
        or not follows_others(name, _at_runs(name, columns, points))
        if not (name == "load" and points.swept.all() and _sweeps(column, points))
    }


def _sweeps(load: Array, points: Points) -> bool:
    """Whether the load changes along the curves: it is depth by another name there."""
    change = np.log(load)
    along = change - _run_means(change, points)
    return float(np.var(along)) > WAVERS * float(np.var(change))


def _wavers(points: Points) -> bool:
    """Whether the load differs within runs by a fair share of what it differs by at all.

    Then it was not set: it answers the wheel's motion, where it also follows the other settings.
    """
    load = np.log(points.measurements.conditions.load)
    steady = [rows for rows, swept in zip(points.rows, points.swept, strict=True) if not swept]
    within = sum(float(np.sum((load[rows] - load[rows].mean()) ** 2)) for rows in steady)
    freedom = sum(rows.size - 1 for rows in steady)
    if not freedom:
        return False
    total = float(np.var(np.concatenate([load[rows] for rows in steady])))
    return within / freedom > WAVERS * total


def _at_runs(name: str, columns: dict[str, Array], points: Points) -> dict[str, Array]:
    """The columns; where the named one is the same all along every run, their means over each run.

    Then each run is one piece of evidence on what it follows, however many settings others have in it.
    """
    means = {n: _run_means(c, points) for n, c in columns.items()}
    if not np.allclose(means[name], columns[name], rtol=1e-6, atol=0.0):
        return columns
    return {n: c for n, c in means.items() if np.ptp(c) > 0.0}


def _run_means(column: Array, points: Points) -> Array:
    """Of each value the mean over its run, shape (values,)."""
    run = np.unique(points.run, return_inverse=True)[1].reshape(-1)
    return np.asarray((np.bincount(run, column) / np.bincount(run))[run])


def follows_others(name: str, columns: Mapping[str, Array]) -> bool:
    """Whether a column answers other settings (a rim's speed, a load that falls while skidding).

    By ranks, so that any rising or falling law counts: of one setting, or of all together with their
    squares and products (adjusted for how many terms that takes).
    """
    others = [c for n, c in columns.items() if n != name and n in SETTINGS]
    others += [columns["load"]] if "load" in columns and name != "load" else []
    if not others:
        return False
    met = np.unique(np.column_stack([columns[name], *others]), axis=0)  # once, not once a channel
    y, *scaled = [_ranks(column) for column in met.T]
    if any(abs(float(np.corrcoef(y, x)[0, 1])) > SAME_ORDER for x in scaled):
        return True
    terms = [np.ones(y.size), *scaled]
    terms += [a * b for i, a in enumerate(scaled) for b in scaled[i:]]
    design = np.column_stack(terms)
    spare = len(design) - design.shape[1]
    if spare < design.shape[1]:
        return False
    left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    return 1.0 - float(left @ left) / spare / max(float(y.var(ddof=1)), 1e-300) > ANSWERS


def _ranks(column: Array) -> Array:
    """Ranks between -1 and 1; what agrees to a hundredth of the range has one rank."""
    steps = cluster(column, _ONE_RANK * float(np.ptp(column)))
    _, place, count = np.unique(steps, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - 0.5 * count)[place.reshape(-1)]
    return np.asarray(2.0 * (ranks - ranks.mean()) / max(float(np.ptp(ranks)), 1.0))
