"""Models against measurements: error held out and in sample, by channel, soil, wheel and condition.

comparison = compare(read_measurements("rig.csv"))
comparison.models[0].score("sinkage", held_out=True)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.compare.contenders import Contender, standard_contenders
from smallwheel_ros.compare.scores import Index, Mask, Part, Score, parts, score
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting.observations import run_codes
from smallwheel_ros.measurements.noise_floor import NoiseFloor, noise_floor
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import ROLLING, Array

_FOLDS, _FOLDS_OF_MANY, _MANY = 10, 5, 1000  # with over so many rows fewer, larger folds do

Progress = Callable[[int, int], object]  # fits done, fits needed


class CompareError(SmallwheelError):
    """Measurements and models that cannot be compared."""


@dataclass(frozen=True)
class Predicted:
    """What a model says of each row; NaN only where `reasons` says why there is no prediction.

    values: by channel, shape (rows,). reasons: each with the rows that it holds for.
    """

    values: Mapping[str, Array]
    reasons: tuple[tuple[str, Index], ...] = ()


@dataclass(frozen=True)
class ModelResult:
    """One model of a comparison.

    model: with the parameters of a fit to all rows; None where it could not be made. in_sample:
    predictions of that model. held_out: predictions of each run by a model that was fitted without
    it, None for a model that stands as it is and where there are too few runs.
    """

    contender: Contender
    model: Model | None
    in_sample: Predicted
    held_out: Predicted | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Models against the same measurements.

    measurements: the rows that were compared. left_out: lines of rows that no model is for, with
    the reason. run: index of each row's run. folds: how many parts the held-out error is from.
    """

    measurements: Measurements
    models: tuple[ModelResult, ...]
    noise: Mapping[str, NoiseFloor]
    parts: tuple[Part, ...]
    run: Index
    folds: int
    left_out: tuple[tuple[str, Index], ...] = ()
    notes: tuple[str, ...] = field(default=())

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that were measured and that at least one model predicts."""
        return tuple(
            name
            for name in self.measurements.channels
            if any(np.isfinite(self.residual(m, name)).any() for m in self.models)
        )

    def residual(self, result: ModelResult, channel: str, held_out: bool = False) -> Array:
        """Measured minus predicted, shape (rows,); NaN where either is missing."""
        predicted = result.held_out if held_out else result.in_sample
        values = None if predicted is None else predicted.values.get(channel)
        measured = self.measurements.channels[channel]
        return measured - values if values is not None else np.full(measured.size, np.nan)

    def score(
        self, result: ModelResult, channel: str, held_out: bool = False, rows: Mask | None = None
    ) -> Score | None:
        """Score one model on one channel, on some rows if given; None where it predicts none."""
        residual = self.residual(result, channel, held_out)
        return score(residual if rows is None else np.where(rows, residual, np.nan), self.run)


def compare(
    measurements: Measurements,
    contenders: Sequence[Contender] = (),
    *,
    standard: bool = True,
    folds: int | None = None,
    progress: Progress = lambda done, needed: None,
) -> Comparison:
    """Compare models with measurements.

    contenders: further models beside the standard ones. folds: parts that the runs are dealt into
    (10; 5 with over 1000 rows); each is predicted by a model that was fitted without it. progress:
    told how many of how many fits are done.
    Raises CompareError where no row can be compared, FittingError where a fit is impossible.
    """
    data, left_out = _comparable(measurements)
    runs, run = run_codes(data)
    few = _FOLDS if len(data) <= _MANY else _FOLDS_OF_MANY
    fold = _deal(len(runs), folds or few)[run]
    models = [*(standard_contenders(data) if standard else ()), *contenders]
    count = _Count(progress, models, fold)
    results = [_result(contender, data, fold, count) for contender in models]
    notes = []
    if len(runs) < 2:
        notes.append("all rows are of one run: nothing can be held out, every error is in sample")
    return Comparison(
        data,
        tuple(results),
        noise_floor(data),
        tuple(parts(data)),
        run,
        int(fold.max()) + 1 if len(runs) > 1 else 0,
        left_out,
        tuple(notes),
    )


def _comparable(measurements: Measurements) -> tuple[Measurements, tuple[tuple[str, Index], ...]]:
    """The rows that a model is for, and the lines of the others with the reason."""
    deep = measurements.sunk_to_axle
    nothing = np.all([~np.isfinite(v) for v in measurements.channels.values()], axis=0)
    reasons = (
        ("the wheel was measured deeper than its axle, where no model holds", deep),
        ("nothing was measured", nothing & ~deep),
    )
    keep = ~(deep | nothing)
    if not keep.any():
        raise CompareError(
            f"{measurements.source or 'the measurements'}: no row to compare: in all "
            f"{len(measurements)} rows {reasons[0 if deep.any() else 1][0]}"
        )
    left_out = tuple((why, measurements.line[rows]) for why, rows in reasons if rows.any())
    return (measurements.take(keep) if left_out else measurements), left_out


def _deal(runs: int, folds: int) -> Index:
    """A fold for each run; shuffled, since runs are often recorded in the order of a setting."""
    dealt = np.arange(runs) % min(folds, runs)
    return np.random.default_rng(0).permutation(dealt)


class _Count:
    """Counts the fits of a comparison and tells of each."""

    def __init__(self, progress: Progress, models: Sequence[Contender], fold: Index) -> None:
        folds = int(fold.max()) + 1
        each = folds + 1 if folds > 1 else 1
        self.needed = each * sum(contender.fit is not None for contender in models)
        self.done, self.progress = 0, progress
        progress(0, self.needed)

    def __call__(self) -> None:
        self.done += 1
        self.progress(self.done, self.needed)


def _result(contender: Contender, data: Measurements, fold: Index, count: _Count) -> ModelResult:
    if contender.model is not None:
        return ModelResult(
            contender,
            contender.model,
            _predicted(contender.model, data),
            None,
            (_standing_note(contender, data),),
        )
    assert contender.fit is not None
    model = contender.fit(data)
    count()
    in_sample = _predicted(model, data)
    if fold.max() == 0:
        return ModelResult(contender, model, in_sample, None)
    return ModelResult(contender, model, in_sample, _held_out(contender.fit, data, fold, count))


def _standing_note(contender: Contender, data: Measurements) -> str:
    if contender.fitted_to and contender.fitted_to == data.sha256:
        return "was fitted to this very file: its error is in sample, nothing was held out"
    if contender.fitted_to:
        return "was fitted to another file and stands as it is: nothing had to be held out"
    return "stands as it is; what it was fitted to is not known, so nothing is called held out"


def _held_out(
    fit: Callable[[Measurements], Model], data: Measurements, fold: Index, count: _Count
) -> Predicted:
    values = {name: np.full(len(data), np.nan) for name in data.channels}
    reasons: dict[str, list[Index]] = {}
    for number in range(int(fold.max()) + 1):
        rows = np.flatnonzero(fold == number)
        model = fit(data.take(fold != number))
        count()
        part = _predicted(model, data.take(rows))
        for name, predicted in part.values.items():
            values[name][rows] = predicted
        for reason, index in part.reasons:
            reasons.setdefault(reason, []).append(rows[index])
    gathered = tuple((reason, np.sort(np.concatenate(r))) for reason, r in reasons.items())
    return Predicted(values, gathered)


def _predicted(model: Model, data: Measurements) -> Predicted:
    """Predictions of every channel that was measured; reasons where there is none."""
    rows = len(data)
    values = {name: np.full(rows, np.nan) for name in data.channels}
    able, reasons = _predictable(model, data)
    index = np.flatnonzero(able)
    if index.size:
        prediction = predict(model, data.conditions.take(index))
        rolling = data.conditions.contact[index] == ROLLING
        fine = ~prediction.immobilised
        for name in values:
            column: Array | None = getattr(prediction, name)
            if column is None:
                reasons.append((f"{name} needs the column 'slip'", data.channel_rows(name)))
                continue
            here = fine if name == "sinkage" else fine & rolling
            values[name][index[here]] = column[here]
        if not fine.all():
            reasons.append(("the model says sunk to the axle: it has no number", index[~fine]))
        for name in values:
            idle = np.intersect1d(data.channel_rows(name), index[~rolling])
            if name != "sinkage" and idle.size:
                reasons.append((f"a wheel that does not roll has no {name}", idle))
    return Predicted(values, tuple(reasons))


def _predictable(model: Model, data: Measurements) -> tuple[Mask, list[tuple[str, Index]]]:
    """The rows for which the model has all that it needs, and why not for the others."""
    conditions = data.conditions
    able = np.ones(len(data), dtype=bool)
    reasons: list[tuple[str, Index]] = []

    def refuse(reason: str, rows: NDArray[np.bool_]) -> None:
        if (rows & able).any():
            reasons.append((reason, np.flatnonzero(rows & able)))
            able[rows] = False

    for effect, columns in model.missing_covariates(conditions).items():
        refuse(f"effect {effect} needs the column '{columns[0]}'", np.ones_like(able))
    needed = {name: effect.id for effect in model.effects for name in effect.needs}
    for name, effect in needed.items():
        if name in conditions:
            refuse(
                f"effect {effect} needs '{name}', which is blank", ~np.isfinite(conditions[name])
            )
    if len(model.soils) > 1:
        known = [soil.name for soil in model.soils]
        unknown = ~np.isin(data.soil, known)
        for name in np.unique(data.soil[unknown]):
            refuse(f"the model has no soil '{name}'", unknown & (data.soil == name))
    return able, reasons
