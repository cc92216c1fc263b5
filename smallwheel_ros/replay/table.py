# SPDX-License-Identifier: Apache-2.0
"""Tables as CSV, written while the replay goes on, and at the end as Parquet too."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from smallwheel_ros.replay.spec import ReplayError

_BLOCK = 1000  # rows; a replay that is killed loses at most these


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV; None is a blank cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


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
        file.write(csv_text(rows))
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
