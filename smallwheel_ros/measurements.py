"""Measurements of wheels in soil: the table that everything is compared with.

One row is one steady measurement of one wheel. `read_measurements` is the one reader of such tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.conditions import PLATE, Array, Conditions
from smallwheel_ros.errors import SmallwheelError

CHANNELS = ("sinkage", "resistance", "drawbar_pull")  # m, N, N: what a model predicts

Rows = NDArray[np.intp] | NDArray[np.bool_] | slice


class MeasurementsError(SmallwheelError):
    """A table of measurements that cannot be used: names file, line, column, found and expected."""


@dataclass(frozen=True)
class Measurements:
    """What was measured, one row per steady measurement of one wheel; SI units, arrays of shape (rows,).

    conditions: load, wheel, contact, soil, and every other numeric column as a covariate. A covariate is
    known in every rolling row; in a pressed or plate row it may be NaN (slip, slip angle and slope are 0
    and the pass is 1 there unless the table says otherwise).
    channels: those of `CHANNELS` that the table has; NaN where a row did not measure it.
    declared_std: by channel, the standard deviation that the table states; NaN where it states none.
    run: rows of one run are repeats of one setting and never split between fit and test. `runs_given`
    is False where the table names no runs and each row is its own.
    wheel: the wheel's name, made from its size where the table has none.
    line: each row's line in the file (row in a Parquet file), for messages.
    labels: text columns that are neither soil, run, wheel nor contact.
    units: of each numeric column, as everything here is held: SI, or "" where the table gives none.
    warnings: what is suspicious; notes: what was assumed.
    """

    conditions: Conditions
    channels: Mapping[str, Array]
    run: NDArray[np.str_]
    wheel: NDArray[np.str_]
    line: NDArray[np.intp]
    declared_std: Mapping[str, Array] = field(default_factory=dict)
    labels: Mapping[str, NDArray[np.str_]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    runs_given: bool = True
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""

    def __len__(self) -> int:
        return len(self.conditions)

    @property
    def runs(self) -> NDArray[np.str_]:
        """The runs' names in the order in which they first appear."""
        names, first = np.unique(self.run, return_index=True)
        return names[np.argsort(first)]

    @property
    def soil(self) -> NDArray[np.str_]:
        """The soil's name per row, "" where the table names none."""
        named = self.conditions.soil
        return np.full(len(self), "") if named is None else named

    @property
    def sunk_to_axle(self) -> NDArray[np.bool_]:
        """Rows in which a wheel was measured deeper than its axle: no model of a rolling wheel holds there."""
        if "sinkage" not in self.channels:
            return np.zeros(len(self), dtype=bool)
        deep = self.channels["sinkage"] > 0.5 * self.conditions.diameter
        return np.asarray(deep & (self.conditions.contact != PLATE))

    def channel_rows(self, name: str) -> NDArray[np.intp]:
        """The rows that measured the channel; empty where the table does not have it."""
        if name not in self.channels:
            return np.empty(0, dtype=np.intp)
        return np.flatnonzero(np.isfinite(self.channels[name]))

    def take(self, rows: Rows) -> Measurements:
        """The rows of that index or mask; a channel that none of them measured is left out."""
        channels = {name: values[rows] for name, values in self.channels.items()}
        kept = [name for name, values in channels.items() if np.isfinite(values).any()]
        return replace(
            self,
            conditions=self.conditions.take(rows),
            channels={name: channels[name] for name in kept},
            run=self.run[rows],
            wheel=self.wheel[rows],
            line=self.line[rows],
            declared_std={k: v[rows] for k, v in self.declared_std.items() if k in kept},
            labels={name: values[rows] for name, values in self.labels.items()},
        )
