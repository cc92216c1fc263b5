# SPDX-License-Identifier: Apache-2.0
"""A wheel of the vehicle as the estimator follows it, and what is expected of its readings."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from statistics import median
from typing import Any, NamedTuple

from smallwheel_ros.estimator.law_filter import LawFilter
from smallwheel_ros.estimator.law_model import Shown
from smallwheel_ros.estimator.scatter import MODEL_ERROR
from smallwheel_ros.estimator.segment import Segment, SegmentCollector
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel

_STANDS = 0.02  # m: a wheel that has moved less stands in the rut that it made
# Of ln load, slip, speed (m/s) and pitch: sinkage is a straight line over so little.
_NEAR = 0.02
_RECENT = 9  # readings, for the median that an outlier is far from
_LEAST_SINKAGE = 1e-9  # m: the model's of a wheel that has no weight to speak of


class Expected(NamedTuple):
    """What a wheel was last expected to show (`shown`) and to sink (`sinkage`), m, and variances.

    of: what for, in steps of `_NEAR`. by_load: slope of both by ln load.
    """

    of: tuple[object, ...]
    log_load: float
    shown: float
    shown_variance: float
    sinkage: float
    sinkage_variance: float
    by_load: float


class WheelTrack(SegmentCollector):
    """A wheel: the collector of its readings, its newest reading, and what is expected of the next.

    at: m along the vehicle's path. slip: the newest that was known, at slip_at on the wheel's own
    path.
    """

    time = distance = path = -math.inf
    at = slip_at = 0.0
    slip: float | None = None
    expected: Expected | None = None

    def __init__(self, *arguments: Any, **names: Any) -> None:
        super().__init__(*arguments, **names)
        self.recent: deque[float] = deque(maxlen=_RECENT)

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
        closed = self.add(given)
        self.time, self.distance, self.path = given.time, given.distance, given.own_path
        self.at = given.distance + self.ahead
        if given.slip is not None and math.isfinite(given.slip):
            self.slip, self.slip_at = given.slip, self.path
        self.recent.append(given.sinkage)
        return closed

    def judge(
        self, given: SinkageMeasurement, law: LawFilter, missed: float, gate: float
    ) -> UpdateResult:
        """Compare a reading with what was expected of it, before it counts.

        missed: see `sinkage_of`. gate: squared normalised innovation from which on it is an outlier.
        Raises one of `NO_SINKAGE` where the model has none for it.
        """
        load, load_variance = self.load(given)
        log_load = math.log(load)
        steps = [
            round(value / _NEAR) if value is not None and math.isfinite(value) else None
            for value in (given.slip, given.speed, given.pitch, log_load)
        ]
        of = law, law.version, missed, given.diameter, given.width, given.contact, *steps
        if self.expected is None or self.expected.of != of:
            now = Segment.of_reading(given, load, load_variance, self)
            self.expected = Expected(of, log_load, *_expect(now, law, missed))
        expected = self.expected
        more = expected.by_load * (log_load - expected.log_load)
        true, variance = expected.sinkage + more, expected.sinkage_variance
        noise = self.reading_variance
        spread = expected.shown_variance + noise + law.scatter.additive
        if not math.isfinite(true + variance + spread):
            raise ArithmeticError("its uncertainty has no bounds")
        shown = expected.shown + more
        miss = given.sinkage - shown
        square = miss * miss / spread
        outcome, reason, message = Outcome.ACCEPTED, "accepted", ""
        if square > gate:
            recent = median([*self.recent, given.sinkage])
            if abs(given.sinkage - recent) > 3.0 * math.sqrt(noise):
                outcome, reason = Outcome.OUTLIER, "gate"
                message = (
                    f"wheel '{given.wheel}': sinkage {1e3 * given.sinkage:.1f} mm, expected "
                    f"{1e3 * shown:.1f} +- {1e3 * math.sqrt(spread):.1f} mm"
                )
        return UpdateResult(outcome, reason, message, true, variance, miss, spread, square)


def _expect(
    now: Segment, law: LawFilter, missed: float
) -> tuple[float, float, float, float, float]:
    """The last five of `Expected`."""
    _, shown = law.linearised(now)
    P = law.most_likely.P
    spread = float(shown.row @ P @ shown.row) + _place_variance(law, shown, now)
    sinkage, variance = sinkage_of(law, now, missed)
    return shown.value, spread, sinkage, variance, shown.by_load


def wheels_ahead(wheel: Wheel, wheels: Iterable[Wheel]) -> list[Wheel]:
    """Wheels that run ahead and whose tracks overlap with this one's."""
    return [
        other
        for other in wheels
        if other.contact == ROLLING == wheel.contact
        and other.longitudinal_position > wheel.longitudinal_position
        and abs(other.lateral_position - wheel.lateral_position) < 0.5 * (wheel.width + other.width)
    ]


def sinkage_of(law: LawFilter, now: Segment, missed: float) -> tuple[float, float]:
    """The sinkage of a wheel (m) and its variance: of the law, the place and the load.

    missed: variance of ln k that an effect takes which the model lacks. Raises one of
    `NO_SINKAGE` where the model has none.
    """
    shown = law.model.sinkage(law.mean, now)
    if not shown.value > _LEAST_SINKAGE:
        raise ArithmeticError(f"it is {shown.value:g} m")
    spread = float(shown.row @ law.covariance @ shown.row) + shown.by_load**2 * missed
    return shown.value, spread + _place_variance(law, shown, now)


def _place_variance(law: LawFilter, shown: Shown, now: Segment) -> float:
    """Variance of the sinkage at one place (m^2) by soil, load and what the law misses."""
    by_place = shown.by_load**2 * (law.scatter.soil + now.load_variance)
    return by_place + (MODEL_ERROR * shown.value) ** 2
