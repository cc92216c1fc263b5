# SPDX-License-Identifier: Apache-2.0
"""Held-out errors of the search itself: settings that it never saw, with all choices made anew.

Runs of one setting are one piece of evidence for a law of that setting, so whole settings are left
out. A vault is a share of the settings that neither search nor folds see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.settings import independent
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import row_errors, rows_of
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.grid import Grid
from smallwheel_ros.learn.law import Law
from smallwheel_ros.learn.search import FOLD, Search
from smallwheel_ros.measurements.settings import LOAD_TOLERANCE, OF_RANGE, cluster
from smallwheel_ros.model import Model

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOLDS = 8
ONE_BY_ONE = 20  # settings up to which each is left out alone
VAULT_FROM = 40  # settings from which some are kept apart from everything
_VAULT_SHARE = 5  # one in so many of them


@dataclass(frozen=True)
class HeldOut:
    """Errors of rows, measured less predicted, by channel, shape (rows,), NaN where none.

    before: of the base; after: with the law that the fold found. choices: these laws, None where a
    fold found none.
    """

    before: dict[str, Array]
    after: dict[str, Array]
    choices: list[Law | None] = field(default_factory=list)

    @classmethod
    def nothing(cls, points: Points) -> HeldOut:
        """No errors yet."""
        rows = len(points.measurements)
        before: dict[str, Array] = {name: np.full(rows, np.nan) for name in points.channels}
        return cls(before, {name: blank.copy() for name, blank in before.items()})

    def add(self, left: Points, base: Model, law: Model) -> bool:
        """Put in the errors of two models on points; return whether the law's are less somewhere."""
        rows, less = rows_of(left), []
        before, after = (row_errors(left.measurements, model, rows) for model in (base, law))
        for name, mine in rows.items():
            self.before[name][mine] = before[name][mine]
            self.after[name][mine] = after[name][mine]
            less.append(np.mean(after[name][mine] ** 2) <= np.mean(before[name][mine] ** 2))
        return any(less)


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
    found = HeldOut.nothing(points)
    for number in range(count):
        out = fold == number
        training = fitter.of_values(points.take(~out), ~out)
        plain = training.fit(base.vector, base.theta, base.scatter, turns=2)
        chosen = Search(training, plain, grid).run(FOLD).draft
        found.choices.append(None if chosen is None else chosen.law)
        found.add(
            points.take(out), plain.model, plain.model if chosen is None else chosen.fit.model
        )
        done()
    return found
