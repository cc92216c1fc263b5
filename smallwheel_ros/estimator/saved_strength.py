"""The strength's part of a saved soil (see `saved_state`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.strength_estimate import PullVariety

Array = NDArray[np.float64]

_SIZE = 4
_LARGEST = 1e12  # of any number: the squares of forces of a vehicle of 100 t stay below
_TOLERANCE = 1e-9  # relative, of the prior's numbers


@dataclass(frozen=True)
class StrengthRecord:
    """A strength's filter without the spots: (cohesion, friction angle, ln kappa, other share).

    mean: of the prior, shape (4,); deviation from it. prior, covariance: shape (4, 4). exponent: the
    law's n that the other share belongs to, and what that falls by where n rises by 1. scattered:
    sums (N^2) for the scatter of the thrust, and the newest load (N).
    """

    mean: Array
    prior: Array
    deviation: Array
    covariance: Array
    exponent: tuple[float, float]
    scattered: tuple[float, float, float]
    variety: PullVariety
    accepted: int

    def made_with(self, other: StrengthRecord) -> bool:
        """Whether both have one prior."""
        return all(
            np.allclose(mine, its, rtol=_TOLERANCE, atol=_TOLERANCE**2)
            for mine, its in ((self.mean, other.mean), (self.prior, other.prior))
        )


def strength_content(record: StrengthRecord | None) -> dict[str, Any] | None:
    """Put a record into what JSON can hold."""
    if record is None:
        return None
    return {
        "mean": record.mean.tolist(),
        "prior_covariance": record.prior.tolist(),
        "deviation": record.deviation.tolist(),
        "covariance": record.covariance.tolist(),
        "exponent": record.exponent,
        "scattered": record.scattered,
        "loads": record.variety.loads,
        "slips": record.variety.slips,
        "area": record.variety.area,
        "accepted": record.accepted,
    }


def strength_record(content: Any) -> StrengthRecord | None:
    """Take a record out of that. Raises KeyError, TypeError, ValueError or LinAlgError if bad."""
    if content is None:
        return None
    mean, deviation = (np.array(content[name], dtype=float) for name in ("mean", "deviation"))
    prior, covariance = (
        np.array(content[name], dtype=float) for name in ("prior_covariance", "covariance")
    )
    if mean.shape != (_SIZE,) or deviation.shape != (_SIZE,):
        raise ValueError("mean or deviation is no strength")
    numbers = np.concatenate([mean, deviation, prior.ravel(), covariance.ravel()])
    if not (np.abs(numbers) <= _LARGEST).all():
        raise ValueError("a number of the strength is not finite, or beyond 1e12")
    for matrix in (prior, covariance):
        if matrix.shape != (_SIZE, _SIZE) or not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0):
            raise ValueError("a covariance of the strength is not symmetric, 4 by 4")
        np.linalg.cholesky(matrix)
    exponent, slope = (float(value) for value in content["exponent"])
    square, thrust, load = scattered = [float(value) for value in content["scattered"]]
    area, accepted = float(content["area"]), int(content["accepted"])
    if not max(abs(exponent), abs(slope), abs(square), area) <= _LARGEST:
        raise ValueError("a number of the strength is not finite, or beyond 1e12")
    if area < 0 or accepted < 0:
        raise ValueError("area or count of the strength is negative")
    if not (0.0 <= thrust <= _LARGEST and 0.0 <= load <= _LARGEST):
        raise ValueError(f"{scattered!r} is no scatter of the thrust")
    loads, slips = (_range(content[name]) for name in ("loads", "slips"))
    if (loads is None) != (accepted == 0) or (loads is None) != (slips is None):
        raise ValueError("ranges of load and slip do not go with the count of pulls")
    variety = PullVariety(loads, slips, area)
    return StrengthRecord(
        mean,
        prior,
        deviation,
        covariance,
        (exponent, slope),
        (square, thrust, load),
        variety,
        accepted,
    )


def _range(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    low, high = (float(v) for v in value)
    if not 0.0 <= low <= high < math.inf:
        raise ValueError(f"{value!r} is no range")
    return low, high
