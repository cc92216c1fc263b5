# SPDX-License-Identifier: Apache-2.0
"""`smallwheel replay`: a thin shell over the folder replay/."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.console import JSON, tell
from smallwheel_ros.common.files import check_targets
from smallwheel_ros.common.tables import text_table, write_json
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.replay.folder import SUMMARY, claimed, read_summary
from smallwheel_ros.replay.inputs import Input, inputs_of, proposals, read_remaps, topics_document
from smallwheel_ros.replay.many import (
    Outcome,
    found_on_disk,
    many_document,
    many_text,
    merge,
    merge_maps,
    replay_all,
    specs_of,
)
from smallwheel_ros.replay.one import replay as replay_bag
from smallwheel_ros.replay.replay_report import summary_text
from smallwheel_ros.replay.result import Replayed
from smallwheel_ros.replay.settings import check_parameters, read_settings, with_assumed_config
from smallwheel_ros.replay.spec import COPIES, Copy, ReplaySpec

_PATH = click.Path(path_type=Path)


@click.command("replay", short_help="The node's estimator over recorded drives, without ROS.")
@click.argument("bags", nargs=-1, required=True, type=_PATH, metavar="BAG...")
@click.option(
    "--config",
    type=_PATH,
    metavar="ROVER.yaml",
    help="The node's parameter file; if not given, what `smallwheel init` finds in the first bag.",
)
@click.option("-o", "--output", type=_PATH, metavar="FOLDER", help="For what is made.")
@click.option("--remap", "remaps", multiple=True, metavar="NAME:=TOPIC",
              help="The node's name of an input, and the bag's topic, as ROS writes it; repeat it "
              "for more.")  # fmt: skip
@click.option("--topics", "only_topics", is_flag=True,
              help="Only list what is in the bag, and propose which topic is what.")  # fmt: skip
@click.option("--clock/--no-clock", default=True, show_default=True,
              help="Judge stamps by the times of recording, as the node does with use_sim_time; "
              "otherwise only by each other.")  # fmt: skip
@click.option("--copy", type=click.Choice(COPIES), default="all", show_default=True,
              help="Topics that go into the new bag beside the estimates.")  # fmt: skip
@click.option("--rate", type=click.FloatRange(0.0, 1000.0), metavar="HZ",
              help="Estimates a second of each wheel at most, in place of the parameter mobility.rate; "
              "0: one for each measured sinkage.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True,
              help="Bags at a time.")  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS",
              help="Of a Dask cluster to do it on, one bag a task: tcp://host:8786.")  # fmt: skip
@click.option("--map", "one_map", is_flag=True,
              help="Lay the cost maps of all bags, in one frame, into one: the newest on top.")  # fmt: skip
@JSON
def replay(
    bags: tuple[Path, ...],
    config: Path | None,
    output: Path | None,
    remaps: tuple[str, ...],
    only_topics: bool,
    clock: bool,
    copy: Copy,
    rate: float | None,
    jobs: int,
    scheduler: str | None,
    one_map: bool,
    json_file: str | None,
) -> None:
    """Give recorded drives to the estimator that the node runs, with the node's parameters.

    BAG is a rosbag2 folder, a .mcap or .db3 file, or a ROS 1 .bag. Into FOLDER go: the estimates
    (CSV, Parquet), a bag with the estimates next to the originals, steady stretches as a table for
    `smallwheel diagnose`, a cost map for Nav2's map_server, and a report. Several bags get a folder
    each. What is done already is not done again: after an interruption give the same command once
    more.

    Exit code 1: a bag ended early, failed, or was interrupted; what there was is written.
    """
    check_targets([json_file], [*bags, config])
    remapped = read_remaps(remaps)
    if only_topics:
        for bag in bags:
            _topics(bag, config, remapped, json_file)
        return
    if output is None:
        raise click.UsageError("give -o FOLDER (or --topics)")
    like = ReplaySpec(bags[0], config or Path(), output, remapped, clock, copy, rate)
    if config is None:
        like = with_assumed_config(like)
    for note in check_parameters(like):
        click.echo(f"warning: {note}", err=True)
    if len(bags) == 1 and scheduler is None and not one_map:
        _one(like, json_file)
    else:
        _many(specs_of(bags, like), output, jobs, scheduler, json_file, one_map=one_map)


def _write_report(result: Replayed, path: Path) -> None:
    """Write the page; what it needs is loaded when it comes to that."""
    from smallwheel_ros.replay.replay_report import replay_page

    replay_page(result).save(path)


def _one(spec: ReplaySpec, json_file: str | None) -> None:
    with tqdm(unit=" messages", disable=None, leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = replay_bag(spec, progress=progress, report=_write_report)
    summary = read_summary(spec.folder)
    assert summary is not None, "replay writes it last"
    written = [spec.folder / name for name in (*summary["files"].values(), SUMMARY)]
    tell(summary, f"{summary_text(summary)}\n", json_file, written)
    if result.state != "complete":
        click.echo(f"{result.state.replace('_', ' ')}: {result.ended}", err=True)
        raise SystemExit(1)


def _many(
    specs: list[ReplaySpec],
    folder: Path,
    jobs: int,
    scheduler: str | None,
    json_file: str | None,
    *,
    one_map: bool,
) -> None:
    if scheduler is not None:
        # Workers may stand elsewhere in the tree of folders than this process does.
        paths = ("bag", "config", "folder")
        specs = [
            replace(spec, **{name: getattr(spec, name).absolute() for name in paths})
            for spec in specs
        ]
    source = replay_all(specs, _write_report, jobs=jobs, scheduler=scheduler)
    found: dict[str, Outcome] = {}
    stopped = False
    bar = tqdm(total=len(specs), unit=" bags", disable=None, leave=False)
    with claimed(folder):
        try:
            with _terminated_as_interrupted(), bar, closing(source):
                for outcome in source:
                    found[outcome.spec.name] = outcome
                    bar.update()
                    said = outcome.error or outcome.state.replace("_", " ")
                    with tqdm.external_write_mode():
                        click.echo(f"{outcome.spec.bag}: {said}", err=True)
        except KeyboardInterrupt:
            stopped = True
        outcomes = [found.get(spec.name) or found_on_disk(spec) for spec in specs]
        done = [o for o in outcomes if o.state in ("complete", "ended_early")]
        files = merge(folder, done) if done else {}
        if one_map and done:
            files |= merge_maps(folder, done)
        document = many_document(outcomes, files)
        write_json(str(folder / "replays.json"), document)
    written = [folder / name for name in (*files.values(), "replays.json")]
    tell(document, many_text(outcomes), json_file, written)
    _say_how_it_ended(outcomes, stopped)


def _say_how_it_ended(outcomes: list[Outcome], stopped: bool) -> None:
    done = sum(o.state in ("complete", "ended_early") for o in outcomes)
    if stopped or any(o.state in ("interrupted", "not_begun") for o in outcomes):
        click.echo(
            f"interrupted: {done} of {len(outcomes)} bags are done; the same command does the rest",
            err=True,
        )
        raise SystemExit(1)
    if all(o.state == "failed" for o in outcomes):
        raise SystemExit(2)
    if any(o.state != "complete" for o in outcomes):
        click.echo(f"{done} of {len(outcomes)} bags are done, see above for the others", err=True)
        raise SystemExit(1)


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Take SIGTERM as Ctrl-C: the processes that are at work must end too."""

    def take(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, take)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _topics(bag: Path, config: Path | None, remaps: dict[str, str], json_file: str | None) -> None:
    with BagReader(bag, salvage=True) as reader:
        inputs: tuple[Input, ...] = ()
        if config is not None:
            settings, _ = read_settings(ReplaySpec(bag, config, Path(), remaps), reader)
            feed = Feed(Onboard(settings.onboard), settings)
            described = settings.robot_description_topic
            inputs = inputs_of(feed.topics, reader.topics, remaps, described)
        content = topics_document(reader, inputs, proposals(reader, inputs))
    tell(content, _topics_text(content, config is not None), json_file)
    if content["damage"] and json_file != "-":
        click.echo(f"damaged: {content['damage']}", err=True)
        raise SystemExit(1)


def _topics_text(content: dict[str, Any], has_config: bool) -> str:
    rows = [
        [
            topic["name"],
            topic["type"],
            str(topic["messages"]),
            "-" if topic["rate"] is None else f"{topic['rate']:.1f}",
            topic["role"],
        ]
        for topic in content["topics"]
    ]
    lines = [f"{content['bag']}: {content['messages']} messages in {content['duration']:.1f} s", ""]
    lines.append(text_table(["topic", "type", "messages", "Hz", "is"], rows))
    if not has_config:
        lines += [
            "",
            f"`smallwheel init {content['bag']} -o rover.yaml` makes a parameter file of these; with",
            "--config rover.yaml this list says which topic is which input.",
        ]
    else:
        if content["missing"]:
            lines += ["", "Missing", *(f"  {text}" for text in content["missing"])]
        if content["proposals"]:
            lines += ["", "These may be them", *(f"  {p['add']}" for p in content["proposals"])]
        if not (content["missing"] or content["proposals"]):
            lines += ["", "Every input of the node is there."]
    return "\n".join(lines)
