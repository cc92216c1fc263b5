"""From a Parquet file's bytes to columns of cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from smallwheel_ros.measurements.cells import (
    MOST_CHARACTERS,
    SMALLER,
    Column,
    MeasurementsError,
    Table,
    clipped,
    refuse_many_cells,
)

_MOST_UNPACKED = 2 * MOST_CHARACTERS  # bytes of all columns, as the footer states them
_TEXTS = ("string", "large_string", "string_view", "binary", "large_binary", "binary_view")


def parquet_table(data: bytes, source: str, digest: str) -> Table:
    """Read a Parquet file; MeasurementsError where it is damaged, too large or no table."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MeasurementsError(
            f"{source}: reading Parquet needs pyarrow: pip install 'smallwheel_ros[parquet]'"
        ) from None
    try:
        columns = _parquet_columns(pyarrow, data, source)
    except MeasurementsError:
        raise
    except Exception as error:  # pyarrow raises many kinds for a damaged file
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise MeasurementsError(f"{source}: a damaged Parquet file: {reason}") from None
    if not columns or not columns[0].blank.size:
        raise MeasurementsError(f"{source}: no rows")
    line = np.arange(1, columns[0].blank.size + 1, dtype=np.intp)
    return Table(source, digest, columns, line, "row")


def _parquet_columns(pyarrow: Any, data: bytes, source: str) -> list[Column]:
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
    return [
        _parquet_column(pyarrow, str(name), column)
        for name, column in zip(table.column_names, table.columns, strict=True)
        if not str(name).startswith("__index_level_")
    ]


def _parquet_column(pyarrow: Any, name: str, column: Any) -> Column:
    blank = np.asarray(column.is_null().to_numpy(), dtype=bool)
    kind = column.type
    number = pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)
    if number or pyarrow.types.is_decimal(kind):
        values = column.cast(pyarrow.float64()).to_numpy()
        return Column(name, None, np.asarray(values, dtype=float), blank)
    if not pyarrow.types.is_dictionary(kind):
        column = column.dictionary_encode()
    cells: list[str] = []
    for chunk in column.chunks:
        # One text for all the rows that it stands in.
        values = ["" if v is None else str(v).strip() for v in chunk.dictionary.to_pylist()]
        cells += ["" if i is None else values[i] for i in chunk.indices.to_pylist()]
    return Column(name, cells, None, np.array([not cell for cell in cells], dtype=bool))


def _refuse_kind(pyarrow: Any, field: Any, source: str) -> None:
    """Refuse a column of anything but numbers, texts and times: one cell may be of any size."""
    kind, types = field.type, pyarrow.types
    known = (types.is_primitive, types.is_decimal, types.is_dictionary, types.is_null)
    if str(kind) not in _TEXTS and not any(is_one(kind) for is_one in known):
        raise MeasurementsError(
            f"{source}, column '{clipped(field.name)}': its cells are of the kind "
            f"{clipped(str(kind))}, expected numbers or texts"
        )
