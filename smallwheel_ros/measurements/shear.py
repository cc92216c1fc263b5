# SPDX-License-Identifier: Apache-2.0
"""Shear tests as they were measured: an annulus or plate turned or dragged under one normal stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.columns import LAB_COLUMNS, Array, Mask, Texts
from smallwheel_ros.measurements.reading import Columns
from smallwheel_ros.measurements.settings import curves_of_rows
from smallwheel_ros.measurements.table import joined_rows


@dataclass(frozen=True)
class ShearTests:
    """Rows of shear tests; SI units, arrays of shape (rows,).

    normal_stress, shear_stress: Pa. displacement: j of the soil at the annulus's middle radius or under
    the plate, m. run: one test, a curve at one normal stress. soil: "" where the table names none.
    line: of the file.
    """

    normal_stress: Array
    shear_stress: Array
    displacement: Array
    run: Texts
    soil: Texts
    line: NDArray[np.intp]
    notes: tuple[str, ...] = ()
    understood: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""

    def __len__(self) -> int:
        return int(self.displacement.size)

    def take(self, rows: Mask) -> ShearTests:
        """Keep the rows of that mask."""
        arrays = ("normal_stress", "shear_stress", "displacement", "run", "soil", "line")
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})


def joined_shear(tables: Sequence[ShearTests]) -> ShearTests:
    """The rows of several tables of shear tests, in order."""
    if len(tables) == 1:
        return tables[0]
    names = ("normal_stress", "shear_stress", "displacement", "soil")
    found = {name: np.concatenate([getattr(t, name) for t in tables]) for name in names}
    notes = tuple(note for table in tables for note in table.notes)
    return replace(tables[0], **joined_rows(tables), **found, notes=notes)


_NEEDED = ("normal_stress", "shear_stress", "shear_displacement")
_NEW_STRESS = 0.10  # of the normal stress: a change that begins another test


def is_shear(columns: Columns) -> bool:
    """Whether a table is one of shear tests: it has a shear stress, and no load beside a sinkage."""
    wheels = columns.there("load") and columns.there("sinkage")
    return "shear_stress" in columns.headings and not wheels


def shear_tests(columns: Columns) -> ShearTests:
    """The shear tests in the columns of a table.

    Raises MeasurementsError that lists everything that is wrong.
    """
    columns.lacking(
        f"no column '{name}' ({LAB_COLUMNS[name].description})"
        for name in _NEEDED
        if name not in columns.headings
    )
    columns.raise_any()
    for name in (n for n in _NEEDED if n not in columns.numbers):
        columns.problem("the whole column is blank", name)
    columns.raise_any()
    sigma = columns.numbers["normal_stress"]
    columns.outside("normal_stress", sigma, sigma <= 0.0, "over 0")
    columns.raise_any()
    blank = np.any([np.isnan(columns.numbers[name]) for name in _NEEDED], axis=0)
    if blank.any():
        columns.understood.append(f"{int(blank.sum())} rows with a blank cell are left out")
        columns.keep(~blank)
    sigma, stress, j = (columns.numbers[name] for name in _NEEDED)
    soil = columns.texts.get("soil", np.full(sigma.size, ""))
    run = _runs(columns, sigma, j, soil)
    said = tuple(columns.notes), tuple(columns.understood)
    return ShearTests(
        sigma, stress, j, run, soil, columns.lines, *said, columns.source, columns.sha256
    )


def _runs(columns: Columns, sigma: Array, j: Array, soil: Texts) -> Texts:
    named = columns.texts.get("run")
    if named is not None and (named != "").all():
        return named

    def other(first: int, row: int) -> bool:
        new_stress = abs(sigma[row] - sigma[first]) > _NEW_STRESS * sigma[first]
        return bool(new_stress or soil[row] != soil[first])

    run = curves_of_rows([j], other)
    columns.understood.append(
        f"no column 'run': {int(run[-1]) + 1} tests, each begins where the normal stress changes or the "
        "displacement begins anew"
    )
    return np.array([f"test {i + 1}" for i in run])
