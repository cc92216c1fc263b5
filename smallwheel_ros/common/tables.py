# SPDX-License-Identifier: Apache-2.0
"""Tables as plain text and as CSV; JSON for the command line."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from smallwheel_ros.common.files import json_text, write_bytes


def text_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = ()
) -> str:
    """Format a table as text, with columns aligned by spaces.

    Columns of numbers are aligned to the right, others to the left.

    Parameters
    ----------
    header
        Heading of each column.
    rows
        Cells of each row, as many as there are headings.
    right
        Indices of further columns to align to the right.

    Returns
    -------
    str
        Lines without a line break at the end.
    """
    columns = list(zip(header, *rows, strict=True))
    widths = [max(len(cell) for cell in column) for column in columns]
    numeric = [i in right or all(_is_number(cell) for cell in column[1:])
               for i, column in enumerate(columns)]  # fmt: skip
    lines = []
    for row in (header, *rows):
        cells = (
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, numeric, strict=True)
        )
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell in ("", "-")
    return True


def each(value: Any, single: Callable[[Any], Any]) -> Any:
    """Convert mappings, lists and arrays to dicts and lists, and apply a function to every value in them.

    Parameters
    ----------
    value
        A value, or mappings, lists, tuples, arrays and columns of values, nested in any way.
    single
        Function that converts a single value.

    Returns
    -------
    Any
        Dicts with texts as keys, lists, and converted values.
    """
    if isinstance(value, Mapping):
        return {str(key): each(item, single) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [each(item, single) for item in value]
    if hasattr(value, "tolist"):  # an array, a column of a table, a number of numpy
        return each(value.tolist(), single)
    return single(value)


def plain(value: Any) -> Any:
    """Convert a value for JSON: arrays become lists, numbers that are not finite become None."""
    return each(value, _single)


def _single(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(target: str, document: Mapping[str, Any]) -> None:
    """Write JSON to a file, or to standard output for `-`.

    Parameters
    ----------
    target
        Name of the file, or `-`.
    document
        Plain values; arrays and numbers of numpy are converted.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    text = json_text(plain(document))
    if target == "-":
        click.echo(text, nl=False)
    else:
        write_bytes(target, text.encode())


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of the same columns as CSV; None is a blank cell.

    Parameters
    ----------
    path
        The file.
    rows
        Rows, each with its values by column; the columns are in the order of the first row.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(path, text.getvalue().encode())
