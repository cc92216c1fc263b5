"""What is expected of a wheel's reading before it counts, and whether the reading fits that."""

from __future__ import annotations

import math
from statistics import median

from smallwheel_ros.estimator.law_filter import LawFilter
from smallwheel_ros.estimator.law_model import Shown
from smallwheel_ros.estimator.scatter import MODEL_ERROR
from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.estimator.sinkage_measurement import Outcome, SinkageMeasurement, UpdateResult
from smallwheel_ros.estimator.wheel_track import Expected, WheelTrack, instant_segment

_LEAST_SINKAGE = 1e-9  # m: the model's of a wheel that has no weight to speak of


def sinkage_of(law: LawFilter, now: Segment, passes: float, missed: float) -> tuple[float, float]:
    """The sinkage of a wheel (m) and its variance: of the law, the place and the load.

    missed: variance of ln k that an effect takes which the model lacks. Raises ArithmeticError or
    ValueError where the model has no sinkage.
    """
    shown = law.model.sinkage(law.mean, now, passes)
    spread = float(shown.row @ law.covariance @ shown.row)
    if not shown.value > _LEAST_SINKAGE:
        raise ArithmeticError(f"it is {shown.value:g} m")
    by_place = _place_variance(law, shown, now)
    return shown.value, spread + shown.by_load**2 * missed + by_place


def judge(
    given: SinkageMeasurement, wheel: WheelTrack, law: LawFilter, missed: float, gate: float
) -> UpdateResult:
    """Compare a reading with what was expected of it, before it counts.

    missed: see `sinkage_of`. gate: squared normalised innovation from which on it is an outlier.
    Raises ArithmeticError or ValueError for one that the model has no sinkage for.
    """
    expected, log_load = _expected(given, wheel, law, missed)
    more = expected.by_load * log_load
    shown, true = expected.shown + more, expected.sinkage + more
    noise = wheel.collector.reading_variance
    spread = expected.shown_variance + noise + law.scatter.additive
    variance = expected.sinkage_variance
    miss = given.sinkage - shown
    square = miss * miss / spread
    outcome, reason, message = Outcome.ACCEPTED, "accepted", ""
    if square > gate:
        recent = median([*wheel.recent, given.sinkage])
        if abs(given.sinkage - recent) > 3.0 * math.sqrt(noise):
            outcome, reason = Outcome.OUTLIER, "gate"
            message = (
                f"wheel '{given.wheel}': sinkage {1e3 * given.sinkage:.1f} mm, expected "
                f"{1e3 * shown:.1f} +- {1e3 * math.sqrt(spread):.1f} mm"
            )
    if not math.isfinite(true + variance + spread):
        raise ArithmeticError("its uncertainty has no bounds")
    return UpdateResult(outcome, reason, message, true, variance, miss, spread, square)


def _expected(
    given: SinkageMeasurement, wheel: WheelTrack, law: LawFilter, missed: float
) -> tuple[Expected, float]:
    """What was expected of a reading, and by how much its ln load is above that of it."""
    place, known = wheel.place, wheel.expected
    load, load_variance = wheel.collector.load(given)
    log_load = math.log(load)
    if known is not None and known.holds(law.version, log_load, given):
        return known, log_load - known.log_load
    now = instant_segment(given, load, load_variance)
    kalman = law.most_likely
    shown = law.model.h(law.model.mean + kalman.x, now, place.passes, place.index)
    true, variance = sinkage_of(law, now, place.passes, missed)
    wheel.expected = Expected(
        law.version,
        log_load,
        given,
        shown.value,
        float(shown.row @ kalman.P @ shown.row) + _place_variance(law, shown, now),
        true,
        variance,
        shown.by_load,
    )
    return wheel.expected, 0.0


def _place_variance(law: LawFilter, shown: Shown, now: Segment) -> float:
    """Variance of the sinkage at one place (m^2) by soil, load and what the law misses."""
    by_place = shown.by_load**2 * (law.scatter.soil + now.load_variance)
    return by_place + (MODEL_ERROR * shown.value) ** 2
