"""Measurements of wheels in soil: the table that everything is compared with.

One row is one steady measurement of one wheel. `read_measurements` is the one reader of such
tables (CSV and Parquet).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import MeasurementsError
from smallwheel_ros.measurements.checks import one_row_a_wheel, suspicions
from smallwheel_ros.measurements.columns import CHANNELS, SETTINGS, TEXTS, is_response
from smallwheel_ros.measurements.files import read_table
from smallwheel_ros.measurements.reading import Columns, read_columns, shown
from smallwheel_ros.measurements.settings import runs_of_rows
from smallwheel_ros.measurements.units import parse_header
from smallwheel_ros.physics.conditions import CONTACTS, PLATE, ROLLING, Array, Conditions

__all__ = ["CHANNELS", "Measurements", "MeasurementsError", "Rows", "read_measurements"]

Rows = NDArray[np.intp] | NDArray[np.bool_] | slice

# What a body that is pressed straight down has of the settings of a rolling wheel.
_AT_REST = {"slip": 0.0, "slip_angle": 0.0, "slope": 0.0, "pass_number": 1.0}
# A wheel that moves more across its plane than along it is ploughed, not rolled.
_PLOUGHED = np.pi / 4
_VEHICLE = (
    "each run has one row of each of several wheels: they count as wheels of one vehicle at one "
    "place. If runs are numbered anew for each wheel, give each a name of its own"
)

_ANSWERS = "taken as what the wheel answers, not as settings: {}"


@dataclass(frozen=True)
class Measurements:
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
    wheels_given: bool = False
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""

    def __len__(self) -> int:
        return len(self.conditions)

    @property
    def runs(self) -> NDArray[np.str_]:
        """Names of the runs in the order in which they first appear."""
        names, first = np.unique(self.run, return_index=True)
        return names[np.argsort(first)]

    @property
    def soil(self) -> NDArray[np.str_]:
        """The soil's name per row, "" where the table names none."""
        named = self.conditions.soil
        return np.full(len(self), "") if named is None else named

    @property
    def responses(self) -> tuple[str, ...]:
        """Covariates that the wheel answers with (torque, side force, motor current), not settings.

        A column of forces, torques, pressures, powers or energies by its unit, or so by its name.
        """
        names = self.conditions.covariates
        return tuple(name for name in names if is_response(name, self.units.get(name, "")))

    @property
    def sunk_to_axle(self) -> NDArray[np.bool_]:
        """Rows in which a wheel was measured deeper than its axle: no model holds there."""
        if "sinkage" not in self.channels:
            return np.zeros(len(self), dtype=bool)
        deep = self.channels["sinkage"] > 0.5 * self.conditions.diameter * (1.0 + 1e-9)
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


def read_measurements(
    path: str | Path, *, diameter: float | None = None, width: float | None = None
) -> Measurements:
    """Read a table of measurements, CSV or Parquet; everything in SI units afterwards.

    A header is a name with an optional unit in brackets, `sinkage [mm]`; without one it is SI.
    diameter, width: m, for all rows, where the file has no such column.
    Raises MeasurementsError that names file, line, column, what was found, what was expected.
    """
    columns = read_columns(read_table(path), {"diameter": diameter, "width": width})
    table, numbers = columns.table, columns.numbers
    rows = table.line.size
    contact = _contact(columns)
    rolling = contact == ROLLING
    for name in ("load", "diameter", "width", "soil"):
        _refuse_blank(columns, name, contact != PLATE if name == "width" else np.full(rows, True))
    channels = {name: numbers.pop(name) for name in CHANNELS if name in numbers}
    if not channels:
        raise MeasurementsError(
            f"{table.source}: nothing was measured: every cell of {', '.join(CHANNELS)} is blank"
        )
    declared = _declared_std(columns, channels)
    load, d, b = (
        numbers.pop(name, np.full(rows, np.nan)) for name in ("load", "diameter", "width")
    )
    tried = {name: _covariate(columns, name, rolling) for name in numbers}
    covariates = {name: values for name, values in tried.items() if values is not None}
    soil = columns.texts.get("soil")
    conditions = Conditions(load, d, b, contact, soil, covariates)
    run, runs_given = _runs(columns)
    data = Measurements(
        conditions,
        channels,
        run,
        _wheels(columns, conditions),
        table.line,
        declared,
        {name: text for name, text in columns.texts.items() if name not in TEXTS},
        columns.units,
        runs_given,
        "wheel" in columns.texts,
        notes=tuple(columns.notes),
        source=table.source,
        sha256=table.sha256,
    )
    if not runs_given:
        data = replace(data, run=_first_of_run(data))
    _refuse_too_deep(columns, data)
    if data.responses:
        data = replace(data, notes=(*data.notes, _ANSWERS.format(", ".join(data.responses))))
    if one_row_a_wheel(data):
        data = replace(data, notes=(*data.notes, _VEHICLE))
    return replace(data, warnings=tuple(suspicions(data, table.place)))


def _contact(columns: Columns) -> NDArray[np.str_]:
    rows = columns.table.line.size
    given = columns.texts.get("contact")
    if given is None:
        return np.full(rows, ROLLING)
    contact = np.where(given == "", ROLLING, given)
    bad = ~np.isin(contact, CONTACTS)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise columns.table.error(
            f"'{contact[row]}' found, expected one of {', '.join(CONTACTS)} (blank is {ROLLING})",
            row,
            "contact",
        )
    return contact


def _refuse_blank(columns: Columns, name: str, needed: NDArray[np.bool_]) -> None:
    """Refuse a column that is there but has no value in a row that needs one."""
    if name in columns.texts:
        blank = columns.texts[name] == ""
        if blank.all():
            del columns.texts[name]
            return
    elif name in columns.numbers:
        blank = np.isnan(columns.numbers[name])
    else:
        return
    if (blank & needed).any():
        row = int(np.flatnonzero(blank & needed)[0])
        raise columns.table.error("the cell is blank, expected a value", row, name)


def _declared_std(columns: Columns, channels: dict[str, Array]) -> dict[str, Array]:
    declared: dict[str, Array] = {}
    for name in CHANNELS:
        values = columns.numbers.pop(f"{name}_std", None)
        if values is None:
            continue
        if name in channels:
            declared[name] = values
        else:
            columns.notes.append(f"column '{name}_std' is left out: there is no '{name}'")
    return declared


def _covariate(columns: Columns, name: str, rolling: NDArray[np.bool_]) -> Array | None:
    """Give the column with every rolling row filled, or None (and a note) if it has gaps."""
    values = columns.numbers[name]
    gaps = np.isnan(values)
    if not gaps.any():
        return values
    holes = gaps & rolling
    if holes.any():
        row = int(np.flatnonzero(holes)[0])
        if name in SETTINGS:
            raise columns.table.error(
                "the cell is blank in a rolling row, expected a value (a whole column may be left "
                "out, and a pressed or plate row may leave it blank)",
                row,
                name,
            )
        columns.notes.append(
            f"column '{name}' is blank in {holes.sum()} rolling rows (first in "
            f"{columns.table.place} {columns.table.line[row]}): not used as a covariate"
        )
        return None
    if name in _AT_REST:
        return np.where(gaps, _AT_REST[name], values)
    return values


def _runs(columns: Columns) -> tuple[NDArray[np.str_], bool]:
    place, line = columns.table.place, columns.table.line
    own = np.array([f"{place} {number}" for number in line], dtype=np.str_)
    run = columns.texts.get("run")
    if run is None or (run == "").all():
        columns.notes.append(
            "no column 'run': rows of exactly the same settings count as repeats of one run, each "
            "other row counts as a run of its own. Say which belong together in that column"
        )
        return own, False
    if (run == "").any():
        columns.notes.append(
            f"{(run == '').sum()} rows name no run: each counts as a run of its own"
        )
    return np.where(run == "", own, run), True


def _first_of_run(data: Measurements) -> NDArray[np.str_]:
    """Name each row's run by the first row of its settings: repeats are no independent runs."""
    _, codes = runs_of_rows(data)
    return data.run[np.unique(codes, return_index=True)[1]][codes]


def _wheels(columns: Columns, conditions: Conditions) -> NDArray[np.str_]:
    size, index = np.unique(
        np.stack([conditions.diameter, np.nan_to_num(conditions.width)]),
        axis=1,
        return_inverse=True,
    )
    names = [
        f"{1e3 * d:.4g} mm x {1e3 * b:.4g} mm" if b else f"{1e3 * d:.4g} mm" for d, b in size.T
    ]
    made = np.array(names, dtype=np.str_)[index.reshape(-1)]
    given = columns.texts.get("wheel")
    return made if given is None else np.where(given == "", made, given)


def _refuse_too_deep(columns: Columns, data: Measurements) -> None:
    """Refuse a rolling or pressed wheel that is deeper than its axle.

    It carries by its lower half, so that is a mistake. A wheel dragged across its plane is ploughed
    in rather than rolled, and does get there: such rows are kept, marked by
    `Measurements.sunk_to_axle`.
    """
    deep = data.sunk_to_axle
    if "slip_angle" in data.conditions:
        deep = deep & (np.abs(data.conditions["slip_angle"]) <= _PLOUGHED)
    if not deep.any():
        return
    row = int(np.flatnonzero(deep)[0])
    column = columns.by_name["sinkage"]
    unit = parse_header(column.header).unit
    hint = "; without a unit it is metres: for mm the header is 'sinkage [mm]'"
    raise columns.table.error(
        f"sinkage is {shown(column, unit, data.channels['sinkage'], row)}, expected at most "
        f"{0.5 * data.conditions.diameter[row]:.6g} m, half the diameter"
        f"{hint if unit is None else ''}",
        row,
        "sinkage",
    )
