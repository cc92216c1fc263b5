# SPDX-License-Identifier: Apache-2.0
"""`smallwheel init`: a parameter file with all that a bag, a URDF or the number of wheels gives."""

from __future__ import annotations

import click

from smallwheel_ros.commands.command import command
from smallwheel_ros.commands.outputs import JSON, Options, output
from smallwheel_ros.common.console import tell
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.init.from_bag import init as rover_from
from smallwheel_ros.init.rover import FILL_IN, InitError, Rover


def _check_free(asked: Options) -> None:
    if asked["output"].exists() and not asked["force"]:
        raise InitError(
            f"{asked['output']}: exists already: give another name, or --force to replace it"
        )


def _written(rover: Rover, asked: Options) -> None:
    file, shown = asked["output"], asked["json_file"] != "-"
    write_bytes(file, rover.parameter_file().encode())
    tell(rover.to_dict(), rover.text(), asked["json_file"], [file])
    if rover.missing and shown:
        click.echo(f"look for {FILL_IN} in {file}")
    if rover.of_bag and shown:
        click.echo(f"then: smallwheel replay {rover.origin} --config {file} -o out")


init = command(
    rover_from,
    output("Parameter file to write.", required=True),
    click.option("--force", is_flag=True, help="Replace an existing file."),
    JSON,
    words="An existing file is kept without --force.",
    begin=_check_free,
    finish=_written,
)
