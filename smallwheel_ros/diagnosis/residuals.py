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
_FAR_OFF = 3.0  # standard errors of a part's mean, from which it is reported


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
    found: list[Entry] = []
    for channel in points.channels:
        mine = np.flatnonzero(points.of_channel(channel))
        error = np.array([np.mean(errors.error[channel][points.rows[i]]) for i in mine])
        mine, error = mine[np.isfinite(error)], error[np.isfinite(error)]
        runs = np.unique(points.run[mine], return_inverse=True)[1].reshape(-1)
        if np.unique(runs).size < 2 * _FEWEST_RUNS:
            continue
        signs = generator.choice([-1.0, 1.0], size=(_REPLICATES, int(runs.max()) + 1))
        share = np.vstack([error, error * signs[:, runs]]) / level[mine]
        worst: dict[str, tuple[Array, Mask, float]] = {}
        for name, column in _cut_by(points).items():
            above, thresholds = _cuts(column[mine], runs)
            if thresholds.size:
                statistic = _apart(share, above)
                best = int(np.argmax(statistic[0]))
                worst[name] = statistic.max(axis=1), above[best], thresholds[best]
        null = np.max([statistic[1:] for statistic, _, _ in worst.values()], axis=0, initial=0.0)
        for name, (statistic, high, threshold) in worst.items():
            p = float((1 + np.sum(null >= statistic[0])) / (1 + _REPLICATES))
            if p > _SHOWN and not certain:
                continue
            sides = [
                np.concatenate([errors.error[channel][points.rows[i]] for i in mine[side]])
                for side in (high, ~high)
            ]
            sizes = [float(np.mean(side**2)) for side in sides]
            here, elsewhere = (0, 1) if sizes[0] >= sizes[1] else (1, 0)
            found.append({
                "region": f"{name} {'><'[here]} {threshold:.3g}",
                "rows": int(sides[here].size),
                "channel": channel,
                "bias": float(np.mean(sides[here])),
                "rmse": float(np.sqrt(sizes[here])),
                "rmse_elsewhere": float(np.sqrt(sizes[elsewhere])),
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


def _cuts(setting: Array, runs: Index) -> tuple[Mask, Array]:
    """Masks of what lies above each cut, shape (cuts, values), and the cuts; enough runs on both sides."""
    levels = np.unique(setting)
    wide = np.diff(levels) > 1e-3 * np.ptp(levels)
    cuts = (0.5 * (levels[1:] + levels[:-1]))[wide]
    above = setting > cuts[:, None]
    enough = [min(np.unique(runs[a]).size, np.unique(runs[~a]).size) >= _FEWEST_RUNS for a in above]
    return above[enough], cuts[enough]


def _apart(share: Array, above: Mask) -> Array:
    """Difference of the two sides' means over its standard error, shape (data sets, cuts)."""
    size, high = above.shape[1], above.sum(axis=1)
    total, square = share.sum(axis=1, keepdims=True), (share**2).sum(axis=1, keepdims=True)
    mean_high = share @ above.T.astype(float) / high
    mean_low = (total - mean_high * high) / (size - high)
    within = np.maximum(square - high * mean_high**2 - (size - high) * mean_low**2, 1e-12)
    spread = np.sqrt(within / max(size - 2, 1) * (1.0 / high + 1.0 / (size - high)))
    return np.asarray(np.abs(mean_high - mean_low) / spread)


def setting_of(points: Points, values: Index) -> str:
    """The setting of some values in words: what was varied."""
    named = {n: float(np.median(c[values])) for n, c in points.varied.items()}
    return ", ".join(f"{words(n)} {setting_words(n, v)}" for n, v in named.items())


def residuals_left(fitter: Fitter, fit: Fit) -> list[Entry]:
    """Mean relative residual of a fit, by channel, in thirds of each setting and by group of rows."""
    points = fitter.points
    share = (points.value - fit.predicted) / fitter.level
    first = np.array([rows[0] for rows in points.rows])
    table = points.measurements
    groups = {"wheel": table.wheel, "soil": table.soil, **table.labels}
    found: list[Entry] = []
    for channel in points.channels:
        mine = points.of_channel(channel)
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
        for name, labels in groups.items():
            label = np.asarray(labels)[first]
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


def worst_left(left: list[Entry], measurements: Measurements) -> str:
    """The setting or group over which the residual differs most, in words; "" where none does."""
    parts = [
        (abs(part["mean"]) / part["std"], entry, part)
        for entry in left
        for part in entry["parts"]
        if part["std"] and part["runs"] >= _FEWEST_RUNS
    ]
    none: tuple[float, Entry, Entry] = (0.0, {}, {})
    size, entry, part = max(parts, key=lambda found: found[0], default=none)
    if size <= _FAR_OFF:
        return ""
    if "group" in entry:
        where = f"{entry['group']} is {part['at']}"
    else:
        shown = column_display(measurements, entry["setting"])
        at = f"{shown.scale * part['at']:.4g} {shown.unit}".rstrip()
        where = f"{words(entry['setting'])} is about {at}"
    return f"{words(entry['channel'])} is {percent(part['mean'], signed=True)} off where {where}"
