"""The table of estimates, written while the replay goes on as CSV, and at its end as Parquet too."""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from smallwheel_ros.replay.rows import Kind
from smallwheel_ros.replay.spec import ReplayError

_BATCH = 1000  # rows; a replay that is killed loses at most these
_PART = ".part"


class TableFiles:
    """Writes rows to NAME.csv and, where pyarrow is installed, NAME.parquet.

    While the `with` block lasts, the first is called NAME.csv.part. What is in it is whole rows,
    readable at any time, whatever becomes of the program.

    Parameters
    ----------
    stem
        Path without suffix; files that are there are replaced.
    columns
        Names and kinds.

    Raises
    ------
    ReplayError
        If a file cannot be written.
    """

    def __init__(self, stem: Path, columns: Mapping[str, Kind]) -> None:
        self._csv, self._parquet = (stem.with_name(stem.name + s) for s in (".csv", ".parquet"))
        self._part = stem.with_name(stem.name + ".csv" + _PART)
        self._columns = dict(columns)
        self._rows: list[list[Any]] = []
        self._file: TextIO | None = None

    def __enter__(self) -> TableFiles:
        try:
            self._csv.unlink(missing_ok=True)
            self._parquet.unlink(missing_ok=True)
            self._file = self._part.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise self._failed(error) from error
        self._rows = [list(self._columns)]
        self._write()
        return self

    def _failed(self, error: OSError) -> ReplayError:
        return ReplayError(
            f"{error.filename or self._csv}: cannot be written: {error.strerror or error}"
        )

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row by the columns; None is a blank cell."""
        self._rows.append([row[name] for name in self._columns])
        if len(self._rows) >= _BATCH:
            self._write()

    def _write(self) -> None:
        assert self._file is not None
        text = io.StringIO()  # so that whole rows go into the file
        csv.writer(text, lineterminator="\n").writerows(self._rows)
        self._rows = []
        try:
            self._file.write(text.getvalue())
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._file is not None
        try:
            if kind is None:
                self._write()
        finally:
            with contextlib.suppress(OSError):
                self._file.close()
        if kind is None:
            try:
                self._part.replace(self._csv)
                self._write_parquet()
            except OSError as failure:
                raise self._failed(failure) from failure

    def _write_parquet(self) -> None:
        """Turn the CSV file into Parquet, some megabytes at a time."""
        try:
            import pyarrow
            from pyarrow.csv import ConvertOptions, open_csv
            from pyarrow.parquet import ParquetWriter
        except ImportError:
            return
        types = {
            "integer": pyarrow.int64(),
            "number": pyarrow.float64(),
            "text": pyarrow.string(),
            "truth": pyarrow.bool_(),
        }
        schema = pyarrow.schema([(name, types[kind]) for name, kind in self._columns.items()])
        options = ConvertOptions(column_types=schema)
        with (
            open_csv(self._csv, convert_options=options) as batches,
            ParquetWriter(self._parquet, schema) as parquet,
        ):
            for batch in batches:
                parquet.write_batch(batch)
