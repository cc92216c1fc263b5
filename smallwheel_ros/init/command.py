# SPDX-License-Identifier: Apache-2.0
"""`smallwheel init`: a parameter file to start from."""

from __future__ import annotations

from pathlib import Path

import click

from smallwheel_ros.common.console import JSON, show
from smallwheel_ros.common.files import check_targets, write_bytes
from smallwheel_ros.init.rover import (
    FILL_IN,
    InitError,
    Rover,
    rover_of_description,
    rover_of_wheels,
)

_PATH = click.Path(path_type=Path)


@click.command(
    "init", short_help="A rover's parameter file, from a bag, a URDF or a number of wheels."
)
@click.argument("source", required=False, type=_PATH, metavar="[BAG|URDF]")
@click.option(
    "--urdf", type=_PATH, metavar="FILE", help="A robot description: sizes, places and joints."
)
@click.option("--wheels", type=int, metavar="N", help="Without either: so many wheels.")
@click.option("-o", "--output", required=True, type=_PATH, metavar="ROVER.yaml",
              help="Parameter file to write.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace a file that is there.")
@JSON
def init(
    source: Path | None,
    urdf: Path | None,
    wheels: int | None,
    output: Path,
    force: bool,
    json_file: str | None,
) -> None:
    """Write a parameter file for the node and for `smallwheel replay`.

    From a recorded drive: wheels by their topics, joints, and sizes where the bag has the robot's
    description. What nobody can find out is marked FILL_IN. Nothing that is there is replaced.
    """
    if source is not None and source.suffix.lower() in (".urdf", ".xml"):
        if urdf is not None:
            raise click.UsageError("two robot descriptions: give one")
        source, urdf = None, source
    if [source, urdf, wheels].count(None) != 2:
        raise click.UsageError("give one of: a BAG, a URDF (--urdf FILE), or --wheels N")
    check_targets([output, json_file], [source, urdf])
    if output.exists() and not force:
        raise InitError(f"{output}: is there already: give another name, or --force to replace it")
    rover = _rover(source, urdf, wheels)
    write_bytes(output, rover.parameter_file().encode())
    show(rover, json_file, [output])
    if rover.missing and json_file != "-":
        click.echo(f"look for {FILL_IN} in {output}")


def _rover(source: Path | None, urdf: Path | None, wheels: int | None) -> Rover:
    if source is not None:
        from smallwheel_ros.init.from_bag import rover_of_bag  # brings the readers of bags

        return rover_of_bag(source)
    if urdf is not None:
        return rover_of_description(urdf)
    assert wheels is not None
    return rover_of_wheels(wheels)
