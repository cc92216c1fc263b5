# SPDX-License-Identifier: Apache-2.0
"""The commands `demo` and `play`."""

from __future__ import annotations

from pathlib import Path

import click

from smallwheel_ros.common.console import JSON, tell
from smallwheel_ros.ros import check_ros

_FILE = click.Path(path_type=Path)


@click.command()
@click.option("-o", "--output", type=_FILE, metavar="FOLDER", default=Path("out") / "demo",
              show_default=True, help="For what is made.")  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the drive."
)
@click.option("--distance", type=click.FloatRange(2, 500), default=24.0, show_default=True,
              help="Distance before the slope at the end, m.")  # fmt: skip
@click.option("--rate", type=click.FloatRange(0.1, 100), default=4.0, show_default=True,
              help="At most so many times as fast as real time: the player waits for the node.")  # fmt: skip
@JSON
def demo(output: Path, seed: int, distance: float, rate: float, json_file: str | None) -> None:
    """Play a simulated drive into the node over DDS, draw what it finds.

    A rover with two wheel sizes drives over three soils and up a slope until it is stuck. Its bag is
    played into the node mobility_estimator, which runs in a process of its own and sees only what
    sensors measure.
    """
    from smallwheel_ros.demo.demo import run_demo

    document, text = run_demo(output, seed=seed, distance=distance, rate=rate)
    tell(document, text, json_file)
    if document["unanswered"] > 0:
        click.echo(f"{document['unanswered']} sinkages got no answer from the node", err=True)
        raise SystemExit(1)


@click.command()
@click.argument("bag", type=_FILE)
@click.option("--rate", type=click.FloatRange(0.001, 1000), default=1.0, show_default=True,
              help="Times as fast as recorded.")  # fmt: skip
@click.option("--wait", type=click.FloatRange(0, 86400), default=10.0, show_default=True,
              help="Wait for listeners, at most this many seconds; 0: begin at once.")  # fmt: skip
def play(bag: Path, rate: float, wait: float) -> None:
    """Publish the messages of BAG over DDS, with /clock; bags of ROS 1 are converted on the way.

    Nodes that listen must have use_sim_time set: stamps are those of the recording. It begins when
    every topic of BAG has a listener, or after --wait. `ros2 bag play` can do more.
    """
    check_ros()
    from smallwheel_ros.ros.play import play_bag

    click.echo(f"{bag}: {play_bag(bag, rate, wait)} messages published")
