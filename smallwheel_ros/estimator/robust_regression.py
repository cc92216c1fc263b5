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
    coefficients: Array = np.zeros(columns.shape[1]) if start is None else start
    errors: Array = y - columns @ coefficients
    square = max(float(np.median(errors**2)) / 0.455, 1e-20)
    before = -math.inf
    for _ in range(_ITERATIONS):
        ratio = errors**2 / (_FREEDOM * square)
        log_likelihood = -0.5 * (
            rows * math.log(square) + (_FREEDOM + 1.0) * float(np.sum(np.log1p(ratio)))
        )
        if log_likelihood - before < 0.5 * _SETTLED:
            break
        before = log_likelihood
        weight = (_FREEDOM + 1.0) / (_FREEDOM * (1.0 + ratio))
        weighted = columns * weight[:, None]
        coefficients = np.asarray(np.linalg.solve(columns.T @ weighted, weighted.T @ y))
        errors = y - columns @ coefficients
        square = max(float(weight @ errors**2) / rows, 1e-20)
    return RobustFit(coefficients, math.sqrt(square), log_likelihood)
