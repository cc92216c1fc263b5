# SPDX-License-Identifier: Apache-2.0
"""Measurements of wheels in soil, the table that models are fitted to and compared with; and shear tests.

One row is one steady measurement of one wheel.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.result import Result
from smallwheel_ros.measurements.cells import MeasurementsError
from smallwheel_ros.measurements.columns import CHANNELS, Mask, Texts, is_response, unit_of
from smallwheel_ros.physics.conditions import PLATE, Array, Conditions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["CHANNELS", "Measurements", "MeasurementsError", "Rows", "ShearTests"]

Rows = NDArray[np.intp] | NDArray[np.bool_] | slice


@dataclass(frozen=True, repr=False)
class Measurements(Result, shown="views.measured"):
    """Measurements, one row for each steady measurement of one wheel. SI units; arrays of shape (rows,).

    Attributes
    ----------
    conditions
        Load, wheel, contact, soil, and every other numeric column as a covariate. A covariate is known
        in every rolling row; in a pressed or plate row it may be NaN (slip, slip angle and slope are 0
        and the pass is 1 there unless the table says otherwise).
    channels
        Those of `CHANNELS` that the table has; NaN where a row did not measure it.
    declared_std
        By channel, the standard deviation that the table states; NaN where it states none.
    run, runs_given
        Name of each row's run. Rows of one run are repeats of one setting and never split between fit and
        test. If the table names no runs (`runs_given` False), rows of one setting are one run
        (`settings.setting_codes`).
    wheel, wheels_given
        Name of each row's wheel, made from its size if the table has none (`wheels_given` False).
    line, place
        Number of each row in the file, for messages, and what it counts: "line" of a text file, "row" of any
        other.
    labels
        By name, text columns that are neither soil, run, wheel nor contact.
    units
        Unit of each numeric column as held here: SI, or empty if the table gives none.
    written_units
        Unit in the table, as `columns.to_base` takes it, of each column whose header has one.
    warnings
        Sentences on what is suspicious.
    notes
        Sentences on what was assumed.
    understood
        Sentences on how headers and cells that are not in our own form were read.
    source, sha256
        Path of the file, and the hash of its content; empty if unknown.
    """

    conditions: Conditions
    channels: Mapping[str, Array]
    run: Texts
    wheel: Texts
    line: NDArray[np.intp]
    declared_std: Mapping[str, Array] = field(default_factory=dict)
    labels: Mapping[str, Texts] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    runs_given: bool = True
    wheels_given: bool = False
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    understood: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""
    written_units: Mapping[str, str] = field(default_factory=dict)
    place: str = "line"

    def __len__(self) -> int:
        return len(self.conditions)

    def headline(self) -> str:
        """One line: source, number of rows and runs, and what was measured."""
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
        """A summary of the table for JSON: source, columns with units and ranges, warnings; not its rows."""
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
        """Draw a channel over a setting.

        Parameters
        ----------
        ax
            Axes of matplotlib to draw into; None: a new figure.
        channel
            sinkage, resistance, drawbar_pull or torque; None: the first that was measured.
        over
            Name of the setting, the load or one that was varied; None: the load.

        Returns
        -------
        Axes
            The axes that were drawn into.

        Raises
        ------
        ResultError
            If there is no such channel or setting.
        """
        return self._drawn(ax, channel, over)

    @property
    def runs(self) -> Texts:
        """Names of the runs in the order in which they first appear."""
        return np.array(codes_of(self.run)[0], dtype=np.str_)

    @property
    def soil(self) -> Texts:
        """The soil's name per row, "" where the table names none."""
        named = self.conditions.soil
        return np.full(len(self), "") if named is None else named

    @property
    def responses(self) -> tuple[str, ...]:
        """Covariates that are responses of the wheel (side force, motor current), not settings.

        These are columns of forces, torques, pressures, powers or energies, by their unit or name.
        """
        names = self.conditions.covariates
        return tuple(name for name in names if is_response(name, self.units.get(name, "")))

    @property
    def sunk_to_axle(self) -> Mask:
        """Whether a wheel was measured deeper than its axle, where no model holds, shape (rows,)."""
        if "sinkage" not in self.channels:
            return np.zeros(len(self), dtype=bool)
        deep = over_half(self.channels["sinkage"], self.conditions.diameter)
        return np.asarray(deep & (self.conditions.contact != PLATE))

    def channel_rows(self, name: str) -> NDArray[np.intp]:
        """Indices of the rows that measured the channel; empty if the table does not have it."""
        if name not in self.channels:
            return np.empty(0, dtype=np.intp)
        return np.flatnonzero(np.isfinite(self.channels[name]))

    def take(self, rows: Rows) -> Measurements:
        """A table of the rows of that index, mask or slice."""
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


@dataclass(frozen=True)
class ShearTests:
    """Rows of shear tests; SI units, arrays of shape (rows,).

    Attributes
    ----------
    normal_stress, shear_stress
        Stresses on the sheared surface, Pa.
    displacement
        Shear displacement j of the soil at the annulus's middle radius or under the plate, m.
    run
        Name of each row's test, which is a curve at one normal stress.
    soil
        Name of each row's soil; empty where the table names none.
    line
        Number of each row in the file.
    notes, understood
        Sentences on what was assumed, and on how headers and cells were read.
    source, sha256
        Path of the file, and the hash of its content.
    """

    normal_stress: Array
    shear_stress: Array
    displacement: Array
    run: Texts
    soil: Texts
    line: NDArray[np.intp]
    notes: tuple[str, ...] = ()
    understood: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""

    def __len__(self) -> int:
        return int(self.displacement.size)

    def take(self, rows: Mask) -> ShearTests:
        """The tests with the rows of that mask only."""
        arrays = ("normal_stress", "shear_stress", "displacement", "run", "soil", "line")
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})


def codes_of(column: NDArray[Any]) -> tuple[list[Any], NDArray[np.intp]]:
    """The different values in the order in which they first appear, and each row's index into that list.

    Equal neighbours are one value to look up, and a table of values is many times quicker than sorting
    texts, as `np.unique` does.
    """
    begins = np.concatenate([[True], column[1:] != column[:-1]])[: column.size]
    rows = column[begins].tolist()
    names = list(dict.fromkeys(rows))
    number = dict(zip(names, range(len(names)), strict=True))
    codes = np.fromiter(map(number.__getitem__, rows), np.intp, len(rows))
    return names, codes[np.cumsum(begins) - 1]


def over_half(sinkage: Array, diameter: Array) -> Mask:
    """Whether a wheel is deeper than its axle, shape (rows,); False where the sinkage is NaN.

    Parameters
    ----------
    sinkage, diameter
        Sinkage and diameter of the wheel, m, shape (rows,).
    """
    return np.asarray(sinkage > 0.5 * diameter * (1.0 + 1e-9))


def joined(tables: Sequence[Measurements]) -> Measurements:
    """Join several tables of one lab (a file for each plate, one for the wheel), rows in order.

    A covariate that one table lacks is left out if that table has rolling wheels, else it is NaN in
    that table's rows. Runs of one name in two tables stay different runs. Labels are dropped. If the tables
    have a column in different units, `written_units` has the unit of the first of them.
    """
    if len(tables) == 1:
        return tables[0]

    def all_columns(of: Callable[[Measurements], Mapping[str, Array]]) -> dict[str, Array]:
        names = dict.fromkeys(name for table in tables for name in of(table))
        parts = [(of(table), np.full(len(table), np.nan)) for table in tables]
        return {name: np.concatenate([c.get(name, blank) for c, blank in parts]) for name in names}

    sizes = all_columns(lambda t: {n: t.conditions[n] for n in ("load", "diameter", "width")})
    covariates = all_columns(lambda t: t.conditions.covariates)
    notes = [note for table in tables for note in table.notes]
    for name in list(covariates):
        lacking = [t for t in tables if name not in t.conditions.covariates]
        if any(t.conditions.rolling.any() for t in lacking):
            notes.append(f"column '{name}' is left out: {lacking[0].source} does not have it")
            del covariates[name]
    # The soil of a table that names none has the name that a fit gives it.
    named = any(t.conditions.soil is not None for t in tables)
    soils = [np.full(len(t), "soil") if t.conditions.soil is None else t.soil for t in tables]
    return replace(
        tables[0],
        **joined_rows(tables),
        conditions=Conditions(
            **sizes,
            contact=np.concatenate([t.conditions.contact for t in tables]),
            soil=np.concatenate(soils) if named else None,
            covariates=covariates,
        ),
        channels=all_columns(lambda t: t.channels),
        wheel=np.concatenate([t.wheel for t in tables]),
        declared_std=all_columns(lambda t: t.declared_std),
        labels={},
        units={name: unit for table in tables for name, unit in table.units.items()},
        written_units={n: unit for t in reversed(tables) for n, unit in t.written_units.items()},
        runs_given=all(t.runs_given for t in tables),
        wheels_given=all(t.wheels_given for t in tables),
        warnings=tuple(w for t in tables for w in t.warnings),
        notes=tuple(dict.fromkeys(notes)),
        place="line" if all(t.place == "line" for t in tables) else "row",
    )


def joined_rows(tables: Sequence[Any]) -> dict[str, Any]:
    """Join the fields that tables of wheels and of shear tests have in common; returns them by name.

    They are `run` and `line` of their rows, a joint `source` and `sha256`, and `understood`, each sentence
    with its file or the table's number. If a run's name occurs in several tables, the name of the file or the
    table's number is put before the names of all runs.
    """
    names = [name for table in tables for name in set(table.run.tolist())]
    run = [table.run for table in tables]
    files = [Path(table.source).name for table in tables]
    if len(set(files)) < len(files):
        files = [f"table {i + 1}" for i in range(len(files))]
    if len(set(names)) < len(names):
        stems = [Path(table.source).stem for table in tables]
        stems = stems if len(set(stems)) == len(stems) else [str(i + 1) for i in range(len(stems))]
        run = [np.char.add(f"{stem} ", part) for stem, part in zip(stems, run, strict=True)]
    return {
        "run": np.concatenate(run),
        "line": np.concatenate([table.line for table in tables]),
        "source": ", ".join(table.source for table in tables),
        "understood": tuple(
            f"{name}: {line}"
            for name, table in zip(files, tables, strict=True)
            for line in table.understood
        ),
        "sha256": hashlib.sha256(" ".join(t.sha256 for t in tables).encode()).hexdigest(),
    }


def joined_shear(tables: Sequence[ShearTests]) -> ShearTests:
    """The rows of several tables of shear tests, in order."""
    if len(tables) == 1:
        return tables[0]
    names = ("normal_stress", "shear_stress", "displacement", "soil")
    found = {name: np.concatenate([getattr(t, name) for t in tables]) for name in names}
    notes = tuple(note for table in tables for note in table.notes)
    return replace(tables[0], **joined_rows(tables), **found, notes=notes)
