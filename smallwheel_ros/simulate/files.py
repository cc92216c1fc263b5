# SPDX-License-Identifier: Apache-2.0
"""Write files whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from smallwheel_ros.common.files import OutputError
from smallwheel_ros.common.files import write_whole as write_in_one_step
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


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` make a file beside `path`, then put it there in one step.

    Raises
    ------
    SimulationError
        If the file cannot be written; what was at `path` is still there then.
    """
    check_folder(path)
    try:
        write_in_one_step(path, write)
    except OutputError as error:
        raise SimulationError(str(error)) from error


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON, refusing numbers that are not finite."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"

    def write(part: Path) -> None:
        part.write_text(text, encoding="utf-8")

    write_whole(path, write)


def write_table(table: pd.DataFrame, path: Path | str) -> None:
    """Write a table as CSV or Parquet, by its suffix, whole or not at all.

    Raises
    ------
    SimulationError
        If the suffix is another one or the file cannot be written.
    """
    path = check_suffix(Path(path))

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


def check_suffix(path: Path) -> Path:
    """Return the path; raise `SimulationError` unless it is that of a table."""
    if path.suffix not in SUFFIXES:
        raise SimulationError(
            f"cannot write {path}: the suffix {path.suffix!r} is not {' or '.join(SUFFIXES)}"
        )
    return path
