# SPDX-License-Identifier: Apache-2.0
"""The runs of a table, and the rows of each that make one point.

A run in which nothing was changed is one point. A run in which a setting was swept (a plate's curve, a
time series) has a point for each setting, or, where it passes through many, at most `CURVE_POINTS` bins
along its path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.constants import CURVE_POINTS, MOST_POINTS
from smallwheel_ros.measurements.settings import runs_of_rows, settings_of_rows
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Conditions

Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

_FEWEST_BINS = 4  # a curve's level, slope and bend, and one to check them
_STRETCHES = MOST_POINTS // 8  # of a long record: so that two channels have four points in each
_TOUCHED = 0.01  # of a curve's depth: before it the body has not settled on the soil


def runs_of(measurements: Measurements) -> tuple[tuple[str, ...], Index]:
    """Names of the runs and each row's run; of a long record without runs, stretches of each wheel."""
    names, run = runs_of_rows(measurements)
    if measurements.runs_given or len(names) <= MOST_POINTS:
        return names, run
    stretch = np.empty(len(measurements), dtype=np.intp)
    for wheel in np.unique(measurements.wheel):
        rows = np.flatnonzero(measurements.wheel == wheel)
        stretch[rows] = np.arange(rows.size) * _STRETCHES // rows.size
    return tuple(f"stretch {i + 1}" for i in range(_STRETCHES)), stretch


class Group(NamedTuple):
    """Rows of one point. swept: part of a run in which a setting was changed; path: place along it."""

    rows: Index
    swept: bool
    path: float


def groups_of(measurements: Measurements, run: Index, usable: Mask) -> list[Group]:
    """The rows of each point; of more runs than `MOST_POINTS` has room for, those of a sample."""
    setting = settings_of_rows(measurements)
    used = np.flatnonzero(usable)
    used = used[np.argsort(run[used], kind="stable")]
    runs = np.split(used, np.flatnonzero(np.diff(run[used])) + 1)
    swept = [_is_swept(measurements.conditions, rows) for rows in runs]
    room = MOST_POINTS // max(1, len(measurements.channels))
    most = max(1, room // (_FEWEST_BINS if any(swept) else 1))
    kept = np.arange(len(runs))
    if kept.size > most:
        kept = np.sort(np.random.default_rng(5).choice(kept, most, replace=False))
    bins = int(np.clip(room // kept.size, _FEWEST_BINS, CURVE_POINTS))
    groups: list[Group] = []
    for i in kept:
        rows = runs[i]
        parts = [rows]
        if swept[i]:
            parts = _along(measurements, rows, setting, bins)
        last = max(len(parts) - 1, 1)
        groups += [Group(part, len(parts) > 1, i / last) for i, part in enumerate(parts)]
    return groups


def _is_swept(conditions: Conditions, rows: Index) -> bool:
    """Whether a setting was changed within the run, by more than it wavers.

    Of the middle four fifths of its rows, so that it does not depend on how many there are.
    """
    low, high = np.quantile(conditions.load[rows], [0.1, 0.9])
    if high > 1.5 * low:
        return True
    for name in ("slip", "slip_angle"):
        if name in conditions and np.isfinite(conditions[name][rows]).all():
            low, high = np.quantile(conditions[name][rows], [0.1, 0.9])
            if high - low > 0.1:
                return True
    kept = [conditions.diameter, conditions.width]
    kept += [conditions[n] for n in ("pass_number", "grouser_height") if n in conditions]
    return any(np.ptp(np.nan_to_num(column[rows])) > 1e-3 for column in kept)


def _along(measurements: Measurements, rows: Index, setting: Index, bins: int) -> list[Index]:
    """The rows of a swept run by setting where those are few, else in bins along its path."""
    codes = np.unique(setting[rows], return_inverse=True)[1].reshape(-1)
    if codes.max() < bins:
        parts = [rows[codes == c] for c in range(int(codes.max()) + 1)]
        return sorted(parts, key=lambda part: float(measurements.conditions.load[part].mean()))
    depth = measurements.channels.get("sinkage")
    if measurements.conditions.rolling[rows].all() or depth is None:
        parts = [part for part in np.array_split(rows, bins) if part.size]
        steady = [part for part in parts if not _is_swept(measurements.conditions, part)]
        return steady or parts
    settled = rows[depth[rows] > _TOUCHED * np.nanmax(depth[rows])]
    z = depth[settled]
    edges = np.linspace(z.min(), z.max(), bins + 1)[1:-1]
    place = np.searchsorted(edges, z)
    return [settled[place == b] for b in range(bins) if (place == b).any()]
