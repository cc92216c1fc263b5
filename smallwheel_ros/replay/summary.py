"""What a replay found out, small however long the drive: counts, events, a thinned course."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from smallwheel_ros.onboard.mobility import Status
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.streams import SECOND

_MOST_POINTS = 2000  # of each wheel
_MOST_EVENTS = 200

# Of a point of the course: its names, and the columns of the table of estimates that it is from.
_FROM = {
    "time": "time",
    "x": "x",
    "y": "y",
    "travel": "travel",
    "sinkage": "sinkage_measured",
    "predicted": "sinkage_predicted",
    "predicted_std": "sinkage_predicted_standard_deviation",
    "slip": "slip",
    "load": "load",
    "margin": "mobility_margin",
    "margin_std": "mobility_margin_standard_deviation",
    "pull": "drawbar_pull",
    "pull_std": "drawbar_pull_standard_deviation",
    "k": "soil_k",
    "k_std": "soil_k_standard_deviation",
    "n": "soil_n",
    "n_std": "soil_n_standard_deviation",
    "m": "soil_m",
    "m_std": "soil_m_standard_deviation",
    "pressure": "soil_reference_pressure",
    "pressure_std": "soil_reference_pressure_standard_deviation",
}
# NaN where not known; SI units, time in s since the bag's beginning. used: 1 or 0.
COURSE = (*_FROM, "used")


@dataclass
class Course:
    """Every so many-th result of one wheel, so that their number stays bounded."""

    every: int = 1
    seen: int = 0
    points: list[tuple[float, ...]] = field(default_factory=list)

    def wants(self) -> bool:
        """Whether the next result is to be kept; call once for each."""
        self.seen += 1
        return (self.seen - 1) % self.every == 0

    def add(self, point: tuple[float, ...]) -> None:
        """Keep one result, by the columns of `COURSE`."""
        self.points.append(point)
        if len(self.points) >= 2 * _MOST_POINTS:
            del self.points[1::2]
            self.every *= 2


@dataclass
class WheelCounts:
    """How many results of a wheel had what: with a load near, with slip, used for the soil."""

    results: int = 0
    with_sinkage: int = 0
    with_load: int = 0
    with_slip: int = 0
    used: int = 0
    squares: float = 0.0  # of measured minus predicted sinkage, of the used ones, m^2

    @property
    def rms(self) -> float | None:
        """Root mean square of measured minus predicted sinkage of those used, m."""
        return (self.squares / self.used) ** 0.5 if self.used else None


@dataclass(frozen=True)
class Event:
    """Something that happened: time in s since the bag's beginning, way in m, and in words."""

    time: float
    travel: float
    kind: str
    text: str


@dataclass
class Drop:
    """Messages of one input that could not be used for one reason, and the first one in words."""

    count: int = 0
    example: str = ""
    first_time: float | None = None


@dataclass
class _Change:
    """A change of soil that is under way: until no more jumps come for a turn of a wheel."""

    time: float
    travel: float
    wheel: str
    before: float  # reference pressures, Pa
    pressure: float = 0.0
    until: float = 0.0


class DriveSummary:
    """Takes results and problems as they come."""

    def __init__(self, onboard: Onboard, start: int) -> None:
        self._onboard, self._start = onboard, start
        names = [wheel.name for wheel in onboard.settings.wheels]
        self.courses = {name: Course() for name in names}
        self.wheels = {name: WheelCounts() for name in names}
        self.statuses: Counter[str] = Counter()
        self.events: list[Event] = []
        self.unlisted_events = 0
        self._examples: dict[tuple[str, str], tuple[str, float]] = {}
        self._accepted = self._changes = 0
        self._last_pressure = onboard.soil.reference_pressure
        self._turn = math.pi * max(wheel.diameter for wheel in onboard.settings.wheels)
        self._change: _Change | None = None
        self._digging: set[str] = set()
        self._missing = ""
        self.soil_changes = 0
        self.travel = 0.0

    def add(self, result: Result, row: Mapping[str, Any]) -> None:
        """Take one result, and its row of the table (`rows.columns`)."""
        found, soil = result.mobility, result.soil
        counts = self.wheels[found.wheel]
        time = (found.stamp - self._start) / SECOND
        if soil.accepted < self._accepted:
            self._changes = 0
        self._accepted = soil.accepted
        used = (
            found.sinkage_measured is not None
            and found.load is not None
            and found.status is not Status.REJECTED
        )
        self.travel = max(self.travel, soil.distance)
        self.statuses[found.status.name] += 1
        counts.results += 1
        counts.with_sinkage += found.sinkage_measured is not None
        counts.with_load += found.load is not None
        counts.with_slip += found.slip is not None
        if used:
            counts.used += 1
            if found.sinkage_measured is not None and found.sinkage_predicted is not None:
                gap = found.sinkage_measured.value - found.sinkage_predicted.value
                counts.squares += gap**2
        self._watch(result, time)
        course = self.courses[found.wheel]
        if course.wants():
            course.add(_point(row, used))

    def _watch(self, result: Result, time: float) -> None:
        """Note changes of soil, wheels that begin to dig in, and effects that the model lacks."""
        found, soil = result.mobility, result.soil
        if soil.soil_changes > self._changes:
            if self._change is None:
                self._change = _Change(time, soil.distance, found.wheel, self._last_pressure)
            self._change.until = soil.distance + self._turn
        elif self._change is None:
            self._last_pressure = soil.reference_pressure
        self._changes = soil.soil_changes
        if self._change is not None:
            self._change.pressure = soil.reference_pressure
            if soil.distance > self._change.until:
                self._note_change()
        if found.digging_in and found.wheel not in self._digging:
            text = f"wheel {found.wheel} digs itself in: slip and sinkage grow, it slows down"
            self._event(time, soil.distance, "digging_in", text)
            self._digging.add(found.wheel)
        elif not found.digging_in:
            self._digging.discard(found.wheel)
        alarm = soil.missing_effect
        if alarm is not None and alarm.effect != self._missing:
            self._event(time, soil.distance, "missing_effect", alarm.message)
        self._missing = alarm.effect if alarm is not None else ""

    def _note_change(self) -> None:
        """Note a change of soil, once the estimate has not jumped for a turn of a wheel."""
        change, self._change = self._change, None
        if change is None:
            return
        self.soil_changes += 1
        self._event(
            change.time,
            change.travel,
            "soil_change",
            f"another soil: reference pressure {change.before / 1e3:.3g} kPa before,"
            f" {change.pressure / 1e3:.3g} kPa after (noticed by wheel {change.wheel})",
        )

    @property
    def changing(self) -> bool:
        """Whether the soil has just changed, and may go on to do so."""
        return self._change is not None

    def finish(self) -> None:
        """Note what still goes on: nothing more will come."""
        self._note_change()
        self.events.sort(key=lambda event: event.time)

    def _event(self, time: float, travel: float, kind: str, text: str) -> None:
        if len(self.events) < _MOST_EVENTS:
            self.events.append(Event(time, travel, kind, text))
        else:
            self.unlisted_events += 1

    def take_problems(self, log_time: int) -> None:
        """Note what could not be used since the last call."""
        time = (log_time - self._start) / SECOND
        for problem in self._onboard.take_problems():
            self._examples.setdefault((problem.stream, problem.reason), (problem.text, time))
            if problem.reason == "time_jump":
                self._note_change()
                self._event(time, self.travel, "time_jump", problem.text)

    def drops(self) -> dict[tuple[str, str], Drop]:
        """Return what could not be used, by stream and reason."""
        found = {}
        for key, count in sorted(self._onboard.counts.items()):
            text, time = self._examples.get(key, ("", None))
            found[key] = Drop(count, text, time)
        return found


def _point(row: Mapping[str, Any], used: bool) -> tuple[float, ...]:
    cells = (row[name] for name in _FROM.values())
    return (*(math.nan if cell is None else cell for cell in cells), float(used))


def course_columns(courses: Sequence[Course]) -> dict[str, list[float]]:
    """Return the points of several courses by column, in the order of time."""
    points = sorted(point for course in courses for point in course.points)
    return {name: [point[i] for point in points] for i, name in enumerate(COURSE)}
