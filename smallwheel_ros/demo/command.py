# SPDX-License-Identifier: Apache-2.0
"""`demo` and `play`: a drive, simulated or recorded, over DDS."""

from pathlib import Path
from typing import Any

import click

from smallwheel_ros.arguments import Bag, Distance, Folder, Pace, Seconds, Seed
from smallwheel_ros.commands.command import command
from smallwheel_ros.commands.outputs import JSON, Options
from smallwheel_ros.common.console import tell
from smallwheel_ros.ros import check_ros


def demo(
    output: Folder = Path("out") / "demo",
    *,
    seed: Seed = 1,
    distance: Distance = 24.0,
    rate: Pace = 4.0,
) -> tuple[dict[str, Any], str]:
    """Play a simulated drive into the node over DDS, draw what it finds.

    A rover with two wheel sizes drives over three soils and up a slope until it is stuck. Its bag is
    played into the node mobility_estimator, which runs in a process of its own and sees only what
    sensors measure.

    Parameters
    ----------
    output
        Folder for the results.
    seed
        Seed of the drive.
    distance
        Distance before the slope at the end, m.
    rate
        Largest factor on real time; the player waits for the node.
    """
    from smallwheel_ros.demo.demo import run_demo

    return run_demo(Path(output), seed=seed, distance=distance, rate=rate)


def play(bag: Bag, *, rate: Pace = 1.0, wait: Seconds = 10.0) -> str:
    """Publish the messages of a bag over DDS, with /clock; bags of ROS 1 are converted on the way.

    Nodes that listen must have use_sim_time set: stamps are those of the recording. It begins when
    every topic of the bag has a listener, or after --wait. `ros2 bag play` can do more.

    Parameters
    ----------
    bag
        A rosbag2 folder, a .mcap or .db3 file, or a ROS 1 .bag.
    rate
        Factor on the recorded speed.
    wait
        Wait for listeners, at most this many seconds; 0: begin at once.
    """
    check_ros()
    from smallwheel_ros.ros.play import play_bag

    published, hole = play_bag(Path(bag), rate, wait)
    return "\n".join([f"{bag}: {published} messages published", *([hole] if hole else [])])


def _shown(found: tuple[dict[str, Any], str], asked: Options) -> None:
    document, text = found
    tell(document, text, asked["json_file"])
    if document["unanswered"] > 0:
        click.echo(f"{document['unanswered']} sinkages got no answer from the node", err=True)
        raise SystemExit(1)


demo_command = command(demo, JSON, finish=_shown)
play_command = command(play, finish=lambda said, asked: click.echo(said))
