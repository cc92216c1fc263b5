# SPDX-License-Identifier: Apache-2.0
"""Write tables and answers, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from smallwheel_ros.common.files import json_text, write_bytes, write_whole
from smallwheel_ros.simulate.truth import SimulationError

SUFFIXES = (".csv", ".parquet")


def check_folder(path: Path) -> Path:
    """Return the path of a file; raise `SimulationError` unless a file can be put there."""
    if not path.parent.is_dir():
        raise SimulationError(
            f"cannot write {path}: the folder {path.parent} does not exist; make it first"
        )
    if path.is_dir():
        raise SimulationError(f"cannot write {path}: it is a folder; give the name of a file")
    return path


def check_suffix(path: Path) -> Path:
    """Return the path; raise `SimulationError` unless it is that of a table."""
    if path.suffix not in SUFFIXES:
        raise SimulationError(
            f"cannot write {path}: the suffix {path.suffix!r} is not {' or '.join(SUFFIXES)}"
        )
    return path


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON, refusing numbers that are not finite. Raises SimulationError, OutputError."""
    write_bytes(check_folder(path), json_text(content).encode())


def write_table(table: pd.DataFrame, path: Path | str) -> None:
    """Write a table as CSV or Parquet, by its suffix, whole or not at all.

    Raises
    ------
    SimulationError, OutputError
        If the suffix is another one or the file cannot be written.
    """
    path = check_folder(check_suffix(Path(path)))

    def write(part: Path) -> None:
        if path.suffix == ".csv":
            table.to_csv(part, index=False, lineterminator="\n")
            return
        try:
            table.to_parquet(part, index=False, engine="pyarrow")
        except ImportError as error:
            raise SimulationError(
                f"cannot write {path}: Parquet needs pyarrow; install smallwheel_ros[parquet], or"
                " write .csv"
            ) from error

    write_whole(path, write)
