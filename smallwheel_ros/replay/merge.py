"""The results of many bags as one: tables and a summary."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from smallwheel_ros.output import write_bytes
from smallwheel_ros.replay.document import SCHEMA
from smallwheel_ros.replay.many import Outcome
from smallwheel_ros.replay.output_paths import ESTIMATES, MEASUREMENTS, csv_text
from smallwheel_ros.replay.rows import Kind, columns
from smallwheel_ros.replay.table_files import TableFiles
from smallwheel_ros.tables import plain, text_table


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
    files: dict[str, str] = {}
    kinds: dict[str, Kind] = {"bag": "text", **columns()}
    with TableFiles(folder / ESTIMATES, kinds) as table:
        for outcome in outcomes:
            for row in _rows(outcome.spec.folder / f"{ESTIMATES}.csv"):
                table.add({"bag": outcome.spec.name, **row})
    files["estimates_csv"] = f"{ESTIMATES}.csv"
    if (folder / f"{ESTIMATES}.parquet").exists():
        files["estimates_parquet"] = f"{ESTIMATES}.parquet"
    measured: list[dict[str, str]] = []
    for outcome in outcomes:
        for row in _rows(outcome.spec.folder / MEASUREMENTS):
            name = outcome.spec.name
            measured.append({**row, "soil": f"{name} {row['soil']}", "run": f"{name} {row['run']}"})
    if measured:
        text = csv_text(measured[0], measured)
        write_bytes(folder / MEASUREMENTS, text.encode())
        files["measurements"] = MEASUREMENTS
    return files


def many_document(outcomes: Sequence[Outcome], files: dict[str, str]) -> dict[str, Any]:
    """Return what became of all bags as plain values; files: of the merged tables."""
    content = {
        "schema": SCHEMA,
        "bags": [
            {
                "bag": str(outcome.spec.bag),
                "folder": str(outcome.spec.folder),
                "state": outcome.state,
                "error": outcome.error,
                "done_before": outcome.before,
                "summary": outcome.summary or None,
            }
            for outcome in outcomes
        ],
        "files": files,
    }
    found = plain(content)
    assert isinstance(found, dict)
    return found


def many_text(outcomes: Sequence[Outcome]) -> str:
    """Say what became of each bag, a line for each."""
    rows = []
    for outcome in outcomes:
        summary = outcome.summary
        pressure = summary.get("soil", {}).get("reference_pressure", {})
        rows.append(
            [
                outcome.spec.name,
                outcome.state.replace("_", " ") + (" (before)" if outcome.before else ""),
                f"{summary['travel']:.1f}" if summary else "-",
                str(summary["estimates"]) if summary else "-",
                str(summary["soil"]["changes"]) if summary else "-",
                f"{pressure['value'] / 1e3:.3g} +- {pressure['std'] / 1e3:.2g}"
                if pressure
                else "-",
            ]
        )
    header = ["bag", "", "way [m]", "estimates", "soil changes", "reference pressure [kPa]"]
    lines = [text_table(header, rows)]
    lines += [
        f"{outcome.spec.name}: {outcome.error}"
        for outcome in outcomes
        if outcome.error and outcome.state in ("failed", "ended_early", "interrupted")
    ]
    return "\n".join(lines)
