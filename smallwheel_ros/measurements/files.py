# SPDX-License-Identifier: Apache-2.0
"""From a path or a data frame to a grid of cells; the kind of a file is known by its content."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from smallwheel_ros.measurements.cells import EXPECTED, MOST_BYTES, SMALLER, Grid, MeasurementsError
from smallwheel_ros.measurements.text_grid import text_grid

if TYPE_CHECKING:
    import pandas as pd

_OTHERS = (
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF", "a PDF document"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook, or one with a password (save it as xlsx)"),
    (b"\x1f\x8b", "a gzip archive (unpack it first)"),
    (b"SQLite format 3", "a rosbag2 or SQLite file (for a bag: smallwheel replay)"),
    (b"#ROSBAG", "a ROS 1 bag (use smallwheel replay)"),
    (b"\x89MCAP", "an MCAP bag (use smallwheel replay)"),
    (b"\x89HDF", "an HDF5 file"),
)


def read_grid(source: str | Path | pd.DataFrame, sheet: str | int | None = None) -> Grid:
    """Read a CSV, Excel (xlsx), OpenDocument (ods) or Parquet file, or take a data frame.

    sheet: of a workbook, by name or number; without it the one sheet that has a table is read.
    Raises MeasurementsError where the file cannot be read, is of another kind, or is no table.
    """
    if not isinstance(source, (str, Path)):
        from smallwheel_ros.measurements.parquet import frame_grid

        if hasattr(source, "columns") and hasattr(source, "to_numpy"):
            return frame_grid(source)
        raise MeasurementsError(
            f"a {type(source).__name__} given, expected the path of a file or a pandas data frame"
        )
    name = str(source)
    data = _bytes(name)
    digest = hashlib.sha256(data).hexdigest()
    if data.startswith(b"PK\x03\x04"):
        from smallwheel_ros.measurements.workbook import workbook_grid

        return workbook_grid(data, name, digest, None if sheet is None else str(sheet))
    if sheet is not None:
        raise MeasurementsError(f"{name}: sheet '{sheet}' asked for, but this is no workbook")
    if kind := next((kind for magic, kind in _OTHERS if data.startswith(magic)), ""):
        raise MeasurementsError(f"{name}: this is {kind}, {EXPECTED}")
    if data.startswith(b"PAR1"):
        from smallwheel_ros.measurements.parquet import parquet_grid

        return parquet_grid(data, name, digest)
    return text_grid(data, name, digest)


def _bytes(source: str) -> bytes:
    """Give what is in a regular file, and no more of it than a table may have."""
    try:
        # Without waiting: a pipe that nobody writes to would never open.
        descriptor = os.open(source, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(descriptor, "rb") as file:
            mode = os.fstat(descriptor).st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise MeasurementsError(
                    f"{source}: a pipe or device, {EXPECTED}: save the table to a file first"
                )
            data = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise MeasurementsError(f"{source}: no such file") from None
    except IsADirectoryError:
        raise MeasurementsError(f"{source}: a folder, {EXPECTED}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise MeasurementsError(f"{source}: cannot be read: {reason}") from None
    if len(data) > MOST_BYTES:
        limit = f"{MOST_BYTES // 2**20} MiB"
        raise MeasurementsError(f"{source}: more than {limit}, expected at most that: {SMALLER}")
    return data
