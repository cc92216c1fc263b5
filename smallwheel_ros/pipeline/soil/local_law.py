# SPDX-License-Identifier: Apache-2.0
"""Versions of the soil's law, and the law under single wheels.

The law is (ln p, n, m): p is the pressure (Pa) at the soil's reference, which is `REFERENCE_SINKAGE` under a
wheel of `REFERENCE_DIAMETER`; n and m are the exponents of p = k z^n D^m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Array, Columns, Integers, Readings
from smallwheel_ros.pipeline.versions import Versions

from .filter import Law
from .identifiability import SoilEstimate, Variety, seen_as
from .limits import StateBelief
from .missing_effect import MissingEffect
from .model import (
    EACH,
    LAW,
    LEAST_SHARE,
    LOAD_SCALE,
    LOAD_ZERO,
    LOG_DEPTH,
    PASS,
    SIDE,
    WHEELS,
    LawModel,
    N,
)
from .scatter import MODEL_ERROR
from .stretches import WheelsUnderLoad


@dataclass(frozen=True)
class Version:
    """Estimate of the soil's law after some stretches of path, with everything that is reported of the soil.

    Attributes
    ----------
    model
        The model of the filter's state; None before any stretch.
    law, slopes
        (ln p, n, m) of the soil, as defined in this module, shape (3,), and their Jacobian with respect to
        the filter's state, shape (3, size).
    mean, covariance
        Mean and covariance of the filter's state (`soil/model.py`), shape (size,) and (size, size); before
        any stretch those of the law alone, with a size of 3.
    scatter
        Variance of ln k from place to place (1), and variance of sinkage in addition to that (m^2).
    number
        Number of the soil, in the order in which soils were found.
    settled, doubt
        See `SoilEstimate`.
    accepted, outliers
        Number of readings used, and of readings left out, so far.
    border, old
        Place along the vehicle's path at which this soil begins, m, -inf without a border; and number of the
        version that holds for wheels which have not reached it.
    variety
        Ranges of diameter and load over the stretches used.
    missing, missed_variance
        Alarm about an effect that the model lacks, or None, and the variance of ln k due to that effect;
        `scatter` includes it.
    changes
        Number of borders found so far.
    distance
        Path of the vehicle so far, m.
    """

    model: LawModel | None
    law: Array
    slopes: Array
    mean: Array
    covariance: Array
    scatter: tuple[float, float]
    number: int = 0
    settled: bool = False
    doubt: str = ""
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
    """Law of the soil under each wheel, in its rut and on its side, and the errors of its load cell.

    Attributes
    ----------
    law
        (ln p, n, m) under the wheel, (rows, 3).
    log_scale, zero
        ln of the load cell's scale, and its zero, N, (rows,).
    covariance
        Covariance of (ln p, n, m, -log_scale, -zero), (rows, 5, 5).
    """

    law: Array
    log_scale: Array
    zero: Array
    covariance: Array

    def net(self, shown: Array) -> Array:
        """Return loads shown by the cells, less the cells' zeros, but at least 0.15 of what is shown.

        Parameters
        ----------
        shown
            Loads shown by the cells, shape (rows,), N.
        """
        net: Array = np.maximum(shown - self.zero, LEAST_SHARE * shown)
        return net

    def load(self, shown: Array) -> Array:
        """Return the loads that the wheels carry, without the cells' errors of zero and scale.

        Parameters
        ----------
        shown
            Loads shown by the cells, shape (rows,), N.
        """
        return np.asarray(self.net(shown) * np.exp(-self.log_scale))

    def with_load(self, shown: Array) -> Array:
        """Return the covariance of (ln p, n, m, ln load), without the noise of the load, (rows, 4, 4).

        Parameters
        ----------
        shown
            Loads shown by the cells, shape (rows,), N.
        """
        turn = np.zeros((shown.size, 4, 5))
        turn[:, range(4), range(4)] = 1.0
        turn[:, 3, 4] = 1.0 / self.net(shown)
        whole: Array = np.einsum("rij,rjk,rlk->ril", turn, self.covariance, turn)
        return whole


def local_laws(
    versions: Versions[Version], wheels: Sequence[Wheel], rows: Readings, version: Integers
) -> LocalLaws:
    """Compute the law of the soil under the wheel at each row.

    Parameters
    ----------
    versions
        Versions of the soil's law.
    wheels
        All wheels.
    rows
        Readings, of which the wheel and its passes are used.
    version
        Number of each row's version, shape (rows,).

    Returns
    -------
    LocalLaws
        A row for each of `rows`.
    """
    count = version.size
    law, scale, zero = np.empty((count, 3)), np.zeros(count), np.zeros(count)
    covariance = np.zeros((count, 5, 5))
    side = np.sign([w.lateral_position for w in wheels])[rows.wheel]
    for number in np.unique(version).tolist():
        mine = np.flatnonzero(version == number)
        of = versions[number]
        if of.model is None:
            law[mine], covariance[mine, :3, :3] = of.mean, of.covariance
            continue
        x, model = of.mean, of.model
        reference = model.reference[0]
        passes, sides, own = rows.passes[mine], side[mine], WHEELS + EACH * rows.wheel[mine] + 1
        J = np.zeros((mine.size, 5, model.size))
        J[:, :LAW] = of.slopes
        # A wheel that sinks deeper by a factor under the same load is on so much softer soil.
        J[:, 0, SIDE] += sides
        J[:, 0, PASS] -= (x[N] + 0.5) * passes
        J[:, 0, N] -= x[PASS] * passes
        J[:, LAW, LOAD_SCALE], J[:, LAW + 1, LOAD_ZERO] = -1.0, -reference
        J[np.arange(mine.size), LAW, own] = -1.0
        law[mine] = of.law
        law[mine, 0] += sides * x[SIDE] - (x[N] + 0.5) * x[PASS] * passes
        scale[mine], zero[mine] = x[LOAD_SCALE] + x[own], x[LOAD_ZERO] * reference
        covariance[mine] = J @ of.covariance @ J.transpose(0, 2, 1)
        covariance[mine, 0, 0] += of.missed_variance
    return LocalLaws(law, scale, zero, covariance)


def sinkages(
    versions: Versions[Version], rows: WheelsUnderLoad, version: Integers
) -> tuple[Array, Array]:
    """Predict the sinkage of wheels, without their sensors' errors, and its variance.

    Parameters
    ----------
    versions
        Versions of the soil's law.
    rows
        Wheels with their loads, slips and passes.
    version
        Number of each row's version, shape (rows,).

    Returns
    -------
    sinkage, variance : ndarray
        Shape (rows,), m and m^2; the variance is due to law, model, place, load, rut and slip. NaN for
        versions before any stretch.
    """
    value, variance = np.full((2, version.size), np.nan)
    of = [versions[number] for number in version.tolist()]
    for model in {id(one.model): one.model for one in of if one.model is not None}.values():
        mine = np.flatnonzero([one.model is model for one in of])
        mean = np.array([of[i].mean for i in mine.tolist()])
        asked = rows.take(mine)
        shown = model.sinkage(mean, asked)
        law = np.empty(mine.size)
        numbers, first = np.unique(version[mine], return_index=True)
        for number, row in zip(numbers.tolist(), mine[first].tolist(), strict=True):
            same = version[mine] == number
            H = shown.H[same]
            law[same] = np.einsum("ri,ij,rj->r", H, of[row].covariance, H)
        places, still = np.array([of[i].scatter for i in mine.tolist()]).T
        by_place = shown.by_load**2 * (places + asked.load_variance)
        own = by_place + (MODEL_ERROR * shown.value) ** 2 + shown.doubt + still
        value[mine], variance[mine] = shown.value, law + own
    return value, variance


def constants(law: Array) -> tuple[float, float, float]:
    """Return the constants of p = k z^n D^m.

    Parameters
    ----------
    law
        (ln p, n, m), shape (3,).

    Returns
    -------
    k, n, m : float
        Pa/m^(n+m), 1, 1.
    """
    log_pressure, n, m = law.tolist()
    return math.exp(log_pressure - n * LOG_DEPTH - m * math.log(REFERENCE_DIAMETER)), n, m


def law_of(version: Version) -> Law:
    """Return mean and covariance of (ln p, n, m), shape (3,) and (3, 3).

    Parameters
    ----------
    version
        Version of the soil's law.
    """
    return version.law, version.slopes @ version.covariance @ version.slopes.T


class Reported:
    """Converts versions of a soil's law to estimates that state the pressure under a given wheel diameter.

    Parameters
    ----------
    prior
        Prior of the soil, whose covariance the estimates include for comparison.
    diameter
        Wheel diameter for which estimates state the pressure at `REFERENCE_SINKAGE`, m.
    """

    def __init__(self, prior: SoilPrior, diameter: float) -> None:
        self._at = REFERENCE_SINKAGE, diameter
        self._turn = np.eye(3)  # of (ln pressure, n, m)
        self._turn[0, 2] = math.log(diameter / REFERENCE_DIAMETER)
        self._prior = seen_as(self._turn, prior.law[1])

    def estimate(self, version: Version) -> SoilEstimate:
        """Return the estimate of the soil at a version."""
        law, covariance = law_of(version)
        more = np.diag([version.missed_variance, 0.0, 0.0])
        pressure, n, m = (self._turn @ law).tolist()
        sinkage, diameter = self._at
        k = math.exp(pressure - n * math.log(sinkage) - m * math.log(diameter))
        state = None
        if version.model is not None:
            slopes = self._turn @ version.slopes
            state = StateBelief(slopes, version.mean, version.covariance)
        return SoilEstimate(
            k, n, m, pressure, seen_as(self._turn, covariance + more), self._prior, *self._at,
            variety=version.variety, accepted=version.accepted, outliers=version.outliers,
            soil_changes=version.changes, distance=version.distance,
            missing_effect=version.missing, settled=version.settled, doubt=version.doubt, state=state,
        )  # fmt: skip
