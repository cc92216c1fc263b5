# SPDX-License-Identifier: Apache-2.0
"""The commands `demo`, `play` and `convert-trial`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from smallwheel_ros.bags import check_new_bag
from smallwheel_ros.common.console import JSON, tell
from smallwheel_ros.common.files import check_targets
from smallwheel_ros.common.options import settings_options
from smallwheel_ros.replay.trial import TrialSettings, read_trial, write_trial
from smallwheel_ros.ros import check_ros

_FILE = click.Path(path_type=Path)


@click.command()
@click.option(
    "-o", "--output", type=_FILE, metavar="FOLDER", help="For what is made.  [default: out/demo]"
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the drive.")
@click.option(
    "--distance",
    type=click.FloatRange(2, 500),
    default=24.0,
    show_default=True,
    help="Way before the slope that ends it, m.",
)
@click.option(
    "--rate",
    type=click.FloatRange(0.1, 100),
    default=4.0,
    show_default=True,
    help="Times as fast as real time, at most: the player waits for the node.",
)
@JSON
def demo(
    output: Path | None, seed: int, distance: float, rate: float, json_file: str | None
) -> None:
    """Play a simulated drive into the node over DDS, draw what it finds.

    A rover with two wheel sizes drives over three soils and up a slope until it is stuck. Its bag is
    played into the node mobility_estimator, which runs in a process of its own and sees only what
    sensors measure; the beginning of it once more, into a node that is given load and slip only.
    """
    from smallwheel_ros.demo.demo import DEFAULT_FOLDER, run_demo, summary

    result = run_demo(
        output or DEFAULT_FOLDER,
        seed=seed,
        distance=distance,
        rate=rate,
        say=lambda line: click.echo(line, err=True),
    )
    found = result.full.recording
    content = {
        "picture": str(result.pictures[0]),
        "pictures": [str(path) for path in result.pictures],
        "mobility": str(result.tables[0]),
        "soil": str(result.tables[1]),
        "messages": found.published,
        "estimates": len(result.full.mobility),
        "unanswered": found.unanswered,
        "seconds": round(result.seconds, 1),
    }
    tell(content, summary(result), json_file)
    if found.unanswered > 0:
        click.echo(f"{found.unanswered} sinkages got no answer from the node", err=True)
        raise SystemExit(1)


@click.command()
@click.argument("bag", type=_FILE)
@click.option(
    "--rate",
    type=click.FloatRange(0.001, 1000),
    default=1.0,
    show_default=True,
    help="Times as fast as recorded.",
)
@click.option(
    "--start", type=click.FloatRange(0), default=0.0, show_default=True, help="Skip so many s."
)
@click.option("--loop", is_flag=True, help="Again and again, until Ctrl-C.")
@click.option(
    "--clock/--no-clock",
    default=True,
    show_default=True,
    help="Publish /clock, for nodes with use_sim_time.",
)
@click.option(
    "--wait",
    type=click.FloatRange(0, 86400),
    default=10.0,
    show_default=True,
    help="For listeners, at most so many s; 0: begin at once.",
)
def play(bag: Path, rate: float, start: float, loop: bool, clock: bool, wait: float) -> None:
    """Publish the messages of BAG over DDS; bags of ROS 1 are converted on the way.

    Nodes that listen must have use_sim_time set: stamps are those of the recording.

    It begins when every topic of BAG has a listener. Where some have one and others none, it begins 2 s
    after the last listener has come; where nobody listens at all, after --wait. Topics that nobody
    listens to are named. It ends when all reliable listeners have everything.
    """
    check_ros()
    from smallwheel_ros.ros.play import CONFIRM, Player

    def say(line: str) -> None:
        click.echo(f"{bag}: {line}", err=True)

    with Player("smallwheel_play", bag, rate=rate, start=start, loop=loop, clock=clock) as player:
        for name, why in player.skipped.items():
            click.echo(f"{name} is left out: {why}", err=True)
        total = None if loop else player.message_count
        with player.stop.listening():
            if wait > 0:
                say(f"waiting for listeners, at most {wait:g} s (--wait)")
                player.wait_for_listeners(wait)
                if lonely := player.nobody_listens():
                    say(lonely)
            bar = tqdm(player.play(), total=total, unit=" messages", disable=None, leave=False)
            count = sum(1 for _ in bar)
            if lacking := player.wait_for_confirmation():
                topics = ", ".join(lacking)
                say(
                    f"listeners have not confirmed the last messages within {CONFIRM:g} s: {topics}"
                )
    click.echo(f"{bag}: {count} messages published")


@click.command("convert-trial")
@click.argument("bag", type=_FILE)
@click.option(
    "--zero", type=_FILE, required=True, metavar="BAG", help="Bag of the unloaded force sensor."
)
@click.option(
    "--log",
    type=_FILE,
    required=True,
    help="Log of the axis: X, Vx, rim speed, slip angle, Z [mm, up], controller clock, unix time.",
)
@click.option(
    "-o",
    "--output",
    type=_FILE,
    required=True,
    metavar="BAG",
    help="Folder for the new bag; it must not exist.",
)
@settings_options(TrialSettings)
@JSON
def convert_trial(
    bag: Path, zero: Path, log: Path, output: Path, json_file: str | None, **given: Any
) -> None:
    """Turn a recorded indentation trial into a bag that the node understands.

    BAG holds the force sensor's messages while a wheel is pressed straight into the soil.
    """
    check_new_bag(output)
    check_targets([json_file], [bag, zero, log])
    settings = TrialSettings(**given)
    trial = read_trial(bag, zero, log, settings)
    count = write_trial(trial, output, settings)
    content = {
        "bag": str(output),
        "messages": count,
        "loads": len(trial.load),
        "sinkages": len(trial.sinkage),
        "largest_load": float(trial.load.max()),
        "largest_sinkage": float(trial.sinkage.max()),
        "zero": trial.zero,
    }
    text = (
        f"{output}: {len(trial.load)} loads to {trial.load.max():.1f} N,"
        f" {len(trial.sinkage)} sinkages to {trial.sinkage.max() * 1e3:.1f} mm"
    )
    tell(content, text, json_file)
