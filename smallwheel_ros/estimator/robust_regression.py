# SPDX-License-Identifier: Apache-2.0
"""Linear regression with errors by Student's t distribution: a few great errors are allowed for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FREEDOM = 4.0  # of Student's t distribution: tails as heavy as borders between soils make them
_ITERATIONS = 40
_SETTLED = 1e-3  # of twice the log likelihood


class RobustFit(NamedTuple):
    """Coefficients (columns,), scale of the errors, and log likelihood but for a constant."""

    coefficients: Array
    scale: float
    log_likelihood: float


def robust_fit(y: Array, columns: Array, start: Array | None = None) -> RobustFit:
    """Fit y (rows,) by columns (rows, columns), the scale of the errors too.

    Iterated weighted least squares, which is expectation maximisation for Student's t (Lange,
    Little and Taylor 1989). start: coefficients to begin at. Raises LinAlgError where the columns
    are not independent.
    """
    rows = y.size
    across = np.ascontiguousarray(columns.T)  # row by row for each column: fewer, longer loops
    coefficients: Array = np.zeros(columns.shape[1]) if start is None else start
    errors: Array = y - coefficients @ across
    squares = errors * errors
    square = max(float(np.median(squares)) / 0.455, 1e-20)
    before = -math.inf
    for _ in range(_ITERATIONS):
        ratio = squares / (_FREEDOM * square)
        log_likelihood = -0.5 * (
            rows * math.log(square) + (_FREEDOM + 1.0) * float(np.log1p(ratio).sum())
        )
        if log_likelihood - before < 0.5 * _SETTLED:
            break
        before = log_likelihood
        weight = (1.0 + 1.0 / _FREEDOM) / (1.0 + ratio)
        weighted = across * weight
        coefficients = np.asarray(np.linalg.solve(weighted @ across.T, weighted @ y))
        errors = y - coefficients @ across
        squares = errors * errors
        square = max(float(weight @ squares) / rows, 1e-20)
    return RobustFit(coefficients, math.sqrt(square), log_likelihood)
