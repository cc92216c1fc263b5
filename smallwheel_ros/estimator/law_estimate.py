"""The soil's law as the filter believes it, in the terms of the field."""

from __future__ import annotations

import math
from typing import NamedTuple

from smallwheel_ros.estimator.law_covariance import LawCovariance, Row
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE


class LawEstimate(NamedTuple):
    """k, n and m, and ln of the pressure at the reference to report at; SI units.

    covariance: of (log_reference_pressure, n, m). prior: the same before the first measurement.
    """

    k: float
    n: float
    m: float
    log_reference_pressure: float
    covariance: LawCovariance
    prior: LawCovariance


def law_estimate(
    state: Row, covariance: LawCovariance, prior: LawCovariance, reference: tuple[float, float]
) -> LawEstimate:
    """Put the filter's state (ln pressure, n, m) into the terms of the field.

    state, covariance, prior: at the reference of `soil`. reference: sinkage and diameter (m) to
    report at.
    """
    pressure_log, n, m = state
    up, across = math.log(reference[0]), math.log(reference[1])
    deeper, larger = up - math.log(REFERENCE_SINKAGE), across - math.log(REFERENCE_DIAMETER)
    pressure_log += n * deeper + m * larger
    to_report = (1.0, deeper, larger)
    return LawEstimate(
        math.exp(pressure_log - n * up - m * across),
        n,
        m,
        pressure_log,
        covariance.seen_as(to_report, 1.0),
        prior.seen_as(to_report, 1.0),
    )
