# SPDX-License-Identifier: Apache-2.0
"""The one reader of measurements of wheels, and of plates, whatever table they come in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import Grid, MeasurementsError, clipped
from smallwheel_ros.measurements.columns import CHANNELS, COLUMNS, SETTINGS, TEXTS, Mask, Texts
from smallwheel_ros.measurements.offers import Offer, offer_of
from smallwheel_ros.measurements.plates import (
    keep_rows_on_soil,
    name_curves,
    take_contact,
    take_plates,
)
from smallwheel_ros.measurements.reading import Columns, read_columns, take_size
from smallwheel_ros.measurements.settings import (
    one_row_a_wheel,
    order_columns,
    set_columns,
    setting_codes,
)
from smallwheel_ros.measurements.several_sheets import joined_sheets, refuse_other_columns
from smallwheel_ros.measurements.shear import ShearTests, is_shear, shear_tests
from smallwheel_ros.measurements.sheets import read_grid
from smallwheel_ros.measurements.suspicions import suspicions
from smallwheel_ros.measurements.table import Measurements, codes_of, over_half
from smallwheel_ros.measurements.words import UNKNOWN, meant
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
_BLANK_ROLLING = (
    "the cell is blank in a rolling row, expected a value (a whole column may be left out, and a "
    "pressed or plate row may leave it blank)"
)
_ANSWERS = "taken as what the wheel answers, not as settings: {}"


def read_measurements(source: str | Path | pd.DataFrame, **how: Any) -> Measurements:
    """Read a table of wheels and plates as `read_tests` does; one of shear tests is refused."""
    found = read_tests(source, shear=False, **how)
    assert isinstance(found, Measurements)
    return found


def read_tests(
    source: str | Path | pd.DataFrame,
    *,
    diameter: float | None = None,
    width: float | None = None,
    contact: str | None = None,
    compliance: float | None = None,
    map: Mapping[str, str] | None = None,
    sheet: str | int | Sequence[str | int] | None = None,
    shear: bool = True,
) -> Measurements | ShearTests:
    """Read a table of measurements; everything in SI units afterwards.

    source: a CSV, xlsx, ods or Parquet file, or a pandas data frame. docs/data.md says what a table
    may look like. diameter, width: m, contact: `plate`, `pressed` or `rolling`, for all rows, where
    there is no such column. compliance: m/N by which the machine gives way; it is taken off the
    sinkage. map: our name -> their header, for headers that are not understood: {"load": "F3"}. sheet:
    of a workbook, by name or number; the rows of several are one table. shear: whether a table of shear
    tests is one to read.
    Raises MeasurementsError that lists everything that is wrong: file, row, column, what was found,
    what was expected, what to do.
    """
    how: dict[str, Any] = {"diameter": diameter, "width": width, "contact": contact}
    how |= {"compliance": compliance, "shear": shear}
    several = [] if sheet is None else [sheet] if isinstance(sheet, (str, int)) else [*sheet]
    grids = [read_grid(source, one) for one in several] or [read_grid(source)]
    if len(grids) == 1:
        return _read_or_offer(grids[0], map or {}, how)
    refuse_other_columns(str(source), grids, map or {})
    for grid in grids:
        grid.source = f"{source}, sheet '{clipped(grid.sheet)}'"
    tables = [_read_or_offer(grid, map or {}, how) for grid in grids]
    return joined_sheets(str(source), [grid.sheet for grid in grids], tables)


def _read_or_offer(
    grid: Grid, mapping: Mapping[str, str], how: Mapping[str, Any]
) -> Measurements | ShearTests:
    """Read a grid, or refuse it with a line to paste where its headers are not understood."""
    try:
        return _read_grid(grid, mapping, **how)
    except MeasurementsError as error:
        given = [name for name in ("diameter", "width") if how[name] is not None]
        offer = offer_of(grid, mapping, given)
        if offer is None:
            raise
        raise MeasurementsError(f"{error}\n  {_offered(grid, offer, how)}") from None


def _offered(grid: Grid, offer: Offer, how: Mapping[str, Any]) -> str:
    """The line of an offer, and what is wrong all the same once it is pasted."""
    said = f"By units, values and near words the headers may be as below: look, and paste\n    {offer.text()}"
    try:
        _read_grid(grid, offer.mapping, **how)
    except MeasurementsError as error:
        left = str(error).removeprefix(f"{grid.source}, ").removeprefix(f"{grid.source}: ")
        return f"{said}\n    with it there is left: {left}"
    return said


def _read_grid(
    grid: Grid,
    mapping: Mapping[str, str],
    *,
    diameter: float | None,
    width: float | None,
    contact: str | None,
    compliance: float | None,
    shear: bool,
) -> Measurements | ShearTests:
    columns = read_columns(grid, mapping)
    if is_shear(columns):
        if shear:
            return shear_tests(columns)
        columns.add(_SHEAR)
        columns.raise_any()
    take_size(columns, "diameter", diameter)
    take_size(columns, "width", width)
    take_contact(columns, contact)
    take_plates(columns, compliance)
    _check_there(columns)
    _check_blanks(columns)
    _check_heights(columns)
    columns.raise_any()
    name_curves(columns)
    if (columns.contact != ROLLING).any():
        keep_rows_on_soil(columns, _runs(columns))
    return _measurements(columns)


def _measurements(columns: Columns) -> Measurements:
    """The table of columns in which nothing is wrong."""
    numbers, notes = columns.numbers, columns.notes
    sizes = {n: columns.values(n) for n in ("load", "diameter", "width")}
    channels = {name: numbers[name] for name in CHANNELS if name in numbers}
    declared = {n: numbers[f"{n}_std"] for n in CHANNELS if f"{n}_std" in numbers}
    for name in [name for name in declared if name not in channels]:
        notes.append(f"column '{name}_std' is left out: there is no '{name}'")
        del declared[name]
    covariates: dict[str, Array] = {}
    for name, values in numbers.items():
        if name in sizes or name.removesuffix("_std") in CHANNELS:
            continue
        holes = np.isnan(values) & (columns.contact == ROLLING)
        if holes.any():
            blank = columns.count(holes, "rolling rows")
            notes.append(f"column '{name}' is blank in {blank}: not used as a covariate")
        else:
            at_rest = _AT_REST.get(name, np.nan)
            covariates[name] = np.where(np.isnan(values), at_rest, values)
    texts, headings = columns.texts, columns.headings
    conditions = Conditions(
        **sizes, contact=columns.contact, soil=texts.get("soil"), covariates=covariates
    )
    runs_given = bool((texts.get("run", np.array([""])) != "").any())
    data = Measurements(
        conditions,
        channels,
        _runs(columns) if runs_given else np.full(columns.lines.size, ""),
        texts["wheel"] if "wheel" in texts else _wheels(conditions),
        columns.lines,
        declared,
        {name: text for name, text in texts.items() if name not in TEXTS},
        columns.units,
        runs_given,
        "wheel" in texts,
        source=columns.source,
        sha256=columns.sha256,
        written_units={n: h.unit for n, h in headings.items() if h.unit is not None},
        place=columns.place,
    )
    if not runs_given:
        data, found = _with_repeats(data, columns.place)
        notes.append(found)
    if data.responses:
        notes.append(_ANSWERS.format(", ".join(data.responses)))
    if one_row_a_wheel(data):
        notes.append(_VEHICLE)
    own = [heading.name for heading in headings.values() if heading.rank == UNKNOWN]
    for use, names in (
        ("columns of your own, used as covariates", set_columns(data)),
        ("order of the runs, for drifts", order_columns(data)),
    ):
        if listed := ", ".join([clipped(name) for name in own if name in names][:30]):
            columns.understood.append(f"{use}: {listed}")
    return replace(
        data,
        notes=tuple(notes),
        understood=tuple(columns.understood),
        warnings=(*columns.warnings, *suspicions(data, columns.place)),
    )


def _check_there(columns: Columns) -> None:
    """Add a problem for each column that there must be; a table of plates needs no width."""
    needed = ["load", "diameter", *(["width"] if np.any(columns.contact != PLATE) else [])]
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
    if not columns.found and not any(name in columns.numbers for name in CHANNELS):
        columns.add(f"nothing was measured: every cell of {', '.join(CHANNELS)} is blank")


def _check_blanks(columns: Columns) -> None:
    """Add a problem for cells that are blank where a value is needed."""

    def check(names: Sequence[str], needed: Mask, words: str) -> None:
        for name in names:
            blank = np.isnan(columns.values(name))
            if not blank.all():  # what is not there or wrong throughout is said elsewhere
                columns.problem(words, name, blank & needed & columns.sound(name))

    check(("load", "diameter"), np.ones(columns.lines.size, dtype=bool), _BLANK)
    check(("width",), columns.contact != PLATE, _BLANK)
    for name in ("soil", "wheel"):
        texts = columns.texts.get(name)
        if texts is not None and (texts == "").all():
            del columns.texts[name]
        elif texts is not None:
            columns.problem(f"{_BLANK}; merged cells have to be filled", name, texts == "")
    check(SETTINGS, columns.contact == ROLLING, _BLANK_ROLLING)


def _runs(columns: Columns) -> Texts:
    """Each row's run; a row that names none is a run of its own, named by its line."""
    run = columns.texts.get("run", np.full(columns.lines.size, ""))
    if (run != "").all():
        return run
    if (run != "").any():
        note = f"{(run == '').sum()} rows name no run: each counts as a run of its own"
        if note not in columns.notes:
            columns.notes.append(note)
    return np.where(run == "", _line_names(columns.place, columns.lines), run)


def _line_names(place: str, lines: NDArray[np.intp]) -> Texts:
    return np.char.add(f"{place} ", lines.astype(np.str_))


def _with_repeats(data: Measurements, place: str) -> tuple[Measurements, str]:
    """Name each row's run by the first row of its setting: repeats are no independent runs."""
    codes = setting_codes(data)
    # codes rise in the order in which they first appear
    first = np.flatnonzero(np.diff(np.maximum.accumulate(codes), prepend=-1))
    count = np.bincount(codes)
    rows, repeated = int(count[count > 1].sum()), int((count > 1).sum())
    repeats = f"{rows} of {len(data)} rows repeat {repeated} settings"
    found = repeats if rows else "no setting is repeated"
    return replace(data, run=_line_names(place, data.line[first])[codes]), (
        f"no column 'run': rows of one setting count as repeats of one run, each other row as a run "
        f"of its own; {found}. Say which belong together in that column"
    )


def _wheels(conditions: Conditions) -> Texts:
    """A name for each size of wheel."""
    # a pair of numbers as a complex one
    sizes, index = codes_of(conditions.diameter + 1j * np.nan_to_num(conditions.width))
    names = [
        f"{1e3 * s.real:.4g} mm" + (f" x {1e3 * s.imag:.4g} mm" if s.imag else "") for s in sizes
    ]
    return np.array(names, dtype=np.str_)[index]


def _check_heights(columns: Columns) -> None:
    """Add a problem for a wheel that is deeper than its axle, and for lugs higher than its radius.

    It carries by its lower half, so that is a mistake. A wheel dragged across its plane is ploughed
    in rather than rolled, and does get there: such rows are kept, marked by
    `Measurements.sunk_to_axle`.
    """
    d = columns.numbers.get("diameter")
    if d is None:
        return
    angle = columns.values("slip_angle", 0.0)
    rolled = (columns.contact != PLATE) & (np.abs(angle) <= _PLOUGHED)
    metres = columns.there("sinkage") and columns.headings["sinkage"].unit is None
    hint = "; without a unit it is metres: for mm the header is 'sinkage [mm]'" if metres else ""
    for name, where, words in (
        ("sinkage", rolled, f"half the diameter{hint}"),
        ("grouser_height", np.ones_like(rolled), "the wheel's radius: is the unit right?"),
    ):
        values = columns.values(name, 0.0)
        over = over_half(values, d) & where & columns.read(name)
        columns.outside(name, values, over, f"at most {0.5 * d[np.argmax(over)]:.6g} m, {words}")
