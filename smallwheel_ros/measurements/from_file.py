# SPDX-License-Identifier: Apache-2.0
"""The one reader of measurements of wheels, and of plates, whatever table they come in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import CellGrid, MeasurementsError, clipped, map_option
from smallwheel_ros.measurements.columns import CHANNELS, COLUMNS, SETTINGS, TEXTS, Mask, Texts
from smallwheel_ros.measurements.copies import without_copies
from smallwheel_ros.measurements.files import read_grid
from smallwheel_ros.measurements.headers import UNKNOWN, meant, tokens_of
from smallwheel_ros.measurements.lab import (
    keep_rows_on_soil,
    name_curves,
    shear_tests,
    take_contact,
    take_plates,
)
from smallwheel_ros.measurements.layout import one_row_a_reading
from smallwheel_ros.measurements.measurements import (
    Measurements,
    ShearTests,
    codes_of,
    joined,
    joined_shear,
    over_half,
)
from smallwheel_ros.measurements.reading import (
    TableColumns,
    listed,
    read_columns,
    take_size,
    weigh,
)
from smallwheel_ros.measurements.settings import (
    one_row_a_wheel,
    order_columns,
    set_columns,
    setting_codes,
)
from smallwheel_ros.measurements.suspicions import SHARES, order_followed, suspicions
from smallwheel_ros.physics.conditions import PLATE, ROLLING, Array, Conditions

if TYPE_CHECKING:
    import pandas as pd

# Settings of a rolling wheel, for a body that is pressed straight down.
_AT_REST = {"slip": 0.0, "slip_angle": 0.0, "slope": 0.0, "pass_number": 1.0}
# A wheel that moves more across its plane than along it is ploughed, not rolled.
_PLOUGHED = np.pi / 4
_VEHICLE = (
    "each run has one row of each of several wheels: they count as wheels of one vehicle at one "
    "place. If runs are numbered anew for each wheel, give each a name of its own"
)

_SHEAR = (
    "a table of shear tests: they are fitted by `smallwheel fit`, together with a table of load and sinkage "
    "or with --model"
)
_BLANK = "the cell is blank, expected a value"
_BLANK_ROLLING = (
    "the cell is blank in a rolling row, expected a value (a whole column may be left out, and a "
    "pressed or plate row may leave it blank)"
)
_ANSWERS = "taken as responses of the wheel, not settings: {}"


def read_measurements(source: str | Path | pd.DataFrame, **how: Any) -> Measurements:
    """Read a table of wheels and plates in SI units; MeasurementsError for one of shear tests.

    Parameters
    ----------
    source, how
        See `read_tests`.
    """
    found = read_tests(source, shear=False, **how)
    assert isinstance(found, Measurements)
    return found


def read_conditions(source: str | Path | pd.DataFrame, **how: Any) -> Measurements:
    """Read a table of settings to be predicted: it needs no measurements, and no row is left out.

    Parameters
    ----------
    source, how
        See `read_tests`.
    """
    found = read_tests(source, shear=False, every_row=True, **how)
    assert isinstance(found, Measurements)
    return found


def read_tests(
    source: str | Path | pd.DataFrame,
    *,
    map: Mapping[str, str] | None = None,
    sheet: str | int | Sequence[str | int] | None = None,
    **how: Any,
) -> Measurements | ShearTests:
    """Read a table of measurements, and convert it to SI units.

    Parameters
    ----------
    source
        A CSV, xlsx, xls, ods or Parquet file, or a pandas data frame.
    map, sheet
        See `api.read.read`.
    how
        diameter, width (m), contact and compliance (m/N) as in `api.read.read`. shear (True): whether a
        table of shear tests is allowed. every_row (False): whether a table needs no measurements, and
        keeps copies and rows in which a plate does not press on the soil.

    Returns
    -------
    Measurements or ShearTests
        Shear tests if the table has a column of shear stress, and not both load and sinkage.

    Raises
    ------
    MeasurementsError
        Lists all problems: file, row, column, what was found, what was expected, what to do.
    """
    one = sheet is None or isinstance(sheet, (str, int))
    several: Sequence[Any] = [sheet] if one else list(sheet or ()) or [None]  # type: ignore[arg-type]
    grids = [read_grid(source, name) for name in several]
    if len(grids) == 1:
        return _read_grid(grids[0], map or {}, **how)
    for grid in grids:
        grid.source = f"{source}, sheet '{clipped(grid.sheet)}'"
    _refuse_other_columns(str(source), grids, map or {})
    tables = [_read_grid(grid, map or {}, **how) for grid in grids]
    return _joined_sheets(str(source), [clipped(grid.sheet) for grid in grids], tables)


def _refuse_other_columns(path: str, grids: Sequence[CellGrid], mapping: Mapping[str, str]) -> None:
    """Raise MeasurementsError if sheets have different columns, or one sheet was asked for twice."""
    names = [clipped(grid.sheet) for grid in grids]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise MeasurementsError(f"{path}: sheet '{twice}' is given twice")
    first, *others = [_quantities(read_columns(grid, mapping)) for grid in grids]
    for name, quantities in zip(names[1:], others, strict=True):
        own = [(names[0], first - quantities), (name, quantities - first)]
        only = [f"only '{n}' has {listed(sorted(lacks))}" for n, lacks in own if lacks]
        if only:
            key = "run" if "run" in first & quantities else "row"
            raise MeasurementsError(
                f"{path}: sheets '{names[0]}' and '{name}' have different columns: {'; '.join(only)}. "
                "Expected the same columns on each, as their rows are put one after the other. Columns of "
                f"one {key} that stand on several sheets have to be brought side by side in one sheet "
                "first, in a spreadsheet with XLOOKUP or VLOOKUP"
            )


def _quantities(columns: TableColumns) -> set[str]:
    """Our names of the columns, but for unknown columns of texts, which one sheet alone may have."""
    headings = columns.headings
    return {n for n in headings if headings[n].rank != UNKNOWN or n not in columns.texts}


def _joined_sheets(
    path: str, sheets: Sequence[str], tables: Sequence[Measurements | ShearTests]
) -> Measurements | ShearTests:
    """Join the tables of several sheets, in order. Runs of one name on two sheets stay different runs."""
    called = " and ".join(f"'{sheet}'" for sheet in sheets)
    # the source tells their runs apart
    named = [replace(table, source=sheet) for sheet, table in zip(sheets, tables, strict=True)]
    wheels = [table for table in named if isinstance(table, Measurements)]
    shear = [table for table in named if isinstance(table, ShearTests)]
    if wheels and shear:
        raise MeasurementsError(
            f"{path}: of the sheets {called} some are shear tests, and some are not"
        )
    warnings = []
    understood = [f"rows of the sheets {called}, one after the other"]
    for sheet, table in zip(sheets, tables, strict=True):
        understood += [f"sheet '{sheet}': {line}" for line in table.understood]
        warnings += [f"sheet '{sheet}': {line}" for line in getattr(table, "warnings", ())]
    found = joined_shear(shear) if shear else replace(joined(wheels), warnings=tuple(warnings))
    if found.run[0] != tables[0].run[0]:
        understood.append(
            "runs of one name on two sheets are different runs, with the sheet before the name: "
            f"'{tables[0].run[0]}' is '{found.run[0]}'"
        )
    return replace(found, understood=tuple(understood), source=path, sha256=tables[0].sha256)


def _read_grid(
    grid: CellGrid,
    mapping: Mapping[str, str],
    *,
    diameter: float | None = None,
    width: float | None = None,
    contact: str | None = None,
    compliance: float | None = None,
    shear: bool = True,
    every_row: bool = False,
) -> Measurements | ShearTests:
    columns = read_columns(grid, mapping)
    of_wheels = columns.there("load") and columns.there("sinkage")
    if "shear_stress" in columns.headings and not of_wheels:
        if shear:
            return shear_tests(columns)
        columns.add(_SHEAR)
        columns.raise_any()
    for name, size in (("diameter", diameter), ("width", width)):
        if size is not None:
            take_size(columns, name, size)
    weigh(columns)
    take_contact(columns, contact)
    take_plates(columns, compliance)
    _check_there(columns, measured=not every_row)
    _check_blanks(columns)
    _check_heights(columns)
    if grid.shares:
        _check_shares(columns)
    columns.raise_any()
    if (columns.contact != ROLLING).all():
        name_curves(columns)
    if (columns.contact != ROLLING).any() and not every_row:
        keep_rows_on_soil(columns, _runs(columns))
    return _measurements(columns, every_row)


def _measurements(columns: TableColumns, every_row: bool) -> Measurements:
    """The table of columns that have no problem. every_row: whether copies of runs are kept."""
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
    data, copies = (data, "") if every_row else without_copies(data)
    if data.responses:
        notes.append(_ANSWERS.format(", ".join(data.responses)))
    if one_row_a_wheel(data):
        notes.append(_VEHICLE)
    if followed := order_followed(data):
        notes.append(followed)
    own = [heading.name for heading in headings.values() if heading.rank == UNKNOWN]
    for use, names in (
        ("columns of your own, used as covariates", set_columns(data)),
        ("order of the runs, for drifts", order_columns(data)),
    ):
        if listed := ", ".join([clipped(name) for name in own if name in names][:30]):
            columns.understood.append(f"{use}: {listed}")
    kept, there = len(data), columns.rows_there
    first = [f"{kept} of {there} rows kept"] if kept < there else []
    return replace(
        data,
        notes=tuple(notes),
        understood=(*first, *columns.understood),
        warnings=(*columns.warnings, *([copies] if copies else []), *suspicions(data)),
    )


def _check_there(columns: TableColumns, measured: bool) -> None:
    """Add a problem for each required column that is absent; a table of plates needs no width.

    measured: whether the table must have a channel.
    """
    needed = ["load", "diameter", *(["width"] if np.any(columns.contact != PLATE) else [])]
    nearly = {meant(heading) for heading in columns.headings.values() if heading.rank == UNKNOWN}
    lacking = [
        f"no column '{name}' ({COLUMNS[name].description})"
        + ("" if name == "load" else f" and no {name} given for all rows (--{name})")
        + ("; plates have none: say contact = plate (--contact plate)" if name == "width" else "")
        for name in needed
        if not columns.there(name) and name not in nearly
    ]
    if measured and not any(name in columns.headings or name in nearly for name in CHANNELS):
        wanted = ", ".join(CHANNELS)
        lacking.append(f"nothing was measured: expected at least one column of {wanted}")
        lacking[-1] += _several(columns)
    numeric = [name for name in columns.numbers if name in columns.headings]
    texts = {name: cells.tolist() for name, cells in columns.texts.items()}
    reading = one_row_a_reading(columns.headings, texts, numeric) if lacking else ""
    if reading:
        columns.add(reading)
    elif lacking:
        columns.lacking(lacking)
    if measured and not columns.found and not any(n in columns.numbers for n in CHANNELS):
        columns.add(f"nothing was measured: every cell of {', '.join(CHANNELS)} is blank")


def _several(columns: TableColumns) -> str:
    """Words on what to do if several columns may be one channel, as of gauges on both sides of a wheel."""
    for name in CHANNELS:
        headings = columns.headings.values()
        own = [h for h in headings if name in tokens_of(f"{h.text} {h.name}".lower())]
        if len(own) > 1:
            # Volts or counts beside newton metres are one gauge twice.
            texts = [h.text for h in own]
            twice = any(a != b and b.startswith(a) for a in texts for b in texts)
            alike = len({h.unit for h in own}) == 1 and not twice
            mean = f"their mean is one {name}, or say" if alike else "say"
            return f". {listed(texts)}: {mean} which is it with {map_option(name, own[0].text)}"
    return ""


def _check_blanks(columns: TableColumns) -> None:
    """Add a problem for cells that are blank where a value is needed."""

    def check(names: Sequence[str], needed: Mask, words: str) -> None:
        """Add a problem in these words for each of the columns that is blank in a needed row."""
        for name in names:
            blank = np.isnan(columns.values(name))
            rows = blank & needed & columns.sound(name)
            if rows.any() and not blank.all():  # all of them: reported elsewhere
                columns.problem(words, name, rows)

    check(("load", "diameter"), np.ones(columns.lines.size, dtype=bool), _BLANK)
    check(("width",), columns.contact != PLATE, _BLANK)
    for name in ("soil", "wheel"):
        texts = columns.texts.get(name)
        if texts is not None and (texts == "").all():
            del columns.texts[name]
        elif texts is not None and (texts == "").any():
            columns.problem(f"{_BLANK}; merged cells have to be filled", name, texts == "")
    check(SETTINGS, columns.contact == ROLLING, _BLANK_ROLLING)


def _runs(columns: TableColumns) -> Texts:
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
    """Name each row's run by the first row of its setting: repeats are no independent runs.

    Returns the table, and a note about the repeats.
    """
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
    """A name for each row's wheel, made from its size, shape (rows,)."""
    # a pair of numbers as a complex one
    sizes, index = codes_of(conditions.diameter + 1j * np.nan_to_num(conditions.width))
    names = [
        f"{1e3 * s.real:.4g} mm" + (f" x {1e3 * s.imag:.4g} mm" if s.imag else "") for s in sizes
    ]
    return np.array(names, dtype=np.str_)[index]


def _check_heights(columns: TableColumns) -> None:
    """Add a problem for a wheel that is deeper than its axle, and for lugs higher than its radius.

    A wheel that rolls is carried by its lower half, so a deeper one is a mistake. A wheel that is dragged
    across its plane does plough itself in so deep: such rows are kept, marked by `Measurements.sunk_to_axle`.
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
        if over.any():
            columns.outside(
                name, values, over, f"at most {0.5 * d[np.argmax(over)]:.6g} m, {words}"
            )


def _check_shares(columns: TableColumns) -> None:
    """Add a problem if a column in % has no value over 1 %: its cells may be shares shown in per cent.

    Only for workbooks in which such cells cannot be told from others.
    """
    for name, heading in columns.headings.items():
        most = float(np.nanmax(np.abs(columns.values(name)), initial=0.0))
        if heading.unit == "%" and 0.0 < most <= SHARES:
            columns.problem(
                f"{name} is {100.0 * most:.3g} % at most: are these shares, shown in per cent? Then the "
                f"header is '{name}', without a unit",
                name,
            )
