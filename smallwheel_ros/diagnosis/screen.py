# SPDX-License-Identifier: Apache-2.0
"""Linearised evidence of every competitor at one fit, for one or many data sets at once.

At a fit with covariance S = V + J P^-1 J' of the errors e, a competitor with column C (what its prior's
deviation does to the predictions) has

    ln Z1 - ln Z0 = 1/2 e' S^-1 C (I + C' S^-1 C)^-1 C' S^-1 e - 1/2 ln |I + C' S^-1 C|

under no more scatter than is usual, since a missing effect inflates it. The same arithmetic on data drawn
from the null model gives the law of the statistic "is anything missing".
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import Competitor, changed
from smallwheel_ros.fitting.constants import HIDE, SPREAD
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter

Array = NDArray[np.float64]

_NUDGE = 0.1  # of a curve's prior deviation: its columns are slopes at none


@dataclass(frozen=True)
class Column:
    """What a competitor does to the predictions at its prior's scale, shape (values, columns).

    start: the strengths at which it was taken, to start a fit from.
    """

    competitor: Competitor
    shift: Array
    start: Array


def columns_of(fitter: Fitter, fit: Fit, competitors: Sequence[Competitor]) -> list[Column]:
    """Columns of each competitor at a fit; one that has no finite prediction there is left out."""
    found: list[Column] = []
    for competitor in competitors:
        try:
            found += _columns(fitter, fit, competitor)
        except FAILURES:
            continue
    return [c for c in found if np.isfinite(c.shift).all()]


def _columns(fitter: Fitter, fit: Fit, competitor: Competitor) -> list[Column]:
    listed = competitor.part.parameters
    vector = changed(fit.vector, competitor)
    base = np.delete(vector.begun_at(fit.vector, fit.theta), vector.places(competitor.part.id))

    def moved(starts: Array) -> Array:
        thetas = np.hstack([np.tile(base, (len(starts), 1)), starts])
        return fitter.predictor.many(vector, thetas) - fit.predicted

    if competitor.geometry is not None:
        none = np.zeros((1, 0))
        return [Column(competitor, moved(none).T, none[0])]
    if competitor.kind == "unknown":
        steps = np.array([_NUDGE * p.prior.deviation for p in listed])
        return [Column(competitor, (moved(np.diag(steps)) / _NUDGE).T, np.zeros(steps.size))]
    main, start = competitor.strength, competitor.part.start
    prior = listed[main].prior
    absent = start[main] if competitor.replaces else 0.0
    if prior.low < 0.0 or competitor.replaces:
        sizes = (absent - 0.5 * prior.deviation, absent + 0.5 * prior.deviation)
    else:
        usual = prior.centre if prior.centre > 0.0 else prior.deviation
        sizes = (0.25 * usual, usual)
    starts = np.tile(start, (len(sizes), 1))
    starts[:, main] = np.clip(sizes, prior.low, prior.high)
    starts = starts[np.abs(starts[:, main] - absent) > 1e-12]
    scale = max(prior.deviation, abs(prior.centre - absent)) / (starts[:, main] - absent)
    return [
        Column(competitor, shift[:, None], at)
        for shift, at in zip(moved(starts) * scale[:, None], starts, strict=True)
    ]


class Screen:
    """Linearised evidence at one fit, under no more scatter than is usual.

    What a missing effect adds to the scatter must hide neither it nor another one.
    """

    def __init__(self, fitter: Fitter, fit: Fit, columns: Sequence[Column]) -> None:
        self.fitter, self.fit, self.columns = fitter, fit, list(columns)
        model = fitter.variance
        self._kernels = model.kernels(fit.stiffness, fit.scatter.log_length)
        usual = np.minimum(fit.scatter.log_deviation, model.log_median)
        self._s = model.total(usual, self._kernels, fit.taken_up)
        stacked = np.hstack([np.zeros((len(fitter.points), 0)), *(c.shift for c in columns)])
        self._white = self._s.whiten(stacked)
        ends = np.cumsum([0] + [c.shift.shape[1] for c in columns])
        self._places = [np.arange(a, b) for a, b in itertools.pairwise(ends)]

    def testability(self) -> list[float]:
        """Of each column, the squared deviations by which its prior's scale moves the predictions."""
        size = np.sum(self._white**2, axis=0)
        return [float(size[place].max()) for place in self._places]

    def cosines(self) -> tuple[list[str], Array]:
        """Families with one column, and how alike they act after the base is refitted."""
        best: dict[str, tuple[float, int]] = {}
        for i, (column, size) in enumerate(zip(self.columns, self.testability(), strict=True)):
            family = column.competitor.family
            if family not in best or size > best[family][0]:
                best[family] = size, i
        chosen = {f: self._places[i][0] for f, (_, i) in best.items() if self._places[i].size == 1}
        white = self._white[:, np.array([*chosen.values()], dtype=np.intp)]
        unit = white / np.maximum(np.linalg.norm(white, axis=0), 1e-150)
        return list(chosen), np.abs(unit.T @ unit)

    def draws(self, count: int, seed: int) -> Array:
        """Errors drawn from the null model, shape (values, count)."""
        model = self.fitter.variance
        capped = np.minimum(self.fit.scatter.log_deviation, model.log_median + HIDE * SPREAD)
        noise = np.random.default_rng(seed).normal(size=(len(self.fitter.points), count))
        return np.asarray(model.total(capped, self._kernels).root @ noise)

    def gains(self, errors: Array) -> Array:
        """ln evidence of each column over none, shape (columns, data sets)."""
        w, found = self._s.whiten(errors), []
        for place in self._places:
            size, turned = np.linalg.eigh(self._white[:, place].T @ self._white[:, place])
            pulled = (self._white[:, place] @ turned).T @ w
            each = pulled**2 / (1.0 + size)[:, None] - np.log1p(size)[:, None]
            found.append(0.5 * each.sum(axis=0))
        return np.array(found)

    def by_family(self, errors: Array) -> dict[str, Array]:
        """ln of each family's mass over none's, shape (data sets,), forms and columns averaged."""
        count = Counter(column.competitor.key for column in self.columns)
        found: dict[str, Array] = {}
        for column, gain in zip(self.columns, self.gains(errors), strict=True):
            c = column.competitor
            value = gain + np.log(c.share / count[c.key])
            found[c.family] = np.logaddexp(found.get(c.family, -np.inf), value)
        return found
