# SPDX-License-Identifier: Apache-2.0
"""Models against measurements: error held out and in sample, by channel, soil, wheel and condition.

comparison = comparison_of(read("rig.csv"))
comparison.score(comparison.models[0], "sinkage", held_out=True)

Points, folds and errors are those of `fitting`, as in every other command.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.arguments import unheard
from smallwheel_ros.common.result import Result
from smallwheel_ros.compare.contenders import REGRESSION, STANDARD, Contender, standard_contenders
from smallwheel_ros.compare.reasons import (
    MISSING,
    SAME_FREEDOM,
    Reasons,
    left_out,
    lone_soils,
    notes_of,
    why_of,
)
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.held_out import (
    CvErrors,
    Score,
    compare_cv,
    folds_of,
    in_sample,
    leave_out,
    row_errors,
    rows_of,
)
from smallwheel_ros.fitting.held_out import ErrorComparison as Change
from smallwheel_ros.fitting.noise import NoiseLine
from smallwheel_ros.fitting.points import Points, filled, runs_of
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, Array, Mask
from smallwheel_ros.measurements.display import listed, shown_value, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import Part, parts, repeatability, runs_of_rows
from smallwheel_ros.model.model import Model, ModelError, predict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Index = NDArray[np.intp]
Progress = Callable[[int, int], object]  # fits done, fits needed

_ROUNDING = 1e-9  # of the error: less of a mean of errors is no bias but its rounding
_ASK_DIAGNOSE = (
    "how low the error could get is unknown until it is known what is missing: "
    "`smallwheel diagnose` works it out"
)
_REPEAT = "how well a row repeats is not known: repeat a few runs, or state {}_std"


@dataclass(frozen=True)
class Floor:
    """The held-out error to expect of a true model on one channel, in which only noise is left.

    Attributes
    ----------
    value
        The error (rms; m, N or N m), as a diagnosis of the same data determines it; None without one.
    source
        How the noise is known: from "repeats", or as "declared" by the table; None without a diagnosis.
    reason
        Why there is no value, in words; empty if there is one.
    repeatability
        Standard deviation of repeats within a run, SI; None if nothing was repeated.
    """

    value: float | None
    source: str | None
    reason: str
    repeatability: float | None = None


@dataclass(frozen=True)
class ModelResult:
    """One model of a comparison, and its errors.

    Attributes
    ----------
    contender
        The model before it was fitted, with its name.
    model
        The model fitted to all rows, or used as it is; None for a constant or a regression.
    in_sample
        Errors of that model on all rows.
    held_out
        Errors on each run by a fit without that run; None for a model that is not fitted, or with one run.
    unseen
        Errors on runs that the model was not fitted to: those held out, or those of a model that was fitted
        to other data; None if there are none, or it is unknown to what it was fitted.
    not_predicted
        Reasons why it cannot predict some rows, each with the indices of these rows.
    notes
        Sentences about its errors.
    why
        By channel, what may make it predict worse than no law at all (`reasons.why_of`).
    """

    contender: Contender
    model: Model | None
    in_sample: CvErrors
    held_out: CvErrors | None = None
    unseen: CvErrors | None = None
    not_predicted: Reasons = ()
    notes: tuple[str, ...] = ()
    why: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class Comparison(Result, shown="views.comparison"):
    """Models compared with the same measurements.

    Attributes
    ----------
    measurements
        The table.
    models
        Each model with its errors, in the order in which they are shown.
    noise
        Error to expect of a true model, by channel.
    parts
        Parts of the rows, by soil, wheel, contact and each setting that was varied, for errors of each.
    folds
        Number of folds into which the runs were divided for the held-out error; 0 if nothing could be held
        out.
    left_out
        Reasons why no error includes some rows, each with the lines of these rows in the file.
    notes
        Sentences that apply to all errors.
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
        """Number of each row's run, shape (rows,)."""
        return self.models[0].in_sample.run

    def residual(self, result: ModelResult, channel: str, held_out: bool = False) -> Array:
        """Compute measured minus predicted, in the channel's SI unit, shape (rows,); NaN if one is missing.

        Parameters
        ----------
        result
            One of the models that were compared.
        channel
            sinkage, resistance, drawbar_pull or torque.
        held_out
            Whether each row is predicted by a fit without its run; else by the fit to all rows.
        """
        errors = result.held_out if held_out else result.in_sample
        blank = np.full(len(self.measurements), np.nan)
        return blank if errors is None else errors.error.get(channel, blank)

    def score(
        self, result: ModelResult, channel: str, held_out: bool = False, rows: Mask | None = None
    ) -> Score | None:
        """Error of one model on one channel; None if it has none on these rows.

        Parameters
        ----------
        result, channel, held_out
            See `residual`.
        rows
            Mask of the rows that count, shape (rows,); None: all.
        """
        errors = result.held_out if held_out else result.in_sample
        found = None if errors is None else errors.score(channel, rows)
        if found is not None and abs(found.bias) < _ROUNDING * found.rmse:
            found = replace(found, bias=0.0)
        return found

    def shown_score(self, result: ModelResult, channel: str) -> Score | None:
        """The error that is shown first: held out, or in sample if none is held out; None without either.

        Parameters
        ----------
        result, channel
            See `residual`.
        """
        return self.score(result, channel, held_out=True) or self.score(result, channel)

    def best(self, channel: str, laws: bool = False) -> ModelResult | None:
        """Find the model with the smallest error on runs that it was not fitted to.

        If no model has such runs, the one with the smallest error in sample; None if none predicts the
        channel.

        Parameters
        ----------
        channel
            sinkage, resistance, drawbar_pull or torque.
        laws
            Whether only laws are considered, which excludes the constant and the regression.
        """
        scores = [
            (m, e.score(channel)) for m, e in self._compared() if not (laws and m.model is None)
        ]
        known = [(s.rmse, i) for i, (_, s) in enumerate(scores) if s is not None]
        return scores[min(known)[1]][0] if known else None

    def differences(self, channel: str) -> dict[str, Change]:
        """The change from the best model's error to that of each other model, by its name.

        Models without an error on the channel, or without rows in common, are absent.
        """
        best = self.best(channel)
        errors = {m.contender.name: e for m, e in self._compared()}
        if best is None:
            return {}
        of_best = errors.pop(best.contender.name)
        found = {name: compare_cv(of_best, e) for name, e in errors.items()}
        return {name: change for name, change in found.items() if channel in change.reduction}

    def useless(self, channel: str) -> str:
        """Words if a model without physics has a smaller error on the channel than every law; else empty."""
        best, law = self.best(channel), self.best(channel, laws=True)
        if best is None or law is None or best is law:
            return ""
        errors = [self.shown_score(m, channel) for m in (best, law)]
        said = [shown_value(channel, e.rmse) for e in errors if e is not None]
        by = "the constant"
        what = "a constant, the mean of the other runs"
        if best.contender.name == REGRESSION:
            by, what = "the regression", "a log-log regression, which contains no physics"
        found = (
            f"no law has less error than {what}: {law.contender.name}, the best of them, has {said[-1]}, "
            f"{by} {said[0]}"
        )
        change = self.differences(channel).get(law.contender.name)
        lone = lone_soils(self.measurements) if law.held_out is not None else []
        if lone:
            met = ~np.isin(self.measurements.soil, lone)
            names = {
                law.contender.name: "the law",
                STANDARD[0]: "the constant",
                REGRESSION: "the regression",
            }
            known = {
                said: self.score(m, channel, held_out=True, rows=met)
                for name, said in names.items()
                for m in self.models
                if m.contender.name == name
            }
            there = [f"{said} {shown_value(channel, e.rmse)}" for said, e in known.items() if e]
            found += (
                f"; where the one run of soil {listed(lone)} is held out, nothing is known of it: "
                f"the errors elsewhere are {listed(there)}"
            )
        if best.contender.name == REGRESSION and change is not None:
            why, worse = law.why.get(channel, MISSING), channel in change.worse
            found += "" if worse else ", within the standard error of their difference"
            return f"{found}; {why}" if worse or why not in (MISSING, SAME_FREEDOM) else found
        return found

    def headline(self) -> str:
        """One line: the best model of each channel, and its error."""
        shown = []
        for channel in self.channels:
            best = self.best(channel)
            score = best and self.shown_score(best, channel)
            if best is not None and score:
                no_law = ", which is no law" if self.useless(channel) else ""
                shown.append(
                    f"{words(channel)} best by {best.contender.name}{no_law}, error "
                    f"{shown_value(channel, score.rmse)}"
                )
        said = "; ".join(shown) or "no model could predict any of the measurements"
        return f"{len(self.models)} models on {len(self.measurements)} rows: {said}"

    def rows(self) -> list[dict[str, Any]]:
        """One mapping for each channel and model: errors held out and in sample, SI; None for no error."""
        found = []
        for channel in self.channels:
            for model in self.models:
                outside = self.score(model, channel, held_out=True)
                inside = self.score(model, channel)
                shown = outside or inside
                found.append({
                    "channel": channel,
                    "unit": CHANNEL_UNITS[channel],
                    "model": model.contender.name,
                    "held_out_rmse": None if outside is None else outside.rmse,
                    "held_out_rmse_std": None if outside is None else outside.rmse_std,
                    "held_out_bias": None if outside is None else outside.bias,
                    "in_sample_rmse": None if inside is None else inside.rmse,
                    "rows": 0 if shown is None else shown.rows,
                })  # fmt: skip
        return found

    def plot(self, ax: Axes | None = None, channel: str | None = None) -> Axes:
        """Draw each model's error, held out and in sample.

        Parameters
        ----------
        ax
            Axes of matplotlib to draw into; None: a new figure.
        channel
            sinkage, resistance, drawbar_pull or torque; None: the first that was measured.

        Returns
        -------
        Axes
            The axes that were drawn into.
        """
        return self._drawn(ax, channel)

    def _compared(self) -> list[tuple[ModelResult, CvErrors]]:
        unseen = [(m, m.unseen) for m in self.models if m.unseen is not None]
        return unseen or [(m, m.in_sample) for m in self.models]


def comparison_of(
    measurements: Measurements,
    contenders: Sequence[Contender] = (),
    *,
    standard: bool = True,
    progress: Progress = unheard,
) -> Comparison:
    """Compare models with measurements: the standard ones, and further ones.

    Parameters
    ----------
    measurements
        The table.
    contenders
        Further models, each fitted or used as it is.
    standard
        Whether the standard models are compared, too.
    progress
        Called with the number of fits done and their total.

    Raises
    ------
    FittingError
        Where nothing usable was measured, or too little for a fit.
    """
    problem = Problem.of(measurements)
    points = problem.points
    folds = int(folds_of(points).max()) + 1 if points.run_count > 1 else 0
    listed = [*(standard_contenders(points) if standard else ()), *contenders]
    needed = (1 + folds) * sum(isinstance(c.model, Base) for c in listed)
    done = itertools.count()

    def count() -> None:
        progress(next(done), needed)

    def result_of(contender: Contender) -> ModelResult:
        model = contender.model
        if isinstance(model, Base):
            return _fitted(contender, replace(problem, base=model), count)
        if contender.name == REGRESSION:
            return _regression(contender, points, folds)
        if model is None:
            return _constant(contender, points, folds)
        return _standing(contender, model, points)

    count()
    repeats = repeatability(measurements)
    return Comparison(
        measurements,
        tuple(map(result_of, listed)),
        {
            name: Floor(
                None,
                None,
                _ASK_DIAGNOSE if name in repeats else _REPEAT.format(name),
                repeats.get(name),
            )
            for name in points.channels
        },
        tuple(parts(measurements)),
        folds,
        left_out(points, problem.outliers),
        notes_of(points, folds),
    )


def _fitted(contender: Contender, problem: Problem, count: Callable[[], None]) -> ModelResult:
    fit = problem.fit
    count()
    errors = in_sample(problem.points, fit.model)
    held_out = problem.held_out(count)
    why = why_of(problem.fitter, fit, problem.base)
    return ModelResult(contender, fit.model, errors, held_out, held_out, why=why)


def _constant(contender: Contender, points: Points, folds: int) -> ModelResult:
    """Errors of a constant: the mean of all rows in sample, the mean of the other folds' rows held out."""
    data, run = points.measurements, runs_of(points.measurements)[1]
    fold = folds_of(points)[run]
    inside, outside = {}, {}
    for name, rows in rows_of(points).items():
        value = data.channels[name][rows]
        inside[name], outside[name] = np.full((2, len(data)), np.nan)
        inside[name][rows] = value - value.mean()
        for out in leave_out(fold[rows]):
            outside[name][rows[out]] = value[out] - value[~out].mean()
    held_out = CvErrors(outside, run) if folds else None
    return ModelResult(contender, None, CvErrors(inside, run), held_out, held_out)


def _regression(contender: Contender, points: Points, folds: int) -> ModelResult:
    """Errors of a regression through all points in sample, through those of the other folds held out."""
    data, fold = points.measurements, folds_of(points)[points.run]
    conditions = filled(data.conditions)

    def errors(seen: Points, judged: Points, error: dict[str, Array]) -> None:
        """Put errors of the `judged` points' rows, by a regression through the `seen` ones, into `error`."""
        for name, rows in rows_of(judged).items():
            use = (seen.channel == seen.channels.index(name)) & (seen.value > 0)
            if name not in seen.forces and use.any():
                line = NoiseLine.through(seen.value[use], seen.row[use], seen.conditions)
                found = data.channels[name][rows] - line.at(conditions.take(rows))
                error.setdefault(name, np.full(len(data), np.nan))[rows] = found

    run = runs_of(data)[1]
    inside: dict[str, Array] = {}
    outside: dict[str, Array] = {}
    errors(points, points, inside)
    for out in leave_out(fold) if folds else ():
        errors(points.take(~out), points.take(out), outside)
    held_out = CvErrors(outside, run) if folds else None
    return ModelResult(contender, None, CvErrors(inside, run), held_out, held_out)


def _standing(contender: Contender, model: Model, points: Points) -> ModelResult:
    data = points.measurements
    able, reasons = _known_soil(model, data)
    rows = {name: index[able[index]] for name, index in rows_of(points).items()}
    rows = {name: index for name, index in rows.items() if index.size}
    error = {}
    try:
        error = row_errors(data, model, rows) if rows else {}
    except ModelError as refused:
        reasons.append((str(refused), np.unique(np.concatenate(list(rows.values())))))
    errors = CvErrors(error, runs_of_rows(data)[1])
    notes = [_origin(contender, data)]
    if error:
        used = np.unique(np.concatenate(list(rows.values())))
        sunk = int(predict(model, filled(data.conditions).take(used)).immobilised.sum())
        if sunk:
            notes.append(
                f"sinks to the axle in {sunk} rows: there its prediction is only an extrapolation, "
                "whose error counts"
            )
    other = bool(contender.fitted_to) and contender.fitted_to != data.sha256
    return ModelResult(
        contender, model, errors, None, errors if other else None, tuple(reasons), tuple(notes)
    )


def _origin(contender: Contender, data: Measurements) -> str:
    if contender.fitted_to and contender.fitted_to == data.sha256:
        return "was fitted to this very file: its error is in sample, nothing was held out"
    if contender.fitted_to:
        return "was fitted to another file and is used as it is: nothing had to be held out"
    return "is used as it is; what it was fitted to is unknown, so no error is called held out"


def _known_soil(model: Model, data: Measurements) -> tuple[Mask, list[tuple[str, Index]]]:
    """Mask of the rows whose soil the model has, and reasons with the indices of the others.

    A model of one soil is used for all rows.
    """
    known = [soil.name for soil in model.soils]
    able = np.isin(data.soil, known) | (len(known) == 1)
    reasons = []
    for name in np.unique(data.soil[~able]):
        why = f"the model has no soil '{name}'"
        if not name:
            why = f"the rows name no soil, expected one of {', '.join(known)}"
        reasons.append((why, np.flatnonzero(~able & (data.soil == name))))
    return able, reasons
