# SPDX-License-Identifier: Apache-2.0
"""Whether stretches lie on two soils, from their differences from a law.

The shift is the change of ln k at a border, nu the innovations (m), and `by` is d sinkage / d ln load (m).
The stretches of leading wheels that wait to be used give for each possible border, with sums over the
stretches beyond it,

    shift    = -sum(nu / by / v) / sum(1 / v),   v = var(nu of a stretch alone) / by^2
    variance = alike(rows) / sum(1 / v) + H P H / by^2

where alike(rows) is the factor by which the correlation of neighbours increases the variance of a mean. All
stretches of the last metres, compared with the law from before them, give

    shift = g^T S^-1 nu / (g^T S^-1 g),   variance = 1 / (g^T S^-1 g)

S = H P H^T + R is their covariance, R that of stretches among their neighbours, and g is -by on
stretches beyond a border and 0 before it. A border is reported where the shift is over 4.75
deviations (6.25 on one row) and a factor of 1.25, and each wheel beyond it shows it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from smallwheel_ros.pipeline.tables import Array, Flags, Integers

from .filter import SoilFilter
from .stretches import Stretches

_LEAST_SHIFT = math.log(1.25)  # of ln k: less is the soil's own drift
# 24 tests a metre with four wheels: one false alarm in 1000 m at 4.75 for sums of many rows, whose errors are
# nearly normal; one row alone needs more deviations, since single places have heavier tails.
_LEAST_SIGMA, _ONE_ROW = 4.75, 1.5
# Share of the shift that each wheel has to show; deviations to which an innovation is cut.
_SHARE, _WILD = 0.3, 5.0
_SUSPECTED = 3.0  # deviations of a border that may be there


class Border(NamedTuple):
    """The likeliest border between two soils.

    Attributes
    ----------
    place
        Place at which the second soil begins, along the vehicle's path, m; NaN if nothing could be tested.
    shift
        Change of ln k there; positive where the second soil is firmer.
    suspected
        Whether the change of ln k at any place tested exceeds 3 of its standard deviations.
    found
        Whether the evidence suffices to report the border. Otherwise `place` and `shift` mean nothing.
    """

    place: float = math.nan
    shift: float = 0.0
    suspected: bool = False
    found: bool = False


def border_ahead(law: SoilFilter, rows: Stretches, wheels: int) -> Border:
    """Find the likeliest border among stretches of leading wheels that the law has not used yet.

    Parameters
    ----------
    law
        Filter of the soil before the border.
    rows
        Stretches of leading wheels, ahead of those that the filter has used.
    wheels
        Number of wheels of the vehicle.

    Returns
    -------
    Border
        `found` is False without enough evidence.
    """
    rows = rows.take(np.argsort(-rows.place, kind="stable"))
    miss, state, variance, by_load = law.innovations(rows)
    if not (by_load > 0.0).all():
        return Border()
    most = _WILD * np.sqrt(variance)
    shift = -np.clip(miss, -most, most) / by_load
    weight = by_load**2 / (variance - state)
    total = np.cumsum(weight)
    size = np.cumsum(weight * shift) / total
    ones = rows.wheel[:, None] == np.arange(wheels)
    counts = np.cumsum(ones, axis=0)
    law_variance = np.maximum.accumulate(state / by_load**2)
    sigma = np.abs(size) / np.sqrt(_alike(counts.max(axis=1)) / total + law_variance)
    means = np.cumsum(ones * shift[:, None], axis=0) / np.maximum(counts, 1)
    return _likeliest(rows, counts, means, size, sigma)


def border_behind(law: SoilFilter, rows: Stretches, wheels: int) -> Border:
    """Find the likeliest border among all stretches since an earlier state of the law.

    Parameters
    ----------
    law
        Filter of the soil as it was some metres ago, before any of the stretches.
    rows
        All stretches since then.
    wheels
        Number of wheels of the vehicle.

    Returns
    -------
    Border
        `found` is False without enough evidence.
    """
    rows = rows.take(np.argsort(-rows.place, kind="stable"))
    miss, covariance, by_load = law.together(rows)
    if not (by_load > 0.0).all():
        return Border()
    most = _WILD * np.sqrt(np.diag(covariance))
    known = np.linalg.inv(covariance)
    score = -by_load * (known @ np.clip(miss, -most, most))
    weight = known * np.outer(by_load, by_load)
    size, total = _shifts(score, weight)
    ones = rows.wheel[:, None] == np.arange(wheels)
    own = [_shifts(score * one, weight * np.outer(one, one))[0] for one in ones.T]
    counts = np.cumsum(ones, axis=0)
    return _likeliest(rows, counts, np.stack(own, axis=1), size, np.abs(size) * np.sqrt(total))


def _likeliest(rows: Stretches, counts: Integers, own: Array, size: Array, sigma: Array) -> Border:
    """Choose the likeliest of the possible borders, one at each row; rows are sorted by falling place.

    counts, own: number of rows beyond the border, and shift that these show, of each wheel, (rows, wheels).
    size, sigma: shift by all wheels, and its size in deviations, (rows,).
    """
    agree: Flags = ((counts == 0) | (own / size[:, None] > _SHARE)).all(axis=1)
    enough = (counts > 0).sum(axis=1) >= min(2, int((counts[-1] > 0).sum()))
    sigma = np.where(agree & enough & (np.abs(size) >= _LEAST_SHIFT), sigma, 0.0)
    found = sigma >= _LEAST_SIGMA + np.where(counts.max(axis=1) == 1, _ONE_ROW, 0.0)
    best = int(np.argmax(np.where(found, sigma, 0.0)))
    return Border(
        float(rows.place[best]),
        float(size[best]),
        bool((sigma >= _SUSPECTED).any()),
        bool(found.any()),
    )


def _shifts(score: Array, weight: Array) -> tuple[Array, Array]:
    """Shift for a border at each row, and g^T S^-1 g, (rows,).

    score: g S^-1 nu of each row. weight: S^-1 of each pair of rows, times both slopes, (rows, rows).
    """
    total = np.diag(np.cumsum(np.cumsum(weight, axis=0), axis=1))
    total = np.maximum(total, 1e-30)
    return np.cumsum(score) / total, total


def _alike(lengths: Integers) -> Array:
    """Variance of a mean over path, over what it would be if stretches were independent, (rows,).

    lengths: number of successive stretches in the mean. For an Ornstein-Uhlenbeck process whose correlation
    has the length of a stretch.
    """
    u = lengths.astype(float)
    mean_variance = 2.0 / u**2 * (u - 1.0 + np.exp(-u))
    return np.asarray(u * mean_variance / (2.0 * math.exp(-1.0)))
