# SPDX-License-Identifier: Apache-2.0
"""The law as it is believed from a stretch on, and under single wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

from .identifiability import SoilEstimate, Variety, seen_as
from .law import LEAST_SHARE, LOG_DEPTH, LawModel
from .missing_effect import MissingEffect
from .soil_filter import Law
from .tables import Array, Columns


@dataclass(frozen=True)
class Version:
    """The law as it is believed from a stretch on. number: of the soil, as they were met.

    law, slopes: ln pressure at the soil's reference, n and m, and their slopes by mean. mean, covariance: of
    the soil's numbers (`law`); before any stretch of the law alone: then model is None. scatter: variances of
    ln k and of sinkage from place to place. border: m along the vehicle's path, behind which wheels are on
    version `old` still. variety: of the stretches used. missing: effect that the model misses;
    missed_variance: of ln k by that, in scatter, too. outliers: readings left out; changes: of soil found;
    distance: m, of the vehicle: all up to here.
    """

    model: LawModel | None
    law: Array
    slopes: Array
    mean: Array
    covariance: Array
    scatter: tuple[float, float]
    number: int = 0
    settled: bool = False
    accepted: int = 0
    border: float = -math.inf
    old: int = 0
    variety: Variety = field(default_factory=Variety)
    missing: MissingEffect | None = None
    missed_variance: float = 0.0
    outliers: int = 0
    changes: int = 0
    distance: float = 0.0


@dataclass(frozen=True)
class LocalLaws(Columns):
    """The law under wheels, with ruts and sides, and their load cells.

    law: ln pressure at the soil's reference, n and m, (rows, 3). log_scale, zero: of the load cell; N.
    covariance: of the law, and of ln load by scale and, per N^-1, by zero, (rows, 5, 5).
    """

    law: Array
    log_scale: Array
    zero: Array
    covariance: Array

    def net(self, shown: Array) -> Array:
        """Loads that are shown (N) without the cells' zeros."""
        net: Array = np.maximum(shown - self.zero, LEAST_SHARE * shown)
        return net

    def load(self, shown: Array) -> Array:
        """The loads themselves, N."""
        return np.asarray(self.net(shown) * np.exp(-self.log_scale))

    def with_load(self, shown: Array) -> Array:
        """Covariance of (ln p, n, m, ln load) but for the load's noise, (rows, 4, 4)."""
        turn = np.zeros((len(self), 4, 5))
        turn[:, range(4), range(4)] = 1.0
        turn[:, 3, 4] = 1.0 / self.net(shown)
        whole: Array = np.einsum("rij,rjk,rlk->ril", turn, self.covariance, turn)
        return whole


def constants(law: Array) -> tuple[float, float, float]:
    """k (Pa/m^(n+m)), n and m of ln pressure at the soil's reference, n and m."""
    log_pressure, n, m = law.tolist()
    return math.exp(log_pressure - n * LOG_DEPTH - m * math.log(REFERENCE_DIAMETER)), n, m


def law_of(version: Version) -> Law:
    """Mean and covariance of (ln pressure at the soil's reference, n, m)."""
    return version.law, version.slopes @ version.covariance @ version.slopes.T


class Reported:
    """Reports laws at the reference sinkage and a diameter (m), the prior's covariance too."""

    def __init__(self, prior: SoilPrior, diameter: float) -> None:
        self._at = REFERENCE_SINKAGE, diameter
        self._turn = np.eye(3)  # of (ln pressure, n, m)
        self._turn[0, 2] = math.log(diameter / REFERENCE_DIAMETER)
        self._prior = seen_as(self._turn, prior.law[1])

    def estimate(self, version: Version) -> SoilEstimate:
        """The soil as it was believed."""
        law, covariance = law_of(version)
        more = np.diag([version.missed_variance, 0.0, 0.0])
        pressure, n, m = (self._turn @ law).tolist()
        sinkage, diameter = self._at
        k = math.exp(pressure - n * math.log(sinkage) - m * math.log(diameter))
        return SoilEstimate(
            k, n, m, pressure, seen_as(self._turn, covariance + more), self._prior, *self._at,
            variety=version.variety, accepted=version.accepted, outliers=version.outliers,
            soil_changes=version.changes, distance=version.distance,
            missing_effect=version.missing, settled=version.settled,
        )  # fmt: skip
