"""Tables as CSV, written while the replay goes on, and at the end as Parquet too."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from smallwheel_ros.replay.spec import ReplayError

_BLOCK = 1000  # rows; a replay that is killed loses at most these


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV; None is a blank cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class Table:
    """Writes rows to NAME.csv and, where pyarrow is installed, NAME.parquet.

    While the `with` block lasts, the first is called NAME.csv.part. What is in it is whole rows,
    readable at any time, whatever becomes of the program.

    Parameters
    ----------
    stem
        Path without suffix; files that are there are replaced.
    columns
        Names and types (Arrow's).

    Raises
    ------
    ReplayError
        If a file cannot be written.
    """

    def __init__(self, stem: Path, columns: Mapping[str, str]) -> None:
        self._csv, self._parquet, self._part = (
            stem.with_name(stem.name + suffix) for suffix in (".csv", ".parquet", ".csv.part")
        )
        self._columns = dict(columns)
        self._rows: list[list[Any]] = [list(columns)]

    def __enter__(self) -> Table:
        try:
            self._csv.unlink(missing_ok=True)
            self._parquet.unlink(missing_ok=True)
            self._file = self._part.open("w", newline="", encoding="utf-8")
            self._write()
        except OSError as error:
            raise self._failed(error) from error
        return self

    def _failed(self, error: OSError) -> ReplayError:
        path = error.filename or self._csv
        return ReplayError(f"{path}: cannot be written: {error.strerror or error}")

    def add(self, row: list[Any]) -> None:
        """Add a row in the order of the columns; None is a blank cell."""
        self._rows.append(row)
        if len(self._rows) >= _BLOCK:
            try:
                self._write()
            except OSError as error:
                raise self._failed(error) from error

    def _write(self) -> None:
        self._file.write(csv_text(self._rows))
        self._file.flush()
        self._rows = []

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self._write()
                self._file.close()
                self._part.replace(self._csv)
                self._write_parquet()
        except OSError as failure:
            raise self._failed(failure) from failure
        finally:
            with suppress(OSError):
                self._file.close()

    def _write_parquet(self) -> None:
        """Turn the CSV file into Parquet, some megabytes at a time."""
        try:
            import pyarrow
            from pyarrow.csv import ConvertOptions, open_csv
            from pyarrow.parquet import ParquetWriter
        except ImportError:
            return
        schema = pyarrow.schema(
            [(name, pyarrow.type_for_alias(kind)) for name, kind in self._columns.items()]
        )
        options = ConvertOptions(column_types=schema)
        with (
            open_csv(self._csv, convert_options=options) as batches,
            ParquetWriter(self._parquet, schema) as parquet,
        ):
            for batch in batches:
                parquet.write_batch(batch)
