# SPDX-License-Identifier: Apache-2.0
"""`smallwheel replay`: one bag, or many."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from smallwheel_ros.api.replay import replay as replay_drive
from smallwheel_ros.arguments import Copy
from smallwheel_ros.bags import BagReader
from smallwheel_ros.commands.command import options_of
from smallwheel_ros.common.console import JSON, show, tell
from smallwheel_ros.common.files import check_targets
from smallwheel_ros.common.stop import Stop
from smallwheel_ros.common.tables import text_table, write_json
from smallwheel_ros.replay.many import (
    many_text,
    merge,
    merge_maps,
    outcome_of,
    replay_all,
    specs_of,
)
from smallwheel_ros.replay.replay import replay as replay_bag
from smallwheel_ros.replay.report import save_page
from smallwheel_ros.replay.result import SCHEMA, SUMMARY, files_in
from smallwheel_ros.replay.spec import (
    ReplaySpec,
    check_parameters,
    read_remaps,
    with_assumed_config,
)

_PATH = click.Path(path_type=Path)
_MANY = "replays.json"


@click.command()
@click.argument("bags", nargs=-1, required=True, type=_PATH, metavar="BAG...")
@options_of(replay_drive, "config", "output", "remaps", "clock", "copy", "rate", "soil_file")
@click.option("--topics", "only_topics", is_flag=True,
              help="Only list what is in the bag.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True,
              help="Bags at a time.")  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS",
              help="Dask cluster to run on, one bag per task: tcp://host:8786.")  # fmt: skip
@click.option("--map", "one_map", is_flag=True,
              help="Merge the cost maps of all bags, in one frame, into one: the newest on top.")  # fmt: skip
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
    soil_file: Path | None,
    one_map: bool,
    json_file: str | None,
) -> None:
    """Give recorded drives to the estimator that the node runs, with the node's parameters.

    BAG is a rosbag2 folder, a .mcap or .db3 file, or a ROS 1 .bag. FOLDER gets the estimates
    (CSV, Parquet), a bag with the estimates next to the originals, steady stretches as a table for
    `smallwheel diagnose`, a cost map for Nav2's map_server, and a report. Several bags get a folder
    each. An interrupted command, given once more, does the rest.

    Exit code 1: a bag ended early, failed, or was interrupted; what there was is written. 2: nothing could
    be estimated.
    """
    check_targets([json_file, soil_file], [*bags, config])
    remapped = read_remaps(remaps)
    if only_topics:
        _topics(bags, json_file)
        return
    if soil_file is not None and (len(bags) > 1 or scheduler is not None or one_map):
        raise click.UsageError(
            "--soil-file is for one bag: each has to begin where the last one ended"
        )
    if output is None:
        raise click.UsageError("give -o FOLDER (or --topics)")
    if scheduler is not None:  # workers may stand elsewhere in the tree of folders
        bags, output = tuple(bag.absolute() for bag in bags), output.absolute()
        config = config and config.absolute()
    like = ReplaySpec(
        bags[0], config or Path(), output, remapped, clock, copy, rate, soil_file=soil_file
    )
    if config is None:
        like = with_assumed_config(like)
    for note in check_parameters(like):
        click.echo(f"warning: {note}", err=True)
    if len(bags) == 1 and scheduler is None and not one_map:
        _one(like, json_file)
    else:
        _many(specs_of(bags, like), output, jobs, scheduler, json_file, one_map=one_map)


def _topics(bags: tuple[Path, ...], json_file: str | None) -> None:
    """Print what is in the bags; the JSON of several is one document with a list of them."""
    contents, texts = zip(*map(_content, bags), strict=True)
    document = contents[0] if len(bags) == 1 else {"schema": SCHEMA, "bags": contents}
    tell(document, "\n\n".join(texts), json_file)
    damaged = [content for content in contents if content["damage"]]
    if damaged and json_file != "-":
        for content in damaged:
            of = f"{content['bag']}: " if len(bags) > 1 else ""
            click.echo(f"{of}damaged: {content['damage']}", err=True)
        raise SystemExit(1)


def _content(bag: Path) -> tuple[dict[str, Any], str]:
    """What is in a bag, as plain values and as a text."""
    with BagReader(bag) as reader:
        seconds = ((reader.end_time or 0) - (reader.start_time or 0)) / 1e9
        rows = [
            [t.name, t.type, str(t.message_count), f"{t.message_count / max(seconds, 1e-9):.1f}"]
            for t in reader.topics
        ]
        content: dict[str, Any] = {"bag": str(bag), "duration": seconds, "damage": reader.damage}
        content["topics"] = [topic._asdict() for topic in reader.topics]
    text = text_table(["topic", "type", "messages", "Hz"], rows)
    return content, f"{bag}: {seconds:.1f} s\n\n{text}"


def _one(spec: ReplaySpec, json_file: str | None) -> None:
    """Replay one bag here."""
    with tqdm(unit=" messages", disable=None, leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = replay_bag(spec, progress=progress, report=save_page)
    written = [spec.folder / name for name in (*files_in(spec.folder).values(), SUMMARY)]
    show(result, json_file, written, f"{result}\n")
    if result.estimates.knows_nothing and not result.has_twists:
        missing = "".join(f"\n  {item}" for item in result.inputs if item.lacking)
        click.echo(
            "nothing could be estimated: no row has slip, margin or a measured sinkage."
            + (f" Missing:{missing}" if missing else " See what was not used."),
            err=True,
        )
        raise SystemExit(2)
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
    """Replay many bags, each in a separate process, and join their tables."""
    stop, found = Stop(), {}
    folder.mkdir(parents=True, exist_ok=True)
    with stop.listening(), tqdm(total=len(specs), unit=" bags", disable=None, leave=False) as bar:
        for outcome in replay_all(specs, stop, jobs=jobs, scheduler=scheduler):
            found[outcome.name] = outcome
            bar.update()
            said = outcome.error or outcome.state.replace("_", " ")
            with tqdm.external_write_mode():
                click.echo(f"{outcome.bag}: {said}", err=True)
    outcomes = [found.get(spec.name) or outcome_of(spec) for spec in specs]
    done = [outcome for outcome in outcomes if outcome.state in ("complete", "ended_early")]
    files = merge(folder, done) if done else {}
    if one_map and done:
        files |= merge_maps(folder, done)
    document = {"schema": SCHEMA, "bags": [asdict(o) for o in outcomes], "files": files}
    write_json(str(folder / _MANY), document)
    written = [folder / name for name in (*files.values(), _MANY)]
    tell(document, many_text(outcomes), json_file, written)
    states, said = {o.state for o in outcomes}, f"{len(done)} of {len(outcomes)} bags are done"
    if states & {"interrupted", "not_begun"}:
        click.echo(f"interrupted: {said}; the same command does the rest", err=True)
    elif states == {"failed"}:
        raise SystemExit(2)
    elif states != {"complete"}:
        click.echo(f"{said}, see above for the others", err=True)
    if states != {"complete"}:
        raise SystemExit(1)
