# SPDX-License-Identifier: Apache-2.0
"""Held-out error: every row is predicted by a fit that never saw its run.

The runs are dealt into folds once, for all commands alike. What is chosen (an effect, its form) is
chosen again in each fold, from its own training runs. Errors are those of rows, in metres or
newtons; their uncertainty comes from the spread over runs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.constants import FOLDS, USEFUL
from smallwheel_ros.fitting.noise import levels_of
from smallwheel_ros.fitting.parameters import SOIL_PARAMETERS, soil_from, soil_numbers
from smallwheel_ros.fitting.points import Index, Mask, Points, filled, runs_of
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict

Array = NDArray[np.float64]

_FEWEST_RUNS = 3  # from which runs' differences have a deviation


@dataclass(frozen=True)
class Score:
    """Error of predictions against measurements of one channel, in its SI unit.

    Attributes
    ----------
    rows, runs
        Number of rows that were predicted, and of their runs.
    rmse
        Root mean square error.
    bias
        Mean of measured minus predicted: positive if the model predicts too little.
    rmse_std
        Standard error of the rmse, from the spread over runs; None with fewer than 3 runs, or if the rmse
        is 0.
    """

    rows: int
    runs: int
    rmse: float
    bias: float
    rmse_std: float | None


@dataclass(frozen=True)
class CvErrors:
    """Errors of a table's rows, held out of the fit (cross-validation) or in sample.

    Attributes
    ----------
    error
        Measured minus predicted, by channel, m, N or N m, shape (rows,); NaN where a row has none.
    run
        Index of each row's run, shape (rows,).
    """

    error: Mapping[str, Array]
    run: Index

    def score(self, name: str, rows: Mask | None = None) -> Score | None:
        """Summarise the errors of one channel.

        Parameters
        ----------
        name
            Name of a measured quantity, such as `sinkage`.
        rows
            Mask of the rows that count, shape (rows,); all if not given.

        Returns
        -------
        Score or None
            In m, N or N m; None where the channel has no error in these rows.
        """
        known = np.isfinite(self.error.get(name, np.full(self.run.size, np.nan)))
        known &= True if rows is None else rows
        if not known.any():
            return None
        error = self.error[name][known]
        squares = self.by_run(error**2, known)
        rmse, std = float(np.sqrt(np.mean(error**2))), None
        if squares.size >= _FEWEST_RUNS and rmse > 0.0:
            std = float(np.std(squares, ddof=1) / np.sqrt(squares.size)) / (2.0 * rmse)
        return Score(error.size, squares.size, rmse, float(np.mean(error)), std)

    def scores(self) -> dict[str, Score]:
        """The error of each channel that has one."""
        return {name: found for name in self.error if (found := self.score(name)) is not None}

    def without(self, rows: Index) -> CvErrors:
        """Return the errors with those of the rows of these numbers set to NaN."""
        error = {name: known.copy() for name, known in self.error.items()}
        for known in error.values():
            known[rows] = np.nan
        return CvErrors(error, self.run)

    def over(self, size: Mapping[str, Array]) -> CvErrors:
        """Return the errors divided by the size of each row's value, given by channel, shape (rows,)."""
        return CvErrors({name: known / size[name] for name, known in self.error.items()}, self.run)

    def rmse(self) -> dict[str, float]:
        """Root mean square of the errors, by channel, m, N or N m."""
        return {name: score.rmse for name, score in self.scores().items()}

    def rmse_std(self) -> dict[str, float | None]:
        """Standard error of the rmse by channel, m, N or N m; None with fewer than 3 runs."""
        return {name: score.rmse_std for name, score in self.scores().items()}

    def by_run(self, values: Array, rows: Mask) -> Array:
        """Average values within each run.

        Parameters
        ----------
        values
            Values in the chosen rows, shape (chosen,).
        rows
            Mask of the chosen rows, shape (rows,).

        Returns
        -------
        ndarray
            One mean for each run that has a chosen row, in the order of the runs' indices, in the unit of
            `values`.
        """
        count = np.bincount(self.run[rows])
        return np.asarray((np.bincount(self.run[rows], values) / np.maximum(count, 1))[count > 0])


@dataclass(frozen=True)
class ErrorComparison:
    """Change of the errors from a first to a second model, by channel.

    Attributes
    ----------
    reduction
        1 - rmse of the second model / rmse of the first; negative if the second is worse.
    z_score
        Mean over runs of the first model's mean squared error minus that of the second, divided by its
        standard error; positive if the second model is better, about 0 with one run.
    """

    reduction: Mapping[str, float]
    z_score: Mapping[str, float]

    @property
    def worse(self) -> tuple[str, ...]:
        """Channels whose error rises by more than its standard error."""
        return tuple(name for name, z in self.z_score.items() if z < -1.0)

    @property
    def better(self) -> tuple[str, ...]:
        """Channels whose error falls by at least a share `USEFUL`, and by more than its standard error."""
        falls = self.reduction
        return tuple(n for n, z in self.z_score.items() if z > 1.0 and falls[n] >= USEFUL)

    @property
    def helps(self) -> bool:
        """Whether any channel is `better`."""
        return bool(self.better)


def compare_cv(before: CvErrors, after: CvErrors) -> ErrorComparison:
    """Compare the errors of two models on the rows that both predict, for each channel that both have.

    Parameters
    ----------
    before, after
        Errors of the first and of the second model, for the same table.
    """
    reduction, z_score = {}, {}
    for name in (n for n in before.error if n in after.error):
        first, second = before.error[name], after.error[name]
        both = np.isfinite(first) & np.isfinite(second)
        if not both.any():
            continue
        squares = first[both] ** 2, second[both] ** 2
        rmse = [float(np.sqrt(s.mean())) for s in squares]
        reduction[name] = 1.0 - rmse[1] / rmse[0] if rmse[0] > 0 else 0.0
        change = before.by_run(squares[0], both) - before.by_run(squares[1], both)
        spread = float(np.std(change, ddof=1) / np.sqrt(change.size)) if change.size > 1 else np.inf
        z_score[name] = float(change.mean()) / max(spread, 1e-300) if np.any(change) else 0.0
    return ErrorComparison(reduction, z_score)


def folds_of(points: Points) -> Index:
    """Fold of each run of the table, shape (runs,): `FOLDS` folds, or one for each run where runs are few.

    Few is up to twice `FOLDS`. Runs are shuffled, the same way each time, since tables often list them in
    an order.
    """
    runs = np.unique(points.run)
    folds = runs.size if runs.size <= 2 * FOLDS else FOLDS
    found = np.zeros(len(points.runs), dtype=np.intp)
    found[runs] = np.random.default_rng(5).permutation(np.arange(runs.size) % folds)
    return found


def sizes_of(points: Points) -> dict[str, Array]:
    """Size of each row's value (`levels_of`) by channel, SI, shape (rows of the table,).

    NaN in rows that are not in the points.
    """
    level, found = levels_of(points), dict[str, Array]()
    for name in points.channels:
        found[name] = np.full(len(points.measurements), np.nan)
        for i in np.flatnonzero(points.of_channel(name)):
            found[name][points.rows[i]] = level[i]
    return found


def leave_out(group: Index) -> Iterator[Mask]:
    """Yield the mask of each group in turn, except of one that has all members.

    Parameters
    ----------
    group
        Code of each member's group, shape (members,).
    """
    for number in range(int(group.max()) + 1):
        out = group == number
        if out.any() and not out.all():
            yield out


def rows_of(points: Points) -> dict[str, Index]:
    """Numbers of the table's rows that are in its points and thus are scored, by channel, ascending."""
    found = {}
    for name in points.channels:
        mine = np.flatnonzero(points.of_channel(name))
        if mine.size:
            found[name] = np.sort(np.concatenate([points.rows[i] for i in mine])).astype(np.intp)
    return found


def row_errors(
    measurements: Measurements, model: Model, rows: Mapping[str, Index]
) -> dict[str, Array]:
    """Compute measured minus predicted values of chosen rows, by channel.

    Parameters
    ----------
    measurements
        The table of measurements.
    model
        Model that predicts the rows.
    rows
        Numbers of the rows to predict, by channel, shape (rows to predict,) each.

    Returns
    -------
    dict of ndarray
        By channel, m, N or N m, shape (rows of the table,); NaN in the other rows.
    """
    used = np.unique(np.concatenate(list(rows.values())))
    there, forces = filled(measurements.conditions).take(used), not set(FORCES).isdisjoint(rows)
    predicted = predict(model, there, with_forces=forces)
    found: dict[str, Array] = {}
    for name, index in rows.items():
        found[name] = np.full(len(measurements), np.nan)
        said = np.asarray(getattr(predicted, name))[np.searchsorted(used, index)]
        found[name][index] = measurements.channels[name][index] - said
    return found


def in_sample(points: Points, model: Model) -> CvErrors:
    """Compute the errors of a model on the rows of the points, without leaving anything out.

    Parameters
    ----------
    points
        The points, with their table.
    model
        The model; it is not fitted.
    """
    error = row_errors(points.measurements, model, rows_of(points))
    return CvErrors(error, runs_of(points.measurements)[1])


def cross_validate(
    points: Points,
    chooser: Callable[[Points], list[Model]],
    steps: int,
    fold: Index | None = None,
    *,
    known: Collection[str] | None = None,
) -> list[CvErrors]:
    """Compute held-out errors of models, each fitted with one fold of the values left out at a time.

    Parameters
    ----------
    points
        All points.
    chooser
        Function that fits models to training points and returns up to `steps` of them, simplest first; if
        it returns fewer, the last one stands for the rest.
    steps
        Number of models.
    fold
        Fold of each value, shape (values,); `folds_of` the runs if not given.
    known
        Names of soils known beforehand. Any other soil without training rows in a fold is predicted with
        the mean parameters of the soils with training rows. None: all soils are known.

    Returns
    -------
    list of CvErrors
        One for each of the `steps` models.
    """
    fold = folds_of(points)[points.run] if fold is None else fold
    blank = np.full(len(points.measurements), np.nan)
    errors = [{name: blank.copy() for name in points.channels} for _ in range(steps)]
    for out in leave_out(fold):
        training, mine = points.take(~out), rows_of(points.take(out))
        models = chooser(training)
        for step in range(steps):
            model = models[min(step, len(models) - 1)]
            model = model if known is None else _with_middle(model, training, known)
            for name, error in row_errors(points.measurements, model, mine).items():
                errors[step][name][mine[name]] = error[mine[name]]
    run = runs_of(points.measurements)[1]
    return [CvErrors(e, run) for e in errors]


def _with_middle(model: Model, training: Points, known: Collection[str]) -> Model:
    """Return the model with a mean of the training points' soils in place of each soil without any.

    Soils in `known` are kept. A fit leaves a soil without training points at its prior, which is that of
    all soils there are. The mean is weighted so that it gives the mean ln z of a plate, ln(z / 10 mm) = (ln
    p - ln p_ref - m ln(D / 0.2 m)) / n, as a regression would.
    """
    named = training.conditions.soil
    met = set() if named is None else {str(name) for name in named[training.row]}
    of_met = [soil_numbers(soil) for soil in model.soils if soil.name in met]
    if not of_met:
        return model
    shares = [1.0 / one["n"] for one in of_met]
    middle = {
        name: float(np.average([one[name] for one in of_met],
                               weights=shares if name in SOIL_PARAMETERS else None))
        for name in of_met[0]
    }  # fmt: skip
    known = {*known, *met}
    soils = tuple(s if s.name in known else soil_from(s, middle) for s in model.soils)
    return replace(model, soils=soils)
