# SPDX-License-Identifier: Apache-2.0
"""From Parquet files and data frames, whose columns have types, to a grid of cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from smallwheel_ros.measurements.cells import (
    MOST_CHARACTERS,
    SMALLER,
    Cell,
    Grid,
    MeasurementsError,
    clipped,
    refuse_many_cells,
)

_MOST_UNPACKED = 4 * MOST_CHARACTERS  # bytes of all columns, as the footer states them
_TEXTS = ("string", "large_string", "string_view", "binary", "large_binary", "binary_view")


def parquet_grid(data: bytes, source: str, digest: str) -> Grid:
    """Read a Parquet file; MeasurementsError where it is damaged, too large or no table."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MeasurementsError(
            f"{source}: reading Parquet needs pyarrow: pip install 'smallwheel_ros[parquet]'"
        ) from None
    try:
        names, columns = _parquet_columns(pyarrow, data, source)
    except MeasurementsError:
        raise
    except Exception as error:  # pyarrow raises many kinds for a damaged file
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise MeasurementsError(f"{source}: a damaged Parquet file: {reason}") from None
    return _grid(source, digest, names, columns)


def frame_grid(frame: Any) -> Grid:
    """Take a pandas data frame. NaN, None and NaT are blank, as pandas means them."""
    source = "data frame"
    refuse_many_cells(source, *frame.shape)
    columns: list[list[Cell]] = []
    for position in range(frame.shape[1]):
        column = frame.iloc[:, position]
        blank = column.isna().to_numpy(dtype=bool)
        if column.dtype.kind in "iuf":
            cells: list[Cell] = column.to_numpy(dtype=float, na_value=np.nan).tolist()
        else:
            cells = [float(v) if _is_number(v) else str(v) for v in column.tolist()]
        for row in np.flatnonzero(blank).tolist():
            cells[row] = ""
        columns.append(cells)
    return _grid(source, "", [str(name) for name in frame.columns], columns)


def _is_number(value: Any) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating))
    return number and not isinstance(value, (bool, np.bool_))


def _grid(source: str, digest: str, names: list[str], columns: list[list[Cell]]) -> Grid:
    rows = len(columns[0]) if columns else 0
    if not rows:
        raise MeasurementsError(f"{source}: no rows")
    lines = list(range(1, rows + 1))
    return Grid(source, digest, list(zip(*columns, strict=True)), lines, "row", names)


def _parquet_columns(pyarrow: Any, data: bytes, source: str) -> tuple[list[str], list[list[Cell]]]:
    """Columns of the file, judged by what its footer states before anything is unpacked."""
    buffer = pyarrow.BufferReader(data)
    footer = pyarrow.parquet.read_metadata(buffer)
    schema = footer.schema.to_arrow_schema()
    groups = [footer.row_group(i) for i in range(footer.num_row_groups)]
    rows = max(footer.num_rows, sum(group.num_rows for group in groups))
    refuse_many_cells(source, rows, footer.num_columns)
    for field in schema:
        _refuse_kind(pyarrow, field, source)
    unpacked = sum(group.total_byte_size for group in groups)
    if unpacked > _MOST_UNPACKED:
        raise MeasurementsError(
            f"{source}: {unpacked} bytes once unpacked, expected at most {_MOST_UNPACKED}: "
            f"{SMALLER}"
        )
    # Texts stay indices into their different values: a value may stand in each of many rows.
    texts = [field.name for field in schema if str(field.type) in _TEXTS]
    table = pyarrow.parquet.ParquetFile(buffer, read_dictionary=texts).read()
    kept = [i for i, n in enumerate(table.column_names) if not str(n).startswith("__index_level_")]
    names = [str(table.column_names[i]) for i in kept]
    return names, [_parquet_cells(pyarrow, table.column(i)) for i in kept]


def _parquet_cells(pyarrow: Any, column: Any) -> list[Cell]:
    kind = column.type
    number = pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)
    if number or pyarrow.types.is_decimal(kind):
        values = column.cast(pyarrow.float64()).to_pylist()
        return ["" if value is None else value for value in values]
    if not pyarrow.types.is_dictionary(kind):
        column = column.dictionary_encode()
    cells: list[Cell] = []
    for chunk in column.chunks:
        # One text for all the rows that it stands in.
        texts = ["" if v is None else str(v).strip() for v in chunk.dictionary.to_pylist()]
        cells += ["" if i is None else texts[i] for i in chunk.indices.to_pylist()]
    return cells


def _refuse_kind(pyarrow: Any, field: Any, source: str) -> None:
    """Refuse a column of anything but numbers, texts and times: one cell may be of any size."""
    kind, types = field.type, pyarrow.types
    known = (types.is_primitive, types.is_decimal, types.is_dictionary, types.is_null)
    if str(kind) not in _TEXTS and not any(is_one(kind) for is_one in known):
        raise MeasurementsError(
            f"{source}, column '{clipped(field.name)}': its cells are of the kind "
            f"{clipped(str(kind))}, expected numbers or texts"
        )
