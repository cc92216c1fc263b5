# SPDX-License-Identifier: Apache-2.0
"""Replays many bags, each in a process of its own, here or on a Dask cluster, and merges their tables."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from smallwheel_ros.common.stop import Stop
from smallwheel_ros.common.tables import text_table
from smallwheel_ros.costmap.grid import HERE, HIGHEST, UNKNOWN, Grid, read_map, union, write_map
from smallwheel_ros.replay.result import (
    FILES,
    MEASUREMENTS,
    files_in,
    is_done,
    read_summary,
    result_state,
)
from smallwheel_ros.replay.spec import ReplayError, ReplaySpec

_LOOK = 0.2  # s between two looks whether somebody asked to stop


@dataclass(frozen=True)
class Outcome:
    """Outcome of one bag, as in replays.json.

    Attributes
    ----------
    bag, folder
        Paths of the bag and of the folder with its results.
    state
        ``complete``, ``ended_early``, ``interrupted``, ``failed`` or ``not_begun``.
    error
        What went wrong, in words; empty if nothing did.
    done_before
        Whether an earlier command had already replayed it.
    summary
        Content of its replay.json; None if there is none.
    """

    bag: str
    folder: str
    state: str
    error: str = ""
    done_before: bool = False
    summary: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """The bag's name, which is also that of its folder."""
        return Path(self.folder).name


def specs_of(bags: Sequence[Path], like: ReplaySpec) -> list[ReplaySpec]:
    """Make the specification of a replay for each bag, each with its own folder below that of `like`.

    Parameters
    ----------
    bags
        The bags.
    like
        Specification from which each takes all its other fields.

    Raises
    ------
    ReplayError
        If two bags have the same name.
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
    specs: Sequence[ReplaySpec], stop: Stop, *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[Outcome]:
    """Replay bag by bag, and yield each outcome as it comes; replays that are complete are skipped.

    Parameters
    ----------
    specs
        Specifications of the replays.
    stop
        Once set, running replays end with what they have, and no further one begins; it has no effect on a
        cluster.
    jobs
        Number of processes at a time, without a cluster.
    scheduler
        Address of the scheduler of a Dask cluster, where each bag is a task. Its workers need this package,
        and bags, parameter file and output folder under the same paths as here. None: processes here.

    Yields
    ------
    Outcome
        The outcome of each bag.

    Raises
    ------
    ReplayError
        If dask.distributed is not installed, or the scheduler does not answer.
    """
    left = []
    for spec in specs:
        if is_done(spec):
            yield outcome_of(spec, before=True)
        else:
            left.append(spec)
    with ThreadPoolExecutor(jobs) if scheduler is None else _cluster(scheduler) as workers:
        # A worker of a cluster cannot be asked to stop.
        asked = [stop] if scheduler is None else []
        futures = {workers.submit(_in_a_process, spec, *asked): spec for spec in left}
        for future in as_completed(futures):
            try:
                error = future.result()
            except Exception as failure:  # a worker of a cluster died, or has not this package
                error = f"{type(failure).__name__}: {failure}"
            yield outcome_of(futures[future], error)


def _in_a_process(spec: ReplaySpec, stop: Stop | None = None) -> str:
    """Replay one bag in a process of its own; return what went wrong, in words."""
    if stop is not None and stop.asked:
        return ""
    command = [sys.executable, "-m", "smallwheel_ros", "replay", str(spec.bag)]
    command += ["--config", str(spec.config), "-o", str(spec.folder), "--copy", spec.copy]
    command += ["--clock" if spec.clock else "--no-clock"]
    command += [] if spec.rate is None else ["--rate", str(spec.rate)]
    command += [word for a, b in spec.remaps.items() for word in ("--remap", f"{a}:={b}")]
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    asked = False
    while True:
        try:
            _, said = process.communicate(timeout=_LOOK)
            break
        except subprocess.TimeoutExpired:
            if stop is not None and stop.asked and not asked:
                process.terminate()  # it writes the results so far
                asked = True
    if asked or process.returncode in (0, 1):
        return ""
    died = f"the process that replayed it died (signal {-process.returncode})"
    lines = said.strip().splitlines() or [died]
    return died if process.returncode < 0 else lines[-1].removeprefix("Error: ")


def outcome_of(spec: ReplaySpec, error: str = "", *, before: bool = False) -> Outcome:
    """Read the outcome of a bag from the summary in its folder.

    Parameters
    ----------
    spec
        Specification of the replay.
    error
        What went wrong, in words; empty if nothing did.
    before
        Whether an earlier command had already replayed it.

    Returns
    -------
    Outcome
        Its state is `failed` with an error; `not_begun` if the folder has no result of this very replay.
    """
    bag, folder, found = str(spec.bag), str(spec.folder), read_summary(spec.folder)
    if error:
        return Outcome(bag, folder, "failed", error)
    if state := result_state(spec):
        return Outcome(bag, folder, state, found["ended"], before, found)
    return Outcome(bag, folder, "not_begun")


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


def merge(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Join the tables of estimates of all bags, and those of measurements, into one each.

    Estimates get a column `bag`; names of runs and soils of the measurements begin with the bag's name,
    since no two drives share them. The measurements keep the columns that all bags have: the pass number is
    not known in every drive.

    Parameters
    ----------
    folder
        Folder for the joined tables.
    outcomes
        Outcomes of the bags, which name their folders; each has a table of estimates.

    Returns
    -------
    dict
        Names of the files written, by their keys in `FILES`.
    """
    target, measured = folder / FILES["estimates_csv"], []
    target.unlink(missing_ok=True)
    for outcome in outcomes:
        place = Path(outcome.folder)
        for block in pd.read_csv(place / FILES["estimates_csv"], chunksize=100_000, dtype=str):
            block.insert(0, "bag", outcome.name)
            block.to_csv(target, index=False, mode="a", header=not target.exists())
        if (place / MEASUREMENTS).exists():
            rows = pd.read_csv(place / MEASUREMENTS, dtype=str)
            named = {name: f"{outcome.name} " + rows[name] for name in ("soil", "run")}
            measured.append(rows.assign(**named))
    (folder / MEASUREMENTS).unlink(missing_ok=True)
    if measured:
        pd.concat(measured, join="inner").to_csv(folder / MEASUREMENTS, index=False)
    merged = ("estimates_csv", "measurements")
    return {what: name for what, name in files_in(folder).items() if what in merged}


def merge_maps(folder: Path, outcomes: Sequence[Outcome]) -> dict[str, str]:
    """Join the cost maps of all bags, the newest on top.

    A cost of 100 in any of them stays: a robot was stuck there.

    Parameters
    ----------
    folder
        Folder for the joined map.
    outcomes
        Outcomes of the bags, which name their folders; each has a summary.

    Returns
    -------
    dict
        Names of the files written, by their keys in `FILES`.

    Raises
    ------
    ReplayError
        If no bag has a map, or the maps are not in one frame.
    CostMapError
        If a map cannot be read, or the joined one would be too large.
    OutputError
        If the map cannot be written.
    """
    found: dict[str, Grid] = {}  # by the bag's path, the newest last
    for outcome in sorted(outcomes, key=lambda one: float((one.summary or {})["start"])):
        path = Path(outcome.folder) / FILES["cost_map"]
        if path.exists():
            found[outcome.bag] = read_map(path)
    if not found:
        raise ReplayError("option --map: no bag has a cost map: where the wheels were is not known")
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


def many_text(outcomes: Sequence[Outcome]) -> str:
    """Report the outcomes as a table with a line for each bag, and below it what went wrong."""
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
    header = ["bag", "", "distance [m]", "estimates", "soil changes", "reference pressure [kPa]"]
    lines = [text_table(header, rows)]
    lines += [f"{outcome.name}: {outcome.error}" for outcome in outcomes if outcome.error]
    return "\n".join(lines)
