"""Measurements as a fit sees them: one long list of numbers, each of a row, a channel and a run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.measurements.table import CHANNELS, Measurements
from smallwheel_ros.model import Prediction
from smallwheel_ros.physics.conditions import ROLLING, Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ROWS_OF_A_CURVE = 20  # as many as a curve counts for
_ACROSS = 0.18  # rad
# A run in which a setting differs by more than this ratio and this much is no run of repeats.
_STEADY = {
    "load": (1.5, 0.0),
    "diameter": (1.02, 0.0),
    "width": (1.02, 0.0),
    "slip": (1.0, 0.1),
    "slip_angle": (1.0, 0.1),
    "speed": (1.5, 0.0),
    "pass_number": (1.0, 0.5),
}


class FittingError(SmallwheelError):
    """Measurements that a model cannot be fitted to, or a fit that makes no sense."""


@dataclass(frozen=True)
class Observations:
    """What was measured, flattened; arrays of shape (observations,) unless said otherwise.

    value: SI. row: index into the conditions. channel: index into `channels`. run: index into
    `runs`.
    declared: standard deviation that the table states, NaN where none. conditions: of shape
    (rows,).
    """

    conditions: Conditions
    channels: tuple[str, ...]
    runs: tuple[str, ...]
    value: Array
    row: Index
    channel: Index
    run: Index
    declared: Array
    notes: tuple[str, ...] = ()

    @cached_property
    def swept(self) -> NDArray[np.bool_]:
        """Observations of a run in which a setting was changed: its rows are no repeats."""
        found = np.zeros(len(self.runs), dtype=bool)
        for name, (ratio, apart) in _STEADY.items():
            if name not in self.conditions:
                continue
            column = self.conditions[name][self.row]
            low, high = np.full(len(self.runs), np.inf), np.full(len(self.runs), -np.inf)
            np.fmin.at(low, self.run, column)
            np.fmax.at(high, self.run, column)
            found |= (high - low > apart) & (high > ratio * low)  # all blank: inf, never swept
        return np.asarray(found[self.run])

    @cached_property
    def curves(self) -> NDArray[np.bool_]:
        """Observations of a long run of a body pressed down: neighbours say nearly the same."""
        rows = np.bincount(self.run, minlength=len(self.runs))
        pressed = self.conditions.contact[self.row] != ROLLING
        return np.asarray(self.swept & pressed & (rows[self.run] > ROWS_OF_A_CURVE))

    def __len__(self) -> int:
        return int(self.value.size)

    def of_channel(self, name: str) -> NDArray[np.bool_]:
        """Mask of the observations of that channel."""
        return np.asarray(self.channel == self.channels.index(name))

    def pick(self, prediction: Prediction) -> Array:
        """The predicted numbers in the order of the observations."""
        columns = [getattr(prediction, name) for name in self.channels]
        return np.asarray(np.stack(columns)[self.channel, self.row])

    def take(self, keep: NDArray[np.bool_]) -> Observations:
        """The observations of that mask, on the same rows and runs."""
        return replace(
            self,
            value=self.value[keep],
            row=self.row[keep],
            channel=self.channel[keep],
            run=self.run[keep],
            declared=self.declared[keep],
        )

    def with_values(self, value: Array) -> Observations:
        """The same, measured otherwise: for simulated data."""
        return replace(self, value=value)


def _filled(conditions: Conditions) -> Conditions:
    """No covariate is NaN: a body that does not roll has none, and there the rolling median stands in.

    Effects of rolling are not applied to such rows; an effect of the soil (its moisture, say) then
    acts as on a middling rolling row.
    """
    covariates = {}
    for name, column in conditions.covariates.items():
        known = column[np.isfinite(column)]
        middle = float(np.median(known)) if known.size else 0.0
        covariates[name] = np.where(np.isfinite(column), column, middle)
    return replace(conditions, covariates=covariates)


def _settings(measurements: Measurements) -> Array:
    conditions = measurements.conditions
    columns = [conditions.load, conditions.diameter, conditions.width]
    columns += list(conditions.covariates.values())
    table = np.nan_to_num(np.column_stack(columns), nan=-1.0)
    texts = [np.unique(t, return_inverse=True)[1] for t in (measurements.soil, conditions.contact)]
    return np.column_stack([table, *texts])


def run_codes(measurements: Measurements) -> tuple[tuple[str, ...], Index]:
    """Names of the runs and each row's index into them.

    Where the table names no runs, rows with the same settings are repeats and make one run: taking
    them as independent would count one piece of evidence several times.
    """
    if measurements.runs_given:
        names = measurements.runs
        order = np.argsort(names)
        codes = order[np.searchsorted(names[order], measurements.run)]
        return tuple(str(name) for name in names), codes.astype(np.intp)
    _, first, codes = np.unique(
        _settings(measurements), axis=0, return_index=True, return_inverse=True
    )
    rank = np.empty(first.size, dtype=np.intp)
    rank[np.argsort(first)] = np.arange(first.size)
    return tuple(f"setting {i + 1}" for i in range(first.size)), rank[codes.reshape(-1)]


def observe(measurements: Measurements) -> Observations:
    """Flatten the measurements. Raises FittingError where nothing usable is measured."""
    conditions = _filled(measurements.conditions)
    runs, codes = run_codes(measurements)
    rolling = conditions.contact == ROLLING
    notes: list[str] = []
    channels, rows = [], []
    deep = measurements.sunk_to_axle
    if deep.any():
        notes.append(
            f"{int(deep.sum())} rows are not used: the wheel was measured deeper than its axle, where "
            "no model of a rolling wheel holds"
        )
    for name in CHANNELS:
        there = measurements.channel_rows(name)
        there = there[~deep[there]]
        usable = there if name == "sinkage" else there[rolling[there]]
        if usable.size < there.size:
            notes.append(f"{name} of rows that do not roll is not used: no model predicts it")
        if name == "drawbar_pull" and usable.size and "slip" not in conditions:
            notes.append("drawbar_pull is not used: the table has no slip, which thrust needs")
            continue
        if name == "drawbar_pull" and "slip_angle" in conditions:
            along = np.abs(conditions["slip_angle"][usable]) <= _ACROSS
            if not along.all():
                notes.append(
                    f"drawbar_pull of {int((~along).sum())} rows is not used: the law of thrust holds "
                    "for a wheel that runs along its plane (slip angle up to 10 deg)"
                )
            usable = usable[along]
        if usable.size:
            channels.append(name)
            rows.append(usable)
    if not channels:
        raise FittingError(
            f"{measurements.source or 'the measurements'}: no row has a usable sinkage, resistance or "
            "drawbar_pull (which needs slip): measure at least one of them"
        )
    row = np.concatenate(rows)
    channel = np.repeat(np.arange(len(channels)), [r.size for r in rows])
    value = np.concatenate(
        [measurements.channels[c][r] for c, r in zip(channels, rows, strict=True)]
    )
    declared = np.concatenate(
        [
            measurements.declared_std[c][r]
            if c in measurements.declared_std
            else np.full(r.size, np.nan)
            for c, r in zip(channels, rows, strict=True)
        ]
    )
    return Observations(
        conditions,
        tuple(channels),
        runs,
        value,
        row,
        channel.astype(np.intp),
        codes[row],
        declared,
        tuple(notes),
    )
