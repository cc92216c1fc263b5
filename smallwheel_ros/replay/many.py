# SPDX-License-Identifier: Apache-2.0
"""Many bags: one after the other, on several processors or on a Dask cluster, and put together."""

from __future__ import annotations

import csv
import multiprocessing
import signal
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.tables import text_table
from smallwheel_ros.costmap.grid import HERE, HIGHEST, UNKNOWN, Grid, read_map, union, write_map
from smallwheel_ros.replay.estimates import columns, table, write_rows
from smallwheel_ros.replay.folder import (
    ESTIMATES,
    FILES,
    MEASUREMENTS,
    done_before,
    files_in,
    read_summary,
)
from smallwheel_ros.replay.one import replay
from smallwheel_ros.replay.result import SCHEMA, Replayed
from smallwheel_ros.replay.spec import ReplayError, ReplaySpec

Report = Callable[[Replayed, Path], None]
_PATIENCE = 60.0  # s that a worker has to put away what it has begun


@dataclass(frozen=True)
class Outcome:
    """What became of one bag.

    state: ``complete``, ``ended_early``, ``interrupted``, ``failed`` or ``not_begun``. error: in
    words, empty where there is none. before: it was done by an earlier command. summary: as in
    replay.json, empty where the replay failed.
    """

    spec: ReplaySpec
    state: str
    error: str = ""
    before: bool = False
    summary: dict[str, Any] = field(default_factory=dict)


def replay_or_say(spec: ReplaySpec, report: Report) -> Outcome:
    """Replay one bag, unless that is done already; what goes wrong is in the outcome."""
    try:
        found = done_before(spec)
        if found is not None:
            return Outcome(spec, str(found["state"]), str(found["ended"]), True, found)
        result = replay(spec, report=report)
    except SmallwheelError as error:
        return Outcome(spec, "failed", str(error))
    except Exception as error:  # one bag's trouble must not be that of the others
        return Outcome(spec, "failed", f"{type(error).__name__}: {error}")
    return Outcome(spec, result.state, result.ended, summary=read_summary(spec.folder) or {})


def found_on_disk(spec: ReplaySpec) -> Outcome:
    """Return what became of a bag whose process could not tell any more."""
    found = done_before(spec)
    if found is None:
        found = read_summary(spec.folder)
        if found is None:
            return Outcome(spec, "not_begun")
        if found.get("state") != "interrupted":  # it was killed
            return Outcome(spec, "interrupted")
    return Outcome(spec, str(found["state"]), str(found["ended"]), summary=found)


def specs_of(bags: Sequence[Path], like: ReplaySpec) -> list[ReplaySpec]:
    """Return one replay for each bag, each into a folder of its own in `like`'s.

    Raises
    ------
    ReplayError
        If two bags have one name.
    """
    named: dict[str, ReplaySpec] = {}
    for bag in bags:
        spec = replace(like, bag=bag)
        if spec.name in named:
            raise ReplayError(
                f"bags {named[spec.name].bag} and {bag} have one name, {spec.name}: replay them"
                " into different folders"
            )
        named[spec.name] = replace(spec, folder=like.folder / spec.name)
    return list(named.values())


def replay_all(
    specs: Sequence[ReplaySpec], report: Report, *, jobs: int = 1, scheduler: str | None = None
) -> Generator[Outcome, None, None]:
    """Replay bag by bag; outcomes as they come.

    With one job that is done in this process, and ends after a bag that somebody interrupted. A process
    that dies costs only its own bag. KeyboardInterrupt ends all of them: what they had finished stays.

    Parameters
    ----------
    jobs
        Processes at a time.
    scheduler
        Address of a Dask cluster, which gets one bag a task. The workers need this package, and the bags,
        the parameter file and the output folder under the same paths as here.

    Raises
    ------
    ReplayError
        If dask.distributed is not installed, or nobody answers at the address.
    """
    if scheduler is None and jobs == 1:
        for spec in specs:
            outcome = replay_or_say(spec, report)
            yield outcome
            if outcome.state == "interrupted":
                return
        return
    lost = []
    with _pool(min(jobs, len(specs))) if scheduler is None else _cluster(scheduler) as workers:
        futures = {workers.submit(replay_or_say, spec, report): spec for spec in specs}
        for future in as_completed(futures):
            try:
                yield future.result()
            except BrokenProcessPool:
                lost.append(futures[future])
            except Exception as error:  # a worker of a cluster died, or has not this package
                yield Outcome(futures[future], "failed", f"{type(error).__name__}: {error}")
    for spec in lost:
        # A process died, and took the others' bags with it: each alone, to see whose fault it was.
        if len(specs) == 1:
            yield Outcome(
                spec, "failed", "the process that replayed it died (killed, or out of memory)"
            )
        else:
            yield from replay_all([spec], report, jobs=jobs)


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


def _rows(path: Path) -> Iterator[dict[str, str]]:
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            yield from csv.DictReader(file)


def merge(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Put estimates and measurements of all bags into one table each; return the files' names.

    Estimates get a column `bag`; runs and soils of the measurements begin with the bag's name,
    since no two drives share them.

    Raises
    ------
    ReplayError, OutputError
        If a table cannot be written.
    """
    with table(folder / ESTIMATES, {"bag": "string", **columns()}) as add:
        for outcome in outcomes:
            for row in _rows(outcome.spec.folder / FILES["estimates_csv"]):
                add([outcome.spec.name, *row.values()])
    measured: list[dict[str, str]] = []
    for outcome in outcomes:
        name = outcome.spec.name
        for row in _rows(outcome.spec.folder / MEASUREMENTS):
            measured.append({**row, "soil": f"{name} {row['soil']}", "run": f"{name} {row['run']}"})
    write_rows(folder / MEASUREMENTS, measured)
    merged = ("estimates_csv", "estimates_parquet", "measurements")
    return {what: name for what, name in files_in(folder).items() if what in merged}


def merge_maps(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Lay the cost maps of all bags into one, the newest on top; return the files' names.

    Where any of them has 100 it stays: a robot was stuck there.

    Raises
    ------
    ReplayError, CostMapError, OutputError
        If there is no map, if they are not in one frame, or if one cannot be read or written.
    """
    found: list[tuple[Outcome, Grid]] = []
    for outcome in sorted(outcomes, key=lambda outcome: float(outcome.summary["start"])):
        path = outcome.spec.folder / FILES["cost_map"]
        if path.exists():
            found.append((outcome, read_map(path)))
    if not found:
        raise ReplayError("option --map: no bag has a cost map: nobody says where the wheels were")
    frames = {grid.frame: outcome.spec.bag for outcome, grid in found}
    if len(frames) > 1:
        words = ", ".join(f"{frame} ({bag})" for frame, bag in frames.items())
        raise ReplayError(f"option --map: expected maps in one frame, found {words}")
    stuck = [
        replace(grid, cells=np.where(grid.cells == HIGHEST, grid.cells, UNKNOWN).astype(np.int8))
        for _, grid in found
    ]
    layers = [(grid, HERE) for grid in [*(grid for _, grid in found), *stuck]]
    write_map(folder / FILES["cost_map"], union(next(iter(frames)), layers))
    return {what: FILES[what] for what in ("cost_map", "cost_map_image")}


def many_document(outcomes: Sequence[Outcome], files: dict[str, str]) -> dict[str, Any]:
    """Return what became of all bags as plain values; files: of the merged tables."""
    bags = [
        {
            "bag": str(outcome.spec.bag),
            "folder": str(outcome.spec.folder),
            "state": outcome.state,
            "error": outcome.error,
            "done_before": outcome.before,
            "summary": outcome.summary or None,
        }
        for outcome in outcomes
    ]
    return {"schema": SCHEMA, "bags": bags, "files": files}


def many_text(outcomes: Sequence[Outcome]) -> str:
    """Say what became of each bag, a line for each."""
    rows = []
    for outcome in outcomes:
        state = outcome.state.replace("_", " ") + (" (before)" if outcome.before else "")
        found = ["-"] * 4
        if outcome.summary:
            soil = outcome.summary["soil"]
            pressure = soil["reference_pressure"]
            found = [
                f"{outcome.summary['travel']:.1f}",
                str(outcome.summary["estimates"]),
                str(soil["changes"]),
                f"{pressure['value'] / 1e3:.3g} +- {pressure['std'] / 1e3:.2g}",
            ]
        rows.append([outcome.spec.name, state, *found])
    header = ["bag", "", "way [m]", "estimates", "soil changes", "reference pressure [kPa]"]
    lines = [text_table(header, rows)]
    lines += [f"{outcome.spec.name}: {outcome.error}" for outcome in outcomes if outcome.error]
    return "\n".join(lines)
