# SPDX-License-Identifier: Apache-2.0
"""What a replay found out, small however long the drive: counts and events."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.statements import Statement, alarms, statements
from smallwheel_ros.onboard.streams import SECOND

_MOST_EVENTS = 200
_LOOK = 1.0  # s: as often as the node says it
_PAUSE = 5.0  # s: what is not said for so long begins anew


class Event(NamedTuple):
    """Something that happened: time in s since the bag's beginning, way in m, and in words.

    place: x and y (m) of the vehicle in the frame of the odometry, None where not known.
    """

    time: float
    travel: float
    kind: str
    text: str
    place: tuple[float, float] | None = None


@dataclass
class _Change:
    """A change of soil that is under way: until no more jumps come for a turn of a wheel."""

    time: float
    travel: float
    wheel: str
    place: tuple[float, float] | None
    before: float  # reference pressures, Pa
    after: float = 0.0
    until: float = 0.0  # m of travel


class DriveSummary:
    """Takes results and problems as they come.

    Attributes
    ----------
    wheels
        By wheel: how many results there were, and had what.
    statuses
        How many results had which.
    examples
        The first thing that could not be used, by stream and reason: in words, and its time.
    """

    def __init__(self, onboard: Onboard, start: int) -> None:
        self._onboard, self._start = onboard, start
        wheels = onboard.settings.wheels
        names = ("estimates", "with_sinkage", "with_load", "with_slip", "used_for_soil")
        self.wheels = {wheel.name: dict.fromkeys(names, 0) for wheel in wheels}
        self.statuses: Counter[str] = Counter()
        self.events: list[Event] = []
        self.unlisted_events = 0
        self.examples: dict[tuple[str, str], tuple[str, float]] = {}
        self.soil_changes = 0
        self.travel = 0.0
        self._squares = dict.fromkeys(self.wheels, 0.0)  # of measured minus predicted sinkage, m^2
        self._accepted = self._changes = 0
        self._last_pressure = onboard.soil.reference_pressure
        self._turn = math.pi * max(wheel.diameter for wheel in wheels)
        self._change: _Change | None = None
        self._newest: dict[str, Result] = {}
        # What is said, without its numbers, and when it was said last, s.
        self._said: dict[str, float] = {}
        self._looked = -math.inf

    def add(self, result: Result) -> None:
        """Take one result."""
        instant = result.instant
        measured, predicted = instant.sinkage, result.sinkage_predicted
        loaded = instant.load is not None
        used = measured is not None and loaded and result.status is not Status.REJECTED
        self.travel = max(self.travel, result.travel)
        self.statuses[result.status.name] += 1
        counts = self.wheels[result.wheel]
        counts["estimates"] += 1
        counts["with_sinkage"] += measured is not None
        counts["with_load"] += loaded
        counts["with_slip"] += instant.slip is not None
        counts["used_for_soil"] += used
        if used and measured is not None and predicted is not None:
            self._squares[result.wheel] += (measured.value - predicted.value) ** 2
        self._watch(result, (instant.stamp - self._start) / SECOND)

    def rms(self, wheel: str) -> float | None:
        """Root mean square of measured minus predicted sinkage of those used, m."""
        used = self.wheels[wheel]["used_for_soil"]
        return (self._squares[wheel] / used) ** 0.5 if used else None

    def _watch(self, result: Result, time: float) -> None:
        """Note changes of soil, and all that the node would say."""
        wheel, soil = result.wheel, result.soil
        if soil.accepted < self._accepted:
            self._changes = 0  # all began anew
        self._accepted = soil.accepted
        if soil.soil_changes > self._changes:
            if self._change is None:
                place = result.instant.vehicle
                self._change = _Change(time, soil.distance, wheel, place, self._last_pressure)
            self._change.until = soil.distance + self._turn
        elif self._change is None:
            self._last_pressure = soil.reference_pressure
        self._changes = soil.soil_changes
        if self._change is not None:
            self._change.after = soil.reference_pressure
            if soil.distance > self._change.until:
                self._note_change()
        self._newest[wheel] = result
        if time - self._looked >= _LOOK:
            self._note(statements(self._onboard, self._newest.values()), result, time)
            self._looked = time
        else:
            self._note(alarms(self._onboard, self._newest.values()), result, time)

    def _note(self, said: Iterable[Statement], result: Result, time: float) -> None:
        """Note what begins to be said."""
        for statement in said:
            before = self._said.get(statement.about, -math.inf)
            self._said[statement.about] = time
            if time - before > _PAUSE:
                way, place = result.travel, result.instant.vehicle
                self._event(time, way, statement.kind, statement.text, place)

    def _note_change(self) -> None:
        """Note a change of soil, once the estimate has not jumped for a turn of a wheel."""
        change, self._change = self._change, None
        if change is not None:
            self.soil_changes += 1
            text = (
                f"another soil: reference pressure {change.before / 1e3:.3g} kPa before,"
                f" {change.after / 1e3:.3g} kPa after (noticed by wheel {change.wheel})"
            )
            self._event(change.time, change.travel, "soil_change", text, change.place)

    @property
    def changing(self) -> bool:
        """Whether the soil has just changed, and may go on to do so."""
        return self._change is not None

    def finish(self) -> None:
        """Note what still goes on: nothing more will come."""
        self._note_change()
        for result in list(self._newest.values())[-1:]:
            time = (result.instant.stamp - self._start) / SECOND
            self._note(statements(self._onboard, self._newest.values()), result, time)
        self.events.sort(key=lambda event: event.time)

    def _event(self, *event: Any) -> None:
        if len(self.events) < _MOST_EVENTS:
            self.events.append(Event(*event))
        else:
            self.unlisted_events += 1

    def take_problems(self, log_time: int) -> None:
        """Note what could not be used since the last call."""
        time = (log_time - self._start) / SECOND
        for problem in self._onboard.take_problems():
            self.examples.setdefault((problem.stream, problem.reason), (problem.text, time))
            if problem.reason == "time_jump":
                self._note_change()
                self._newest.clear()
                self._event(time, self.travel, "time_jump", problem.text)
