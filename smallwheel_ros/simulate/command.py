# SPDX-License-Identifier: Apache-2.0
"""The command `smallwheel simulate`: thin shells over `simulate_drive` and `simulate_rig`."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from smallwheel_ros.bags.files import STORAGES, Storage, check_new_bag
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.simulate.drive import DriveSettings, simulate_drive
from smallwheel_ros.simulate.drive_bag import write_drive_bag
from smallwheel_ros.simulate.files import check_folder, check_suffix, write_json, write_table
from smallwheel_ros.simulate.hidden import hidden_names
from smallwheel_ros.simulate.hidden_effects import FORMS, Form
from smallwheel_ros.simulate.rig import (
    CHANNELS,
    RigSettings,
    simulate_rig,
)
from smallwheel_ros.simulate.rig_design import CONTINUOUS
from smallwheel_ros.simulate.rover import ROVERS
from smallwheel_ros.simulate.terrain import FINISHES, TERRAINS
from smallwheel_ros.simulate.truth import SimulationError

Command = TypeVar("Command", bound=Callable[..., Any])


def _names(_context: click.Context, _option: click.Parameter, text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


class _BadInput(click.ClickException):
    exit_code = 2


def _one_message(command: Command) -> Command:
    """Turn the package's own errors into one line on stderr and exit code 2."""

    @wraps(command)
    def guarded(*args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        except SmallwheelError as error:
            raise _BadInput(str(error)) from error

    return cast(Command, guarded)


def _hidden_options(command: Command) -> Command:
    for option in (
        click.option(
            "--form",
            type=click.Choice(FORMS),
            default="own",
            show_default=True,
            help="Form of the hidden effects: the simulator's own, or one from the literature.",
        ),
        click.option(
            "--strength",
            type=float,
            default=1.0,
            show_default=True,
            help="Factor on the size of the hidden effects.",
        ),
        click.option(
            "--seed", type=int, default=0, show_default=True, help="Same seed, same data."
        ),
        click.option(
            "--hidden",
            callback=_names,
            default="none",
            show_default=True,
            metavar="EFFECT[=SIZE][,EFFECT]",
            help=f"Effects and faults of instruments in the truth: {', '.join(hidden_names())}."
            " With a size, that is its amplitude in SI units: load_offset=-4.",
        ),
    ):
        command = option(command)
    return command


def _output_options(command: Command) -> Command:
    for option in (
        click.option(
            "--json", "json_file", metavar="FILE", help="Summary as JSON, - for standard output."
        ),
        click.option(
            "--answer",
            type=click.Path(path_type=Path, dir_okay=False),
            help="File for the truth (JSON).  [default: the output's name + .answer.json]",
        ),
    ):
        command = option(command)
    return command


def _places(output: Path, answer: Path | None, json_file: str | None) -> Path:
    """Check where everything will be written, before the work; return the place of the answer."""
    answer = output.with_name(f"{output.name}.answer.json") if answer is None else answer
    summary = [] if json_file in (None, "-") else [Path(str(json_file))]
    files = [check_folder(path) for path in (answer, *summary)]
    if len({path.resolve() for path in (output, *files)}) <= len(files):
        raise SimulationError(f"two outputs have one name ({output}): give each its own")
    return answer


def _report(json_file: str | None, summary: dict[str, Any], text: str) -> None:
    if json_file == "-":
        click.echo(json.dumps(summary, indent=1))
        return
    if json_file is not None:
        write_json(Path(json_file), summary)
    click.echo(text)


@click.group()
def simulate() -> None:
    """Make data or a bag from the truth simulator."""


@simulate.command()
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="BAG",
    help="Folder for the bag; it must not exist.",
)
@_hidden_options
@click.option("--distance", type=float, default=30.0, show_default=True, help="Way, m.")
@click.option("--speed", type=float, default=0.5, show_default=True, help="Middle speed, m/s.")
@click.option("--wheels", default="four", show_default=True, help=f"{' or '.join(ROVERS)}.")
@click.option(
    "--terrain", default="mixed", show_default=True, help=f"{' or '.join(TERRAINS)} soil."
)
@click.option(
    "--finish",
    default="none",
    show_default=True,
    help=f"What it ends in, stuck: {', '.join(FINISHES)}.",
)
@click.option(
    "--noise", type=float, default=1.0, show_default=True, help="Factor on every sensor's noise."
)
@click.option(
    "--outliers",
    type=float,
    default=0.0,
    show_default=True,
    metavar="FRACTION",
    help="Share of measured sinkages that are grossly wrong.",
)
@click.option(
    "--dropouts",
    type=float,
    default=0.01,
    show_default=True,
    metavar="FRACTION",
    help="Share of load and sinkage messages that are missing.",
)
@click.option("--storage", type=click.Choice(STORAGES), default="mcap", show_default=True)
@_output_options
@_one_message
def drive(
    output: Path,
    hidden: tuple[str, ...],
    seed: int,
    strength: float,
    form: Form,
    distance: float,
    speed: float,
    wheels: str,
    terrain: str,
    finish: str,
    noise: float,
    outliers: float,
    dropouts: float,
    storage: Storage,
    answer: Path | None,
    json_file: str | None,
) -> None:
    """Make a rosbag2 bag of a small rover's drive."""
    check_new_bag(output)
    answer_path = _places(output, answer, json_file)
    made = simulate_drive(
        DriveSettings(
            seed=seed,
            distance=distance,
            speed=speed,
            wheels=wheels,
            terrain=terrain,
            finish=finish,
            hidden=hidden,
            strength=strength,
            form=form,
            noise=noise,
            outliers=outliers,
            dropouts=dropouts,
        )
    )
    count = write_drive_bag(made, output, storage=storage)
    write_json(answer_path, made.answer())
    duration = float(made.truth.travel.time[-1])
    summary = {
        "bag": str(output),
        "answer": str(answer_path),
        "messages": count,
        "duration": duration,
        "distance": float(made.truth.travel.way[-1]),
        "wheels": [wheel.name for wheel in made.rover.wheels],
    }
    _report(
        json_file,
        summary,
        f"{output}: {count} messages, {duration:.0f} s, {summary['distance']:.1f} m,"
        f" {len(made.rover.wheels)} wheels\n{answer_path}: the truth",
    )


@simulate.command()
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="Table to write, .csv or .parquet; one that exists is replaced.",
)
@_hidden_options
@click.option("--runs", type=int, default=32, show_default=True)
@click.option(
    "--rows-per-run", type=int, default=3, show_default=True, help="Repeats of each run's setting."
)
@click.option(
    "--noise", type=float, default=0.03, show_default=True, help="Relative noise of the channels."
)
@click.option(
    "--soil-scatter",
    type=float,
    default=0.05,
    show_default=True,
    help="Relative scatter of the soil's k from run to run.",
)
@click.option(
    "--channels",
    callback=_names,
    default="sinkage,resistance",
    show_default=True,
    metavar="NAME[,NAME]",
    help=f"What is measured: {', '.join(CHANNELS)}.",
)
@click.option(
    "--tie",
    callback=_names,
    default="",
    metavar="NAME,NAME",
    help=f"Two settings driven together: {', '.join(CONTINUOUS)}, an extra column.",
)
@click.option(
    "--outliers",
    type=float,
    default=0.0,
    show_default=True,
    metavar="FRACTION",
    help="Share of rows in which one channel is grossly wrong.",
)
@_output_options
@_one_message
def rig(
    output: Path,
    hidden: tuple[str, ...],
    seed: int,
    strength: float,
    form: Form,
    runs: int,
    rows_per_run: int,
    noise: float,
    soil_scatter: float,
    channels: tuple[str, ...],
    tie: tuple[str, ...],
    outliers: float,
    answer: Path | None,
    json_file: str | None,
) -> None:
    """Make a table of single-wheel measurements."""
    check_folder(check_suffix(output))
    answer_path = _places(output, answer, json_file)
    made = simulate_rig(
        RigSettings(
            seed=seed,
            hidden=hidden,
            strength=strength,
            form=form,
            runs=runs,
            rows_per_run=rows_per_run,
            noise=noise,
            soil_scatter=soil_scatter,
            channels=channels,
            tie=tie,
            outliers=outliers,
        )
    )
    write_table(made.table, output)
    write_json(answer_path, made.truth.answer())
    summary = {
        "table": str(output),
        "answer": str(answer_path),
        "runs": runs,
        "rows": len(made.table),
        "columns": list(made.table.columns),
    }
    _report(
        json_file,
        summary,
        f"{output}: {runs} runs, {len(made.table)} rows\n{answer_path}: the truth",
    )
