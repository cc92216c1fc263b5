"""Long records: a drive of 10^5 rows is not 10^5 pieces of evidence.

Neighbouring rows see the same ground. Rows are taken together into blocks, of which each becomes one
row (medians). A block ends where a setting jumps; one in which a setting drifts far, or too short to
have a steady middle, is left out. Stretches of track are the runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import ROLLING, Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]

MOST_ROWS = 4000  # from which a table is condensed
_BLOCKS = 600  # at most: more would cost time and say no more than the stretches allow
_STRETCHES = 100  # runs, where the table names none
# How far a setting may spread within a steady block (standard deviation): absolute, relative.
_STEADY = {
    "load": (0.0, 0.12),
    "speed": (0.0, 0.25),
    "slip": (0.06, 0.0),
    "slip_angle": (0.06, 0.0),
    "slope": (0.03, 0.0),
    "pass_number": (0.0, 0.0),
    "grouser_height": (0.0, 0.02),
}
_JUMP = 8.0  # over the usual step from row to row
_OF_MEDIAN = 1.2533  # standard deviation of a median over that of a mean
_LEAST_SHARE = 0.25  # of a block's usual length


@dataclass(frozen=True)
class _Blocks:
    """Members of each block, one array of rows each; run: name of each row's run."""

    members: list[Index]
    run: NDArray[np.str_]
    length: int


def _numbered(texts: NDArray[Any]) -> Index:
    return np.asarray(np.unique(texts, return_inverse=True)[1].reshape(-1), dtype=np.intp)


def _settings(conditions: Conditions) -> Iterator[tuple[Array, float, float]]:
    columns = {"load": conditions.load} | dict(conditions.covariates)
    for name, (absolute, relative) in _STEADY.items():
        if name in columns:
            yield columns[name], absolute, relative


def _jumps(conditions: Conditions, order: Index) -> NDArray[np.bool_]:
    """Whether a setting jumps from the row before, in that order."""
    found = np.zeros(order.size, dtype=bool)
    for column, absolute, relative in _settings(conditions):
        ordered = column[order]
        step = np.abs(np.diff(ordered, prepend=ordered[:1]))
        allowed = absolute + relative * np.abs(ordered) + 1e-12
        found |= step > np.maximum(_JUMP * np.nanmedian(step), allowed)
    return found


def _blocks(measurements: Measurements) -> _Blocks:
    rows = len(measurements)
    conditions = measurements.conditions
    stretch = np.arange(rows) * _STRETCHES // rows
    run = np.array([f"stretch {s + 1:03d}" for s in stretch])
    if measurements.runs_given:
        run = measurements.run
    parts = [measurements.wheel, measurements.soil, run, conditions.diameter]
    keys = np.column_stack([_numbered(p) for p in (*parts, np.nan_to_num(conditions.width))])
    group = _numbered(np.unique(keys, axis=0, return_inverse=True)[1])
    length = int(np.ceil(rows / _BLOCKS))
    order = np.argsort(group, kind="stable").astype(np.intp)
    ends = np.diff(group[order], prepend=-1) != 0
    piece = np.cumsum(ends | _jumps(conditions, order))
    first = np.searchsorted(piece, piece)  # where each row's piece begins
    place = (np.arange(rows) - first) // length
    starts = np.flatnonzero((np.diff(piece, prepend=0) != 0) | (np.diff(place, prepend=0) != 0))
    return _Blocks(np.split(order, starts[1:]), run, length)


def condense(measurements: Measurements) -> Measurements:
    """The measurements as they are, or in at most 600 blocks where there are over 4000 rows.

    Only rolling rows are condensed: a curve of a pressed body keeps its rows.
    """
    conditions = measurements.conditions
    if len(measurements) <= MOST_ROWS or np.any(conditions.contact != ROLLING):
        return measurements
    blocks = _blocks(measurements)
    longest = max(rows.size for rows in blocks.members)
    least = max(1.0, _LEAST_SHARE * min(blocks.length, longest))
    members = [rows for rows in blocks.members if rows.size >= least]
    steady = np.ones(len(members), dtype=bool)
    for column, absolute, relative in _settings(conditions):
        middle = _middle(column, members)
        spread = np.array([np.std(column[rows]) for rows in members])
        steady &= ~(spread > absolute + relative * np.abs(middle) + 1e-9)
    members = [rows for rows, keep in zip(members, steady, strict=True) if keep]
    steady_rows = sum(rows.size for rows in members)
    members = members[:: int(np.ceil(len(members) / _BLOCKS)) or 1]
    used = sum(rows.size for rows in members)
    if steady_rows < 0.1 * len(measurements):  # nothing is steady: the rows themselves, if slowly
        return measurements
    first = np.array([rows[0] for rows in members])
    taken = measurements.take(first)
    covariates: Mapping[str, Array] = {
        name: _middle(column, members) for name, column in conditions.covariates.items()
    }
    return replace(
        taken,
        conditions=replace(
            taken.conditions, load=_middle(conditions.load, members), covariates=dict(covariates)
        ),
        channels={name: _middle(v, members) for name, v in measurements.channels.items()},
        declared_std={name: _std(v, members) for name, v in measurements.channels.items()},
        run=blocks.run[first],
        runs_given=True,
        notes=(
            *measurements.notes,
            f"{len(measurements)} rows were condensed to {len(members)} blocks of up to "
            f"{blocks.length} neighbouring rows (medians); {len(measurements) - steady_rows} rows in "
            f"which a setting changed were left out, and {steady_rows - used} of steady blocks "
            "beyond the largest number that is worked on",
        ),
    )


def _middle(column: Array, members: list[Index]) -> Array:
    return np.array([_median(column[rows]) for rows in members])


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _std(values: Array, members: list[Index]) -> Array:
    """Standard deviation of each block's median, its rows being correlated with their neighbours.

    The spread within blocks is pooled, as a share of the middle: a single block says little of it.
    """
    middle = _middle(values, members)
    size = np.array([np.isfinite(values[rows]).sum() for rows in members], dtype=float)
    apart = [values[rows] - m for rows, m in zip(members, middle, strict=True)]
    together = np.concatenate([a[:-1] * a[1:] for a in apart])
    alone = np.concatenate([a[:-1] ** 2 for a in apart])
    known = np.isfinite(together) & np.isfinite(alone)
    alike = np.sum(together[known]) / max(np.sum(alone[known]), 1e-300)
    alike = float(np.clip(alike, 0.0, 0.95))
    spread = np.array(
        [np.sqrt(np.nanmean(a**2)) if np.isfinite(a).any() else np.nan for a in apart]
    )
    weight = np.abs(middle)
    share = np.nanmedian(spread / np.maximum(weight, 1e-12))
    typical = np.sqrt(0.5 * (spread**2 + (share * weight) ** 2))
    inflated = _OF_MEDIAN * np.sqrt((1.0 + alike) / (1.0 - alike) / np.maximum(size, 1.0))
    return np.asarray(np.where(size > 0, typical * inflated, np.nan))
