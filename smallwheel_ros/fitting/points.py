# SPDX-License-Identifier: Apache-2.0
"""Measurements as a fit sees them: points, each the mean of a steady stretch of one run.

Rows of a run are not independent evidence. A run in which nothing was changed is one point. A run in which
a setting was swept (a plate's curve, a time series) has a point for each setting, or, where it passes
through many, at most `CURVE_POINTS` bins along its path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.fitting.constants import CURVE_POINTS, FEWEST_VALUES, MOST_POINTS
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.measurements.measurements import CHANNELS, Measurements
from smallwheel_ros.measurements.settings import (
    order_columns,
    runs_of_rows,
    setting_columns,
    settings_of_rows,
    varies,
)
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

_FEWEST_BINS = 4  # a curve's level, slope and bend, and one to check them
_STRETCHES = MOST_POINTS // 8  # of a long record: so that two channels have four points in each
_TOUCHED = 0.01  # of a curve's depth: before it the body has not settled on the soil
_ALONG = np.radians(10.0)  # slip angle up to which the law of pull is as good as along the plane
_OF_VALUES = ("value", "row", "channel", "run", "setting", "swept", "path", "declared")


class FittingError(SmallwheelError):
    """A model cannot be fitted to the measurements, or the fit would make no sense."""


@dataclass(frozen=True)
class Points:
    """Measured values, one for each point and channel; arrays of shape (values,).

    Attributes
    ----------
    measurements
        The table that the points were reduced from.
    conditions
        Settings of the points, shape (points,).
    channels
        Names of the measured channels.
    runs
        Names of all runs of the table.
    value
        Mean of the rows, m, N or N m by channel.
    row
        Index of the value's point, a row of `conditions`.
    channel, run
        Indices in `channels` and `runs`.
    setting
        Code of the setting; values with one code were measured under the same conditions.
    swept
        Whether the value is part of a run in which a setting was changed.
    path
        Position along a swept run, from 0 to 1; else 0.
    declared
        Standard deviation of a row as the table states it, unit of the value; NaN if it does not.
    rows
        For each value, numbers of the rows of `measurements` that it is the mean of.
    notes
        Sentences on rows that are not used, and why.
    """

    measurements: Measurements
    conditions: Conditions
    channels: tuple[str, ...]
    runs: tuple[str, ...]
    value: Array
    row: Index
    channel: Index
    run: Index
    setting: Index
    swept: Mask
    path: Array
    declared: Array
    rows: tuple[Index, ...]
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return int(self.value.size)

    @cached_property
    def count(self) -> Array:
        """Number of rows that each value is the mean of, shape (values,)."""
        return np.array([r.size for r in self.rows], dtype=float)

    @property
    def forces(self) -> tuple[str, ...]:
        """The channels that depend on the soil's strength: drawbar pull and torque, where measured."""
        return tuple(name for name in self.channels if name in FORCES)

    @property
    def share_errors(self) -> bool:
        """Whether many values share an error (that of pull, torque or a curve), which no fit may absorb."""
        return bool(self.forces) or bool(self.swept.any())

    @property
    def run_count(self) -> int:
        """Number of runs that have values."""
        return int(np.unique(self.run).size)

    def of_channel(self, name: str) -> Mask:
        """Mask of the values of a channel, shape (values,)."""
        return np.asarray(self.channel == self.channels.index(name))

    def only(self, channels: Sequence[str]) -> Points:
        """The values of these channels alone, which need not all have been measured."""
        code = np.array([channels.index(c) if c in channels else -1 for c in self.channels])
        kept = self.take(code[self.channel] >= 0)
        return replace(kept, channels=tuple(channels), channel=code[kept.channel])

    def take(self, keep: Mask) -> Points:
        """The values where a mask of shape (values,) is true; the points' conditions stay as they are."""
        kept = {name: getattr(self, name)[keep] for name in _OF_VALUES}
        return replace(self, **kept, rows=tuple(self.rows[i] for i in np.flatnonzero(keep)))

    def of_runs(self, others: Points) -> Mask:
        """Mask of the values whose runs are also in `others`, shape (values,)."""
        return np.isin(self.run, np.unique(others.run))

    def column(self, name: str) -> Array:
        """A setting at each value, SI, shape (values,)."""
        return np.asarray(self.conditions[name][self.row])

    @cached_property
    def settings(self) -> dict[str, Array]:
        """Settings, and the time or order of measurement, by name, SI, shape (values,) each."""
        names = (*setting_columns(self.measurements), *([self.order] if self.order else []))
        return {name: self.column(name) for name in names}

    @cached_property
    def varied(self) -> dict[str, Array]:
        """Settings that were varied, and the order of measurement, by name, SI, shape (values,) each."""
        found = self.settings.items()
        return {name: column for name, column in found if name == self.order or varies(column)}

    @cached_property
    def order(self) -> str:
        """Name of the column that shows best when each run was made; empty if values are too few."""
        columns = {name: self.column(name) for name in order_columns(self.measurements)}
        found = {n: np.unique(c).size for n, c in columns.items() if np.isfinite(c).all()}
        best = max(found, key=lambda name: found[name], default="")
        return best if found.get(best, 0) >= FEWEST_VALUES else ""


def points_of(measurements: Measurements, outliers: Index | None = None) -> Points:
    """Reduce measurements to points: means over the rows of one run and setting.

    In swept runs load and sinkage are geometric means, weighted by squared depth where the body does not
    roll.

    Parameters
    ----------
    measurements
        The table of measurements.
    outliers
        Numbers of the rows to leave out, shape (outliers,); none if not given.

    Returns
    -------
    Points
        One value for each point and channel, with notes on rows that no model can predict. Of more runs
        than `MOST_POINTS` has room for, a random sample, the same each time.

    Raises
    ------
    FittingError
        If nothing usable is measured.
    """
    conditions = filled(measurements.conditions)
    usable, notes = _usable(measurements, conditions)
    for mask in usable.values() if outliers is not None else ():
        mask[outliers] = False
    if not any(mask.any() for mask in usable.values()):
        raise FittingError(
            f"{measurements.source or 'the measurements'}: no row has a usable sinkage, resistance "
            "or drawbar_pull or torque (which need slip): measure at least one of them"
        )
    names, run = runs_of(measurements)
    some = np.any(list(usable.values()), axis=0)
    groups = _groups_of(measurements, run, some)
    there, kept = (np.unique(run[r]).size for r in (some, [group.rows[0] for group in groups]))
    if kept < there:
        notes.append(
            f"of {there} runs {kept}, drawn at random, are fitted and judged:"
            " more take longer and change nothing"
        )
    # A value for each channel and group of rows that has it.
    values = [
        (name, g, rows)
        for name, mask in usable.items()
        for g, group in enumerate(groups)
        if (rows := group.rows[mask[group.rows]]).size
    ]
    channels = tuple(dict.fromkeys(name for name, _, _ in values))
    row = np.array([g for _, g, _ in values], dtype=np.intp)
    swept = np.array([group.swept for group in groups])
    first = np.array([group.rows[0] for group in groups], dtype=np.intp)
    depth = measurements.channels.get("sinkage", np.ones(len(measurements)))
    depth = np.where(conditions.rolling, 1.0, depth)  # a wheel's sinkage goes with its slip
    mean = _mean_conditions(conditions, groups, depth)
    measured = [
        _along_curve(measurements.channels[name][rows], depth[rows])
        if swept[g] and name == "sinkage"
        else float(np.mean(measurements.channels[name][rows]))
        for name, g, rows in values
    ]
    return Points(
        measurements,
        mean,
        channels,
        names,
        np.array(measured),
        row,
        np.array([channels.index(name) for name, _, _ in values], dtype=np.intp),
        run[first][row],
        settings_of_rows(replace(measurements.take(first), conditions=mean))[row],
        swept[row],
        np.array([group.path for group in groups])[row],
        np.array([_declared(measurements, name, rows) for name, _, rows in values]),
        tuple(rows for *_, rows in values),
        tuple(notes),
    )


def runs_of(measurements: Measurements) -> tuple[tuple[str, ...], Index]:
    """Return the names of the runs, and the index of each row's run, shape (rows,).

    A long record in which no runs are given is cut into stretches of consecutive rows of each wheel.
    """
    names, run = runs_of_rows(measurements)
    if measurements.runs_given or len(names) <= MOST_POINTS:
        return names, run
    stretch = np.empty(len(measurements), dtype=np.intp)
    for wheel in np.unique(measurements.wheel):
        rows = np.flatnonzero(measurements.wheel == wheel)
        stretch[rows] = np.arange(rows.size) * _STRETCHES // rows.size
    return tuple(f"stretch {i + 1}" for i in range(_STRETCHES)), stretch


def filled(conditions: Conditions) -> Conditions:
    """Replace NaN in covariates by the median of the column, and NaN widths by 0.

    Bodies that do not roll lack them. Effects of rolling are not applied to such rows; an effect of the
    soil (its moisture, say) then acts as on a rolling row with the median value.
    """
    covariates = {}
    for name, column in conditions.covariates.items():
        known = column[np.isfinite(column)]
        middle = float(np.median(known)) if known.size else 0.0
        covariates[name] = np.where(np.isfinite(column), column, middle)
    return replace(conditions, covariates=covariates, width=np.nan_to_num(conditions.width))


def _usable(
    measurements: Measurements, conditions: Conditions
) -> tuple[dict[str, Mask], list[str]]:
    """Mask of the rows that a model can be compared with, by channel, and notes on why others cannot."""
    notes: list[str] = []
    deep = measurements.sunk_to_axle
    if deep.any():
        notes.append(
            f"{int(deep.sum())} rows are not used: the wheel was measured deeper than its axle, "
            "where no model of a rolling wheel holds"
        )
    found = {}
    for name in (n for n in CHANNELS if n in measurements.channels):
        there = np.isfinite(measurements.channels[name]) & ~deep
        usable = there if name == "sinkage" else there & conditions.rolling
        if usable.sum() < there.sum():
            notes.append(f"{name} of rows that do not roll is not used: no model predicts it")
        if name in FORCES and usable.any() and "slip" not in conditions:
            first = measurements.line[np.flatnonzero(usable)[0]]
            notes.append(
                f"{name} (from {measurements.place} {first}) is not used: the table has no slip, which "
                "it needs"
            )
            continue
        if name in FORCES and "slip_angle" in conditions:
            along = np.abs(conditions["slip_angle"]) <= _ALONG
            if (usable & ~along).any():
                notes.append(
                    f"{name} of {int((usable & ~along).sum())} rows is not used: its law is as good as "
                    "stated for a wheel that runs along its plane (slip angle up to 10 deg)"
                )
            usable = usable & along
        found[name] = usable
    return found, notes


class _Group(NamedTuple):
    """Rows of one point.

    Attributes
    ----------
    rows
        Numbers of the table's rows.
    swept
        Whether they are part of a run in which a setting was changed.
    path
        Position along that run, 0 to 1.
    """

    rows: Index
    swept: bool
    path: float


def _groups_of(measurements: Measurements, run: Index, usable: Mask) -> list[_Group]:
    """The rows of each point; of more runs than `MOST_POINTS` has room for, those of a random sample.

    `run` is the index of each row's run, `usable` the mask of the rows to use, shape (rows,) each.
    """
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
    groups: list[_Group] = []
    for i in kept:
        parts = _along(measurements, runs[i], setting, bins) if swept[i] else [runs[i]]
        last = max(len(parts) - 1, 1)
        groups += [_Group(part, len(parts) > 1, j / last) for j, part in enumerate(parts)]
    return groups


def _is_swept(conditions: Conditions, rows: Index) -> bool:
    """Whether a setting was changed within the run, by more than it wavers.

    Load, slip and slip angle are judged between their 10 and 90 % quantiles, so that the number of rows
    does not matter.
    """
    low, high = np.quantile(conditions.load[rows], [0.1, 0.9])
    if high > 1.5 * low:
        return True
    for name in ("slip", "slip_angle"):
        if name in conditions and np.isfinite(conditions[name][rows]).all():
            low, high = np.quantile(conditions[name][rows], [0.1, 0.9])
            if high - low > 0.1:
                return True
    kept = ("diameter", "width", "pass_number", "grouser_height")
    columns = [conditions[n] for n in kept if n in conditions]
    return any(np.ptp(np.nan_to_num(column[rows])) > 1e-3 for column in columns)


def _along(measurements: Measurements, rows: Index, setting: Index, bins: int) -> list[Index]:
    """Split a swept run: by setting where there are at most `bins` settings, else into bins along its path.

    The path of a plate is its depth, that of a wheel the order of its rows; bins in which a setting still
    changes are left out.
    """
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
    place = np.searchsorted(np.linspace(z.min(), z.max(), bins + 1)[1:-1], z)
    return [settled[place == b] for b in range(bins) if (place == b).any()]


def _declared(measurements: Measurements, channel: str, rows: Index) -> float:
    """Root mean square of the deviations stated for these rows; NaN unless the table states one for each."""
    stated = measurements.declared_std.get(channel)
    if stated is None or not np.isfinite(stated[rows]).all():
        return float("nan")
    return float(np.sqrt(np.mean(stated[rows] ** 2)))


def _along_curve(values: Array, depth: Array) -> float:
    """Geometric mean along a curve, since between its points pressure is a power of depth.

    The weight of a row is its squared depth: the error of a zero is of one size at all depths, so that of
    ln depth is inversely proportional to the depth. Rows at touch-down thus have little weight. Whatever
    the weights are, the means of load and depth lie on the same power law as the rows do.
    """
    if not np.all(values > 0):
        return float(np.mean(values))
    weights = depth**2 if np.all(depth > 0) else None
    return float(np.exp(np.average(np.log(values), weights=weights)))


def _mean_conditions(conditions: Conditions, groups: list[_Group], depth: Array) -> Conditions:
    first = np.array([group.rows[0] for group in groups])
    columns = {name: conditions[name] for name in ("load", "diameter", "width")}
    mean = {
        name: np.array([column[group.rows].mean() for group in groups])
        for name, column in {**columns, **conditions.covariates}.items()
    }
    load, diameter, width = (mean.pop(name) for name in columns)
    for i, rows in ((i, group.rows) for i, group in enumerate(groups) if group.swept):
        load[i] = _along_curve(conditions.load[rows], depth[rows])
    return Conditions(
        load,
        diameter,
        width,
        conditions.contact[first],
        None if conditions.soil is None else conditions.soil[first],
        mean,
    )
