# SPDX-License-Identifier: Apache-2.0
"""The two tables of a drive: its estimates, and its steady stretches as measurements.

A row of estimates is written while the replay goes on. From a drive to steady measurements there is
one row for each wheel and stretch of way.

Readings that a sensor takes one after the other are no independent evidence: they share the spot.
So each row is the median of a wheel's readings over a stretch of way no shorter than a turn of the
largest wheel, and the rows of one stretch are one run. Stretches in which load, slip or speed
changed are left out, since a row is to be one steady measurement. So are those of a turn after a
change of soil: some wheels are on the old one still. The soils are those between the changes that the
replay counts, so a drive has one more of them than its summary has changes. The pass number (see
`PassCounter`) is that of the middle half of a stretch's readings. Where the drive tells it for most rows,
those without are left out, since a table of measurements has no blank one; else the column is.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smallwheel_ros.bags import Message, header
from smallwheel_ros.bags.types import plain_fields
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.result import VALID, Result, mobility_fields, soil_fields
from smallwheel_ros.physics.conditions import PRESSED
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.replay.spec import ReplayError

_BLOCK = 1000  # rows; a replay that is killed loses at most these
MOBILITY = "smallwheel_ros/msg/MobilityEstimate"
SOIL = "smallwheel_ros/msg/SoilEstimate"
_ARROW = {"bool": "bool", "string": "string", "float64": "float64"}  # else an integer
_FIRST = {
    "stamp": "int64",
    "time": "float64",
    "wheel": "string",
    "x": "float64",
    "y": "float64",
    "speed": "float64",
    "travel": "float64",
    "status": "string",
    "status_text": "string",
}
_FEWEST_READINGS = 3
# Quartile to quartile: slip as it is, load and speed as a share of their median. Sinkage goes with
# load to a power near 1, so a load that scatters by half makes the median sinkage wrong by 1 %.
_STEADY_SLIP, _STEADY_SHARE = 0.1, 0.5
_DEPTH = 0.5e-3  # m of new depth that make a stretch of a pressed wheel's way
_UNKNOWN = Quantity(math.nan, math.nan)


# --- Files


def _csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV; None is a blank cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows by column as CSV; no file where there are none. Raises OutputError."""
    path.unlink(missing_ok=True)
    if rows:
        write_bytes(path, _csv_text([rows[0], *(row.values() for row in rows)]).encode())


@contextmanager
def table(stem: Path, columns: Mapping[str, str]) -> Iterator[Callable[[list[Any]], None]]:
    """Write NAME.csv and, where pyarrow is installed, NAME.parquet, by a function that takes a row.

    While the `with` block lasts, the first is called NAME.csv.part. What is in it is whole rows,
    readable at any time, whatever becomes of the program.

    Parameters
    ----------
    stem
        Path without suffix; files that are there are replaced.
    columns
        Names, and types (Arrow's), in the order of a row's cells, of which None is a blank one.

    Raises
    ------
    ReplayError
        If a file cannot be written.
    """
    whole, parquet, part = (
        stem.with_name(stem.name + suffix) for suffix in (".csv", ".parquet", ".csv.part")
    )
    rows: list[list[Any]] = [list(columns)]

    def put() -> None:
        file.write(_csv_text(rows))
        file.flush()
        rows.clear()

    def add(row: list[Any]) -> None:
        rows.append(row)
        if len(rows) >= _BLOCK:
            put()

    try:
        whole.unlink(missing_ok=True)
        parquet.unlink(missing_ok=True)
        with part.open("w", newline="", encoding="utf-8") as file:
            put()
            yield add
            put()
        part.replace(whole)
        _write_parquet(whole, parquet, columns)
    except OSError as error:
        path = error.filename or whole
        raise ReplayError(f"{path}: cannot be written: {error.strerror or error}") from error


def _write_parquet(whole: Path, path: Path, columns: Mapping[str, str]) -> None:
    """Turn the CSV file into Parquet, some megabytes at a time."""
    try:
        import pyarrow
        from pyarrow.csv import ConvertOptions, open_csv
        from pyarrow.parquet import ParquetWriter
    except ImportError:
        return
    schema = pyarrow.schema(
        [(name, pyarrow.type_for_alias(kind)) for name, kind in columns.items()]
    )
    options = ConvertOptions(column_types=schema)
    with (
        open_csv(whole, convert_options=options) as batches,
        ParquetWriter(path, schema) as parquet,
    ):
        for batch in batches:
            parquet.write_batch(batch)


# --- Estimates


@cache
def columns() -> dict[str, str]:
    """Return the table's columns in their order, with their types (Arrow's).

    They are the fields of both messages; not the flags of what is valid, since an unknown cell is blank.
    """
    found = dict(_FIRST)
    for prefix, message in (("", MOBILITY), ("soil_", SOIL)):
        for name, kind in plain_fields(message).items():
            if name not in VALID:
                found.setdefault(f"{prefix}{name}", _ARROW.get(kind, "int64"))
    deviations = {f"soil_{name}_standard_deviation": "float64" for name in "knm"}
    return {**found, **deviations, "soil_changes": "int64"}


class Estimate:
    """One result, as a row of the table and as the two messages that the node publishes of it.

    before: the one before it. What is said of the soil changes only when a stretch of way ends.
    """

    def __init__(self, result: Result, before: Estimate | None = None) -> None:
        self.result, soil = result, result.soil
        self._mobility = mobility_fields(result)
        law = (soil.k, soil.n, soil.m, soil.log_covariance.tobytes())
        self._state = (*law, soil.variety, soil.accepted, result.rejected)
        if before is not None and before._state == self._state:
            self._soil: dict[str, Any] = before._soil
            self._soil_cells: dict[str, str] = before._soil_cells
        else:
            self._soil = soil_fields(soil, result.rejected)
            cells = {f"soil_{name}": value for name, value in self._soil.items()}
            for name, variance in zip("knm", soil.covariance.diagonal().tolist(), strict=True):
                cells[f"soil_{name}_standard_deviation"] = max(variance, 0.0) ** 0.5
            self._soil_cells = {name: str(cells[name]) for name in cells.keys() & columns().keys()}

    def row(self, start: int) -> list[Any]:
        """Return the cells in the order of `columns`, None for a blank one.

        start: the bag's first log time, ns.
        """
        result, reading = self.result, self.result.reading
        cells = self._mobility | self._soil_cells
        for flag, names in VALID.items():
            if not cells[flag]:
                for name in names:
                    cells[name] = cells[f"{name}_standard_deviation"] = None
        cells["stamp"], cells["time"] = reading.stamp, (reading.stamp - start) / SECOND
        cells["x"], cells["y"] = reading.vehicle or (None, None)
        cells["wheel"], cells["status"] = result.wheel, result.status.name
        cells["speed"], cells["travel"] = reading.speed, result.travel
        cells["soil_changes"] = result.soil.soil_changes
        return [cells[name] for name in columns()]

    def mobility(self) -> Message:
        """Return it as MobilityEstimate."""
        stamp = header(self.result.reading.stamp, self.result.wheel)
        return Message(header=stamp, **self._mobility)

    def soil(self, frame: str) -> Message:
        """Return it as SoilEstimate; frame: that of odometry."""
        return Message(header=header(self.result.reading.stamp, frame), **self._soil)


# --- Steady stretches


class _Key(NamedTuple):
    soil: int
    stretch: int
    wheel: int


class _Row(NamedTuple):
    """What one reading says, or the readings of one wheel over one stretch; NaN: not known.

    Deviations are those that the sensor declares, or those of the medians.
    """

    load: float
    sinkage: float
    pull: float
    slip: float
    speed: float
    sinkage_std: float
    pull_std: float
    passes: float


class SteadySegments:
    """Takes readings as they come, and gives the rows of a section 5 table at the end.

    pulls: whether there are columns of measured drawbar pull.
    """

    def __init__(self, wheels: Sequence[Wheel], pulls: bool = False) -> None:
        self._wheels, self._pulls = tuple(wheels), pulls
        self._order = {wheel.name: i for i, wheel in enumerate(wheels)}
        self._turn = math.pi * max(wheel.diameter for wheel in wheels)
        self._open: dict[int, tuple[_Key, list[_Row]]] = {}  # stretches that still go on, by wheel
        self._rows: dict[_Key, _Row] = {}
        self._soil = 1
        self._changing = False
        self._way = 0.0
        self.unsteady = 0
        self.at_changes = 0
        self.unusable = 0

    def add(self, reading: Reading, way: float, changing: bool) -> None:
        """Take one reading; changing: the soil is taken to change just now (`DriveSummary.changing`).

        way: m that the vehicle has travelled.
        """
        passes = reading.pass_number
        forgotten = way < self._way - 1e-9  # time went back
        if forgotten or (changing and not self._changing):
            self._next_soil()
        self._changing, self._way = changing, way
        if changing:
            self.at_changes += 1
            return
        order = self._order[reading.wheel.name]
        pressed = self._wheels[order].contact == PRESSED
        load, sinkage, slip, speed = reading.load, reading.sinkage, reading.slip, reading.speed
        still = not pressed and (slip is None or speed is None)
        if load is None or sinkage is None or still:
            self.unusable += 1
            return
        length = _DEPTH if pressed else self._turn
        key = _Key(self._soil, int(way / length), order)
        if order not in self._open or self._open[order][0] != key:
            self._close(order)
            self._open[order] = (key, [])
        pull = reading.drawbar_pull or _UNKNOWN
        self._open[order][1].append(
            _Row(
                load.value,
                sinkage.value,
                pull.value,
                math.nan if slip is None else slip.value,
                math.nan if speed is None else abs(speed),
                sinkage.standard_deviation,
                pull.standard_deviation,
                math.nan if passes is None else float(passes),
            )
        )

    def _next_soil(self) -> None:
        """Begin another soil; the stretches where it was not yet noticed belong to neither."""
        last = max((key.stretch for key in self._rows if key.soil == self._soil), default=None)
        for key in [k for k in self._rows if k.soil == self._soil and k.stretch == last]:
            del self._rows[key]
            self.unsteady += 1
        self.unsteady += len(self._open)
        self._open.clear()
        self._soil += 1

    def _close(self, order: int) -> None:
        if order not in self._open:
            return
        key, readings = self._open.pop(order)
        row = _median(readings, self._wheels[order])
        if row is None:
            self.unsteady += 1
            return
        self._rows[key] = row

    def finish(self) -> None:
        """Close the last stretches: nothing more will come."""
        for order in list(self._open):
            self._close(order)

    def __len__(self) -> int:
        return len(self._rows)

    def table(self) -> Iterator[dict[str, str | float | None]]:
        """Give the rows by column; None for a blank cell."""
        rows = self._rows
        known = {key: row for key, row in rows.items() if math.isfinite(row.passes)}
        with_passes = 2 * len(known) > len(rows)
        for key, row in sorted((known if with_passes else rows).items()):
            wheel = self._wheels[key.wheel]
            cells: dict[str, str | float | None] = {
                "load [N]": row.load,
                "diameter [m]": wheel.diameter,
                "width [m]": wheel.width,
                "sinkage [m]": row.sinkage,
                "sinkage_std [m]": row.sinkage_std,
            }
            if self._pulls:
                cells["drawbar_pull [N]"] = _cell(row.pull)
                cells["drawbar_pull_std [N]"] = _cell(row.pull_std)
            cells |= {"slip": _cell(row.slip), "speed [m/s]": _cell(row.speed)}
            if with_passes:
                cells["pass_number"] = int(row.passes)
            yield cells | {
                "contact": wheel.contact,
                "soil": f"soil {key.soil}",
                "run": f"{key.soil}.{key.stretch}",
                "wheel": wheel.name,
            }


def _cell(value: float) -> float | None:
    return None if math.isnan(value) else value


def _median(readings: Sequence[_Row], wheel: Wheel) -> _Row | None:
    """Return the medians of a stretch, and how well they are known; None where it is not steady."""
    pressed = wheel.contact == PRESSED
    if not pressed and len(readings) < _FEWEST_READINGS:
        return None
    quartiles = np.percentile(np.array(readings), [25.0, 50.0, 75.0], axis=0)
    low, middle, high = (_Row(*values) for values in quartiles.tolist())
    steady = pressed or not (
        high.slip - low.slip > _STEADY_SLIP
        or high.load - low.load > _STEADY_SHARE * middle.load
        or high.speed - low.speed > _STEADY_SHARE * middle.speed
    )
    if middle.sinkage > wheel.diameter / 2 or not steady:
        return None
    passes = [0.0 if math.isnan(reading.passes) else reading.passes for reading in readings]
    fewest, most = np.percentile(passes, [25.0, 75.0]).tolist()
    return middle._replace(
        sinkage_std=_deviation([reading.sinkage for reading in readings], middle.sinkage_std),
        pull_std=_deviation([reading.pull for reading in readings], middle.pull_std),
        passes=most if most == fewest > 0 else math.nan,
    )


def _deviation(values: Sequence[float], declared: float) -> float:
    """Standard deviation of a median of readings.

    What they scatter, and what their sensor declares for each: the larger one counts.
    """
    scatter = 1.4826 * float(np.median(np.abs(np.array(values) - np.median(values))))
    return max(scatter, declared) / math.sqrt(len(values))
