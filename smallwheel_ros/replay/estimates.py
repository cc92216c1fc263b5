# SPDX-License-Identifier: Apache-2.0
"""Estimates as rows of a table, which is written while the replay goes on, and as messages."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace as Message  # has a type's fields, as rosbags needs it
from typing import Any

from smallwheel_ros.bags.types import plain_fields
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.onboard.result import VALID, Result, mobility_fields, soil_fields
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.replay.spec import ReplayError

_BLOCK = 1000  # rows; a replay that is killed loses at most these


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


@cache
def _own_columns() -> dict[str, str]:
    """Of MobilityEstimate, without flags of what is valid, since an unknown cell is blank."""
    return {
        name: _ARROW.get(kind, "int64")
        for name, kind in plain_fields(MOBILITY).items()
        if name not in VALID and name not in _FIRST
    }


@cache
def _soil_columns() -> dict[str, str]:
    """Of SoilEstimate, without `soil_` before them."""
    return {name: _ARROW.get(kind, "int64") for name, kind in plain_fields(SOIL).items()}


@cache
def columns() -> dict[str, str]:
    """Return the table's columns in their order, with their types (Arrow's)."""
    soil = {f"soil_{name}": kind for name, kind in _soil_columns().items()}
    deviations = {f"soil_{name}_standard_deviation": "float64" for name in "knm"}
    return {**_FIRST, **_own_columns(), **soil, **deviations, "soil_changes": "int64"}


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
            self._soil_cells: list[str] = before._soil_cells
        else:
            self._soil = soil_fields(soil, result.rejected)
            variances = soil.covariance.diagonal().tolist()
            cells = [self._soil[name] for name in _soil_columns()]
            cells += [max(variance, 0.0) ** 0.5 for variance in variances]
            self._soil_cells = [str(cell) for cell in cells]

    def row(self, start: int) -> list[Any]:
        """Return the cells in the order of `columns`, None for a blank one.

        start: the bag's first log time, ns.
        """
        result, instant, soil = self.result, self.result.instant, self.result.soil
        x, y = instant.vehicle or (None, None)
        own = dict(self._mobility)
        for flag, names in VALID.items():
            if not own[flag]:
                for name in names:
                    own[name] = own[f"{name}_standard_deviation"] = None
        return [
            instant.stamp,
            (instant.stamp - start) / SECOND,
            result.wheel,
            x,
            y,
            instant.speed,
            result.travel,
            result.status.name,
            result.status_text,
            *[own[name] for name in _own_columns()],
            *self._soil_cells,
            soil.soil_changes,
        ]

    def mobility(self) -> Message:
        """Return it as MobilityEstimate."""
        return Message(header=self._header(self.result.wheel), **self._mobility)

    def soil(self, frame: str) -> Message:
        """Return it as SoilEstimate; frame: that of odometry."""
        return Message(header=self._header(frame), **self._soil)

    def _header(self, frame: str) -> Message:
        seconds, rest = divmod(self.result.instant.stamp, SECOND)
        return Message(stamp=Message(sec=seconds, nanosec=rest), frame_id=frame)
