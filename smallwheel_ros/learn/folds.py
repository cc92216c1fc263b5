# SPDX-License-Identifier: Apache-2.0
"""Held-out errors of the search itself: settings that it never saw, with all choices made anew.

Runs of one setting are one piece of evidence for a law of that setting, so whole settings are left
out. A vault is a share of the settings that neither search nor folds see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.settings import independent
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import row_errors
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.law import Law
from smallwheel_ros.learn.search import FOLD, Grid, Search
from smallwheel_ros.learn.tangent import Yardstick
from smallwheel_ros.measurements.settings import LOAD_TOLERANCE, OF_RANGE, cluster
from smallwheel_ros.model import Model

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOLDS = 8
ONE_BY_ONE = 20  # settings up to which each is left out alone
VAULT_FROM = 40  # settings from which some are kept apart from everything
_VAULT_SHARE = 5  # one in so many of them
_STUDENT = 4.0  # degrees of freedom of the loss: one bad extrapolation does not decide


@dataclass(frozen=True)
class HeldOut:
    """Errors of rows, measured less predicted, by channel, shape (rows,), NaN where none.

    before: of the base; after: with the law that the fold found. choices: these laws, None where a
    fold found none.
    """

    before: dict[str, Array]
    after: dict[str, Array]
    choices: tuple[Law | None, ...]


@dataclass(frozen=True)
class Judgement:
    """What held-out errors say.

    reduction: relative fall of the whitened rms. z: mean gain of settings over its standard error.
    agreeing: share of the folds that chose the same drivers.
    """

    reduction: float
    z: float
    agreeing: float


def setting_of(points: Points) -> NDArray[np.intp]:
    """Code of what was set at each value, shape (values,).

    Of the settings that were varied on their own: a load that follows slip does not make two settings
    of one slip, and runs of one slip stay together.
    """
    codes = [
        cluster(np.log(c) if n == "load" else c,
                LOAD_TOLERANCE if n == "load" else OF_RANGE * float(np.ptp(c)))
        for n, c in independent(points).items()
    ]  # fmt: skip
    if not codes:
        return points.setting
    return np.unique(np.column_stack(codes), axis=0, return_inverse=True)[1].reshape(-1)


def vault_of(points: Points, seed: int) -> Mask:
    """Values that are kept apart, shape (values,): none under `VAULT_FROM` settings."""
    setting = setting_of(points)
    settings = np.unique(setting)
    if settings.size < VAULT_FROM:
        return np.zeros(len(points), dtype=bool)
    kept = np.random.default_rng([seed, 1]).permutation(settings)[: settings.size // _VAULT_SHARE]
    return np.isin(setting, kept)


def nested(fitter: Fitter, base: Fit, grid: Grid, seed: int, done: Callable[[], object]) -> HeldOut:
    """Leave settings out in turn and search again without them. done: called after each fold."""
    points = fitter.points
    settings, code = np.unique(setting_of(points), return_inverse=True)
    count = settings.size if settings.size <= ONE_BY_ONE else FOLDS
    dealt = np.random.default_rng([seed, 2]).permutation(np.arange(settings.size) % count)
    fold = dealt[code.reshape(-1)]
    rows = len(points.measurements)
    before: dict[str, Array] = {name: np.full(rows, np.nan) for name in points.channels}
    after: dict[str, Array] = {name: np.full(rows, np.nan) for name in points.channels}
    choices: list[Law | None] = []
    for number in range(count):
        out = fold == number
        training = fitter.of_values(points.take(~out), ~out)
        plain = training.fit(base.vector, base.theta, base.scatter, turns=2)
        found = Search(training, plain, grid).run(FOLD)
        chosen = found.draft if found.gain > 0.0 else None
        choices.append(None if chosen is None else chosen.law)
        left = points.take(out)
        add_errors(before, left, plain.model)
        add_errors(after, left, plain.model if chosen is None else chosen.fit.model)
        done()
    return HeldOut(before, after, tuple(choices))


def rows_of(points: Points) -> dict[str, NDArray[np.intp]]:
    """By channel, the rows of the table that these points are of."""
    return {
        name: np.concatenate([points.rows[i] for i in np.flatnonzero(points.channel == c)])
        for c, name in enumerate(points.channels)
        if (points.channel == c).any()
    }


def add_errors(errors: dict[str, Array], left: Points, model: Model) -> None:
    """Put the errors of a model on the rows of these points in their places."""
    rows = rows_of(left)
    for name, error in row_errors(left.measurements, model, rows).items():
        errors[name][rows[name]] = error[rows[name]]


def judge(held_out: HeldOut, law: Law, fitter: Fitter, fit: Fit) -> Judgement:
    """What held-out errors say of a law. fit: with the law; its scatter is the yardstick."""
    points = fitter.points
    yardstick = Yardstick(fitter, fit)
    first, second = (_by_point(yardstick, points, e) for e in (held_out.before, held_out.after))
    gap = np.bincount(_settings(points), _loss(first) - _loss(second))
    error = float(np.std(gap, ddof=1)) / np.sqrt(gap.size)
    most = max(3.0 * float(np.sqrt(np.mean(first**2))), 4.0)
    rms = [float(np.sqrt(np.mean(np.minimum(np.abs(e), most) ** 2))) for e in (first, second)]
    same = [_agrees(choice, law) for choice in held_out.choices]
    return Judgement(
        1.0 - rms[1] / rms[0], float(gap.mean()) / max(error, 1e-12), float(np.mean(same))
    )


def _agrees(choice: Law | None, law: Law) -> bool:
    """Whether a fold's law follows the same settings; a constant has its stage only."""
    if choice is None or choice.columns != law.columns:
        return False
    return bool(law.columns) or choice.place.stage == law.place.stage


def _by_point(yardstick: Yardstick, points: Points, errors: dict[str, Array]) -> Array:
    """Whitened errors of the points, shape (channels, points)."""
    names = [points.channels[c] for c in points.channel]
    mean = np.array(
        [np.mean(errors[name][rows]) for name, rows in zip(names, points.rows, strict=True)]
    )
    return np.array([part[:, 0] for part in yardstick.by_channel(yardstick.white(mean)[:, None])])


def _loss(white: Array) -> Array:
    return np.asarray((_STUDENT + 1) / 2 * np.log1p(white**2 / _STUDENT).sum(axis=0))


def _settings(points: Points) -> NDArray[np.intp]:
    """Code of each point's setting, in the order of `Yardstick.by_channel`."""
    first = np.unique(points.row, return_index=True)[1]
    return np.unique(setting_of(points)[first], return_inverse=True)[1].reshape(-1)
