# SPDX-License-Identifier: Apache-2.0
"""What a replay found out, small however long the drive: counts and events."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.streams import SECOND

_MOST_EVENTS = 200


class Event(NamedTuple):
    """Something that happened: time in s since the bag's beginning, way in m, and in words."""

    time: float
    travel: float
    kind: str
    text: str


@dataclass
class _Change:
    """A change of soil that is under way: until no more jumps come for a turn of a wheel."""

    time: float
    travel: float
    wheel: str
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
        self._digging: set[str] = set()
        self._missing = ""

    def add(self, result: Result) -> None:
        """Take one result."""
        instant = result.instant
        measured, predicted = instant.sinkage, result.sinkage_predicted
        loaded = instant.load is not None
        used = measured is not None and loaded and result.status is not Status.REJECTED
        self.travel = max(self.travel, result.soil.distance)
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
        """Note changes of soil, wheels that begin to dig in, and effects that the model lacks."""
        wheel, soil = result.wheel, result.soil
        if soil.accepted < self._accepted:
            self._changes = 0  # all began anew
        self._accepted = soil.accepted
        if soil.soil_changes > self._changes:
            if self._change is None:
                self._change = _Change(time, soil.distance, wheel, self._last_pressure)
            self._change.until = soil.distance + self._turn
        elif self._change is None:
            self._last_pressure = soil.reference_pressure
        self._changes = soil.soil_changes
        if self._change is not None:
            self._change.after = soil.reference_pressure
            if soil.distance > self._change.until:
                self._note_change()
        if not result.digging_in:
            self._digging.discard(wheel)
        elif wheel not in self._digging:
            self._digging.add(wheel)
            text = f"wheel {wheel} digs itself in: slip and sinkage grow, it slows down"
            self._event(time, soil.distance, "digging_in", text)
        alarm = soil.missing_effect
        if alarm is not None and alarm.effect != self._missing:
            self._event(time, soil.distance, "missing_effect", alarm.message)
        self._missing = alarm.effect if alarm is not None else ""

    def _note_change(self) -> None:
        """Note a change of soil, once the estimate has not jumped for a turn of a wheel."""
        change, self._change = self._change, None
        if change is not None:
            self.soil_changes += 1
            text = (
                f"another soil: reference pressure {change.before / 1e3:.3g} kPa before,"
                f" {change.after / 1e3:.3g} kPa after (noticed by wheel {change.wheel})"
            )
            self._event(change.time, change.travel, "soil_change", text)

    @property
    def changing(self) -> bool:
        """Whether the soil has just changed, and may go on to do so."""
        return self._change is not None

    def finish(self) -> None:
        """Note what still goes on: nothing more will come."""
        self._note_change()
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
                self._event(time, self.travel, "time_jump", problem.text)
