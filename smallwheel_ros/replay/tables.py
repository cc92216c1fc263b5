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
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smallwheel_ros.bags import Message, header
from smallwheel_ros.bags.types import plain_fields
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.tables import plain
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.result import VALID, Result, mobility_fields, soil_fields
from smallwheel_ros.physics.conditions import PRESSED
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.replay.spec import ReplayError

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
_DEVIATIONS = tuple(f"{name}_standard_deviation" for name in "knm")
_FEWEST_READINGS = 3
# Quartile to quartile: slip as it is, load and speed as a share of their median. Sinkage goes with
# load to a power near 1, so a load that scatters by half makes the median sinkage wrong by 1 %.
_STEADY_SLIP, _STEADY_SHARE = 0.1, 0.5
_DEPTH = 0.5e-3  # m of new depth that make a stretch of a pressed wheel's way
_UNKNOWN = Quantity(math.nan, math.nan)


# --- Files


@contextmanager
def table(stem: Path, columns: Mapping[str, str]) -> Iterator[Callable[[Iterable[Any]], object]]:
    """Write NAME.csv and, where pyarrow is installed, NAME.parquet, by a function that takes a row.

    While the `with` block lasts, the first is called NAME.csv.part. What is in it is whole rows,
    readable at any time, whatever becomes of the program. stem: path without suffix; files that are
    there are replaced. columns: names, and types (Arrow's), in the order of a row's cells, of which None
    is a blank one. Raises ReplayError if a file cannot be written.
    """
    whole, parquet, part = (Path(f"{stem}{suffix}") for suffix in (".csv", ".parquet", ".csv.part"))
    try:
        whole.unlink(missing_ok=True)
        parquet.unlink(missing_ok=True)
        with part.open("w", newline="", encoding="utf-8", buffering=1) as file:  # row by row
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            yield writer.writerow
        part.replace(whole)
        _write_parquet(whole, parquet, columns)
    except OSError as error:
        path = error.filename or whole
        raise ReplayError(f"{path}: cannot be written: {reason(error)}") from error


def _write_parquet(whole: Path, path: Path, columns: Mapping[str, str]) -> None:
    """Turn the CSV file into Parquet, some megabytes at a time."""
    try:
        import pyarrow
        from pyarrow.csv import ConvertOptions, open_csv
        from pyarrow.parquet import ParquetWriter
    except ImportError:
        return
    types = [(name, pyarrow.type_for_alias(kind)) for name, kind in columns.items()]
    options = ConvertOptions(column_types=pyarrow.schema(types))
    with (
        open_csv(whole, convert_options=options) as batches,
        ParquetWriter(path, batches.schema) as parquet,
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
    found |= {f"soil_{name}": "float64" for name in _DEVIATIONS}
    return {**found, "soil_changes": "int64"}


def deviations(soil: SoilEstimate) -> dict[str, float]:
    """Return the standard deviations of k, n and m, which the message has as a covariance."""
    spread = np.sqrt(np.maximum(soil.covariance.diagonal(), 0.0)).tolist()
    return dict(zip(_DEVIATIONS, spread, strict=True))


class Estimate:
    """One result, as a row of the table and as the two messages that the node publishes of it.

    before: the one before it. What is said of the soil changes only when a stretch of way ends, and to
    say it again takes a fourteenth of a replay's time.
    """

    def __init__(self, result: Result, before: Estimate | None = None) -> None:
        self.result, soil = result, result.soil
        self._mobility = mobility_fields(result)
        law = (soil.k, soil.n, soil.m, soil.log_covariance.tobytes())
        self._state = (*law, soil.variety, soil.accepted, result.rejected)
        self._soil: dict[str, Any]
        self._soil_cells: dict[str, str]
        if before is not None and before._state == self._state:
            self._soil, self._soil_cells = before._soil, before._soil_cells
            return
        self._soil = soil_fields(soil, result.rejected)
        cells = self._soil | deviations(soil)
        del cells["covariance"]
        self._soil_cells = {f"soil_{name}": str(cell) for name, cell in cells.items()}

    def row(self, start: int) -> list[Any]:
        """Return the cells in the order of `columns`, None for a blank one.

        start: the bag's first log time, ns.
        """
        result, reading = self.result, self.result.reading
        x, y = reading.vehicle or (None, None)
        cells = self._mobility | self._soil_cells
        cells |= {
            "stamp": reading.stamp,
            "time": (reading.stamp - start) / SECOND,
            "wheel": result.wheel,
            "x": x,
            "y": y,
            "speed": reading.speed,
            "travel": result.travel,
            "status": result.status.name,
            "soil_changes": result.soil.soil_changes,
        }
        for flag, names in VALID.items():
            if not cells[flag]:
                for name in names:
                    cells[name] = cells[f"{name}_standard_deviation"] = None
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
    """Which soil, stretch of way and wheel; numbers, in the order of the table."""

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

    pulls: whether there are columns of measured drawbar pull. unsteady: stretches that were left out,
    at_changes and unusable: readings.
    """

    def __init__(self, wheels: Sequence[Wheel], pulls: bool = False) -> None:
        self._wheels, self._pulls = tuple(wheels), pulls
        self._order = {wheel.name: i for i, wheel in enumerate(wheels)}
        self._turn = math.pi * max(wheel.diameter for wheel in wheels)
        self._open: dict[_Key, list[_Row]] = {}  # stretches that still go on, one of each wheel
        self._rows: dict[_Key, _Row] = {}
        self._soil = 1
        self._changing = False
        self._way = 0.0
        self.unsteady = self.at_changes = self.unusable = 0

    def add(self, reading: Reading, way: float, changing: bool) -> None:
        """Take one reading; changing: the soil is taken to change just now (`DriveSummary.changing`).

        way: m that the vehicle has travelled.
        """
        forgotten = way < self._way - 1e-9  # time went back
        if forgotten or (changing and not self._changing):
            self._next_soil()
        self._changing, self._way = changing, way
        if changing:
            self.at_changes += 1
            return
        order, pressed = self._order[reading.wheel.name], reading.wheel.contact == PRESSED
        load, sinkage, slip, pull = (
            quantity or _UNKNOWN
            for quantity in (reading.load, reading.sinkage, reading.slip, reading.drawbar_pull)
        )
        speed = math.nan if reading.speed is None else abs(reading.speed)
        passes = math.nan if reading.pass_number is None else float(reading.pass_number)
        needed = (load.value, sinkage.value, *(() if pressed else (slip.value, speed)))
        if any(map(math.isnan, needed)):
            self.unusable += 1
            return
        key = _Key(self._soil, int(way / (_DEPTH if pressed else self._turn)), order)
        if key not in self._open:
            self._close([old for old in self._open if old.wheel == order])
        row = _Row(load.value, sinkage.value, pull.value, slip.value, speed,
                   sinkage.standard_deviation, pull.standard_deviation, passes)  # fmt: skip
        self._open.setdefault(key, []).append(row)

    def _next_soil(self) -> None:
        """Begin another soil; the stretches where it was not yet noticed belong to neither."""
        last = max((key.stretch for key in self._rows if key.soil == self._soil), default=None)
        old = [key for key in self._rows if key[:2] == (self._soil, last)]
        for key in old:
            del self._rows[key]
        self.unsteady += len(old) + len(self._open)
        self._open.clear()
        self._soil += 1

    def _close(self, keys: Sequence[_Key]) -> None:
        """End these stretches."""
        for key in keys:
            row = _median(self._open.pop(key), self._wheels[key.wheel])
            if row is None:
                self.unsteady += 1
            else:
                self._rows[key] = row

    def finish(self) -> None:
        """Close the last stretches: nothing more will come."""
        self._close(list(self._open))

    def __len__(self) -> int:
        return len(self._rows)

    def table(self) -> list[dict[str, str | float | None]]:
        """Return the rows by column; None for a blank cell."""
        rows = self._rows
        known = {key: row for key, row in rows.items() if not math.isnan(row.passes)}
        with_passes = 2 * len(known) > len(rows)
        table = []
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
                cells |= {"drawbar_pull [N]": row.pull, "drawbar_pull_std [N]": row.pull_std}
            cells |= {"slip": row.slip, "speed [m/s]": row.speed}
            if with_passes:
                cells["pass_number"] = int(row.passes)
            cells |= {
                "contact": wheel.contact,
                "soil": f"soil {key.soil}",
                "run": f"{key.soil}.{key.stretch}",
                "wheel": wheel.name,
            }
            table.append(plain(cells))
        return table


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
    passes = np.nan_to_num([reading.passes for reading in readings])
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
