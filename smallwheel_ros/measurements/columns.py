"""What each column of a measurements table means, and its cells as checked numbers in SI units."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.files import Column, MeasurementsError, Table
from smallwheel_ros.measurements.units import (
    DIMENSIONLESS,
    Header,
    UnitsError,
    base_unit,
    parse_header,
    to_base,
)
from smallwheel_ros.physics.conditions import PLATE

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHANNELS = ("sinkage", "resistance", "drawbar_pull")  # m, N, N: what a model predicts
TEXTS = ("contact", "soil", "run", "wheel")
SETTINGS = ("slip", "slip_angle", "slope", "speed", "pass_number", "grouser_height")
_ROUNDING = 1e-9  # a limit may be passed by the rounding of a converted unit


@dataclass(frozen=True)
class Quantity:
    """A column of the contract: the unit it is held in and the values it may have."""

    unit: str
    low: float = -np.inf
    high: float = np.inf
    open_low: bool = False  # low itself is excluded
    hint: str = ""

    def bad(self, values: Array) -> Mask:
        """Values outside the range; NaN is not outside."""
        span = _ROUNDING * max(1.0, abs(self.high) if np.isfinite(self.high) else 1.0)
        below = values <= self.low if self.open_low else values < self.low - span
        return np.asarray(below | (values > self.high + span))

    def expected(self) -> str:
        """Say the range in words."""
        unit = "" if self.unit == DIMENSIONLESS else f" {self.unit}"
        if np.isfinite(self.high):
            return f"{self.low:.4g} to {self.high:.4g}{unit}"
        return f"over {self.low:g}{unit}" if self.open_low else f"{self.low:g}{unit} or more"


QUANTITIES: dict[str, Quantity] = {
    "load": Quantity("N", low=0.0, open_low=True),
    "diameter": Quantity("m", low=0.0, open_low=True),
    "width": Quantity("m", low=0.0, open_low=True),
    "sinkage": Quantity("m", low=0.0, hint="sinkage is positive downwards"),
    "resistance": Quantity("N"),
    "drawbar_pull": Quantity("N"),
    "sinkage_std": Quantity("m", low=0.0, open_low=True, hint="leave the cell blank if unknown"),
    "resistance_std": Quantity("N", low=0.0, open_low=True, hint="leave the cell blank if unknown"),
    "drawbar_pull_std": Quantity(
        "N", low=0.0, open_low=True, hint="leave the cell blank if unknown"
    ),
    "slip": Quantity("1", -1.0, 1.0, hint="in per cent? then the header is 'slip [%]'"),
    "slip_angle": Quantity(
        "rad", -np.pi, np.pi, hint="in degrees? then the header is 'slip_angle [deg]'"
    ),
    "slope": Quantity(
        "rad", -np.pi / 2, np.pi / 2, hint="in degrees? then the header is 'slope [deg]'"
    ),
    "speed": Quantity("m/s", low=0.0, hint="the speed of travel, without a sign"),
    "pass_number": Quantity("1", low=1.0, hint="1 is fresh soil"),
    "grouser_height": Quantity("m", low=0.0),
}
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
            raise table.error(f"header '{column.header}': {error}") from None
        if not header.name:
            hint = " (a pandas index? write with index=False)" if position == 1 else ""
            raise table.error(f"column {position} has no name{hint}")
        if header.name in found:
            other = found[header.name][1].header
            raise table.error(
                f"two columns are named '{header.name}' ('{other}' and '{column.header}'), "
                "expected one: remove or rename the other"
            )
        found[header.name] = (header, column)
    return found


def _lacking(table: Table, name: str, there: list[str], why: str) -> Exception:
    lower = {other.lower(): other for other in there}
    guess = [lower[name]] if name in lower else difflib.get_close_matches(name, there, 1, 0.6)
    guess = guess or [other for other in there if other.lower().startswith(name + " (")]
    hint = f"; is '{guess[0]}' it? Write '{name} [unit]'" if guess else ""
    return table.error(f"no column '{name}'{why}{hint}. There is: {', '.join(there)}")


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
        elif name in QUANTITIES:
            columns.numbers[name] = _known(table, name, header, column)
            columns.units[name] = QUANTITIES[name].unit
        else:
            _extra(columns, name, header, column)
    for name, size in sizes.items():
        if size is not None:
            columns.numbers[name] = np.full(table.line.size, float(size))
            columns.units[name] = QUANTITIES[name].unit
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
        if not (np.isfinite(size) and size > 0):
            raise MeasurementsError(f"{name} given as {size!r} m, expected a length over 0 m")
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
            f"There is: {', '.join(there)}"
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
    if np.isinf(converted).any():
        row = int(np.flatnonzero(np.isinf(converted))[0])
        raise table.error(f"{values[row]:g} {header.unit} is too large a number", row, name)
    return converted


def _known(table: Table, name: str, header: Header, column: Column) -> Array:
    quantity = QUANTITIES[name]
    # The unit first: of a column in the wrong one, every value may look wrong.
    _convert(table, name, np.zeros(1), header, quantity.unit)
    values = _convert(table, name, _finite(table, name, column), header, quantity.unit)
    bad = quantity.bad(values)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise table.error(
            f"{name} is {shown(column, header.unit, values, row)}, expected {quantity.expected()}"
            f"{'; ' + quantity.hint if quantity.hint else ''}{_more(bad)}",
            row,
            name,
        )
    return np.clip(values, quantity.low, quantity.high)


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
    table = columns.table
    columns.numbers[name] = _convert(table, name, _finite(table, name, column), header, None)
    try:
        columns.units[name] = "" if header.unit is None else base_unit(header.unit)
    except UnitsError as error:
        raise table.error(str(error), column=name) from None
