"""Settings that were varied together: whatever follows one may follow the other.

Two settings are tied where one is nearly a function of the other (variance inflation over 5) and
too few
measurements break the rule: rows in which the one is far (a quarter of its range) from what
the other predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidates import kinematic, settings_of, varies
from smallwheel_ros.fitting.observations import Observations

Array = NDArray[np.float64]

_INFLATION = 5.0
_FAR = 0.25  # of the range
_ENOUGH = 5  # rows that break the rule


@dataclass(frozen=True)
class Tie:
    """`first` follows `second`: correlation, and share of its variance that `second` explains."""

    first: str
    second: str
    correlation: float
    explained: float


def drivers(observations: Observations) -> dict[str, Array]:
    """The settings that vary, one value per row that was observed."""
    rows = np.unique(observations.row)
    derived = kinematic(observations.conditions)
    found = {}
    for name, column in settings_of(observations).items():
        if name not in derived and varies(column[rows]):
            found[name] = column[rows]
    return found


def _basis(x: Array) -> Array:
    scaled = (x - x.mean()) / x.std()
    columns = [np.ones_like(x), scaled]
    if np.unique(np.round(scaled, 2)).size > 3:
        columns += [scaled**2]
    if x.min() > 0 and x.max() > 3.0 * x.min():
        logged = np.log(x)
        columns.append((logged - logged.mean()) / logged.std())
    return np.column_stack(columns)


def _explained(y: Array, x: Array, runs: int) -> tuple[float, Array]:
    """Adjusted share of the variance of y that a curve over x explains, and what is left of y."""
    basis = _basis(x)
    left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    lost = basis.shape[1]
    if runs <= lost + 1:
        return 1.0, left
    share = float(np.sum(left**2) / np.sum((y - y.mean()) ** 2))
    return 1.0 - share * (runs - 1) / (runs - lost), left


def find_ties(observations: Observations) -> list[Tie]:
    """All tied pairs, in both directions where both hold."""
    found = []
    columns = drivers(observations)
    rows = np.unique(observations.row)
    first_of = {int(r): int(g) for r, g in zip(observations.row, observations.run, strict=True)}
    runs = np.unique([first_of[int(r)] for r in rows]).size
    for a, y in columns.items():
        for b, x in columns.items():
            if a == b:
                continue
            explained, left = _explained(y, x, runs)
            far = int(np.sum(np.abs(left) > _FAR * np.ptp(y)))
            if explained > 1.0 - 1.0 / _INFLATION and far < _ENOUGH:
                r = float(np.corrcoef(x, y)[0, 1])
                found.append(Tie(a, b, r, explained))
    return found


def partners(ties: list[Tie], driver: str) -> list[Tie]:
    """The ties that a driver is in, whichever way."""
    return [t for t in ties if driver in (t.first, t.second)]
