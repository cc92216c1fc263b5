"""The error of a model, and how it compares with that of another, over all rows or some."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.fitting.held_out import CvErrors, compare_cv
from smallwheel_ros.measurements.columns import Mask


@dataclass(frozen=True)
class Score:
    """Error of predictions against measurements, in the channel's SI unit.

    bias: mean of measured less predicted, so a positive one says that the model predicts too
    little. rmse_std: standard error of the rmse over runs, None with under 3 runs.
    """

    rows: int
    runs: int
    rmse: float
    bias: float
    rmse_std: float | None


def score(errors: CvErrors, channel: str, rows: Mask | None = None) -> Score | None:
    """Score one channel, on some rows if given, shape (rows,); None where it has no errors there."""
    error = errors.error.get(channel)
    if error is None:
        return None
    error = error if rows is None else np.where(rows, error, np.nan)
    known = np.isfinite(error)
    if not known.any():
        return None
    mine = CvErrors({channel: error}, errors.run)
    return Score(
        int(known.sum()),
        int(np.unique(errors.run[known]).size),
        mine.rmse()[channel],
        mine.bias()[channel],
        mine.rmse_std()[channel],
    )


@dataclass(frozen=True)
class Difference:
    """How a model's error of one channel compares with the least one, on the rows that both have.

    increase: relative, of the rmse. z_score: of the difference over its standard error, negative
    where the model is worse. worse: the error rises by more than its standard error.
    """

    increase: float
    z_score: float
    worse: bool


def difference(best: CvErrors, other: CvErrors, channel: str) -> Difference | None:
    """Compare two models on a channel; None where they have no row in common."""
    one, two = best.error.get(channel), other.error.get(channel)
    if one is None or two is None:
        return None
    both = np.isfinite(one) & np.isfinite(two)
    if not both.any():
        return None
    pair = [CvErrors({channel: np.where(both, e, np.nan)}, best.run) for e in (one, two)]
    change = compare_cv(*pair)
    return Difference(-change.reduction[channel], change.z_score[channel], channel in change.worse)
