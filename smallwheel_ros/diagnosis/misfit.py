# SPDX-License-Identifier: Apache-2.0
"""What a model leaves unexplained: lack of fit, a saturated sensor, regions where it fails, residuals.

Errors are relative to the size of a value, and the run is the unit of evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from smallwheel_ros.diagnosis.held_out import HeldOut
from smallwheel_ros.diagnosis.posterior import Posterior
from smallwheel_ros.diagnosis.search import Search
from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.result import unusual
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.measurements.display import (
    column_display,
    percent,
    setting_words,
    shown_value,
    words,
)
from smallwheel_ros.measurements.measurements import Measurements

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Entry = dict[str, Any]

_PLATEAU = 4  # values at least
_DRAWS = 999
_FEWEST_RUNS = 3  # on each side of a cut, or of a part, to say anything
_REPLICATES = 499
_SHOWN = 0.05
_BOTH_SIGNS = 0.2  # least share of a range on the other side of zero
_MOST = 6
_PARTS = 3  # low, middle and high of a setting
_MOST_GROUPS = 12
_ONE_LEVEL = 0.01  # of a setting's range: what differs by less was set alike
_FEW_LEFT = 0.5  # of an error: where no more is left elsewhere, it is one of that end
_FAR_OFF = 3.0  # standard errors of a part's mean, from which it is reported


@dataclass(frozen=True)
class LackOfFit:
    """Misfit of a channel from setting to setting, compared with the differences of runs of one setting.

    Attributes
    ----------
    ratio
        Square root of F (`lack_of_fit`): the misfit over the standard deviation expected from repeated runs
        and the usual error of a law.
    p
        p-value of F.
    misfit
        Root mean square of the settings' mean residuals, relative to the size of a value.
    at
        The setting with the largest misfit, in words.
    """

    ratio: float
    p: float
    misfit: float
    at: str


def lack_of_fit(fitter: Fitter, fit: Fit) -> dict[str, LackOfFit]:
    """Test each channel for lack of fit (F test: Fisher 1922; Draper and Smith 1998, ch. 2).

        F = [sum n m^2 / (settings - parameters)] / [sum (r - m)^2 / (runs - settings) + n u^2]

    with r the relative residual of a run, and m the mean of a setting's n runs. No law is exact: u is the
    largest usual relative error of a law. Values of swept runs are not used.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.

    Returns
    -------
    dict of LackOfFit
        By channel, for those with settings that several runs repeat, and with more settings than
        parameters.
    """
    points, found = fitter.points, {}
    share = (points.value - fit.predicted) / fitter.level
    pulled = fitter.covariance(fit).solve(fit.slopes)
    leverage = np.sum((fit.slopes @ fit.covariance) * pulled, axis=1)
    usual = constants.LACK_OF_FIT * np.exp(constants.SPREAD)
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & ~points.swept)
        setting = np.unique(points.setting[mine], return_inverse=True)[1].reshape(-1)
        count = np.bincount(setting)
        spare = count.size - float(leverage[mine].sum())
        repeats = mine.size - count.size
        if repeats < 1 or spare < 1.0:
            continue
        mean = np.bincount(setting, share[mine]) / count
        off = float(np.sum(count * mean**2)) / spare
        apart = float(np.sum((share[mine] - mean[setting]) ** 2)) / repeats
        noise = apart + float(count.mean()) * usual**2
        worst = mine[setting == int(np.argmax(np.abs(mean) * np.sqrt(count)))]
        found[name] = LackOfFit(
            float(np.sqrt(off / noise)),
            float(fdtrc(spare, repeats, off / noise)),
            float(np.sqrt(np.mean(mean**2))),
            setting_of(points, worst),
        )
    return found


@dataclass(frozen=True)
class Plateau:
    """A group of a channel's largest values that lie close together.

    Attributes
    ----------
    count
        Number of values in the group.
    value
        Their geometric mean, in the channel's SI unit.
    span
        Relative difference of the largest from the smallest: largest / smallest - 1.
    p
        Probability that chance alone brings the largest values so close together.
    """

    count: int
    value: float
    span: float
    p: float


def plateaus(fitter: Fitter, fit: Fit) -> dict[str, Plateau]:
    """Test whether a channel's largest values lie as close together as those of a saturated sensor.

    The statistic is the largest of -ln(variance of ln y over the k largest values), with k from 4 to half
    of the values, standardised for each k. Its distribution comes from data that is drawn from the fit with
    its scatter, and rounded to the resolution of the measurements.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.

    Returns
    -------
    dict of Plateau
        By channel, for those with at least 8 values, all of them positive; not for pull and torque.
    """
    points, found = fitter.points, {}
    deviation = np.sqrt(np.diag(fitter.covariance(fit).matrix))
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name) & ~points.swept)
        measured, predicted = points.value[mine], fit.predicted[mine]
        if name in FORCES or mine.size < 2 * _PLATEAU:
            continue
        if min(measured.min(), predicted.min()) <= 0.0:
            continue
        resolution = float(np.diff(np.unique(measured), prepend=0.0).min())
        noise = np.random.default_rng(17).normal(size=(_DRAWS, measured.size))
        drawn = predicted * np.exp(deviation[mine] / predicted * noise)
        drawn = np.maximum(np.rint(drawn / resolution), 1.0) * resolution
        top = np.log(
            np.sort(np.vstack([measured, drawn]), axis=1)[:, : -measured.size // 2 - 1 : -1]
        )
        count = np.arange(1, top.shape[1] + 1)
        apart = top - top[:, :1]
        spread = np.cumsum(apart**2, axis=1) / count - (np.cumsum(apart, axis=1) / count) ** 2
        rounding = (resolution / measured.max()) ** 2 / 12.0
        close = -np.log(np.maximum(spread, 0.0) + rounding)[:, _PLATEAU - 1 :]
        flat = (close - close[1:].mean(axis=0)) / close[1:].std(axis=0)
        best = flat.max(axis=1)
        k = int(np.argmax(flat[0])) + _PLATEAU
        p = float((1 + np.sum(best[1:] >= best[0])) / (1 + _DRAWS))
        value, span = float(np.exp(top[0, :k].mean())), float(np.expm1(-apart[0, k - 1]))
        found[name] = Plateau(k, value, span, p)
    return found


@dataclass(frozen=True)
class Misfit:
    """What the best explanation leaves unexplained beyond chance.

    Attributes
    ----------
    lack_of_fit, plateaus
        Results of `lack_of_fit` and `plateaus`, by channel.
    scatter
        Standard deviation of each variance component of that model, by name (`Scatter`).
    mixed
        Those of `scatter` that show that runs of different soils bear one name; usually empty.
    """

    lack_of_fit: Mapping[str, LackOfFit]
    plateaus: Mapping[str, Plateau]
    scatter: Mapping[str, float]
    mixed: Mapping[str, float]


def misfit_of(found: Search, posterior: Posterior, held: HeldOut) -> Misfit:
    """Compute the misfit of the best explanation of the data.

    That is the model with the named effects, if there are neither rivals nor unknown effects besides; else
    the most probable model. If nothing is missing, lack of fit and plateaus are those of the base model.

    Parameters
    ----------
    found
        All models that were fitted.
    posterior
        Probabilities of the effects.
    held
        Held-out errors, and the effects that are named after them.
    """
    rivals = posterior.rivals or held.useless
    named_alone = held.named and not rivals and not posterior.unknown
    model = held.best if named_alone else found.ordered[0]
    judged = found.none if posterior.word == "adequate" else model
    return Misfit(
        lack_of_fit(found.fitter, judged),
        plateaus(found.fitter, judged),
        model.scatter.deviations,
        _mixed(found.fitter, model),
    )


def _mixed(fitter: Fitter, fit: Fit) -> dict[str, float]:
    """Unusual components of scatter between runs where the fit explains none of a channel's variance.

    The model's variance is then at least that of the measured values, as where soils of any firmness bear
    one name, and evidence on what the law lacks counts for nothing.
    """
    points, large, found = fitter.points, unusual(fitter, fit.scatter), dict[str, float]()
    variance = np.diag(fitter.covariance(fit).matrix)
    for name in points.channels:
        mine = points.of_channel(name)
        if variance[mine].mean() >= points.value[mine].var():
            found |= {n: size for n, size in large.items() if n in ("tau", f"own:{name}")}
    return found


# --- Where a model fails, and what is left over each part of the data


def where_it_fails(
    points: Points, errors: CvErrors, level: Array, seed: int, *, certain: bool = False
) -> list[Entry]:
    """Find the regions in which each channel fails most, as far as that is not chance.

    A cut splits the points at one value of one setting. Its statistic is the difference of the mean error
    of its two sides, relative to the level, over the standard error of that difference; the largest over
    all cuts counts. Its distribution comes from reversing the sign of whole runs' errors at random.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    errors
        Held-out errors of the table's rows.
    level
        Size of each value (`levels_of`), shape (values,), m, N or N m.
    seed
        Seed of the random signs.
    certain
        Whether the model is known to fail somewhere: then the worst cut is returned even if chance may
        explain it.

    Returns
    -------
    list of dict
        At most six, the clearest first, each with `region`, as `slip > 0.3` (SI); `channel`; `rows`, their
        number in the region; `bias` (mean of measured minus predicted) and `rmse` there, `rmse_elsewhere`,
        in m, N or N m; and `p_value`, over all cuts of the channel.
    """
    generator = np.random.default_rng([seed, 13])
    found: list[Entry] = []
    cut_by = _cut_by(points)
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
        for name, column in cut_by.items():
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
    """Settings by which the points are cut, and the absolute value, `|NAME|`, of one with both signs."""
    columns = {}
    for name, column in points.varied.items():
        columns[name] = column
        low, high = -float(column.min()), float(column.max())
        if min(low, high) > _BOTH_SIGNS * max(low, high):
            columns[f"|{name}|"] = np.abs(column)
    return columns


def _cuts(setting: Array, runs: Index) -> tuple[Mask, Array]:
    """Cuts with enough runs on both sides, and masks of the values above each.

    Returns the masks, shape (cuts, values), and the cuts, shape (cuts,).
    """
    levels = np.unique(setting)
    wide = np.diff(levels) > 1e-3 * np.ptp(levels)
    cuts = (0.5 * (levels[1:] + levels[:-1]))[wide]
    above = setting > cuts[:, None]
    enough = [min(np.unique(runs[a]).size, np.unique(runs[~a]).size) >= _FEWEST_RUNS for a in above]
    return above[enough], cuts[enough]


def _apart(share: Array, above: Mask) -> Array:
    """Absolute difference of the two sides' means over its standard error, shape (data sets, cuts)."""
    size, high = above.shape[1], above.sum(axis=1)
    total, square = share.sum(axis=1, keepdims=True), (share**2).sum(axis=1, keepdims=True)
    mean_high = share @ above.T.astype(float) / high
    mean_low = (total - mean_high * high) / (size - high)
    within = np.maximum(square - high * mean_high**2 - (size - high) * mean_low**2, 1e-12)
    spread = np.sqrt(within / max(size - 2, 1) * (1.0 / high + 1.0 / (size - high)))
    return np.asarray(np.abs(mean_high - mean_low) / spread)


def setting_of(points: Points, values: Index) -> str:
    """Describe the setting of some values in words, by the medians of the varied settings.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    values
        Indices of the values, shape (chosen,).
    """
    named = {n: float(np.median(c[values])) for n, c in points.varied.items()}
    return ", ".join(f"{words(n)} {setting_words(n, v)}" for n, v in named.items())


def at_an_end(points: Points, errors: CvErrors, channel: str) -> str:
    """Name the end of a setting's range from which most of a held-out error comes, if there is one.

    Only ends with one or two runs that no other run repeats are considered: once such a run is left out,
    the others can hardly do more than extrapolate.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    errors
        Held-out errors.
    channel
        Name of a measured quantity, such as `sinkage`.

    Returns
    -------
    str
        A clause with the errors at that end and elsewhere, and what to measure; empty if there is no such
        end.
    """
    mine = points.of_channel(channel) & ~points.swept
    square = np.array([np.mean(errors.error[channel][rows] ** 2) for rows in points.rows])
    mine &= np.isfinite(square)
    found = []
    for name, column in points.varied.items():
        levels = np.unique(column[mine])
        for end, next_to in (levels[-1:-3:-1], levels[:2]) if levels.size > 2 else ():
            there = mine & (np.abs(column - end) <= _ONE_LEVEL * (levels[-1] - levels[0]))
            repeated = np.bincount(points.setting[there]).max() > 1
            if repeated or np.unique(points.run[there]).size >= _FEWEST_RUNS:
                continue
            here, elsewhere = (float(np.sqrt(square[m].mean())) for m in (there, mine & ~there))
            if elsewhere <= _FEW_LEFT * float(np.sqrt(square[mine].mean())):
                found.append((elsewhere, here, name, end, next_to))
    if not found:
        return ""
    elsewhere, here, name, end, next_to = min(found)
    at, near = (setting_words(name, float(v)) for v in (end, next_to))
    return (
        f"{shown_value(channel, here)} at {words(name)} {at}, the end of what was measured, "
        f"{shown_value(channel, elsewhere)} elsewhere: to settle it, repeat these runs, or measure between "
        f"{words(name)} {near} and {at}"
    )


def residuals_left(fitter: Fitter, fit: Fit) -> list[Entry]:
    """Average the relative residuals of each channel over thirds of each setting, and over groups of rows.

    A residual is measured minus predicted, relative to the size of the value.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.

    Returns
    -------
    list of dict
        One for each channel and setting or group (wheel, soil, labels): `channel`; `setting` or `group`,
        its name; `parts`, each with `at` (median of the setting in SI, or the label), `runs` (their
        number), `mean`, and `std` (standard error from the spread over runs; None of a single run).
    """
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
    """Number of runs, mean relative residual over them, and its standard error (None of a single run)."""
    means = np.array([share[run == r].mean() for r in np.unique(run)])
    error = float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else None
    return {"runs": int(means.size), "mean": float(means.mean()), "std": error}


def worst_left(left: list[Entry], measurements: Measurements) -> str:
    """Describe the part of a setting or group whose mean residual differs most clearly from zero.

    Parameters
    ----------
    left
        As `residuals_left` returns it.
    measurements
        The table of measurements.

    Returns
    -------
    str
        A clause; empty if no mean over at least three runs exceeds three standard errors.
    """
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
