"""Error of a prediction: over all rows, and over parts of them (a soil, a range of slip)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Array

Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

_DRAWS = 400
_FEW_VALUES = 5  # a column with at most so many different values is split by value
_PARTS = 4  # otherwise into so many parts of about as many rows
_VARIES = 0.01  # spread over size below which a column was meant to be constant

UNITS = {"sinkage": "m", "resistance": "N", "drawbar_pull": "N"}


@dataclass(frozen=True)
class Score:
    """Error of predictions against measurements, in the channel's SI unit.

    bias: mean of measured minus predicted, so a positive one says that the model predicts too
    little. rmse_std: standard error of the rmse by bootstrap over runs, None with under 3 runs.
    """

    rows: int
    runs: int
    rmse: float
    bias: float
    rmse_std: float | None


def score(residual: Array, run: Index) -> Score | None:
    """Score the residuals that are finite; None where there are none.

    residual: measured minus predicted, shape (rows,). run: index of each row's run.
    """
    known = np.isfinite(residual)
    if not known.any():
        return None
    e, _, codes = residual[known], *np.unique(run[known], return_inverse=True)
    codes = codes.reshape(-1)
    rows = np.bincount(codes)
    squares = np.bincount(codes, e**2).astype(float)
    return Score(
        int(e.size),
        int(rows.size),
        float(np.sqrt(np.mean(e**2))),
        float(np.mean(e)),
        _bootstrap(squares, rows.astype(float)) if rows.size >= 3 else None,
    )


def _bootstrap(squares: Array, rows: Array) -> float:
    """Standard deviation of the rmse over draws of whole runs."""
    picks = _picks(rows.size)
    return float(np.std(np.sqrt((picks @ squares) / (picks @ rows))))


def difference_std(one: Array, other: Array, run: Index) -> float | None:
    """Standard error of rmse(one) - rmse(other) by bootstrap over runs; None with under 3 runs.

    one, other: residuals of two models on the same rows; rows that either lacks are left out.
    """
    known = np.isfinite(one) & np.isfinite(other)
    _, codes = np.unique(run[known], return_inverse=True)
    codes = codes.reshape(-1)
    if codes.size == 0 or codes.max() < 2:
        return None
    picks = _picks(int(codes.max()) + 1)
    rows = picks @ np.bincount(codes).astype(float)
    rmse = [np.sqrt(picks @ np.bincount(codes, e[known] ** 2) / rows) for e in (one, other)]
    return float(np.std(rmse[0] - rmse[1]))


def _picks(runs: int) -> Array:
    """How often each run is drawn, shape (draws, runs); one seed, so that figures repeat."""
    drawn = np.random.default_rng(0).multinomial(runs, np.full(runs, 1 / runs), _DRAWS)
    return np.asarray(drawn, dtype=float)


@dataclass(frozen=True)
class Part:
    """Some of the rows, named: by which column ("slip") and which of its values ("0.2 to 0.4").

    range: smallest and largest value of a numeric column, in SI; empty for a text.
    """

    by: str
    label: str
    rows: Mask
    range: tuple[float, ...] = ()


def varied(values: Array) -> bool:
    """Whether a column varies by more than a setting that is meant to be constant does."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return False
    return bool(np.ptp(known) > _VARIES * np.abs(known).max())


def drivers(measurements: Measurements) -> dict[str, Array]:
    """The numeric columns that vary: what an error may follow."""
    conditions = measurements.conditions
    columns = {name: conditions[name] for name in ("load", "diameter", "width")}
    columns |= dict(conditions.covariates)
    return {name: values for name, values in columns.items() if varied(values)}


def parts(measurements: Measurements) -> list[Part]:
    """The rows split by soil, wheel, contact and each condition that varies."""
    texts = {
        "soil": measurements.soil,
        "wheel": _wheels(measurements),
        "contact": measurements.conditions.contact,
    }
    found: list[Part] = []
    for by, names in texts.items():
        kinds = np.unique(names)
        if kinds.size > 1:
            found += [Part(by, str(kind) or "not named", names == kind) for kind in kinds]
    for by, values in drivers(measurements).items():
        found += _by_value(by, values)
    return found


def _wheels(measurements: Measurements) -> NDArray[np.str_]:
    """Names of the wheels; with the size where wheels of several sizes share one name."""
    size = measurements.conditions.diameter
    names = measurements.wheel
    shared = any(np.unique(np.round(size[names == n], 6)).size > 1 for n in np.unique(names))
    if not shared:
        return names
    return np.array([f"{n} {1e3 * d:.4g} mm" for n, d in zip(names, size, strict=True)])


def levels(values: Array) -> Array | None:
    """The different values of a column that has few (to 2 % of its range), else None."""
    known = values[np.isfinite(values)]
    step = 0.02 * np.ptp(known)
    ordered = np.sort(known)
    group = np.concatenate(([0], np.cumsum(np.diff(ordered) > step)))
    if group[-1] >= _FEW_VALUES:
        return None
    return np.asarray(np.bincount(group, ordered) / np.bincount(group), dtype=float)


def _by_value(by: str, values: Array) -> list[Part]:
    known = np.isfinite(values)
    few = levels(values)
    if few is not None:
        nearest = np.abs(values[:, None] - few).argmin(axis=1)
        return [
            Part(by, f"{level:.4g}", known & (nearest == i), (float(level),))
            for i, level in enumerate(few)
        ]
    edges = np.unique(np.quantile(values[known], np.linspace(0, 1, _PARTS + 1)))
    number = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    found = [
        Part(by, f"{low:.3g} to {high:.3g}", known & (number == i), (float(low), float(high)))
        for i, (low, high) in enumerate(pairwise(edges))
    ]
    return [part for part in found if part.rows.any()]
