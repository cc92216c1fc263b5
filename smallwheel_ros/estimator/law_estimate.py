"""The soil's law as the filter believes it, in the terms of the field.

Its covariance is held in plain floats: it is asked for at every measurement.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]
DETERMINED = 0.5  # posterior over prior standard deviation
Row = tuple[float, float, float]  # weights of ln pressure, n and m in a sum of them


class LawCovariance(NamedTuple):
    """Covariance of (ln reference pressure, n, m): a symmetric matrix by rows from its diagonal on."""

    pp: float
    pn: float
    pm: float
    nn: float
    nm: float
    mm: float

    @classmethod
    def of(cls, covariance: Array) -> LawCovariance:
        """Take a matrix of shape (3, 3), which rounding may have left a little asymmetric."""
        (pp, pn, pm), (np_, nn, nm), (mp, mn, mm) = covariance.tolist()
        return cls(pp, 0.5 * (pn + np_), 0.5 * (pm + mp), nn, 0.5 * (nm + mn), mm)

    def array(self) -> Array:
        """Return the matrix, shape (3, 3)."""
        pp, pn, pm, nn, nm, mm = self
        return np.array((pp, pn, pm, pn, nn, nm, pm, nm, mm)).reshape(3, 3)

    def seen_as(self, first: Row, slope: float) -> LawCovariance:
        """Covariance where the first quantity is another sum of the three, and n counts otherwise.

        first: weights of the sum. slope: what one of the old n is in the new one.
        """
        pp, pn, pm, nn, nm, mm = self
        x, y, z = first
        by_p = x * pp + y * pn + z * pm
        by_n = x * pn + y * nn + z * nm
        by_m = x * pm + y * nm + z * mm
        whole = x * by_p + y * by_n + z * by_m
        return LawCovariance(whole, slope * by_n, by_m, slope * slope * nn, slope * nm, mm)

    def with_more(self, variance: float) -> LawCovariance:
        """Covariance where the first quantity is more uncertain by this variance."""
        pp, pn, pm, nn, nm, mm = self
        return LawCovariance(pp + variance, pn, pm, nn, nm, mm)

    def variance(self, row: Row) -> float:
        """Variance of a weighted sum of the three; rounding can leave one of zero below it."""
        pp, pn, pm, nn, nm, mm = self
        x, y, z = row
        return x * (x * pp + 2.0 * (y * pn + z * pm)) + y * (y * nn + 2.0 * z * nm) + z * z * mm

    def deviation(self, row: Row) -> float:
        """Standard deviation of a weighted sum of the three."""
        return math.sqrt(max(self.variance(row), 0.0))


@lru_cache(maxsize=64)
def modulus_row(reference_sinkage: float, reference_diameter: float, diameter: float) -> Row:
    """Give ln(k D^m) as a sum of (ln reference pressure, n, m); all in m."""
    return 1.0, -math.log(reference_sinkage), math.log(diameter / reference_diameter)


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
