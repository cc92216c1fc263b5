# SPDX-License-Identifier: Apache-2.0
"""The one reader of measurements of wheels, and of plates, whatever table they come in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import clipped
from smallwheel_ros.measurements.checks import suspicions
from smallwheel_ros.measurements.columns import CHANNELS, COLUMNS, SETTINGS, TEXTS
from smallwheel_ros.measurements.headers import UNKNOWN, meant
from smallwheel_ros.measurements.plates import (
    contact_of_rows,
    name_curves,
    rows_on_soil,
    take_plates,
)
from smallwheel_ros.measurements.reading import Columns, read_columns, take_size
from smallwheel_ros.measurements.settings import (
    codes_of,
    one_row_a_wheel,
    order_columns,
    set_columns,
    setting_codes,
)
from smallwheel_ros.measurements.shear import ShearTests, is_shear, shear_tests
from smallwheel_ros.measurements.sheets import read_grid
from smallwheel_ros.measurements.table import Measurements, over_half
from smallwheel_ros.physics.conditions import PLATE, ROLLING, Array, Conditions

if TYPE_CHECKING:
    import pandas as pd

# What a body that is pressed straight down has of the settings of a rolling wheel.
_AT_REST = {"slip": 0.0, "slip_angle": 0.0, "slope": 0.0, "pass_number": 1.0}
# A wheel that moves more across its plane than along it is ploughed, not rolled.
_PLOUGHED = np.pi / 4
_VEHICLE = (
    "each run has one row of each of several wheels: they count as wheels of one vehicle at one "
    "place. If runs are numbered anew for each wheel, give each a name of its own"
)

_SHEAR = (
    "a table of shear tests: they are fitted by `smallwheel fit`, beside a table of load and sinkage or "
    "with --model"
)
_BLANK = "the cell is blank, expected a value"
_ANSWERS = "taken as what the wheel answers, not as settings: {}"


def read_measurements(
    source: str | Path | pd.DataFrame,
    *,
    diameter: float | None = None,
    width: float | None = None,
    contact: str | None = None,
    compliance: float | None = None,
    map: Mapping[str, str] | None = None,
    sheet: str | int | None = None,
) -> Measurements:
    """Read a table of measurements; everything in SI units afterwards.

    source: a CSV, xlsx, ods or Parquet file, or a pandas data frame. docs/data.md says what a table
    may look like. diameter, width: m, contact: `plate`, `pressed` or `rolling`, for all rows, where
    there is no such column. compliance: m/N by which the machine gives way; it is taken off the
    sinkage. map: our name -> their header, for headers that are not understood: {"load": "F3"}. sheet:
    of a workbook, by name or number.
    Raises MeasurementsError that lists everything that is wrong: file, row, column, what was found,
    what was expected, what to do.
    """
    columns = read_columns(read_grid(source, sheet), map or {})
    if is_shear(columns):
        columns.problems.add(_SHEAR)
        columns.problems.raise_any()
    return measurements_of(columns, diameter, width, contact, compliance)


def read_tests(
    source: str | Path | pd.DataFrame,
    *,
    diameter: float | None = None,
    width: float | None = None,
    contact: str | None = None,
    compliance: float | None = None,
    map: Mapping[str, str] | None = None,
    sheet: str | int | None = None,
) -> Measurements | ShearTests:
    """Read a table of wheels and plates, as `read_measurements`, or one of shear tests."""
    columns = read_columns(read_grid(source, sheet), map or {})
    if is_shear(columns):
        return shear_tests(columns)
    return measurements_of(columns, diameter, width, contact, compliance)


def measurements_of(
    columns: Columns,
    diameter: float | None = None,
    width: float | None = None,
    given: str | None = None,
    compliance: float | None = None,
) -> Measurements:
    """The measurements in the columns of a table. Raises MeasurementsError, as `read_measurements`."""
    take_size(columns, "diameter", diameter)
    take_size(columns, "width", width)
    contact = contact_of_rows(columns, given)
    take_plates(columns, contact, compliance)
    _check_there(columns, contact)
    _check_blanks(columns, contact)
    _check_depth(columns, contact)
    _check_lugs(columns)
    columns.problems.raise_any()
    name_curves(columns, contact)
    if (contact != ROLLING).any():
        keep = rows_on_soil(columns, contact, _runs(columns))
        if not keep.any():
            columns.problems.add("no row of load and sinkage over 0 is left")
            columns.problems.raise_any()
        columns.keep(keep)
        contact = contact[keep]
    return _measurements(columns, contact)


def _own_columns(columns: Columns, data: Measurements) -> list[str]:
    """What becomes of the columns that no standard one is meant by."""
    mine = [h.name for h in columns.headings.values() if h.rank == UNKNOWN]
    uses = {
        "columns of your own, used as covariates": set_columns(data),
        "order of the runs, for drifts": order_columns(data),
    }
    lists = {use: [clipped(name) for name in mine if name in names] for use, names in uses.items()}
    return [f"{use}: {', '.join(names[:30])}" for use, names in lists.items() if names]


def _measurements(columns: Columns, contact: NDArray[np.str_]) -> Measurements:
    """The table of columns in which nothing is wrong."""
    numbers, rows = dict(columns.numbers), columns.lines.size
    channels = {name: numbers.pop(name) for name in CHANNELS if name in numbers}
    declared = _declared_std(columns, channels, numbers)
    load, d, b = (numbers.pop(n, np.full(rows, np.nan)) for n in ("load", "diameter", "width"))
    rolling = contact == ROLLING
    tried = {name: _covariate(columns, name, values, rolling) for name, values in numbers.items()}
    covariates = {name: values for name, values in tried.items() if values is not None}
    conditions = Conditions(load, d, b, contact, columns.texts.get("soil"), covariates)
    runs_given = bool((columns.texts.get("run", np.array([""])) != "").any())
    data = Measurements(
        conditions,
        channels,
        _runs(columns) if runs_given else np.full(rows, ""),
        _wheels(columns, conditions),
        columns.lines,
        declared,
        {name: text for name, text in columns.texts.items() if name not in TEXTS},
        columns.units,
        runs_given,
        "wheel" in columns.texts,
        headers={name: heading.text for name, heading in columns.headings.items()},
        understood=tuple(columns.understood),
        source=columns.source,
        sha256=columns.sha256,
        written_units={
            name: heading.unit
            for name, heading in columns.headings.items()
            if heading.unit is not None
        },
    )
    data = replace(data, understood=(*data.understood, *_own_columns(columns, data)))
    notes = list(columns.notes)
    if not runs_given:
        data, found = _with_repeats(data, columns.place)
        notes.append(found)
    if data.responses:
        notes.append(_ANSWERS.format(", ".join(data.responses)))
    if one_row_a_wheel(data):
        notes.append(_VEHICLE)
    warnings = (*columns.warnings, *suspicions(data, columns.place))
    return replace(data, notes=tuple(notes), warnings=warnings)


def _check_there(columns: Columns, contact: NDArray[np.str_]) -> None:
    """Add a problem for each column that there must be; a table of plates needs no width."""
    needed = ["load", "diameter", *(["width"] if np.any(contact != PLATE) else [])]
    nearly = {meant(heading) for heading in columns.headings.values() if heading.rank == UNKNOWN}
    lacking = [
        f"no column '{name}' ({COLUMNS[name].description})"
        + ("" if name == "load" else f" and no {name} given for all rows (--{name})")
        + ("; plates have none: say contact = plate (--contact plate)" if name == "width" else "")
        for name in needed
        if not columns.there(name) and name not in nearly
    ]
    if not any(name in columns.headings or name in nearly for name in CHANNELS):
        wanted = ", ".join(CHANNELS)
        lacking.append(f"nothing was measured: expected at least one column of {wanted}")
    columns.lacking(lacking)
    if not columns.problems.found and not any(name in columns.numbers for name in CHANNELS):
        columns.problems.add(f"nothing was measured: every cell of {', '.join(CHANNELS)} is blank")


def _check_blanks(columns: Columns, contact: NDArray[np.str_]) -> None:
    """Add a problem for cells that are blank where a value is needed."""
    faulty = {name for name, values in columns.numbers.items() if np.isnan(values).all()}
    for name in ("load", "diameter", "width"):
        if name in columns.numbers and name not in faulty:
            blank = np.isnan(columns.numbers[name])
            blank &= (contact != PLATE) if name == "width" else True
            if blank.any():
                columns.problem(_BLANK, name, blank)
    for name in ("soil", "wheel"):
        texts = columns.texts.get(name)
        if texts is not None and (texts == "").all():
            del columns.texts[name]
        elif texts is not None and (texts == "").any():
            columns.problem(f"{_BLANK}; merged cells have to be filled", name, texts == "")
    for name in SETTINGS:
        if name in columns.numbers and name not in faulty:
            holes = np.isnan(columns.numbers[name]) & (contact == ROLLING)
            if holes.any():
                columns.problem(
                    "the cell is blank in a rolling row, expected a value (a whole column may be "
                    "left out, and a pressed or plate row may leave it blank)",
                    name,
                    holes,
                )


def _declared_std(
    columns: Columns, channels: dict[str, Array], numbers: dict[str, Array]
) -> dict[str, Array]:
    declared: dict[str, Array] = {}
    for name in CHANNELS:
        values = numbers.pop(f"{name}_std", None)
        if values is None:
            continue
        if name in channels:
            declared[name] = values
        else:
            columns.notes.append(f"column '{name}_std' is left out: there is no '{name}'")
    return declared


def _covariate(
    columns: Columns, name: str, values: Array, rolling: NDArray[np.bool_]
) -> Array | None:
    """Give the column with every rolling row filled, or None (and a note) if it has gaps."""
    gaps = np.isnan(values)
    holes = gaps & rolling
    if holes.any():
        columns.notes.append(
            f"column '{name}' is blank in {holes.sum()} rolling rows (first in {columns.place} "
            f"{columns.lines[np.flatnonzero(holes)[0]]}): not used as a covariate"
        )
        return None
    return np.where(gaps, _AT_REST[name], values) if name in _AT_REST and gaps.any() else values


def _runs(columns: Columns) -> NDArray[np.str_]:
    """Each row's run; a row that names none is a run of its own, named by its line."""
    run = columns.texts.get("run", np.full(columns.lines.size, ""))
    if (run != "").all():
        return run
    if (run != "").any():
        note = f"{(run == '').sum()} rows name no run: each counts as a run of its own"
        if note not in columns.notes:
            columns.notes.append(note)
    return np.where(run == "", _line_names(columns.place, columns.lines), run)


def _line_names(place: str, lines: NDArray[np.intp]) -> NDArray[np.str_]:
    return np.char.add(f"{place} ", lines.astype(np.str_))


def _with_repeats(data: Measurements, place: str) -> tuple[Measurements, str]:
    """Name each row's run by the first row of its setting: repeats are no independent runs."""
    codes = setting_codes(data)
    # codes rise in the order in which they first appear
    first = np.flatnonzero(np.diff(np.maximum.accumulate(codes), prepend=-1))
    count = np.bincount(codes)
    rows, repeated = int(count[count > 1].sum()), int((count > 1).sum())
    found = (
        f"{rows} of {len(data)} rows repeat {repeated} settings"
        if rows
        else "no setting is repeated"
    )
    return replace(data, run=_line_names(place, data.line[first])[codes]), (
        f"no column 'run': rows of one setting count as repeats of one run, each other row as a run "
        f"of its own; {found}. Say which belong together in that column"
    )


def _wheels(columns: Columns, conditions: Conditions) -> NDArray[np.str_]:
    # a pair of numbers as a complex one
    sizes, index = codes_of(conditions.diameter + 1j * np.nan_to_num(conditions.width))
    names = [
        f"{1e3 * s.real:.4g} mm" + (f" x {1e3 * s.imag:.4g} mm" if s.imag else "") for s in sizes
    ]
    made = np.array(names, dtype=np.str_)[index]
    return columns.texts.get("wheel", made)


def _check_depth(columns: Columns, contact: NDArray[np.str_]) -> None:
    """Add a problem for a rolling or pressed wheel that is deeper than its axle.

    It carries by its lower half, so that is a mistake. A wheel dragged across its plane is ploughed
    in rather than rolled, and does get there: such rows are kept, marked by
    `Measurements.sunk_to_axle`.
    """
    z, d = columns.numbers.get("sinkage"), columns.numbers.get("diameter")
    if z is None or d is None:
        return
    deep = over_half(z, d) & (contact != PLATE)
    if "slip_angle" in columns.numbers:
        deep &= np.abs(columns.numbers["slip_angle"]) <= _PLOUGHED
    if not deep.any():
        return
    row = int(np.flatnonzero(deep)[0])
    heading = columns.headings["sinkage"]
    hint = "; without a unit it is metres: for mm the header is 'sinkage [mm]'"
    columns.problem(
        f"sinkage is {columns.found('sinkage', z, row)}, expected at most {0.5 * d[row]:.6g} m, half "
        f"the diameter{hint if heading.unit is None else ''}",
        "sinkage",
        deep,
    )


def _check_lugs(columns: Columns) -> None:
    """Add a problem for lugs that are higher than the wheel's radius."""
    lugs, d = columns.numbers.get("grouser_height"), columns.numbers.get("diameter")
    if lugs is None or d is None or not (high := lugs > 0.5 * d).any():
        return
    row = int(np.flatnonzero(high)[0])
    columns.problem(
        f"grouser_height is {columns.found('grouser_height', lugs, row)}, expected at most "
        f"{0.5 * d[row]:.6g} m, the wheel's radius: is the unit right?",
        "grouser_height",
        high,
    )
