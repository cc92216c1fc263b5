"""Where the model fails: under which conditions its error is largest, in words a person can check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import varied
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.fitting.points import Points

Array = NDArray[np.float64]

_FEWEST_RUNS = 3  # on each side of a cut
_REPLICATES = 499
_SHOWN = 0.05
_BOTH_SIGNS = 0.2  # least share of a range on the other side of zero
_MOST = 6


@dataclass(frozen=True)
class Region:
    """Values on one side of a cut. bias, rmse: m or N, held out. p: over all cuts of the channel."""

    region: str
    rows: int
    channel: str
    bias: float
    rmse: float
    rmse_elsewhere: float
    p: float


def where_it_fails(
    points: Points, errors: CvErrors, level: Array, seed: int, *, certain: bool = False
) -> list[Region]:
    """The worst cut of each channel by each setting, as far as it is more than chance.

    A cut splits the points by one setting; its statistic is the difference of the two sides' mean
    error, relative to the level, over its standard error; the largest over all cuts. Its law comes
    from turning round the sign of whole runs' errors. certain: it does fail somewhere; then the worst
    cut is given even if few runs cannot confirm it.
    """
    generator = np.random.default_rng([seed, 13])
    columns = _cut_by(points)
    found: list[Region] = []
    for c, channel in enumerate(points.channels):
        mine = np.flatnonzero(points.channel == c)
        error = np.array([np.mean(errors.error[channel][points.rows[i]]) for i in mine])
        runs = np.unique(points.run[mine], return_inverse=True)[1].reshape(-1)
        good = np.isfinite(error)
        if np.unique(runs[good]).size < 2 * _FEWEST_RUNS:
            continue
        mine, error, runs = mine[good], error[good], runs[good]
        signs = generator.choice([-1.0, 1.0], size=(_REPLICATES, int(runs.max()) + 1))
        share = error / level[mine]
        values = np.vstack([share, share * signs[:, runs]])
        cuts = [
            (name, *cut)
            for name, column in columns.items()
            if (cut := _worst_cut(column[mine], values, runs)) is not None
        ]
        if not cuts:
            continue
        null = np.max([cut[1][1:] for cut in cuts], axis=0)
        for name, statistic, threshold in cuts:
            p = float((1 + np.sum(null >= statistic[0])) / (1 + null.size))
            if p <= _SHOWN or certain:
                rows = [points.rows[i] for i in mine]
                found.append(
                    _region(name, threshold, columns[name][mine], rows, errors, channel, p)
                )
    found.sort(key=lambda r: (r.p, -r.rmse / max(r.rmse_elsewhere, 1e-300)))
    sure = [region for region in found if region.p <= _SHOWN]
    return sure[:_MOST] or found[:1]


def _cut_by(points: Points) -> dict[str, Array]:
    """What is cut: the settings that vary, and the size of one that has both signs."""
    columns = {}
    for name, column in varied(points).items():
        columns[name] = column
        low, high = -float(column.min()), float(column.max())
        if min(low, high) > _BOTH_SIGNS * max(low, high):
            columns[f"|{name}|"] = np.abs(column)
    return columns


def _worst_cut(setting: Array, values: Array, runs: NDArray[np.intp]) -> tuple[Array, float] | None:
    """Largest statistic over the cuts of a setting, for each row of values, and the first's cut."""
    order = np.argsort(setting, kind="stable")
    ordered, run = setting[order], runs[order]
    size = ordered.size
    step = 1e-3 * np.ptp(ordered)
    first_seen = np.array([np.unique(run[:i]).size for i in range(size + 1)])
    last_seen = np.array([np.unique(run[i:]).size for i in range(size + 1)])
    places = [
        i
        for i in range(1, size)
        if ordered[i] - ordered[i - 1] > step
        and first_seen[i] >= _FEWEST_RUNS
        and last_seen[i] >= _FEWEST_RUNS
    ]
    if not places:
        return None
    v = values[:, order]
    at = np.array(places)
    running = np.cumsum(v, axis=1)[:, at - 1]
    total, square = v.sum(axis=1, keepdims=True), (v**2).sum(axis=1, keepdims=True)
    low, high = running / at, (total - running) / (size - at)
    within = np.maximum(square - at * low**2 - (size - at) * high**2, 1e-12)
    spread = np.sqrt(within / max(size - 2, 1) * (1.0 / at + 1.0 / (size - at)))
    statistic = np.abs(high - low) / spread
    best = places[int(np.argmax(statistic[0]))]
    return statistic.max(axis=1), float(0.5 * (ordered[best - 1] + ordered[best]))


def _region(
    name: str,
    threshold: float,
    column: Array,
    rows: list[NDArray[np.intp]],
    errors: CvErrors,
    channel: str,
    p: float,
) -> Region:
    above = column > threshold
    error = errors.error[channel]

    def of(side: NDArray[np.bool_]) -> Array:
        return np.concatenate([error[rows[i]] for i in np.flatnonzero(side)])

    if np.mean(of(above) ** 2) < np.mean(of(~above) ** 2):
        inside, sign = ~above, "<"
    else:
        inside, sign = above, ">"
    here, elsewhere = of(inside), of(~inside)
    return Region(
        f"{name} {sign} {threshold:.3g}",
        int(here.size),
        channel,
        float(np.mean(here)),
        float(np.sqrt(np.mean(here**2))),
        float(np.sqrt(np.mean(elsewhere**2))),
        p,
    )
