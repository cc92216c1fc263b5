# SPDX-License-Identifier: Apache-2.0
"""Several sheets of a workbook as one table: the same columns, one row after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from smallwheel_ros.measurements.cells import Grid, MeasurementsError, clipped
from smallwheel_ros.measurements.layout import listed
from smallwheel_ros.measurements.reading import Columns, read_columns
from smallwheel_ros.measurements.shear import ShearTests, joined_shear
from smallwheel_ros.measurements.table import Measurements, joined
from smallwheel_ros.measurements.words import UNKNOWN


def refuse_other_columns(path: str, grids: Sequence[Grid], mapping: Mapping[str, str]) -> None:
    """Refuse sheets of different columns, and a sheet that was asked for twice. Raises MeasurementsError."""
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


def _quantities(columns: Columns) -> set[str]:
    """Columns by our names; a remark of one's own may stand on one sheet only."""
    headings = columns.headings
    return {n for n in headings if headings[n].rank != UNKNOWN or n not in columns.texts}


def joined_sheets(
    path: str, sheets: Sequence[str], tables: Sequence[Measurements | ShearTests]
) -> Measurements | ShearTests:
    """The rows of several sheets, in order. Runs of one name on two sheets are different runs."""
    called = " and ".join(f"'{clipped(sheet)}'" for sheet in sheets)
    understood = [f"rows of the sheets {called}, one after the other"]
    warnings = []
    for sheet, table in zip(sheets, tables, strict=True):
        understood += [f"sheet '{clipped(sheet)}': {line}" for line in table.understood]
        warnings += [f"sheet '{clipped(sheet)}': {line}" for line in getattr(table, "warnings", ())]
    # the source tells their runs apart
    named = [replace(table, source=sheet) for sheet, table in zip(sheets, tables, strict=True)]
    wheels = [table for table in named if isinstance(table, Measurements)]
    shear = [table for table in named if isinstance(table, ShearTests)]
    if wheels and shear:
        raise MeasurementsError(
            f"{path}: of the sheets {called} some are shear tests, and some are not"
        )
    found = joined_shear(shear) if shear else replace(joined(wheels), warnings=tuple(warnings))
    if found.run[0] != tables[0].run[0]:
        understood.append(
            "runs of one name on two sheets are different runs, with the sheet before the name: "
            f"'{tables[0].run[0]}' is '{found.run[0]}'"
        )
    return replace(found, understood=tuple(understood), source=path, sha256=tables[0].sha256)
