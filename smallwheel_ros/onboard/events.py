# SPDX-License-Identifier: Apache-2.0
"""What happens on a drive, in words, with its time and place: changes of soil, alarms, jumps of time."""

from __future__ import annotations

import math
from typing import NamedTuple

from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.statements import alarms, statements

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


class DriveEvents:
    """Takes results and problems as they come, and notes what happened.

    examples: the first thing that could not be used, by stream and reason: in words, and its time.
    """

    def __init__(self, onboard: Onboard, start: int) -> None:
        self._onboard, self._start = onboard, start
        self.events: list[Event] = []
        self.examples: dict[tuple[str, str], tuple[str, float]] = {}
        self.travel = 0.0
        self._accepted = self._changes = 0
        self._turn = math.pi * max(wheel.diameter for wheel in onboard.settings.wheels)
        # A change of soil that is under way: until no more jumps come for a turn of a wheel.
        self._change: Event | None = None
        self._until = 0.0  # m of travel
        self._pressure_before = self._pressure = onboard.soil.reference_pressure
        self._newest: dict[str, Result] = {}
        self._said: dict[str, float] = {}  # what, without its numbers, and when last, s
        self._looked = -math.inf

    def add(self, result: Result) -> None:
        """Take one result."""
        self.travel = max(self.travel, result.travel)
        time = self._since(result.reading.stamp)
        self._watch_soil(result, time)
        self._newest[result.wheel] = result
        all_of_it = time - self._looked >= _LOOK
        if all_of_it:
            self._looked = time
        self._note(result, time, all_of_it)

    def _since(self, stamp: int) -> float:
        """Time since the bag's beginning, s."""
        return (stamp - self._start) / SECOND

    def _watch_soil(self, result: Result, time: float) -> None:
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

    def _note(self, result: Result, time: float, all_of_it: bool) -> None:
        """Note what begins to be said: all of it, or alarms alone."""
        say = statements if all_of_it else alarms
        for statement in say(self._onboard, self._newest.values()):
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
            self._note(result, self._since(result.reading.stamp), True)
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
