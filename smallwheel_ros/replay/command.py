# SPDX-License-Identifier: Apache-2.0
"""`smallwheel replay`: one bag, or many: one after the other, on several processors, on a Dask cluster."""

from __future__ import annotations

import csv
import multiprocessing
import signal
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from tqdm import tqdm

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.console import JSON, show, tell
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import check_targets
from smallwheel_ros.common.tables import text_table, write_json, write_rows
from smallwheel_ros.costmap.grid import HERE, HIGHEST, UNKNOWN, Grid, read_map, union, write_map
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.replay.replay import Report
from smallwheel_ros.replay.replay import replay as replay_bag
from smallwheel_ros.replay.result import (
    ESTIMATES,
    FILES,
    MEASUREMENTS,
    SCHEMA,
    SUMMARY,
    Replayed,
    claimed,
    files_in,
    is_done,
    read_summary,
)
from smallwheel_ros.replay.spec import (
    COPIES,
    Copy,
    Input,
    ReplayError,
    ReplaySpec,
    check_parameters,
    inputs_of,
    read_remaps,
    read_settings,
    topics_document,
    with_assumed_config,
)
from smallwheel_ros.replay.tables import columns, table

_PATH = click.Path(path_type=Path)
_MANY = "replays.json"
_PATIENCE = 60.0  # s that a worker has to put away what it has begun


@click.command()
@click.argument("bags", nargs=-1, required=True, type=_PATH, metavar="BAG...")
@click.option("--config", type=_PATH, metavar="ROVER.yaml",
              help="The node's parameter file; if not given, what `smallwheel init` finds in the first "
              "bag.")  # fmt: skip
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
    if scheduler is not None:  # workers may stand elsewhere in the tree of folders
        bags, output = tuple(bag.absolute() for bag in bags), output.absolute()
        config = config and config.absolute()
    like = ReplaySpec(bags[0], config or Path(), output, remapped, clock, copy, rate)
    if config is None:
        like = with_assumed_config(like)
    for note in check_parameters(like):
        click.echo(f"warning: {note}", err=True)
    if len(bags) == 1 and scheduler is None and not one_map:
        _one(like, json_file)
    else:
        _many(_specs_of(bags, like), output, jobs, scheduler, json_file, one_map=one_map)


# --- What is in a bag


def _topics(bag: Path, config: Path | None, remaps: dict[str, str], json_file: str | None) -> None:
    with BagReader(bag, salvage=True) as reader:
        inputs: tuple[Input, ...] = ()
        if config is not None:
            spec = ReplaySpec(bag, config, Path(), remaps)
            settings, _ = read_settings(spec, reader)
            inputs = inputs_of(spec, Feed(Onboard(settings.onboard), settings), reader, {})
        content = topics_document(reader, inputs)
    tell(content, _topics_text(content, config is not None), json_file)
    if content["damage"] and json_file != "-":
        click.echo(f"damaged: {content['damage']}", err=True)
        raise SystemExit(1)


def _topics_text(content: dict[str, Any], has_config: bool) -> str:
    bag, missing, proposals = content["bag"], content["missing"], content["proposals"]
    rows = []
    for topic in content["topics"]:
        rate = "-" if topic["rate"] is None else f"{topic['rate']:.1f}"
        rows.append([topic["name"], topic["type"], str(topic["messages"]), rate, topic["role"]])
    lines = [f"{bag}: {content['messages']} messages in {content['duration']:.1f} s", ""]
    lines += [text_table(["topic", "type", "messages", "Hz", "is"], rows), ""]
    if not has_config:
        lines += [
            f"`smallwheel init {bag} -o rover.yaml` makes a parameter file of these; with",
            "--config rover.yaml this list says which topic is which input.",
        ]
    elif not (missing or proposals):
        lines.append("Every input of the node is there.")
    if missing:
        lines += ["Missing", *(f"  {text}" for text in missing)]
    if proposals:
        lines += ["", "These may be them", *(f"  {proposal['add']}" for proposal in proposals)]
    return "\n".join(lines)


# --- One bag


def _one(spec: ReplaySpec, json_file: str | None) -> None:
    with tqdm(unit=" messages", disable=None, leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = replay_bag(spec, progress=progress, report=Replayed.save)
    written = [spec.folder / name for name in (*files_in(spec.folder).values(), SUMMARY)]
    show(result, json_file, written, f"{result}\n")
    if result.state != "complete":
        click.echo(f"{result.state.replace('_', ' ')}: {result.ended}", err=True)
        raise SystemExit(1)


# --- Many bags


@dataclass(frozen=True)
class Outcome:
    """What became of one bag, as replays.json has it.

    state: ``complete``, ``ended_early``, ``interrupted``, ``failed`` or ``not_begun``. error: in
    words, empty where there is none. done_before: by an earlier command. summary: as in replay.json,
    None where the replay failed.
    """

    bag: str
    folder: str
    state: str
    error: str = ""
    done_before: bool = False
    summary: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """The bag's name, which its folder has."""
        return Path(self.folder).name


def _many(
    specs: list[ReplaySpec],
    folder: Path,
    jobs: int,
    scheduler: str | None,
    json_file: str | None,
    *,
    one_map: bool,
) -> None:
    source = replay_all(specs, Replayed.save, jobs=jobs, scheduler=scheduler)
    found: dict[str, Outcome] = {}
    bar = tqdm(total=len(specs), unit=" bags", disable=None, leave=False)
    with claimed(folder):
        # Who interrupts sees by the states that not all is done.
        with suppress(KeyboardInterrupt), _terminated_as_interrupted(), bar, closing(source):
            for outcome in source:
                found[outcome.name] = outcome
                bar.update()
                said = outcome.error or outcome.state.replace("_", " ")
                with tqdm.external_write_mode():
                    click.echo(f"{outcome.bag}: {said}", err=True)
        outcomes = [found.get(spec.name) or _outcome(spec) for spec in specs]
        done = [o for o in outcomes if o.state in ("complete", "ended_early")]
        files = _merge(folder, done) if done else {}
        if one_map and done:
            files |= _merge_maps(folder, done)
        document = {"schema": SCHEMA, "bags": [asdict(o) for o in outcomes], "files": files}
        write_json(str(folder / _MANY), document)
    written = [folder / name for name in (*files.values(), _MANY)]
    tell(document, _many_text(outcomes), json_file, written)
    states, said = {o.state for o in outcomes}, f"{len(done)} of {len(outcomes)} bags are done"
    if states & {"interrupted", "not_begun"}:
        click.echo(f"interrupted: {said}; the same command does the rest", err=True)
    elif states == {"failed"}:
        raise SystemExit(2)
    elif states != {"complete"}:
        click.echo(f"{said}, see above for the others", err=True)
    if states != {"complete"}:
        raise SystemExit(1)


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Take SIGTERM as Ctrl-C: the processes that are at work must end too."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _specs_of(bags: Sequence[Path], like: ReplaySpec) -> list[ReplaySpec]:
    """Return one replay for each bag, each into a folder of its own in `like`'s.

    Raises ReplayError if two bags have one name.
    """
    named: dict[str, ReplaySpec] = {}
    for spec in (replace(like, bag=bag) for bag in bags):
        if spec.name in named:
            raise ReplayError(
                f"bags {named[spec.name].bag} and {spec.bag} have one name, {spec.name}: replay them"
                " into different folders"
            )
        named[spec.name] = spec
    return [replace(spec, folder=like.folder / name) for name, spec in named.items()]


def replay_all(
    specs: Sequence[ReplaySpec], report: Report, *, jobs: int = 1, scheduler: str | None = None
) -> Generator[Outcome, None, None]:
    """Replay bag by bag; outcomes as they come.

    jobs: processes at a time. With one job that is done in this process, and ends after a bag that
    somebody interrupted. A process that dies costs only its own bag. KeyboardInterrupt ends all of them:
    what they had finished stays. scheduler: address of a Dask cluster, which gets one bag a task. The
    workers need this package, and the bags, the parameter file and the output folder under the same
    paths as here; ReplayError if dask.distributed is not installed, or nobody answers there.
    """
    if scheduler is None and jobs == 1:
        for spec in specs:
            outcome = _replay_or_say(spec, report)
            yield outcome
            if outcome.state == "interrupted":
                return
        return
    lost = []  # bags of which no process tells any more: one died, and took the others' with it
    with _pool(min(jobs, len(specs))) if scheduler is None else _cluster(scheduler) as workers:
        futures = {workers.submit(_replay_or_say, spec, report): spec for spec in specs}
        for future in as_completed(futures):
            try:
                yield future.result()
            except BrokenProcessPool:
                lost.append(futures[future])
            except Exception as error:  # a worker of a cluster died, or has not this package
                yield _outcome(futures[future], f"{type(error).__name__}: {error}")
    if lost and len(specs) == 1:
        yield _outcome(lost[0], "the process that replayed it died (killed, or out of memory)")
        return
    for spec in lost:  # each alone, to see whose fault it was
        yield from replay_all([spec], report, jobs=jobs)


def _replay_or_say(spec: ReplaySpec, report: Report) -> Outcome:
    """Replay one bag, unless that is done already; what goes wrong is in the outcome."""
    try:
        before = is_done(spec)
        if not before:
            replay_bag(spec, report=report)
        return _outcome(spec, before=before)
    except SmallwheelError as error:
        return _outcome(spec, str(error))
    except Exception as error:  # one bag's trouble must not be that of the others
        return _outcome(spec, f"{type(error).__name__}: {error}")


def _outcome(spec: ReplaySpec, error: str = "", before: bool | None = None) -> Outcome:
    """What became of a bag, as its folder says; error: what went wrong instead.

    before: whether an earlier replay did it, and not this one; None: nobody told.
    """
    bag, folder, found = str(spec.bag), str(spec.folder), read_summary(spec.folder)
    state = found.get("state")
    if error:
        return Outcome(bag, folder, "failed", error)
    if state == "interrupted" or before is not None or is_done(spec):
        return Outcome(bag, folder, found["state"], found["ended"], bool(before), found)
    # A replay that was killed says that it is at work; what else is there is of an earlier one.
    return Outcome(bag, folder, "interrupted" if state == "running" else "not_begun")


@contextmanager
def _pool(jobs: int) -> Iterator[Executor]:
    """Processes that put away what they have begun when the block ends by an exception."""
    pool = ProcessPoolExecutor(
        jobs,
        # A fresh interpreter: a forked one may hold locks of threads that are not there.
        mp_context=multiprocessing.get_context("spawn"),
        # Ctrl-C goes to all processes of a terminal; one that waits for work ignores it.
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        children = multiprocessing.active_children()
        for child in children:
            child.terminate()  # those at work take it as a wish to stop
        end = time.monotonic() + _PATIENCE
        for child in children:
            child.join(max(end - time.monotonic(), 0.0))
            # Who was at work may now wait for ever, for a lock that an idle one has taken with it.
            child.kill()
        raise


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask cluster. Raises ReplayError."""
    try:
        from distributed import Client
    except ImportError:
        raise ReplayError(
            "option --scheduler needs dask.distributed: pip install 'smallwheel_ros[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=5)
    except (OSError, ValueError) as error:
        raise ReplayError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        # Not pure: the same bag may be replayed again by a later command.
        yield client.get_executor(pure=False, retries=1)


# --- All bags together


def _merge(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Put estimates and measurements of all bags into one table each; return the files' names.

    Estimates get a column `bag`; runs and soils of the measurements begin with the bag's name,
    since no two drives share them. Of the measurements' columns those stay that all bags have: not
    every drive tells the pass number. Raises ReplayError, OutputError if a table cannot be written.
    """
    measured: list[dict[str, str]] = []
    with table(folder / ESTIMATES, {"bag": "string", **columns()}) as add:
        for outcome in outcomes:
            name, place = outcome.name, Path(outcome.folder)
            for row in _rows(place / FILES["estimates_csv"]):
                add([name, *row.values()])
            for row in _rows(place / MEASUREMENTS):
                mine = {"soil": f"{name} {row['soil']}", "run": f"{name} {row['run']}"}
                measured.append(row | mine)
    (folder / MEASUREMENTS).unlink(missing_ok=True)
    if measured:
        shared = [name for name in measured[0] if all(name in row for row in measured)]
        rows = [{name: row[name] for name in shared} for row in measured]
        write_rows(folder / MEASUREMENTS, rows)
    merged = ("estimates_csv", "estimates_parquet", "measurements")
    return {what: name for what, name in files_in(folder).items() if what in merged}


def _rows(path: Path) -> Iterator[dict[str, str]]:
    """The rows of a table (CSV), if there is one."""
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            yield from csv.DictReader(file)


def _merge_maps(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Lay the cost maps of all bags into one, the newest on top; return the files' names.

    Where any of them has 100 it stays: a robot was stuck there. Raises ReplayError, CostMapError,
    OutputError if there is no map, if they are not in one frame, or if one cannot be read or written.
    """
    found: dict[str, Grid] = {}  # by the bag's path, the newest last
    for outcome in sorted(outcomes, key=lambda one: float((one.summary or {})["start"])):
        path = Path(outcome.folder) / FILES["cost_map"]
        if path.exists():
            found[outcome.bag] = read_map(path)
    if not found:
        raise ReplayError("option --map: no bag has a cost map: nobody says where the wheels were")
    frames = {grid.frame: bag for bag, grid in found.items()}
    if len(frames) > 1:
        words = ", ".join(f"{frame} ({bag})" for frame, bag in frames.items())
        raise ReplayError(f"option --map: expected maps in one frame, found {words}")
    stuck = [
        replace(grid, cells=np.where(grid.cells == HIGHEST, grid.cells, UNKNOWN).astype(np.int8))
        for grid in found.values()
    ]
    layers = [(grid, HERE) for grid in (*found.values(), *stuck)]
    write_map(folder / FILES["cost_map"], union(next(iter(frames)), layers))
    return {what: FILES[what] for what in ("cost_map", "cost_map_image")}


def _many_text(outcomes: Sequence[Outcome]) -> str:
    """Say what became of each bag, a line for each."""
    rows = []
    for outcome in outcomes:
        state = outcome.state.replace("_", " ") + (" (before)" if outcome.done_before else "")
        row, summary = [outcome.name, state, "-", "-", "-", "-"], outcome.summary
        if summary is not None:
            soil = summary["soil"]
            pressure, deviation = (soil["reference_pressure"][n] / 1e3 for n in ("value", "std"))
            row[2:4] = [f"{summary['travel']:.1f}", str(summary["estimates"])]
            row[4:] = [str(soil["changes"]), f"{pressure:.3g} +- {deviation:.2g}"]
        rows.append(row)
    header = ["bag", "", "way [m]", "estimates", "soil changes", "reference pressure [kPa]"]
    lines = [text_table(header, rows)]
    lines += [f"{outcome.name}: {outcome.error}" for outcome in outcomes if outcome.error]
    return "\n".join(lines)
