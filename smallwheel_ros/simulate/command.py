# SPDX-License-Identifier: Apache-2.0
"""The command `smallwheel simulate`: thin shells over `simulate_drive` and `simulate_rig`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from smallwheel_ros.bags import STORAGES, Storage, check_new_bag
from smallwheel_ros.common.console import JSON, tell
from smallwheel_ros.common.files import check_targets, json_text, write_bytes
from smallwheel_ros.simulate.drive import simulate_drive
from smallwheel_ros.simulate.drive_bag import write_drive_bag
from smallwheel_ros.simulate.options import Command, settings_options
from smallwheel_ros.simulate.rig import check_suffix, simulate_rig, write_table
from smallwheel_ros.simulate.settings import DriveSettings, RigSettings

_FIRST = ("hidden", "seed", "strength")  # options of both drive and rig
_ANSWER = click.option(
    "--answer",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File for the truth (JSON).  [default: the output's name + .answer.json]",
)


def _output(metavar: str, text: str) -> Callable[[Command], Command]:
    path = click.Path(path_type=Path)
    return click.option("-o", "--output", type=path, required=True, metavar=metavar, help=text)


def _answer_of(output: Path, answer: Path | None, json_file: str | None) -> Path:
    """Path of the file for the truth. Checks that it and the other files can be written, before the work."""
    answer = output.with_name(f"{output.name}.answer.json") if answer is None else answer
    check_targets([output, answer, json_file])
    return answer


@click.group()
def simulate() -> None:
    """Make data or a bag from the truth simulator."""


@simulate.command()
@_output("BAG", "Folder for the bag; it must not exist.")
@settings_options(DriveSettings, _FIRST)
@click.option("--storage", type=click.Choice(STORAGES), default="mcap", show_default=True)
@_ANSWER
@JSON
def drive(
    output: Path, storage: Storage, answer: Path | None, json_file: str | None, **settings: Any
) -> None:
    """Make a rosbag2 bag of a small rover's drive."""
    check_new_bag(output)
    answer = _answer_of(output, answer, json_file)
    made = simulate_drive(DriveSettings(**settings))
    count = write_drive_bag(made, output, storage=storage)
    write_bytes(answer, json_text(made.answer()).encode())
    duration, way = (float(x[-1]) for x in (made.truth.time, made.truth.path))
    wheels = [wheel.name for wheel in made.rover.wheels]
    summary = {
        "bag": str(output),
        "answer": str(answer),
        "messages": count,
        "duration": duration,
        "distance": way,
        "wheels": wheels,
    }
    text = f"{output}: {count} messages, {duration:.0f} s, {way:.1f} m, {len(wheels)} wheels"
    tell(summary, f"{text}\n{answer}: the truth", json_file)


@simulate.command()
@_output("FILE", "Table to write, .csv or .parquet; one that exists is replaced.")
@settings_options(RigSettings, _FIRST)
@_ANSWER
@JSON
def rig(output: Path, answer: Path | None, json_file: str | None, **settings: Any) -> None:
    """Make a table of single-wheel measurements."""
    check_suffix(output)
    answer = _answer_of(output, answer, json_file)
    made = simulate_rig(RigSettings(**settings))
    write_table(made.table, output)
    write_bytes(answer, json_text(made.truth.answer()).encode())
    runs, rows = made.truth.settings.runs, len(made.table)
    summary = {
        "table": str(output),
        "answer": str(answer),
        "runs": runs,
        "rows": rows,
        "columns": list(made.table.columns),
    }
    text = f"{output}: {runs} runs, {rows} rows\n{answer}: the truth"
    tell(summary, text, json_file)
