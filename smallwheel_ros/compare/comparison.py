# SPDX-License-Identifier: Apache-2.0
"""Models against measurements: error held out and in sample, by channel, soil, wheel and condition.

comparison = compare(read_measurements("rig.csv"))
comparison.score(comparison.models[0], "sinkage", held_out=True)

Points, folds and errors are those of `fitting`, as in every other command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.common.results import Result
from smallwheel_ros.compare.contenders import Constant, Contender, standard_contenders
from smallwheel_ros.compare.results import (
    Floor,
    Index,
    ModelResult,
    Progress,
    Reasons,
    floors_of,
    results_of,
)
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.held_out import Comparison as Change
from smallwheel_ros.fitting.held_out import CvErrors, Score, compare_cv, folds_of, rows_of
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, Array, Mask
from smallwheel_ros.measurements.display import shown_value, words
from smallwheel_ros.measurements.settings import Part, parts
from smallwheel_ros.measurements.table import Measurements

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROUNDING = 1e-9  # of the error: less of a mean of errors is no bias but its rounding
_SUNK = "the wheel was measured deeper than its axle"


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """Models against the same measurements.

    noise: by channel. folds: how many parts the runs were dealt into for the held-out error, 0 where
    nothing could be held out. left_out: lines of rows that are in no error, with the reason.
    """

    measurements: Measurements
    models: tuple[ModelResult, ...]
    noise: Mapping[str, Floor]
    parts: tuple[Part, ...]
    folds: int
    left_out: Reasons
    notes: tuple[str, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that at least one model predicts."""
        return tuple(c for c in self.noise if any(self.score(m, c) for m in self.models))

    @property
    def run(self) -> Index:
        """Code of each row's run, shape (rows,)."""
        return self.models[0].in_sample.run

    def residual(self, result: ModelResult, channel: str, held_out: bool = False) -> Array:
        """Measured less predicted, shape (rows,); NaN where either is missing."""
        errors = result.held_out if held_out else result.in_sample
        blank = np.full(len(self.measurements), np.nan)
        return blank if errors is None else errors.error.get(channel, blank)

    def score(
        self, result: ModelResult, channel: str, held_out: bool = False, rows: Mask | None = None
    ) -> Score | None:
        """Score one model on one channel, on some rows if given; None where it predicts none."""
        errors = result.held_out if held_out else result.in_sample
        found = None if errors is None else errors.score(channel, rows)
        if found is not None and abs(found.bias) < _ROUNDING * found.rmse:
            found = replace(found, bias=0.0)
        return found

    def best(self, channel: str, laws: bool = False) -> ModelResult | None:
        """The model of the least error on runs that it was not fitted to.

        Where no model has such runs, of the least error in sample. None where none predicts it.
        laws: among the laws only, of which a constant is none.
        """
        scores = [(m, e.score(channel)) for m, e in self._compared()
                  if not (laws and isinstance(m.contender.model, Constant))]  # fmt: skip
        known = [(s.rmse, i) for i, (_, s) in enumerate(scores) if s is not None]
        return scores[min(known)[1]][0] if known else None

    def differences(self, channel: str) -> dict[str, Change]:
        """How the models compare with the best one, by name, of those that can be compared."""
        best = self.best(channel)
        errors = {m.contender.name: e for m, e in self._compared()}
        if best is None:
            return {}
        of_best = errors.pop(best.contender.name)
        found = {name: compare_cv(of_best, e) for name, e in errors.items()}
        return {name: change for name, change in found.items() if channel in change.reduction}

    def useless(self, channel: str) -> str:
        """Say so where a constant has less error than every law; "" elsewhere."""
        best, law = self.best(channel), self.best(channel, laws=True)
        if best is None or law is None or best is law:
            return ""
        errors = [
            self.score(m, channel, held_out=True) or self.score(m, channel) for m in (best, law)
        ]
        said = [shown_value(channel, e.rmse) for e in errors if e is not None]
        return (
            f"no law has less error than a constant, the mean of the other runs: {law.contender.name}, the "
            f"best of them, has {said[-1]}, the constant {said[0]}"
        )

    def headline(self) -> str:
        """The best model of each channel, and how far off it is."""
        shown = []
        for channel in self.channels:
            best = self.best(channel)
            score = best and (self.score(best, channel, held_out=True) or self.score(best, channel))
            if useless := self.useless(channel):
                shown.append(f"{words(channel)}: {useless}")
            elif best is not None and score:
                shown.append(
                    f"{words(channel)} best by {best.contender.name}, error "
                    f"{shown_value(channel, score.rmse)}"
                )
        said = "; ".join(shown) or "no model could predict any of the measurements"
        return f"{len(self.models)} models on {len(self.measurements)} rows: {said}"

    def rows(self) -> list[dict[str, Any]]:
        """Errors of each model on each channel."""
        found = []
        for channel in self.channels:
            for model in self.models:
                outside = self.score(model, channel, held_out=True)
                inside = self.score(model, channel)
                either = outside or inside
                found.append({
                    "channel": channel,
                    "unit": CHANNEL_UNITS[channel],
                    "model": model.contender.name,
                    "held_out_rmse": None if outside is None else outside.rmse,
                    "held_out_rmse_std": None if outside is None else outside.rmse_std,
                    "held_out_bias": None if outside is None else outside.bias,
                    "in_sample_rmse": None if inside is None else inside.rmse,
                    "rows": 0 if either is None else either.rows,
                })  # fmt: skip
        return found

    def plot(self, ax: Axes | None = None, channel: str | None = None) -> Axes:
        """Draw each model's error, held out and in sample. channel: the first if not given."""
        return self._drawn(ax, channel)

    def _compared(self) -> list[tuple[ModelResult, CvErrors]]:
        unseen = [(m, m.unseen) for m in self.models if m.unseen is not None]
        return unseen or [(m, m.in_sample) for m in self.models]


def compare(
    measurements: Measurements,
    contenders: Sequence[Contender] = (),
    *,
    standard: bool = True,
    progress: Progress = lambda done, needed: None,
) -> Comparison:
    """Compare models with measurements.

    contenders: further models beside the standard ones. progress: told how many of how many fits
    are done.
    Raises FittingError where nothing usable was measured, or too little for a fit.
    """
    problem = Problem.of(measurements)
    points = problem.points
    folds = int(folds_of(points).max()) + 1 if points.run_count > 1 else 0
    models = [*(standard_contenders(points) if standard else ()), *contenders]
    results = results_of(models, problem, folds, progress)
    return Comparison(
        measurements,
        tuple(results),
        floors_of(points),
        tuple(parts(measurements)),
        folds,
        _left_out(points, problem.outliers),
        _notes(points, folds),
    )


def _left_out(points: Points, outliers: Index) -> Reasons:
    data = points.measurements
    free = np.ones(len(data), dtype=bool)
    free[np.concatenate(list(rows_of(points).values()))] = False
    nothing = np.all([~np.isfinite(v) for v in data.channels.values()], axis=0)
    found = []
    for why, rows in (
        (f"{_SUNK}, where no model of a rolling wheel holds", data.sunk_to_axle),
        ("nothing was measured", nothing),
        ("far off the others of their run", np.isin(np.arange(len(data)), outliers)),
        ("a body that has not settled, or a channel that no model predicts there", free),
    ):
        if (rows & free).any():
            found.append((why, data.line[rows & free]))
            free[rows] = False
    return tuple(found)


def _notes(points: Points, folds: int) -> tuple[str, ...]:
    notes = [note for note in points.notes if _SUNK not in note]
    if not folds:
        notes.append("all rows are of one run: nothing can be held out, every error is in sample")
        return tuple(notes)
    soil = points.measurements.soil
    run = {i: rows[0] for i, rows in zip(points.run, points.rows, strict=True)}
    names, count = np.unique(soil[list(run.values())], return_counts=True)
    if names.size > 1:
        notes += [
            f"soil '{name}' has one run: where it is held out, nothing is known of that soil"
            for name in names[count == 1]
        ]
    return tuple(notes)
