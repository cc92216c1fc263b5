# SPDX-License-Identifier: Apache-2.0
"""Events of a drive in words, with time and place: changes of soil, alarms, jumps of time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate
from smallwheel_ros.pipeline.tables import Estimates, Flags, Integers, Readings, none_of
from smallwheel_ros.pipeline.warning.hazard import APART
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel

from .statements import WARNINGS, statements

_PAUSE = 5.0  # s: a report that was absent for longer is a new event
_Place = tuple[float, float] | None


class Event(NamedTuple):
    """An event of a drive.

    Attributes
    ----------
    time
        Time since the beginning of the drive, s.
    travel
        Distance that the vehicle had travelled, m.
    kind
        `soil_change`, `time_jump`, or the kind of a `Statement`.
    text
        The event in words.
    place
        x and y of the vehicle in the odometry's frame, m; None if unknown.
    times
        Number of times that it happened; time, travel and place are those of the first.
    """

    time: float
    travel: float
    kind: str
    text: str
    place: tuple[float, float] | None = None
    times: int = 1


class DriveEvents:
    """Collects events of a drive by comparing the state after each turn of the pipeline with that before.

    Parameters
    ----------
    pipeline
        Pipeline; the result of each of its turns is given to `take`.
    start
        Stamp at which times of events are 0, ns.

    Attributes
    ----------
    events
        The events so far; after `finish` in the order of time.
    travel
        Distance that the vehicle has travelled, m.
    examples
        By stream and reason, the first problem of that kind: its explanation, and its time (s).
    newest
        The newest estimate of each wheel.
    soils, soil_of
        Soils under the readings of the newest turn of the pipeline, and the index of each reading's soil,
        shape (rows,).
    """

    def __init__(self, pipeline: Pipeline, start: int) -> None:
        self._pipeline, self._start = pipeline, start
        self.events: list[Event] = []
        self.examples: dict[tuple[str, str], tuple[str, float]] = {}
        self.travel = 0.0
        self._turn = math.pi * max(wheel.diameter for wheel in pipeline.settings.wheels)
        # A change of soil that is under way: until no more jumps come for one revolution of a wheel.
        self._change: Event | None = None
        self._pressure = self._pressure_before = pipeline.soil.reference_pressure
        self._said: dict[str, float] = {}  # by text without numbers, when last reported, s
        self._holds: set[str] = set()  # reports after the pipeline's last turn, less numbers
        self._once: dict[str, int] = {}  # by text without numbers, the index of its event
        self._begin()

    def _begin(self) -> None:
        """Begin anew, as after a jump of time; events so far are kept."""
        self._note_change()
        self.newest: Estimates = none_of(Estimates)
        self._changes, self._until = 0, 0.0
        self._raised = [-math.inf, -math.inf]  # s, when each level of the warning was last on
        self._version = -1
        self.soils: list[SoilEstimate] = [self._pipeline.soil]
        self.soil_of: Integers = np.empty(0, dtype=np.int64)

    def take(self, turn: Turn) -> Flags:
        """Process one turn of the pipeline; return a mask of its readings at which the soil was changing."""
        if turn.starts_over:
            self._begin()
        rows, estimates = turn.readings, turn.estimates
        if len(rows):
            self.travel = max(self.travel, float(rows.distance.max()))
        changing = self._watch_soil(rows, turn)
        self._warn(turn)
        self.newest = newest_of(self.newest, estimates)
        self._look(turn)
        return changing

    def _since(self, stamp: int) -> float:
        """Time since the bag's beginning, s."""
        return (stamp - self._start) / SECOND

    def _watch_soil(self, rows: Readings, turn: Turn) -> Flags:
        """Look for changes of soil, from version to version of the law."""
        changing, self.soils = np.zeros(len(rows), dtype=bool), self.soils[-1:]
        self.soil_of = np.zeros(len(rows), dtype=np.int64)
        if not len(rows):
            return changing
        newest = np.maximum.accumulate(np.maximum(turn.version, self._version))
        begins = np.flatnonzero(np.diff(newest, prepend=newest[0] - 1)).tolist()
        for begin, end in zip(begins, [*begins[1:], len(rows)], strict=True):
            if newest[begin] != self._version:
                self._version = int(newest[begin])
                self.soils.append(self._pipeline.soil_at(self._version))
            self._know(self.soils[-1], rows, begin)
            changing[begin:end] = self._change is not None
            self.soil_of[begin:end] = len(self.soils) - 1
        return changing

    def _know(self, soil: SoilEstimate, rows: Readings, i: int) -> None:
        """Note the soil that is estimated from reading i on."""
        if soil.soil_changes > self._changes:
            if self._change is None:
                wheel = self._pipeline.settings.wheels[int(rows.wheel[i])].name
                time, text = self._since(int(rows.stamp[i])), f"noticed by wheel {wheel}"
                self._change = Event(time, soil.distance, "soil_change", text, _place(rows, i))
            self._until = soil.distance + self._turn
        elif self._change is None:
            self._pressure_before = soil.reference_pressure
        self._changes, self._pressure = soil.soil_changes, soil.reference_pressure
        if soil.distance > self._until:
            self._note_change()

    def _warn(self, turn: Turn) -> None:
        """Note each rise of the warning's level, even if it ends within the same turn of the pipeline."""
        warned, rows = turn.warned, turn.readings
        if warned is None or not len(rows):
            return
        for i in np.flatnonzero(warned.level > 0).tolist():
            level, time = int(warned.level[i]), self._since(int(warned.stamp[i]))
            rises = [one for one in range(level) if time - self._raised[one] > APART]
            self._raised[:level] = [time] * level
            if rises:
                row = max(int(np.searchsorted(rows.stamp, warned.stamp[i], side="right")) - 1, 0)
                text = WarningLevel.warned(level).said(warned.slip[i])
                way = float(rows.distance[row])
                self.events.append(Event(time, way, WARNINGS[level - 1], text, _place(rows, row)))

    def _look(self, turn: Turn) -> None:
        """Note new reports; a report on a sensor is one event, with the number of times it was made."""
        rows, now = turn.estimates, self._since(turn.until)
        place = _place(rows, len(rows) - 1) if len(rows) else None
        goes_on, self._holds = self._holds, set()
        for statement in statements(self._pipeline, self.newest):
            if statement.kind in WARNINGS:
                continue  # by the instants of the warning
            about = statement.about
            self._holds.add(about)
            before, self._said[about] = self._said.get(about, -math.inf), now
            if about in goes_on or now - before <= _PAUSE:
                continue
            event = Event(now, self.travel, statement.kind, statement.text, place)
            if statement.entry != "sensors":
                self.events.append(event)
            elif about in self._once:
                first = self.events[self._once[about]]
                self.events[self._once[about]] = first._replace(times=first.times + 1)
            else:
                self._once[about] = len(self.events)
                self.events.append(event)

    def _note_change(self) -> None:
        """Note a change of soil, once the estimate has not jumped for one revolution of a wheel."""
        if self._change is not None:
            text = (
                f"another soil: reference pressure {self._pressure_before / 1e3:.3g} kPa before,"
                f" {self._pressure / 1e3:.3g} kPa after ({self._change.text})"
            )
            self.events.append(self._change._replace(text=text))
            self._change = None

    @property
    def soil_changes(self) -> int:
        """Number of changes of the soil so far."""
        return sum(event.kind == "soil_change" for event in self.events)

    def finish(self) -> None:
        """Close the events still open at the end of the drive."""
        self._note_change()
        self.events.sort(key=lambda event: event.time)

    def take_problems(self, log_time: int) -> None:
        """Record new problems with messages, at the log time (ns) of the newest message."""
        time = self._since(log_time)
        for problem in self._pipeline.take_problems():
            self.examples.setdefault((problem.stream, problem.reason), (problem.text, time))
            if problem.reason == "time_jump":
                self.events.append(Event(time, self.travel, "time_jump", problem.text))


def _place(rows: Readings | Estimates, i: int) -> _Place:
    x, y = float(rows.x[i]), float(rows.y[i])
    return (x, y) if math.isfinite(x + y) else None


def newest_of(before: Estimates, estimates: Estimates) -> Estimates:
    """Find the newest row of each wheel.

    Parameters
    ----------
    before
        Newest rows so far, at most one for each wheel.
    estimates
        Rows since then, in the order of their stamps.

    Returns
    -------
    Estimates
        At most one row for each wheel, in the order of stamps.
    """
    rows = Estimates.joined([before, estimates])
    _, last = np.unique(rows.wheel[::-1], return_index=True)
    return rows.take(np.sort(len(rows) - 1 - last))
