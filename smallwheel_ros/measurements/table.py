# SPDX-License-Identifier: Apache-2.0
"""Measurements of wheels in soil: the table that everything is compared with.

One row is one steady measurement of one wheel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.results import Result
from smallwheel_ros.measurements.cells import MeasurementsError
from smallwheel_ros.measurements.columns import CHANNELS, is_response, unit_of
from smallwheel_ros.physics.conditions import PLATE, Array, Conditions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["CHANNELS", "Measurements", "MeasurementsError", "Rows"]

Rows = NDArray[np.intp] | NDArray[np.bool_] | slice


@dataclass(frozen=True, repr=False)
class Measurements(Result):
    """What was measured, one row per steady measurement of one wheel.

    SI units; arrays of shape (rows,).
    conditions: load, wheel, contact, soil, and every other numeric column as a covariate. A
    covariate is known in every rolling row; in a pressed or plate row it may be NaN (slip, slip
    angle and slope are 0 and the pass is 1 there unless the table says otherwise).
    channels: those of `CHANNELS` that the table has; NaN where a row did not measure it.
    declared_std: by channel, the standard deviation that the table states; NaN where none.
    run: rows of one run are repeats of one setting and never split between fit and test.
    `runs_given` is False where the table names no runs: rows of exactly the same settings are one.
    wheel: the wheel's name, made from its size where the table has none (`wheels_given` False).
    line: each row's line in the file (row in a Parquet file), for messages.
    labels: text columns that are neither soil, run, wheel nor contact.
    units: of each numeric column, as everything here is held: SI, or "" where the table gives none.
    headers: by our name, the column's header as it stands in the file.
    written_units: of the columns whose header has one, as `units.to_base` takes it.
    warnings: what is suspicious; notes: what was assumed; understood: what was made of headers and
    cells that are not written our way.
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
    wheels_given: bool = False
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    understood: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""
    written_units: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.conditions)

    def headline(self) -> str:
        """How many rows and runs, and what was measured."""
        count = f"{len(self)} rows, {self.runs.size} runs of {', '.join(self.channels)}"
        return f"{self.source}: {count}" if self.source else count

    def columns(self) -> dict[str, Any]:
        """Every column by name, SI units, shape (rows,): settings first, then what was measured."""
        c = self.conditions
        found: dict[str, Any] = {"run": self.run, "wheel": self.wheel}
        found |= {} if c.soil is None else {"soil": c.soil}
        found |= {name: c[name] for name in ("load", "diameter", "width", *c.covariates)}
        return found | dict(self.channels)

    def to_dict(self) -> dict[str, Any]:
        """What the table is: columns with units and ranges, not its rows."""
        numbers = {n: c for n, c in self.columns().items() if np.asarray(c).dtype.kind == "f"}
        return {
            "schema": 1,
            "source": self.source,
            "sha256": self.sha256,
            "rows": len(self),
            "runs": int(self.runs.size),
            "runs_given": self.runs_given,
            "columns": {
                name: {
                    "unit": self.units.get(name, unit_of(name)),
                    "from": float(np.nanmin(values)) if np.isfinite(values).any() else None,
                    "to": float(np.nanmax(values)) if np.isfinite(values).any() else None,
                }
                for name, values in numbers.items()
            },
            "understood": list(self.understood),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One mapping for each row, SI units; None where nothing was measured."""
        lists = {name: column.tolist() for name, column in self.columns().items()}
        return [
            {n: None if v != v else v for n, v in zip(lists, row, strict=True)}
            for row in zip(*lists.values(), strict=True)
        ]

    def plot(
        self, ax: Axes | None = None, channel: str | None = None, over: str | None = None
    ) -> Axes:
        """Draw a channel (the first) over a setting (load); ResultError where there is none."""
        return self._drawn(ax, channel, over)

    @property
    def runs(self) -> NDArray[np.str_]:
        """Names of the runs in the order in which they first appear."""
        return np.array(codes_of(self.run)[0], dtype=np.str_)

    @property
    def soil(self) -> NDArray[np.str_]:
        """The soil's name per row, "" where the table names none."""
        named = self.conditions.soil
        return np.full(len(self), "") if named is None else named

    @property
    def responses(self) -> tuple[str, ...]:
        """Covariates that the wheel answers with (side force, motor current), not settings.

        A column of forces, torques, pressures, powers or energies by its unit, or so by its name.
        """
        names = self.conditions.covariates
        return tuple(name for name in names if is_response(name, self.units.get(name, "")))

    @property
    def sunk_to_axle(self) -> NDArray[np.bool_]:
        """Rows in which a wheel was measured deeper than its axle: no model holds there."""
        if "sinkage" not in self.channels:
            return np.zeros(len(self), dtype=bool)
        deep = over_half(self.channels["sinkage"], self.conditions.diameter)
        return np.asarray(deep & (self.conditions.contact != PLATE))

    def channel_rows(self, name: str) -> NDArray[np.intp]:
        """Rows that measured the channel; empty where the table does not have it."""
        if name not in self.channels:
            return np.empty(0, dtype=np.intp)
        return np.flatnonzero(np.isfinite(self.channels[name]))

    def take(self, rows: Rows) -> Measurements:
        """Keep the rows of that index or mask."""
        return replace(
            self,
            conditions=self.conditions.take(rows),
            channels={name: values[rows] for name, values in self.channels.items()},
            run=self.run[rows],
            wheel=self.wheel[rows],
            line=self.line[rows],
            declared_std={name: values[rows] for name, values in self.declared_std.items()},
            labels={name: values[rows] for name, values in self.labels.items()},
        )


def codes_of(column: NDArray[Any]) -> tuple[list[Any], NDArray[np.intp]]:
    """The different values in the order in which they first appear, and each row's index into them.

    Equal neighbours are one value to look up, and a table of values is many times quicker than sorting
    texts, as `np.unique` does.
    """
    begins = np.concatenate([[True], column[1:] != column[:-1]])[: column.size]
    rows = column[begins].tolist()
    names = list(dict.fromkeys(rows))
    number = dict(zip(names, range(len(names)), strict=True))
    codes = np.fromiter(map(number.__getitem__, rows), np.intp, len(rows))
    return names, codes[np.cumsum(begins) - 1]


def over_half(sinkage: Array, diameter: Array) -> NDArray[np.bool_]:
    """Whether a wheel is deeper than its axle."""
    return np.asarray(sinkage > 0.5 * diameter * (1.0 + 1e-9))
