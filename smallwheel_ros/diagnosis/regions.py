"""Where the model fails: under which conditions its error is largest, in words a person can check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidates import settings_of
from smallwheel_ros.diagnosis.held_out import Errors
from smallwheel_ros.diagnosis.ties import drivers
from smallwheel_ros.fitting.observations import Observations

Array = NDArray[np.float64]

_FEWEST_RUNS = 3  # on each side of a cut
_PERMUTATIONS = 499
_SHOWN = 0.05
_BOTH_SIGNS = 0.2  # least share of a range on the other side of zero
_NOISE = 0.5  # of the variance of a standardised error: how far under its noise is no matter
_MOST = 6


@dataclass(frozen=True)
class Region:
    """Rows on one side of a cut. bias, rmse: m or N, held out. p: by permuting runs, over all cuts."""

    region: str
    rows: int
    channel: str
    bias: float
    rmse: float
    rmse_elsewhere: float
    p: float


def where_it_fails(
    observations: Observations,
    errors: Errors,
    seed: int,
    results: Sequence[str] = (),
    *,
    certain: bool = False,
) -> list[Region]:
    """The worst cut of each channel by each setting, as far as it is more than chance.

    A cut splits the runs by one setting; its statistic is the difference of the two sides' error (its mean,
    or the logarithm of its size) over its standard error, the largest over all cuts of all settings.
    Its law comes from permuting the runs' errors. results: columns that are no settings.
    certain: it does fail somewhere; then the worst cut is given even if few runs cannot confirm it.
    """
    generator = np.random.default_rng([seed, 13])
    columns = _cut_by(observations, results)
    found: list[Region] = []
    for c, channel in enumerate(observations.channels):
        mask = observations.channel == c
        _, group = np.unique(observations.run[mask], return_inverse=True)
        group = group.reshape(-1)
        count = np.bincount(group)
        scaled = errors.error[mask] / np.sqrt(errors.variance[mask])
        if count.size < 2 * _FEWEST_RUNS:
            continue
        # What a run's error is on average, and how large it is either way.
        scores = [
            np.bincount(group, scaled) / count,
            0.5 * np.log(np.bincount(group, scaled**2) / count + _NOISE),
        ]
        order = np.array([generator.permutation(count.size) for _ in range(_PERMUTATIONS)])
        values = [np.vstack([x, x[order]]) for x in scores]
        settings = {
            name: np.bincount(group, column[observations.row[mask]]) / count
            for name, column in columns.items()
        }
        found_cuts = [(name, _worst_cut(x, v)) for name, x in settings.items() for v in values]
        cuts = [(name, *cut) for name, cut in found_cuts if cut is not None]
        if not cuts:
            continue
        null = np.max([cut[1][1:] for cut in cuts], axis=0)
        best = {name: max(c[1][0] for c in cuts if c[0] == name) for name, _, _ in cuts}
        for name, statistic, threshold in cuts:
            if statistic[0] < best[name]:
                continue
            p = float((1 + np.sum(null >= statistic[0])) / (1 + null.size))
            if p <= _SHOWN or certain:
                column = columns[name][observations.row[mask]]
                found.append(_region(name, threshold, column, errors.error[mask], channel, p))
    found.sort(key=lambda r: (r.p, -r.rmse / max(r.rmse_elsewhere, 1e-300)))
    sure = [region for region in found if region.p <= _SHOWN]
    return sure[:_MOST] or found[:1]


def _cut_by(observations: Observations, results: Sequence[str]) -> dict[str, Array]:
    """What is cut: the settings that vary, and the size of one that has both signs."""
    columns = {}
    for name in drivers(observations):
        if name in results:
            continue
        column = columns[name] = settings_of(observations)[name]
        low, high = -np.nanmin(column), np.nanmax(column)
        if min(low, high) > _BOTH_SIGNS * max(low, high):
            columns[f"|{name}|"] = np.abs(column)
    return columns


def _worst_cut(setting: Array, values: Array) -> tuple[Array, float] | None:
    """Largest statistic over the cuts of a setting, for each row of values, and the first's cut."""
    order = np.argsort(setting, kind="stable")
    ordered = setting[order]
    size = ordered.size
    step = 1e-3 * np.ptp(ordered)
    places = [
        i
        for i in range(_FEWEST_RUNS, size - _FEWEST_RUNS + 1)
        if ordered[i] - ordered[i - 1] > step
    ]
    if not places:
        return None
    v = values[:, order]
    total, square = v.sum(axis=1), (v**2).sum(axis=1)
    running = np.cumsum(v, axis=1)
    statistics = []
    for i in places:
        low, high = running[:, i - 1] / i, (total - running[:, i - 1]) / (size - i)
        within = square - i * low**2 - (size - i) * high**2
        spread = np.sqrt(np.maximum(within, 1e-12) / (size - 2) * (1.0 / i + 1.0 / (size - i)))
        statistics.append(np.abs(high - low) / spread)
    stacked = np.array(statistics)
    best = places[int(np.argmax(stacked[:, 0]))]
    return stacked.max(axis=0), float(0.5 * (ordered[best - 1] + ordered[best]))


def _region(
    name: str, threshold: float, column: Array, error: Array, channel: str, p: float
) -> Region:
    above = column > threshold
    if np.mean(error[above] ** 2) < np.mean(error[~above] ** 2):
        inside, sign = ~above, "<"
    else:
        inside, sign = above, ">"
    return Region(
        f"{name} {sign} {threshold:.3g}",
        int(inside.sum()),
        channel,
        float(np.mean(error[inside])),
        float(np.sqrt(np.mean(error[inside] ** 2))),
        float(np.sqrt(np.mean(error[~inside] ** 2))),
        p,
    )
