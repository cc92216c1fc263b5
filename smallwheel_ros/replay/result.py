# SPDX-License-Identifier: Apache-2.0
"""What comes of a replay: the folder with its files, what happened on the way, and all of it as values."""

from __future__ import annotations

import fcntl
import json
import math
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from smallwheel_ros.bags import Key
from smallwheel_ros.common.results import Result, pandas
from smallwheel_ros.common.tables import plain, write_json
from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result as Estimated
from smallwheel_ros.onboard.result import Status, soil_fields
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.onboard.statements import Statement, alarms, statements
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.replay.spec import Input, ReplayError, ReplaySpec, using
from smallwheel_ros.replay.tables import SteadySegments, deviations

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

SCHEMA = 1
SUMMARY, ESTIMATES, MEASUREMENTS, BAG = "replay.json", "estimates", "measurements.csv", "bag"
FILES = {
    "estimates_csv": f"{ESTIMATES}.csv",
    "estimates_parquet": f"{ESTIMATES}.parquet",
    "measurements": MEASUREMENTS,
    "bag": BAG,
    "report": "report.html",
    "cost_map": "cost_map.yaml",
    "cost_map_image": "cost_map.pgm",
}
_MOST_EVENTS = 200
_LOOK = 1.0  # s: as often as the node says it
_PAUSE = 5.0  # s: what is not said for so long begins anew
_UNITS = {"k": "Pa/m^(n+m)", "n": "1", "m": "1"}
_UNITS |= {"effective_modulus": "Pa/m^n", "reference_pressure": "Pa"}
_Say = Callable[[Onboard, Iterable[Estimated]], Iterable[Statement]]


# --- The folder


def files_in(folder: Path) -> dict[str, str]:
    """Return what has been written, by what it is, as names in the folder."""
    return {what: name for what, name in FILES.items() if (folder / name).exists()}


def read_summary(folder: Path) -> dict[str, Any]:
    """Return what a replay into that folder said of itself; empty where there is none."""
    try:
        content = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def is_done(spec: ReplaySpec) -> bool:
    """Whether the folder holds all that came of the same replay."""
    summary = read_summary(spec.folder)
    if summary.get("state") not in ("complete", "ended_early"):
        return False
    try:
        same = summary.get("fingerprint") == spec.fingerprint()
    except OSError:
        return False
    return same and all((spec.folder / name).exists() for name in summary.get("files", {}).values())


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Make a folder and keep other replays out of it meanwhile, also those that are killed.

    Raises ReplayError if it cannot be made, or another replay is at work in it.
    """
    with using(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ReplayError(
                    f"folder {folder}: another replay is writing into it; wait until it is done, or"
                    " give another folder with -o"
                ) from None
        yield
    finally:
        os.close(handle)


def begin(spec: ReplaySpec) -> list[str]:
    """Clear the folder of an earlier replay, drafts of a killed one too; note that one is under way.

    Returns what is to be said of the earlier one. Raises ReplayError if the folder is the bag, would lose
    the bag, holds something else under the names needed, or cannot be cleared.
    """
    folder, bag, before = spec.folder, spec.bag.resolve(), read_summary(spec.folder)
    if folder.resolve() == bag:
        raise ReplayError(f"folder {folder} is the bag itself: give another one with -o")
    if bag.is_relative_to((folder / BAG).resolve()):
        raise ReplayError(
            f"bag {spec.bag} is what an earlier replay has written into folder {folder}, which a"
            " new one clears: give another one with -o"
        )
    names = (*FILES.values(), f"{ESTIMATES}.csv.part", SUMMARY)
    there = [folder / name for name in names if (folder / name).exists()]
    if there and not before:
        raise ReplayError(
            f"folder {folder} has {there[0].name}, which no replay has made: give another folder, or"
            " remove it"
        )
    # What a replay that was killed had not put in its place yet.
    drafts = [path for name in names for path in folder.glob(f".{name}[.-]*") if before]
    with using(folder):
        for path in (*there, *drafts):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
    running = {"schema": SCHEMA, "state": "running", "bag": str(spec.bag)}
    write_json(str(folder / SUMMARY), running)
    killed = before.get("state") == "running"
    return (
        ["an earlier replay into this folder was not finished; it is done anew"] if killed else []
    )


# --- What happened


class Event(NamedTuple):
    """Something that happened: time in s since the bag's beginning, way in m, and in words.

    place: x and y (m) of the vehicle in the frame of the odometry, None where not known.
    """

    time: float
    travel: float
    kind: str
    text: str
    place: tuple[float, float] | None = None


class DriveSummary:
    """Takes results and problems as they come.

    wheels: by wheel, how many results there were, and had what. statuses: how many results had which.
    examples: the first thing that could not be used, by stream and reason: in words, and its time.
    """

    def __init__(self, onboard: Onboard, start: int) -> None:
        self._onboard, self._start = onboard, start
        wheels = onboard.settings.wheels
        names = ("estimates", "with_sinkage", "with_load", "with_slip", "used_for_soil")
        self.wheels = {wheel.name: dict.fromkeys(names, 0) for wheel in wheels}
        self.statuses: Counter[str] = Counter()
        self.events: list[Event] = []
        self.examples: dict[tuple[str, str], tuple[str, float]] = {}
        self.travel = 0.0
        self._squares = dict.fromkeys(self.wheels, 0.0)  # of measured minus predicted sinkage, m^2
        self._accepted = self._changes = 0
        self._turn = math.pi * max(wheel.diameter for wheel in wheels)
        # A change of soil that is under way: until no more jumps come for a turn of a wheel.
        self._change: Event | None = None
        self._until = 0.0  # m of travel
        self._pressure_before = self._pressure = onboard.soil.reference_pressure
        self._newest: dict[str, Estimated] = {}
        # What is said, without its numbers, and when it was said last, s.
        self._said: dict[str, float] = {}
        self._looked = -math.inf

    def add(self, result: Estimated) -> None:
        """Take one result."""
        reading = result.reading
        measured, predicted = reading.sinkage, result.sinkage_predicted
        loaded = reading.load is not None
        used = measured is not None and loaded and result.status is not Status.REJECTED
        self.travel = max(self.travel, result.travel)
        self.statuses[result.status.name] += 1
        counts = self.wheels[result.wheel]
        counts["estimates"] += 1
        counts["with_sinkage"] += measured is not None
        counts["with_load"] += loaded
        counts["with_slip"] += reading.slip is not None
        counts["used_for_soil"] += used
        if used and measured is not None and predicted is not None:
            self._squares[result.wheel] += (measured.value - predicted.value) ** 2
        time = self._since(reading.stamp)
        self._watch(result, time)
        self._newest[result.wheel] = result
        if time - self._looked < _LOOK:
            self._note(alarms, result, time)
        else:
            self._looked = time
            self._note(statements, result, time)

    def _since(self, stamp: int) -> float:
        """Time since the bag's beginning, s."""
        return (stamp - self._start) / SECOND

    def rms(self, wheel: str) -> float | None:
        """Root mean square of measured minus predicted sinkage of those used, m."""
        used = self.wheels[wheel]["used_for_soil"]
        return (self._squares[wheel] / used) ** 0.5 if used else None

    def _watch(self, result: Estimated, time: float) -> None:
        """Look for changes of soil."""
        soil = result.soil
        if soil.accepted < self._accepted:
            self._changes = 0  # all began anew
        if soil.soil_changes > self._changes:
            if self._change is None:
                text, place = f"noticed by wheel {result.wheel}", result.reading.vehicle
                self._change = Event(time, soil.distance, "soil_change", text, place)
            self._until = soil.distance + self._turn
        elif self._change is None:
            self._pressure_before = soil.reference_pressure
        self._accepted, self._changes = soil.accepted, soil.soil_changes
        self._pressure = soil.reference_pressure
        if soil.distance > self._until:
            self._note_change()

    def _note(self, said: _Say, result: Estimated, time: float) -> None:
        """Note what begins to be said."""
        for statement in said(self._onboard, self._newest.values()):
            before = self._said.get(statement.about, -math.inf)
            self._said[statement.about] = time
            if time - before > _PAUSE:
                way, place = result.travel, result.reading.vehicle
                self.events.append(Event(time, way, statement.kind, statement.text, place))

    def _note_change(self) -> None:
        """Note a change of soil, once the estimate has not jumped for a turn of a wheel."""
        if self._change is not None:
            text = (
                f"another soil: reference pressure {self._pressure_before / 1e3:.3g} kPa before,"
                f" {self._pressure / 1e3:.3g} kPa after ({self._change.text})"
            )
            self.events.append(self._change._replace(text=text))
            self._change = None

    @property
    def changing(self) -> bool:
        """Whether the soil has just changed, and may go on to do so."""
        return self._change is not None

    @property
    def soil_changes(self) -> int:
        """How often the soil has changed."""
        return sum(event.kind == "soil_change" for event in self.events)

    def finish(self) -> None:
        """Note what still goes on: nothing more will come."""
        self._note_change()
        for result in list(self._newest.values())[-1:]:
            self._note(statements, result, self._since(result.reading.stamp))
        self.events.sort(key=lambda event: event.time)

    def take_problems(self, log_time: int) -> None:
        """Note what could not be used since the last call."""
        time = self._since(log_time)
        for problem in self._onboard.take_problems():
            self.examples.setdefault((problem.stream, problem.reason), (problem.text, time))
            if problem.reason == "time_jump":
                self._note_change()
                self._newest.clear()
                self.events.append(Event(time, self.travel, "time_jump", problem.text))


# --- All of it


@dataclass(repr=False)
class Replayed(Result):
    """What came of a replay.

    state: ``complete``, ``ended_early`` (the bag is damaged) or ``interrupted``. ended: in words, what is
    wrong with the bag, or where the replay stopped; empty when complete. start, end: ns. messages_read,
    message_count: of the topics that were read, and how many the bag says there are. prefix: of the
    topics of the estimates in the new bag. left_out: topics and types that are not in the new bag, since
    nobody knows the type. place: what keeps a folder that is only for this result; it goes when the
    result does.
    """

    spec: ReplaySpec
    settings: NodeSettings
    notes: list[str]
    inputs: tuple[Input, ...]
    start: int
    end: int
    message_count: int
    onboard: Onboard
    summary: DriveSummary
    segments: SteadySegments
    state: str = "complete"
    ended: str = ""
    messages_read: int = 0
    prefix: str = ""
    left_out: list[Key] = field(default_factory=list)
    place: TemporaryDirectory[str] | None = None

    def headline(self) -> str:
        """How far the drive was, and how many estimates it gave."""
        seconds, metres = (self.end - self.start) / SECOND, self.summary.travel
        state = "" if self.state == "complete" else f", {self.state.replace('_', ' ')}"
        count = self.summary.statuses.total()
        return f"{self.spec.bag.name}: {seconds:.1f} s, {metres:.1f} m, {count} estimates{state}"

    def rows(self) -> list[dict[str, Any]]:
        """How well the measured sinkage of each wheel was met."""
        return [
            {"wheel": name, **counts, "sinkage_rms": self.summary.rms(name)}
            for name, counts in self.summary.wheels.items()
        ]

    def to_frame(self) -> pd.DataFrame:
        """Every estimate, one row each, SI units, as in estimates.csv."""
        frame: pd.DataFrame = pandas().read_csv(self.spec.folder / FILES["estimates_csv"])
        return frame

    def plot(self, ax: Axes | None = None, quantity: str = "sinkage_predicted") -> Axes:
        """Draw a column of the estimates over time, one curve for each wheel."""
        return self._drawn(ax, quantity)

    def to_dict(self) -> dict[str, Any]:
        """As replay.json has it: SI units, times in s since the bag's beginning."""
        summary, received = self.summary, self.onboard.received
        rolling = {w.name for w in self.settings.onboard.wheels if w.contact == ROLLING}
        inputs = [
            {"stream": i.stream, "topic": i.topic, "type": i.type, "messages": received[i.stream]}
            for i in self.inputs
        ]
        topics = {item.stream: item.topic for item in self.inputs}
        not_used: list[dict[str, Any]] = []
        for (stream, why), count in sorted(self.onboard.counts.items()):
            drop = {"topic": topics.get(stream, stream), "stream": stream, "reason": why}
            text, time = summary.examples.get((stream, why), ("", None))
            not_used.append({**drop, "count": count, "first_time": time, "example": text})
        content = {
            "schema": SCHEMA,
            "state": self.state,
            "ended": self.ended,
            "bag": str(self.spec.bag),
            "config": str(self.spec.config),
            "remaps": dict(self.spec.remaps),
            "fingerprint": self.spec.fingerprint(),
            "start": self.start / SECOND,
            "duration": (self.end - self.start) / SECOND,
            "travel": summary.travel,
            "messages": {"read": self.messages_read, "in_bag": self.message_count},
            "estimates": summary.statuses.total(),
            "statuses": dict(summary.statuses),
            "wheels": {
                name: {"rolls": name in rolling, **counts, "sinkage_rms": summary.rms(name)}
                for name, counts in summary.wheels.items()
            },
            "soil": self._soil(),
            "sensors": list(self.onboard.findings),
            "slip_tests": [test.text for test in self.onboard.slip_tests],
            "filter": self.onboard.concern,
            "events": [event._asdict() for event in summary.events[:_MOST_EVENTS]],
            "unlisted_events": max(len(summary.events) - _MOST_EVENTS, 0),
            "inputs": inputs,
            "missing": [str(item) for item in self.inputs if item.lacking],
            "not_used": not_used,
            "measurements": {
                "rows": len(self.segments),
                "stretches_not_steady": self.segments.unsteady,
                "results_without_load_slip_or_sinkage": self.segments.unusable,
                "results_at_changes_of_soil": self.segments.at_changes,
            },
            "not_copied": [f"{name} ({kind})" for name, kind in self.left_out],
            "notes": self.notes,
            "topics_of_estimates": [f"{self.prefix}/mobility", f"{self.prefix}/soil"],
            "files": files_in(self.spec.folder),
        }
        return dict(plain(content))

    def _soil(self) -> dict[str, Any]:
        soil, alarm = self.onboard.soil, self.onboard.soil.missing_effect
        told = soil_fields(soil, rejected=0) | deviations(soil)
        return {
            **{
                name: {
                    "value": told[name],
                    "std": told[f"{name}_standard_deviation"],
                    "unit": unit,
                    "determined": told[f"{name}_identifiable"],
                }
                for name, unit in _UNITS.items()
            },
            "reference_sinkage": soil.reference_sinkage,
            "reference_diameter": soil.reference_diameter,
            "status": list(soil.status),
            "changes": self.summary.soil_changes,
            "missing_effect": alarm
            and {
                "effect": alarm.effect,
                "rivals": list(alarm.rivals),
                "follows": alarm.follows,
                "text": alarm.message,
            },
        }
