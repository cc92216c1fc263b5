"""The table of estimates, written while the replay goes on: CSV and Parquet, a batch at a time.

Where pyarrow is installed it writes both, since Python takes ten times as long to write a number as
text. Then the CSV file may have 0.00001 or 1e-7 where it else has 1e-05 and 1e-07: the same numbers.
"""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from smallwheel_ros.replay.errors import ReplayError
from smallwheel_ros.replay.rows import Kind

_BATCH = 2000  # rows; a replay that is killed loses at most these and what waits in `Outputs`
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
        self._rows: list[tuple[Any, ...]] = []
        self._file: BinaryIO | None = None
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
            self._file = csv_path.open("wb")
            self._file.write(_csv([self._names]))
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
        texts = [name for name, kind in self._columns.items() if kind == "text"]
        return ParquetWriter(path, self._schema, use_dictionary=texts)

    def _part(self, suffix: str) -> Path:
        return self._stem.with_name(self._stem.name + suffix + _PART)

    def _whole(self, suffix: str) -> Path:
        return self._stem.with_name(self._stem.name + suffix)

    def _failed(self, error: OSError) -> ReplayError:
        return ReplayError(
            f"{error.filename or self._stem}: cannot be written: {error.strerror or error}"
        )

    def add(self, row: tuple[Any, ...]) -> None:
        """Add a row, its cells in the order of the columns; None is a blank cell."""
        self._rows.append(row)
        if len(self._rows) >= _BATCH:
            self._write()

    def _write(self) -> None:
        assert self._file is not None
        rows, self._rows = self._rows, []
        if not rows:
            return
        try:
            if self._parquet is None:
                self._file.write(_csv(rows))
            else:
                batch = self._batch(rows)
                self._file.write(self._csv_of(batch))
                self._parquet.write_batch(batch)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def _batch(self, rows: list[tuple[Any, ...]]) -> Any:
        import pyarrow

        columns = zip(*rows, strict=True)
        arrays = [
            pyarrow.array(column, field.type)
            for column, field in zip(columns, self._schema, strict=True)
        ]
        return pyarrow.record_batch(arrays, schema=self._schema)

    def _csv_of(self, batch: Any) -> Any:
        import pyarrow
        from pyarrow import compute
        from pyarrow.csv import WriteOptions, write_csv

        arrays = [
            compute.if_else(column, "True", "False") if kind == "truth" else column
            for column, kind in zip(batch.columns, self._columns.values(), strict=True)
        ]
        sink = pyarrow.BufferOutputStream()
        options = WriteOptions(include_header=False, quoting_style="needed")
        write_csv(pyarrow.record_batch(arrays, names=self._names), sink, options)
        return sink.getvalue()

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


def _csv(rows: Sequence[Sequence[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)  # None becomes a blank cell
    return text.getvalue().encode()
