# SPDX-License-Identifier: Apache-2.0
"""The command `smallwheel node`: the node in this process, without the command line of ROS."""

from __future__ import annotations

from pathlib import Path

import click

from smallwheel_ros.ros.node_process import check_ros


@click.command()
@click.option(
    "--params-file",
    "files",
    type=click.Path(path_type=Path, exists=True, dir_okay=False, readable=True),
    multiple=True,
    required=True,
    metavar="ROVER.yaml",
    help="Parameters, as `smallwheel init` writes them; of several files later ones win.",
)
@click.option(
    "--remap",
    "remaps",
    multiple=True,
    metavar="NAME:=TOPIC",
    help="The node's name of a topic, then the robot's: odom:=/rover/odom.",
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="[-- ROS_ARGUMENTS...]")
def node(files: tuple[Path, ...], remaps: tuple[str, ...], arguments: tuple[str, ...]) -> None:
    """Run the node mobility_estimator until Ctrl-C; it needs ROS 2.

    Further arguments of ROS come after --, such as `-- -p use_sim_time:=true -r __ns:=/robot1`. Exit
    code 2: a parameter or argument is wrong, which the last line says.
    """
    check_ros()
    from smallwheel_ros.ros.mobility_estimator import main

    given = [word for file in files for word in ("--params-file", str(file))]
    given += [word for remap in remaps for word in ("-r", remap)]
    raise SystemExit(main(["--ros-args", *given, *arguments]))
