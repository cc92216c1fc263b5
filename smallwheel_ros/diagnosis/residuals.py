# SPDX-License-Identifier: Apache-2.0
"""What a model leaves: where it fails, and what the best explanation leaves over each part of the data.

Both look at errors relative to the size of a value, with the run as the unit of evidence.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.display import column_display, percent, setting_words, words
from smallwheel_ros.measurements.table import Measurements

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Entry = dict[str, Any]

_FEWEST_RUNS = 3  # on each side of a cut, or of a part, to say anything
_REPLICATES = 499
_SHOWN = 0.05
_BOTH_SIGNS = 0.2  # least share of a range on the other side of zero
_MOST = 6
_PARTS = 3  # low, middle and high of a setting
_MOST_GROUPS = 12
_FAR_OFF = 3.0  # standard errors of a part's mean, from which it is said


def where_it_fails(
    points: Points, errors: CvErrors, level: Array, seed: int, *, certain: bool = False
) -> list[Entry]:
    """The worst cut of each channel by each setting, as far as it is more than chance.

    A cut splits the points by one setting; its statistic is the difference of the two sides' mean
    error, relative to the level, over its standard error; the largest over all cuts. Its law comes
    from turning round the sign of whole runs' errors. errors: held out. certain: it does fail
    somewhere; then the worst cut is given even if few runs cannot confirm it. p_value: over all cuts
    of the channel. bias, rmse: m or N.
    """
    generator = np.random.default_rng([seed, 13])
    columns = _cut_by(points)
    found: list[Entry] = []
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
                above = columns[name][mine] > threshold
                here, elsewhere, sign = _worse_side(above, errors.error[channel], rows)
                found.append({
                    "region": f"{name} {sign} {threshold:.3g}",
                    "rows": int(here.size),
                    "channel": channel,
                    "bias": float(np.mean(here)),
                    "rmse": float(np.sqrt(np.mean(here**2))),
                    "rmse_elsewhere": float(np.sqrt(np.mean(elsewhere**2))),
                    "p_value": p,
                })  # fmt: skip
    found.sort(key=lambda r: (r["p_value"], -r["rmse"] / max(r["rmse_elsewhere"], 1e-300)))
    sure = [region for region in found if region["p_value"] <= _SHOWN]
    return sure[:_MOST] or found[:1]


def _cut_by(points: Points) -> dict[str, Array]:
    """What is cut: the settings that vary, and the size of one that has both signs."""
    columns = {}
    for name, column in points.varied.items():
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


def _worse_side(above: Mask, error: Array, rows: list[Index]) -> tuple[Array, Array, str]:
    """Errors on the side of a cut where they are larger, those of the other, and which side it is."""
    low, high = (
        np.concatenate([error[rows[i]] for i in np.flatnonzero(side)]) for side in (~above, above)
    )
    return (low, high, "<") if np.mean(high**2) < np.mean(low**2) else (high, low, ">")


def setting_of(points: Points, values: Index) -> str:
    """The setting of some values in words: what was varied."""
    named = {n: float(np.median(c[values])) for n, c in points.varied.items()}
    return ", ".join(f"{words(n)} {setting_words(n, v)}" for n, v in named.items())


def residuals_left(fitter: Fitter, fit: Fit) -> list[Entry]:
    """Mean relative residual of a fit, by channel, in thirds of each setting and by group of rows."""
    points = fitter.points
    share = (points.value - fit.predicted) / fitter.level
    found: list[Entry] = []
    for c, channel in enumerate(points.channels):
        mine = points.channel == c
        for name, column in points.varied.items():
            edges = np.unique(np.quantile(column[mine], np.linspace(0, 1, _PARTS + 1)))
            place = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, edges.size - 2)
            masks = [mine & (place == i) for i in range(edges.size - 1)]
            parts = [
                {"at": float(np.median(column[mask])), **_part(share[mask], points.run[mask])}
                for mask in masks
                if mask.any()
            ]
            found.append({"channel": channel, "setting": name, "parts": parts})
        for name, label in _groups(points).items():
            values = np.unique(label[mine])
            if 1 < values.size <= _MOST_GROUPS:
                masks = [mine & (label == value) for value in values]
                parts = [
                    {"at": str(value), **_part(share[mask], points.run[mask])}
                    for value, mask in zip(values, masks, strict=True)
                ]
                found.append({"channel": channel, "group": name, "parts": parts})
    return found


def _part(share: Array, run: Index) -> Entry:
    """Mean of some relative residuals and its standard error, by runs."""
    means = np.array([share[run == r].mean() for r in np.unique(run)])
    error = float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else None
    return {"runs": int(means.size), "mean": float(means.mean()), "std": error}


def _groups(points: Points) -> dict[str, NDArray[np.str_]]:
    """Labels of each value: the wheel, the soil, and every column of text."""
    measurements = points.measurements
    first = np.array([rows[0] for rows in points.rows])
    columns = {"wheel": measurements.wheel, "soil": measurements.soil, **measurements.labels}
    return {name: np.asarray(column)[first] for name, column in columns.items()}


def worst_left(left: list[Entry], measurements: Measurements) -> str:
    """The setting or group over which the residual differs most, in words; "" where none does."""
    parts = [
        (abs(part["mean"]) / part["std"], entry, part)
        for entry in left
        for part in entry["parts"]
        if part["std"] and part["runs"] >= _FEWEST_RUNS
    ]
    parts = [found for found in parts if found[0] > _FAR_OFF]
    if not parts:
        return ""
    _, entry, part = max(parts, key=lambda found: found[0])
    if "group" in entry:
        where = f"{entry['group']} is {part['at']}"
    else:
        shown = column_display(measurements, entry["setting"])
        at = f"{shown.scale * part['at']:.4g} {shown.unit}".rstrip()
        where = f"{words(entry['setting'])} is about {at}"
    return f"{words(entry['channel'])} is {percent(part['mean'], signed=True)} off where {where}"
