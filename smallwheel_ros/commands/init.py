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
from smallwheel_ros.onboard.template import template


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


def _print_template(context: click.Context, _option: click.Parameter, asked: bool) -> None:
    if asked:
        click.echo(template(), nl=False)
        context.exit()


init = command(
    rover_from,
    output("Parameter file to write.", required=True),
    click.option("--force", is_flag=True, help="Replace an existing file."),
    click.option(
        "--template",
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_print_template,
        help="Print a file with every parameter, its meaning and default, and exit.",
    ),
    JSON,
    words="An existing file is kept without --force.",
    begin=_check_free,
    finish=_written,
)
