# SPDX-License-Identifier: Apache-2.0
"""The results of many bags as one: tables and a summary."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from smallwheel_ros.output import write_bytes
from smallwheel_ros.replay.estimates import columns
from smallwheel_ros.replay.folder import ESTIMATES, FILES, MEASUREMENTS, files_in
from smallwheel_ros.replay.many import Outcome
from smallwheel_ros.replay.result import SCHEMA
from smallwheel_ros.replay.table import csv_text, table
from smallwheel_ros.tables import text_table


def _rows(path: Path) -> Iterator[dict[str, str]]:
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            yield from csv.DictReader(file)


def merge(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Put estimates and measurements of all bags into one table each; return the files' names.

    Estimates get a column `bag`; runs and soils of the measurements begin with the bag's name,
    since no two drives share them.

    Raises
    ------
    ReplayError, OutputError
        If a table cannot be written.
    """
    with table(folder / ESTIMATES, {"bag": "string", **columns()}) as add:
        for outcome in outcomes:
            for row in _rows(outcome.spec.folder / FILES["estimates_csv"]):
                add([outcome.spec.name, *row.values()])
    measured: list[dict[str, str]] = []
    for outcome in outcomes:
        name = outcome.spec.name
        for row in _rows(outcome.spec.folder / MEASUREMENTS):
            measured.append({**row, "soil": f"{name} {row['soil']}", "run": f"{name} {row['run']}"})
    (folder / MEASUREMENTS).unlink(missing_ok=True)
    if measured:
        text = csv_text([measured[0], *(row.values() for row in measured)])
        write_bytes(folder / MEASUREMENTS, text.encode())
    merged = ("estimates_csv", "estimates_parquet", "measurements")
    return {what: name for what, name in files_in(folder).items() if what in merged}


def many_document(outcomes: Sequence[Outcome], files: dict[str, str]) -> dict[str, Any]:
    """Return what became of all bags as plain values; files: of the merged tables."""
    bags = [
        {
            "bag": str(outcome.spec.bag),
            "folder": str(outcome.spec.folder),
            "state": outcome.state,
            "error": outcome.error,
            "done_before": outcome.before,
            "summary": outcome.summary or None,
        }
        for outcome in outcomes
    ]
    return {"schema": SCHEMA, "bags": bags, "files": files}


def many_text(outcomes: Sequence[Outcome]) -> str:
    """Say what became of each bag, a line for each."""
    rows = []
    for outcome in outcomes:
        state = outcome.state.replace("_", " ") + (" (before)" if outcome.before else "")
        found = ["-"] * 4
        if outcome.summary:
            soil = outcome.summary["soil"]
            pressure = soil["reference_pressure"]
            found = [
                f"{outcome.summary['travel']:.1f}",
                str(outcome.summary["estimates"]),
                str(soil["changes"]),
                f"{pressure['value'] / 1e3:.3g} +- {pressure['std'] / 1e3:.2g}",
            ]
        rows.append([outcome.spec.name, state, *found])
    header = ["bag", "", "way [m]", "estimates", "soil changes", "reference pressure [kPa]"]
    lines = [text_table(header, rows)]
    lines += [f"{outcome.spec.name}: {outcome.error}" for outcome in outcomes if outcome.error]
    return "\n".join(lines)
