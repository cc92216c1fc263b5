"""A wheel of the vehicle as the estimator follows it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from smallwheel_ros.estimator.law_member import WheelPlace
from smallwheel_ros.estimator.segment import Segment, SegmentCollector
from smallwheel_ros.estimator.sinkage_measurement import SinkageMeasurement
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel

_STANDS = 0.02  # m: a wheel that has moved less stands in the rut that it made
# Of ln load, slip, speed (m/s) and pitch: sinkage is a straight line over so little.
_NEAR = 0.02
_RECENT = 9  # readings, for the median that an outlier is far from


@dataclass(frozen=True)
class Expected:
    """What was last expected of a wheel's readings, and what for.

    shown: of the sensor, m; sinkage: of the wheel, m. by_load: slope of both by ln load.
    shown_variance: by law and place; sinkage_variance. m^2.
    """

    version: int  # of the law
    log_load: float
    given: SinkageMeasurement
    shown: float
    shown_variance: float
    sinkage: float
    sinkage_variance: float
    by_load: float

    def holds(self, version: int, log_load: float, given: SinkageMeasurement) -> bool:
        """Whether it holds for a reading too, but for a little more or less load."""
        was = self.given
        if version != self.version or abs(log_load - self.log_load) > _NEAR:
            return False
        if (was.diameter, was.width, was.contact) != (given.diameter, given.width, given.contact):
            return False
        return (
            abs(was.pitch - given.pitch) <= _NEAR
            and _is_near(was.slip, given.slip)
            and _is_near(was.speed, given.speed)
        )


def _known(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def _is_near(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is other
    return abs(one - other) <= _NEAR


@dataclass(eq=False)
class WheelTrack:
    """A wheel: its place in the state, its collector, and its newest reading.

    ahead: m that it is ahead of the vehicle's middle. leads: no wheel runs ahead in its track. at: m
    along the vehicle's path. slip: the newest that was known, at slip_at on the wheel's own path.
    """

    collector: SegmentCollector
    place: WheelPlace
    ahead: float
    leads: bool
    time: float = -math.inf
    distance: float = -math.inf
    path: float = -math.inf
    at: float = 0.0
    slip: float | None = None
    slip_at: float = 0.0
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT))
    expected: Expected | None = None

    def out_of_order(self, given: SinkageMeasurement) -> tuple[str, str] | None:
        """Reason and message if a reading is not behind the newest one."""
        if given.time <= self.time:
            return "time_backwards", (
                f"wheel '{given.wheel}': time {given.time:.6f} s is not after the last one, "
                f"{self.time:.6f} s"
            )
        if given.distance < self.distance or given.own_path < self.path:
            return "distance_backwards", (
                f"wheel '{given.wheel}': distance {given.distance:g} m is less than the last one, "
                f"{self.distance:g} m"
            )
        return None

    def in_its_rut(self, given: SinkageMeasurement) -> SinkageMeasurement:
        """A wheel that stands is as deep as it dug itself when it last rolled: so is its slip."""
        if given.slip is not None or self.slip is None or given.own_path - self.slip_at > _STANDS:
            return given
        return replace(given, slip=self.slip)

    def follow(self, given: SinkageMeasurement) -> Segment | None:
        """Take a reading; return the segment that it closes, if any."""
        closed = self.collector.add(given)
        self.time, self.distance, self.path = given.time, given.distance, given.own_path
        self.at = given.distance + self.ahead
        slip = _known(given.slip)
        if slip is not None:
            self.slip, self.slip_at = slip, self.path
        self.recent.append(given.sinkage)
        return closed


def wheels_ahead(wheel: Wheel, wheels: Iterable[Wheel]) -> list[Wheel]:
    """Wheels that run ahead and whose tracks overlap with this one's."""
    return [
        other
        for other in wheels
        if other.contact == ROLLING == wheel.contact
        and other.longitudinal_position > wheel.longitudinal_position
        and abs(other.lateral_position - wheel.lateral_position) < 0.5 * (wheel.width + other.width)
    ]


def instant_segment(given: SinkageMeasurement, load: float, load_variance: float) -> Segment:
    """A segment of one reading, to predict by. load: N; load_variance: of its logarithm."""
    return Segment(
        wheel=given.wheel,
        time=given.time,
        distance=given.distance,
        place=given.distance,
        sinkage=given.sinkage,
        sinkage_variance=0.0,
        load=load,
        load_variance=load_variance,
        load_rate=0.0,
        slip=_known(given.slip),
        speed=_known(given.speed),
        pitch=given.pitch,
        diameter=given.diameter,
        width=given.width,
        contact=given.contact,
        count=1,
        dropped=0,
        stuck=False,
    )
