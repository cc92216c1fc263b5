# SPDX-License-Identifier: Apache-2.0
"""What is expected of a wheel's next reading, and whether it shows that."""

from __future__ import annotations

import math
from statistics import median
from typing import NamedTuple

from scipy.special import chdtri

from smallwheel_ros.estimator.law_filter import LawFilter
from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.estimator.wheel_track import WheelTrack

# Of ln load, slip, speed (m/s) and pitch: sinkage is a straight line over so little.
_NEAR = 0.02
_FAR = 3.0  # deviations of the sensor from the newest readings: else the soil is another, not the reading


class _Expected(NamedTuple):
    """What a wheel was last expected to show (`shown`) and to sink (`sinkage`), m, and variances.

    of: what for, in steps of `_NEAR`. by_load: slope of both by ln load.
    """

    of: tuple[object, ...]
    log_load: float
    shown: float
    shown_variance: float
    by_load: float
    sinkage: float
    sinkage_variance: float


class ReadingJudge:
    """Compares readings with what was expected of them. share: of the good ones that are to pass."""

    def __init__(self, share: float) -> None:
        self._gate = float(chdtri(1, 1.0 - share))
        self._expected: dict[str, _Expected] = {}

    def judge(
        self, given: SinkageMeasurement, wheel: WheelTrack, law: LawFilter, missed: float
    ) -> UpdateResult:
        """Compare a reading with what was expected of it, before it counts.

        missed: see `LawFilter.sinkage`. Raises one of `NO_SINKAGE` where the model has none for it.
        """
        load, log_load_variance = wheel.load(given)
        log_load = math.log(load)
        steps = [
            round(value / _NEAR) if value is not None and math.isfinite(value) else None
            for value in (given.slip, given.speed, given.pitch, log_load)
        ]
        position = wheel.position_of(given)
        of = law, law.version, missed, given.diameter, given.width, given.contact, position, *steps
        expected = self._expected.get(given.wheel)
        if expected is None or expected.of != of:
            now = Segment.single(given, load, log_load_variance, position)
            expected = _Expected(of, log_load, *law.shown(now), *law.sinkage(now, missed))
            self._expected[given.wheel] = expected
        more = expected.by_load * (log_load - expected.log_load)
        true, variance = expected.sinkage + more, expected.sinkage_variance
        noise = wheel.reading_variance
        spread = expected.shown_variance + noise + law.scatter.additive
        if not math.isfinite(true + variance + spread):
            raise ArithmeticError("its uncertainty has no bounds")
        shown = expected.shown + more
        miss = given.sinkage - shown
        square = miss * miss / spread
        outcome, reason, message = Outcome.ACCEPTED, "accepted", ""
        if square > self._gate:
            recent = median([*wheel.recent, given.sinkage])
            if abs(given.sinkage - recent) > _FAR * math.sqrt(noise):
                outcome, reason = Outcome.OUTLIER, "gate"
                message = (
                    f"wheel '{given.wheel}': sinkage {1e3 * given.sinkage:.1f} mm, expected "
                    f"{1e3 * shown:.1f} +- {1e3 * math.sqrt(spread):.1f} mm"
                )
        return UpdateResult(outcome, reason, message, true, variance, miss, spread, square)
