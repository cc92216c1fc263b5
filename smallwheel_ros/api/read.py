# SPDX-License-Identifier: Apache-2.0
"""`read`: a table of measurements from a file or a DataFrame."""

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from smallwheel_ros.arguments import Compliance, Contact, Headers, Sheets, Size, refuse_given
from smallwheel_ros.common.errors import ArgumentError, kind_of
from smallwheel_ros.measurements.given import Data
from smallwheel_ros.measurements.typed import number_of

if TYPE_CHECKING:
    from smallwheel_ros.measurements.measurements import Measurements, ShearTests


def read(
    data: Data,
    map: Headers | None = None,
    *,
    sheet: Sheets | None = None,
    diameter: Size | None = None,
    width: Size | None = None,
    contact: Contact | None = None,
    compliance: Compliance | None = None,
) -> "Measurements":
    """Read a table of measurements: a file, or a DataFrame of pandas.

    Parameters
    ----------
    data : path, DataFrame, or what `sw.read` returned
        CSV, Parquet or a spreadsheet, as docs/data.md says, or a DataFrame with such headers.
    map : dict, as ``{"load": "F3", "width [cm]": "b"}``, optional
        Quantity of a column whose header does not name it.
    sheet : str, int, or several, as ``["dry", "wet"]``, optional
        Sheet of a workbook, by name or number; several of the same columns become one table.
    diameter : number or text, optional
        Wheel diameter [m] for all rows: 0.2, or with a unit, 20cm.
    width : number or text, optional
        Wheel width [m] for all rows: 0.1, or with a unit, 10cm.
    contact : {'rolling', 'pressed', 'plate'}, optional
        Contact in all rows, where the table has no such column.
    compliance : number or text, optional
        Compliance of the machine [m/N]: its product with the load is subtracted from each measured sinkage;
        1 mm under 500 N is 2e-6.

    Returns
    -------
    Measurements
        The table in SI units; `data` itself where `sw.read` returned it.

    Raises
    ------
    ArgumentError
        If `data` was read before and anything else is given.
    MeasurementsError
        If the table cannot be used; the message names file, row, column, what was found and what was
        expected.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> data = sw.read("rig.csv")
    >>> data.channels.keys()
    dict_keys(['sinkage', 'resistance'])
    """
    from smallwheel_ros.measurements.from_file import read_measurements
    from smallwheel_ros.measurements.measurements import Measurements

    if isinstance(data, Measurements):
        sizes = {"diameter": diameter, "width": width, "compliance": compliance}
        return _as_it_is(data, {"map": map, "sheet": sheet, "contact": contact} | sizes)
    known, said = _in_all_rows(diameter=diameter, width=width, compliance=compliance)
    found = read_measurements(_source(data), map=map, sheet=sheet, contact=contact, **known)
    return replace(found, understood=(*said, *found.understood))


def read_test(data: Any, **how: Any) -> "Measurements | ShearTests":
    """Read a table of any test of a lab, shear tests too.

    Parameters
    ----------
    data
        A file, a DataFrame, or a table that was read before.
    how
        Further arguments by name, as those of `read`.

    Returns
    -------
    Measurements or ShearTests
        Which of them the columns of the table decide.
    """
    from smallwheel_ros.measurements.from_file import read_tests
    from smallwheel_ros.measurements.measurements import Measurements, ShearTests

    if isinstance(data, (Measurements, ShearTests)):
        return _as_it_is(data, how)
    known, said = _in_all_rows(**{name: how.pop(name, None) for name in _SIZES})
    found = read_tests(_source(data), **how, **known)
    return replace(found, understood=(*said, *found.understood))


def conditions_of(data: Any, **how: Any) -> "Measurements":
    """Read a table of settings to predict; unlike in `read`, no row needs to have a measured quantity.

    Parameters
    ----------
    data
        A file, a DataFrame, or a table that was read before.
    how
        Further arguments by name, as those of `read`.
    """
    from smallwheel_ros.measurements.from_file import read_conditions
    from smallwheel_ros.measurements.measurements import Measurements

    if isinstance(data, Measurements):
        return _as_it_is(data, how)
    known, said = _in_all_rows(**{name: how.pop(name, None) for name in _SIZES})
    found = read_conditions(_source(data), **how, **known)
    return replace(found, understood=(*said, *found.understood))


_SIZES = ("diameter", "width", "compliance")
_Table = TypeVar("_Table")


def _as_it_is(table: _Table, how: Mapping[str, Any]) -> _Table:
    """Return a table that was read before. Raises ArgumentError if other arguments are given."""
    refuse_given(
        how,
        "for a table that was read before, which stays as it is: give it to sw.read with the file",
    )
    return table


def _in_all_rows(**sizes: float | str | None) -> tuple[dict[str, Any], list[str]]:
    """Values that hold for all rows, in SI units, and notes on how texts were understood."""
    typed = {name: number_of(name, given) for name, given in sizes.items() if given is not None}
    values = {name: float(read.values[0]) for name, read in typed.items()}
    return values, [read.said for read in typed.values() if read.said]


def _source(data: Any) -> Any:
    """Return a file's path or a DataFrame. Raises ArgumentError for anything else."""
    if not (isinstance(data, (str, PathLike)) or hasattr(data, "columns")):
        raise ArgumentError(
            f"data: found {kind_of(data)}, expected a file, a DataFrame or what sw.read returned"
        )
    return Path(data) if isinstance(data, (str, PathLike)) else data
