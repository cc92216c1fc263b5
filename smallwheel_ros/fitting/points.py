"""Measurements as a fit sees them: points, each the mean of a steady stretch of one run.

Rows of a run are no independent evidence. A run in which nothing was changed becomes one point of
each channel; a run in which a setting was swept (a plate's curve, a time series) becomes one point
for each setting, or, where it passes through many, at most `CURVE_POINTS` bins along its path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting.constants import CURVE_POINTS, MOST_POINTS
from smallwheel_ros.measurements.settings import (
    runs_of_rows,
    setting_columns,
    settings_of_rows,
    varies,
)
from smallwheel_ros.measurements.table import CHANNELS, Measurements
from smallwheel_ros.model import Prediction
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

_FEWEST_BINS = 4  # a curve's level, slope and bend, and one to check them
_ALONG = np.radians(10.0)  # slip angle up to which a law of thrust along the wheel's plane holds
_STRETCHES = MOST_POINTS // 8  # of a long record: so that two channels have four points in each
_TOUCHED = 0.01  # of a curve's depth: before it the body has not settled on the soil


class FittingError(SmallwheelError):
    """Measurements that a model cannot be fitted to, or a fit that makes no sense."""


@dataclass(frozen=True)
class Points:
    """What was measured, one number for each point and channel; arrays of shape (values,).

    conditions: settings of the points, shape (points,). value: mean of the rows, SI. row: index of
    the point. channel, run, setting: codes; values of one setting were taken under the same
    conditions. swept: part of a run in which a setting was changed. rows: of each value, its rows
    in `measurements`. declared: standard deviation of a row that the table states, NaN where none.
    path: order along a swept run.
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
        """How many rows each value is the mean of."""
        return np.array([r.size for r in self.rows], dtype=float)

    @property
    def run_count(self) -> int:
        """How many runs have values."""
        return int(np.unique(self.run).size)

    def of_channel(self, name: str) -> Mask:
        """Mask of the values of that channel."""
        return np.asarray(self.channel == self.channels.index(name))

    def pick(self, prediction: Prediction) -> Array:
        """The predicted numbers in the order of the values."""
        columns = np.stack([getattr(prediction, name) for name in self.channels])
        return np.asarray(columns[self.channel, self.row])

    def without_channel(self, name: str) -> Points:
        """The values of the other channels."""
        kept = self.take(~self.of_channel(name))
        code = self.channels.index(name)
        channel = np.where(kept.channel > code, kept.channel - 1, kept.channel)
        return replace(kept, channels=tuple(c for c in self.channels if c != name), channel=channel)

    def take(self, keep: Mask) -> Points:
        """The values of that mask, on the same points."""
        index = np.flatnonzero(keep)
        kept = {
            name: getattr(self, name)[keep]
            for name in ("value", "row", "channel", "run", "setting", "swept", "path", "declared")
        }
        return replace(self, **kept, rows=tuple(self.rows[i] for i in index))

    def column(self, name: str) -> Array:
        """A setting at each value, shape (values,)."""
        return np.asarray(self.conditions[name][self.row])

    @property
    def settings(self) -> dict[str, Array]:
        """Everything that was set by name, at each value."""
        return {name: self.column(name) for name in setting_columns(self.measurements)}

    @property
    def varied(self) -> dict[str, Array]:
        """The settings that were varied, by name, at each value."""
        return {name: column for name, column in self.settings.items() if varies(column)}


def filled(conditions: Conditions) -> Conditions:
    """No covariate is NaN: a body that does not roll has none, and there the median stands in.

    Effects of rolling are not applied to such rows; an effect of the soil (its moisture, say) then
    acts as on a middling rolling row.
    """
    covariates = {}
    for name, column in conditions.covariates.items():
        known = column[np.isfinite(column)]
        middle = float(np.median(known)) if known.size else 0.0
        covariates[name] = np.where(np.isfinite(column), column, middle)
    return replace(conditions, covariates=covariates, width=np.nan_to_num(conditions.width))


def points_of(measurements: Measurements, outliers: Index | None = None) -> Points:
    """Reduce the measurements to points. outliers: rows that are left out.

    Raises FittingError where nothing usable is measured.
    """
    conditions = filled(measurements.conditions)
    usable, notes = _usable(measurements, conditions)
    if outliers is not None:
        for mask in usable.values():
            mask[outliers] = False
    if not any(mask.any() for mask in usable.values()):
        raise FittingError(
            f"{measurements.source or 'the measurements'}: no row has a usable sinkage, resistance "
            "or drawbar_pull (which needs slip): measure at least one of them"
        )
    channels = tuple(name for name in CHANNELS if name in usable and usable[name].any())
    names, run = _runs(measurements)
    groups, swept, path = _groups(measurements, run, np.any([usable[c] for c in channels], axis=0))
    value: list[float] = []
    rows: list[Index] = []
    index: list[int] = []
    channel: list[int] = []
    curved: list[bool] = []
    for c, name in enumerate(channels):
        measured = measurements.channels[name]
        for g, members in enumerate(groups):
            used = members[usable[name][members]]
            if used.size:
                log = swept[g] and name == "sinkage"
                value.append(_mean(measured[used], log))
                rows.append(used)
                index.append(g)
                channel.append(c)
                curved.append(swept[g])
    row = np.array(index, dtype=np.intp)
    first = np.array([g[0] for g in groups], dtype=np.intp)
    mean = _mean_conditions(conditions, groups, swept)
    setting = settings_of_rows(replace(measurements.take(first), conditions=mean))
    return Points(
        measurements,
        mean,
        channels,
        names,
        np.array(value),
        row,
        np.array(channel, dtype=np.intp),
        run[first][row],
        setting[row],
        np.array(curved, dtype=bool),
        path[row],
        _declared(measurements, channels, channel, rows),
        tuple(rows),
        tuple(notes),
    )


def _runs(measurements: Measurements) -> tuple[tuple[str, ...], Index]:
    """Names of the runs and each row's run; of a long record without runs, stretches of each wheel."""
    names, run = runs_of_rows(measurements)
    if measurements.runs_given or len(names) <= MOST_POINTS:
        return names, run
    stretch = np.empty(len(measurements), dtype=np.intp)
    for wheel in np.unique(measurements.wheel):
        rows = np.flatnonzero(measurements.wheel == wheel)
        stretch[rows] = np.arange(rows.size) * _STRETCHES // rows.size
    return tuple(f"stretch {i + 1}" for i in range(_STRETCHES)), stretch


def _declared(
    measurements: Measurements, channels: tuple[str, ...], channel: list[int], rows: list[Index]
) -> Array:
    found = np.full(len(rows), np.nan)
    for i, (c, used) in enumerate(zip(channel, rows, strict=True)):
        stated = measurements.declared_std.get(channels[c])
        if stated is not None and np.isfinite(stated[used]).all():
            found[i] = np.sqrt(np.mean(stated[used] ** 2))
    return found


def _usable(
    measurements: Measurements, conditions: Conditions
) -> tuple[dict[str, Mask], list[str]]:
    """By channel, the rows that a model can be held against, and why others cannot."""
    notes: list[str] = []
    deep = measurements.sunk_to_axle
    if deep.any():
        notes.append(
            f"{int(deep.sum())} rows are not used: the wheel was measured deeper than its axle, "
            "where no model of a rolling wheel holds"
        )
    found = {}
    for name in CHANNELS:
        if name not in measurements.channels:
            continue
        there = np.isfinite(measurements.channels[name]) & ~deep
        usable = there if name == "sinkage" else there & conditions.rolling
        if usable.sum() < there.sum():
            notes.append(f"{name} of rows that do not roll is not used: no model predicts it")
        if name == "drawbar_pull" and usable.any() and "slip" not in conditions:
            notes.append("drawbar_pull is not used: the table has no slip, which thrust needs")
            continue
        if name == "drawbar_pull" and "slip_angle" in conditions:
            along = np.abs(conditions["slip_angle"]) <= _ALONG
            if (usable & ~along).any():
                notes.append(
                    f"drawbar_pull of {int((usable & ~along).sum())} rows is not used: the law of "
                    "thrust holds for a wheel that runs along its plane (slip angle up to 10 deg)"
                )
            usable = usable & along
        found[name] = usable
    return found, notes


def _groups(
    measurements: Measurements, run: Index, usable: Mask
) -> tuple[list[Index], list[bool], Array]:
    """Rows of each point, whether its run was swept, and its place along the run."""
    setting = settings_of_rows(measurements)
    runs = [np.flatnonzero((run == r) & usable) for r in range(int(run.max()) + 1)]
    runs = [rows for rows in runs if rows.size]
    channels = len(measurements.channels)
    room = MOST_POINTS // max(1, channels * len(runs))
    bins = int(np.clip(room, _FEWEST_BINS, CURVE_POINTS))
    groups: list[Index] = []
    swept: list[bool] = []
    path: list[float] = []
    for rows in runs:
        if not _is_swept(measurements.conditions, rows):
            parts = [rows]
        else:
            parts = _along(measurements, rows, setting, bins)
        groups += parts
        swept += [len(parts) > 1] * len(parts)
        path += [float(i) / max(len(parts) - 1, 1) for i in range(len(parts))]
    return groups, swept, np.array(path)


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


def _mean(values: Array, log: bool) -> float:
    """Mean, geometric along a curve: between its points pressure is a power of depth."""
    if log and np.all(values > 0):
        return float(np.exp(np.mean(np.log(values))))
    return float(np.mean(values))


def _mean_conditions(conditions: Conditions, groups: list[Index], swept: list[bool]) -> Conditions:
    first = np.array([g[0] for g in groups])

    def mean(column: Array, log: bool) -> Array:
        return np.array([_mean(column[g], log and s) for g, s in zip(groups, swept, strict=True)])

    return Conditions(
        mean(conditions.load, True),
        mean(conditions.diameter, False),
        mean(conditions.width, False),
        conditions.contact[first],
        None if conditions.soil is None else conditions.soil[first],
        {name: mean(column, False) for name, column in conditions.covariates.items()},
    )
