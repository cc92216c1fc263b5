"""The columns of a file's table, its cells as checked numbers in SI units."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import Column, MeasurementsError, Table, clipped
from smallwheel_ros.measurements.columns import (
    CHANNELS,
    COLUMNS,
    LEAST,
    OTHER,
    TEXTS,
    Array,
    ColumnSpec,
    Mask,
)
from smallwheel_ros.measurements.units import (
    DIMENSIONLESS,
    Header,
    UnitsError,
    base_unit,
    parse_header,
    to_base,
)
from smallwheel_ros.physics.conditions import PLATE

_MOST_NAMES = 30  # that a message lists
_MOSTLY = 0.8  # an extra column with at least this share of numbers is a numeric one


@dataclass(frozen=True)
class Columns:
    """A table's columns by name, and its numeric ones as numbers in `units`."""

    table: Table
    by_name: dict[str, Column]
    numbers: dict[str, Array]
    units: dict[str, str]
    texts: dict[str, NDArray[np.str_]]  # of the contract and labels alike
    notes: list[str]


def _headers(table: Table) -> dict[str, tuple[Header, Column]]:
    found: dict[str, tuple[Header, Column]] = {}
    for position, column in enumerate(table.columns, start=1):
        try:
            header = parse_header(column.header)
        except UnitsError as error:
            raise table.error(f"header '{clipped(column.header)}': {error}") from None
        if not header.name:
            hint = " (a pandas index? write with index=False)" if position == 1 else ""
            raise table.error(f"column {position} has no name{hint}")
        if header.name in found:
            other, name = found[header.name][1].header, clipped(header.name)
            raise table.error(
                f"two columns are named '{name}' ('{clipped(other)}' and "
                f"'{clipped(column.header)}'), expected one: remove or rename the other"
            )
        found[header.name] = (header, column)
    return found


def _lacking(table: Table, name: str, there: list[str], why: str) -> Exception:
    lower = {other.lower(): other for other in there}
    guess = [lower[name]] if name in lower else difflib.get_close_matches(name, there, 1, 0.6)
    guess = guess or [other for other in there if other.lower().startswith(name + " (")]
    hint = f"; is '{clipped(guess[0])}' it? Write '{name} [unit]'" if guess else ""
    what = f"no column '{name}' ({COLUMNS[name].description}){why}"
    return table.error(f"{what}{hint}. There is: {_listed(there)}")


def _listed(names: list[str]) -> str:
    shown = ", ".join(clipped(name) for name in names[:_MOST_NAMES])
    more = len(names) - _MOST_NAMES
    return f"{shown} and {more} more" if more > 0 else shown


def read_columns(table: Table, sizes: dict[str, float | None]) -> Columns:
    """Every column of the table, checked cell by cell; diameter and width from `sizes` if given."""
    headers = _headers(table)
    needed = _needed(headers)
    _check_there(table, list(headers), sizes, needed)
    columns = Columns(
        table, {name: column for name, (_, column) in headers.items()}, {}, {}, {}, []
    )
    for name, (header, column) in headers.items():
        if name in TEXTS:
            if header.unit not in (None, DIMENSIONLESS):
                raise table.error(f"unit '{header.unit}' on a text", column=name)
            columns.texts[name] = column.as_text()
        elif column.blank.all():
            if name in needed:
                raise table.error("the whole column is blank", column=name)
            columns.notes.append(f"column '{name}' is blank throughout and is left out")
        elif name in COLUMNS:
            columns.numbers[name] = _checked(columns, name, header, column, COLUMNS[name])
            columns.units[name] = COLUMNS[name].unit
        else:
            _extra(columns, name, header, column)
    for name, size in sizes.items():
        if size is not None:
            columns.numbers[name] = np.full(table.line.size, float(size))
            columns.units[name] = COLUMNS[name].unit
    return columns


def _needed(headers: dict[str, tuple[Header, Column]]) -> tuple[str, ...]:
    """Columns that there must be; a table of nothing but plates needs no width."""
    if "contact" in headers and np.all(headers["contact"][1].as_text() == PLATE):
        return ("load", "diameter")
    return ("load", "diameter", "width")


def _check_there(
    table: Table, there: list[str], sizes: dict[str, float | None], needed: tuple[str, ...]
) -> None:
    for name, size in sizes.items():
        if size is None:
            continue
        spec = COLUMNS[name]
        if np.isnan(size) or spec.bad(np.array([size])).any():
            raise MeasurementsError(
                f"{table.source}: {name} given as {size!r} m, expected {spec.expected()}"
            )
        if name in there:
            raise table.error(f"{name} was given for all rows too, expected one of the two: "
                              "leave the option or the column out", column=name)  # fmt: skip
    for name in needed:
        if name not in there and sizes.get(name) is None:
            why = "" if name == "load" else f" and no {name} given for all rows (--{name})"
            raise _lacking(table, name, there, why)
    if not any(name in there for name in CHANNELS):
        wanted = ", ".join(CHANNELS)
        raise table.error(
            f"nothing was measured: expected at least one column of {wanted}. "
            f"There is: {_listed(there)}"
        )


def _finite(table: Table, name: str, column: Column) -> Array:
    """Numbers of the column, NaN where blank; MeasurementsError for anything else."""
    values, bad = column.parsed()
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        cell = column.cell(row)
        hint = ": write a decimal point, not a comma" if "," in cell else ""
        if cell.lower() in ("na", "n/a", "-", "none", "null", "missing", "?"):
            hint = ": leave the cell blank where nothing was measured"
        raise table.error(f"'{cell}' found, expected a number{hint}{_more(bad)}", row, name)
    bad = ~np.isfinite(values) & ~column.blank
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise table.error(
            f"{column.cell(row)} found, expected a finite number, or a blank cell where nothing "
            f"was measured{_more(bad)}",
            row,
            name,
        )
    return values


def _more(bad: Mask) -> str:
    others = int(bad.sum()) - 1
    return f" (and {others} more like it)" if others else ""


def _convert(table: Table, name: str, values: Array, header: Header, expected: str | None) -> Array:
    if header.unit is None:
        return values
    try:
        converted = to_base(values, header.unit, expected)
    except UnitsError as error:
        raise table.error(str(error), column=name) from None
    return converted


def _checked(
    columns: Columns, name: str, header: Header, column: Column, spec: ColumnSpec
) -> Array:
    """Numbers of a column in its SI unit, each within the range of its kind."""
    table, expected = columns.table, spec.unit or None
    # The unit first: of a column in the wrong one, every value may look wrong.
    _convert(table, name, np.zeros(1), header, expected)
    values = _convert(table, name, _finite(table, name, column), header, expected)
    bad = spec.bad(values)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise table.error(
            f"{clipped(name)} is {shown(column, header.unit, values, row)}, "
            f"expected {spec.expected()}{_hint(name, header, spec)}{_more(bad)}",
            row,
            name,
        )
    tiny = (np.abs(values) < LEAST) & (values != 0.0)
    if tiny.any():
        columns.notes.append(
            f"column '{clipped(name)}': {tiny.sum()} numbers under {LEAST:g} are taken as 0"
        )
        values = np.where(tiny, 0.0, values)
    return np.clip(values, spec.low, spec.high)


def _hint(name: str, header: Header, spec: ColumnSpec) -> str:
    if spec.hint:
        return f"; {spec.hint}"
    if spec.unit == "m" and header.unit is None:
        return f"; without a unit it is metres: for mm the header is '{name} [mm]'"
    return ""


def shown(column: Column, unit: str | None, values: Array, row: int) -> str:
    """Show a value as it stands in the file, and converted where the file has another unit."""
    if unit is None:
        return column.cell(row)
    if unit == DIMENSIONLESS:
        return column.cell(row)
    same = float(values[row]) == float(column.parsed()[0][row])
    return f"{column.cell(row)} {unit}" + ("" if same else f" ({values[row]:.6g} in SI)")


def _extra(columns: Columns, name: str, header: Header, column: Column) -> None:
    """Take a column that the contract does not know: a covariate if numeric, else a label."""
    _, bad = column.parsed()
    numeric = ~bad & ~column.blank
    if header.unit is None and numeric.sum() < _MOSTLY * (~column.blank).sum():
        columns.texts[name] = column.as_text()
        columns.notes.append(f"column '{name}' is text: kept as a label, not used by any model")
        return
    columns.numbers[name] = _checked(columns, name, header, column, OTHER)
    # The unit was understood when its numbers were converted.
    columns.units[name] = "" if header.unit is None else base_unit(header.unit)
