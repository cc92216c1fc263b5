# SPDX-License-Identifier: Apache-2.0
"""A file of any test of a lab: what its columns are says which."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from smallwheel_ros.measurements.files import read_grid
from smallwheel_ros.measurements.reading import read_columns
from smallwheel_ros.measurements.shear import ShearTests, is_shear, shear_tests
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.wheels import measurements_of

if TYPE_CHECKING:
    import pandas as pd


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
    """Read a table of wheels and plates, as `read_measurements`, or one of shear tests.

    Raises MeasurementsError that lists everything that is wrong.
    """
    grid = read_grid(source, None if sheet is None else str(sheet))
    columns = read_columns(grid, map or {})
    if is_shear(columns):
        return shear_tests(columns)
    return measurements_of(columns, diameter, width, contact, compliance)
