"""The table of estimates, written while the replay goes on: CSV and Parquet, a batch at a time."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Mapping
from io import TextIOWrapper
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any

from smallwheel_ros.replay.errors import ReplayError
from smallwheel_ros.replay.rows import Kind

_BATCH = 2000  # rows; what a replay that is killed loses at most
_PART = ".part"


class TableFiles:
    """Writes rows to NAME.csv and, where pyarrow is installed, NAME.parquet.

    While the `with` block lasts, the files are called NAME.csv.part and NAME.parquet.part. What is
    in the first is whole rows, readable at any time, whatever becomes of the program.

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
        self._stem, self._columns = stem, dict(columns)
        self._names = list(columns)
        self._cells = itemgetter(*columns)
        self._rows: list[tuple[Any, ...]] = []
        self.rows = 0
        self._text: TextIOWrapper | None = None
        self._parquet: Any = None
        self._schema: Any = None

    @property
    def has_parquet(self) -> bool:
        """Whether a Parquet file is written as well."""
        return self._schema is not None

    def __enter__(self) -> TableFiles:
        csv_path, parquet_path = self._part(".csv"), self._part(".parquet")
        try:
            for path in (csv_path, parquet_path, self._whole(".csv"), self._whole(".parquet")):
                path.unlink(missing_ok=True)
            self._text = csv_path.open("w", newline="", encoding="utf-8")
            self._writer = csv.writer(self._text, lineterminator="\n")
            self._writer.writerow(self._names)
            with contextlib.suppress(ImportError):
                self._parquet = self._open_parquet(parquet_path)
        except OSError as error:
            raise self._failed(error) from error
        return self

    def _open_parquet(self, path: Path) -> Any:
        import pyarrow
        from pyarrow.parquet import ParquetWriter

        types = {
            "integer": pyarrow.int64(),
            "number": pyarrow.float64(),
            "text": pyarrow.string(),
            "truth": pyarrow.bool_(),
        }
        self._schema = pyarrow.schema([(n, types[k]) for n, k in self._columns.items()])
        return ParquetWriter(path, self._schema)

    def _part(self, suffix: str) -> Path:
        return self._stem.with_name(self._stem.name + suffix + _PART)

    def _whole(self, suffix: str) -> Path:
        return self._stem.with_name(self._stem.name + suffix)

    def _failed(self, error: OSError) -> ReplayError:
        return ReplayError(
            f"{error.filename or self._stem}: cannot be written: {error.strerror or error}"
        )

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row; None is a blank cell."""
        self._rows.append(self._cells(row))
        if len(self._rows) >= _BATCH:
            self._write()

    def _write(self) -> None:
        assert self._text is not None
        rows, self._rows = self._rows, []
        if not rows:
            return
        try:
            self._writer.writerows(rows)  # None becomes a blank cell
            self._text.flush()
            if self._parquet is not None:
                import pyarrow

                columns = zip(*rows, strict=True)
                arrays = [
                    pyarrow.array(column, field.type)
                    for column, field in zip(columns, self._schema, strict=True)
                ]
                self._parquet.write_batch(pyarrow.record_batch(arrays, schema=self._schema))
        except OSError as error:
            raise self._failed(error) from error
        self.rows += len(rows)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._text is not None
        try:
            if kind is None:
                self._write()
        finally:
            with contextlib.suppress(OSError):
                self._text.close()
            if self._parquet is not None:
                with contextlib.suppress(OSError):
                    self._parquet.close()
        if kind is not None:
            # Without its end a Parquet file cannot be read; the CSV file can.
            self._part(".parquet").unlink(missing_ok=True)
            return
        try:
            self._part(".csv").replace(self._whole(".csv"))
            if self._parquet is not None:
                self._part(".parquet").replace(self._whole(".parquet"))
        except OSError as failure:
            raise self._failed(failure) from failure
