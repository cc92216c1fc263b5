# SPDX-License-Identifier: Apache-2.0
"""Predictions for one wheel or a grid of settings on one soil, with deviations: `smallwheel predict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.result import Result
from smallwheel_ros.measurements.columns import COLUMNS, OTHER, SETTINGS, Texts, unit_of
from smallwheel_ros.measurements.display import setting_words, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import varies
from smallwheel_ros.model.measured import Measured
from smallwheel_ros.model.mixture import rivals_text
from smallwheel_ros.model.model import CalibratedModel, Model, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.prediction.uncertainty import (
    QUANTITIES,
    UncertainPrediction,
    predict_of,
    with_usual_strength,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

# SI units of the settings by name; a column that is not among them is in SI, too, whatever its unit.
UNITS = {name: unit_of(name) for name in ("load", "diameter", "width", *SETTINGS)}
_MOST = 200_000
SUNK = "immobilised: sunk to the axle"


class PredictionError(SmallwheelError):
    """Settings for which no prediction can be made."""


# How each of `QUANTITIES` is shown: title, factor on SI units.
SHOWN = {
    "sinkage": ("sinkage [mm]", 1e3),
    "compaction_resistance": ("compaction resistance [N]", 1.0),
    "resistance": ("resistance [N]", 1.0),
    "thrust": ("thrust [N]", 1.0),
    "rolling_resistance": ("rolling resistance [N]", 1.0),
    "drawbar_pull": ("drawbar pull [N]", 1.0),
    "torque": ("torque [N m]", 1.0),
}


@dataclass(frozen=True, repr=False)
class PredictionTable(Result, shown="views.prediction"):
    """Settings, and a model's predictions for each row; arrays of shape (rows,), SI units.

    Attributes
    ----------
    settings
        Load, diameter, width and covariates of each row, by name.
    varied
        Names of the settings that are not the same in all rows.
    result
        Predictions with their standard deviations.
    notes
        Sentences to be shown: what was not measured, extrapolation, and warnings about the table.
    names
        `run` and `soil` of each row, if rows of a table that has these columns were predicted.
    measured
        Measured values of that table, by name: `measured_sinkage`, the standard deviation
        `measured_sinkage_std` that it states, and so on; NaN where blank.
    """

    settings: Mapping[str, Array]
    varied: tuple[str, ...]
    result: UncertainPrediction
    notes: tuple[str, ...] = ()
    names: Mapping[str, Texts] = field(default_factory=dict)
    measured: Mapping[str, Array] = field(default_factory=dict)

    def headline(self) -> str:
        """For one row sinkage, resistance and pull; for several their number and the varied settings."""
        rows = self.rows()
        if len(rows) > 1:
            return f"{len(rows)} settings of {', '.join(self.varied)}"
        (row,) = rows
        if row["status"] == SUNK:
            return SUNK
        shown = [q for q in ("sinkage", "resistance", "drawbar_pull") if q in row]
        return ", ".join(
            f"{words(q)} {cell(row, q)} {SHOWN[q][0].partition('[')[2].strip(']')}" for q in shown
        )

    def to_dict(self) -> dict[str, Any]:
        """The document that `smallwheel predict --json` writes: `schema`, `rows` (see `rows`) and `notes`."""
        return {"schema": 1, "rows": self.rows(), "notes": list(self.notes)}

    def plot(self, ax: Axes | None = None, quantity: str = "sinkage") -> Axes:
        """Draw a quantity over the setting with the most values, a curve for each combination of the others.

        Parameters
        ----------
        ax
            Axes of matplotlib to draw into; new ones without it.
        quantity
            sinkage, resistance, drawbar_pull, torque, thrust, rolling_resistance or compaction_resistance.

        Returns
        -------
        Axes
            The axes drawn into.
        """
        return self._drawn(ax, quantity)

    def rows(self) -> list[dict[str, Any]]:
        """Return one mapping for each row, SI units.

        Its keys: those of `names`, `settings` and `measured` (None where blank); each quantity that was
        predicted, its standard deviations QUANTITY_std (of the law) and QUANTITY_run_std (of a row of a new
        run) where known (None where the wheel is sunk to its axle); and `status`, `ok` or `SUNK`.
        """
        prediction = self.result.prediction
        rows = []
        for i in range(prediction.sinkage.size):
            sunk = bool(prediction.immobilised[i])
            row: dict[str, Any] = {name: str(v[i]) for name, v in self.names.items()}
            numbers = {**self.settings, **self.measured}
            row |= {n: float(v[i]) if np.isfinite(v[i]) else None for n, v in numbers.items()}
            for quantity in QUANTITIES:
                values = getattr(prediction, quantity)
                if values is None:
                    continue
                row[quantity] = None if sunk else float(values[i])
                deviation = self.result.standard_deviation.get(quantity)
                if deviation is not None:
                    row[f"{quantity}_std"] = None if sunk else float(deviation[i])
                one_run = self.result.run_deviation.get(quantity)
                if one_run is not None:
                    row[f"{quantity}_run_std"] = None if sunk else float(one_run[i])
            row["status"] = SUNK if sunk else "ok"
            rows.append(row)
        return rows


def cell(row: Mapping[str, Any], quantity: str) -> str:
    """Format a predicted quantity for display: `9.563 +- 0.21 (0.54)`.

    Parameters
    ----------
    row
        A row of `PredictionTable.rows`, in SI units.
    quantity
        Name of a quantity of `SHOWN` that the row has.

    Returns
    -------
    str
        The value with four digits in the unit of `SHOWN`; where known, the standard deviation of the law and,
        in brackets, that of a row of a new run; `-` where the wheel is sunk.
    """
    value, std, factor = row[quantity], row.get(f"{quantity}_std"), SHOWN[quantity][1]
    if value is None:
        return "-"
    shown = value * factor
    text = f"{shown:#.4g}".rstrip(".") if abs(shown) < 1e5 else f"{shown:.4g}"
    text = text if std is None else f"{text} +- {std * factor:.2g}"
    one_run = row.get(f"{quantity}_run_std")
    return text if one_run is None else f"{text} ({one_run * factor:.2g})"


def on_one_soil(calibrated: CalibratedModel, name: str | None, source: str) -> CalibratedModel:
    """Return a model with one of its soils, and without the parameters of the others; likewise its rivals.

    Parameters
    ----------
    calibrated
        The model, with one soil or several.
    name
        Name of the soil to keep; None for the only one.
    source
        Name of the model's file, or "the model", for the error message.

    Raises
    ------
    PredictionError
        Where the model has no such soil, and for None where it has several.
    """
    model = calibrated.model
    names = [soil.name for soil in model.soils]
    if name is None and len(names) > 1:
        raise PredictionError(f"{source}: has several soils ({', '.join(names)}): say which")
    if name is not None and name not in names:
        raise PredictionError(f"{source}: has no soil '{name}': {nearest(name, names)}")
    kept = model.soils[names.index(name)] if name is not None else model.soils[0]
    others = {other for other in names if other != kept.name}
    rows = [i for i, known in enumerate(calibrated.names) if known.rpartition(".")[0] not in others]
    return calibrated.changed(
        model=replace(model, soils=(kept,)),
        names=tuple(calibrated.names[i] for i in rows),
        covariance=calibrated.covariance[np.ix_(rows, rows)],
        rivals=[(share, on_one_soil(rival, name, source)) for share, rival in calibrated.rivals],
    )


def _refuse_absurd(name: str, values: Array) -> None:
    """Raise PredictionError for values of a setting that a table of measurements may not have either.

    values: SI, shape (rows,); a blank (NaN) is refused, too.
    """
    spec = COLUMNS.get(name, OTHER)
    bad = np.flatnonzero(spec.bad(values) | np.isnan(values))
    if bad.size:
        raise PredictionError(f"{name} is {values[bad[0]]:g}, expected {spec.expected()}")


def _refuse_no_number(
    model: Model, conditions: Conditions, columns: Mapping[str, Array], result: UncertainPrediction
) -> None:
    """Raise PredictionError where a prediction or deviation is not finite; it names row, settings and effect.

    A wheel that is sunk to its axle is no exception: its numbers are finite, though they are not shown.

    columns: settings by name, SI, shape (rows,), for the message.
    """
    bad = np.flatnonzero(_without_number(result.prediction, result.standard_deviation))
    if not bad.size:
        return
    first = conditions.take(bad[:1])
    culprit = "the model"
    for i, effect in enumerate(model.effects, 1):
        if _without_number(predict(replace(model, effects=model.effects[:i]), first)).any():
            culprit = f"effect '{effect.id}'"
            break
    setting = ", ".join(f"{name} {values[bad[0]]:g}" for name, values in columns.items())
    also = f", nor in {bad.size - 1} of the other rows" if bad.size > 1 else ""
    raise PredictionError(
        f"row {bad[0] + 1} of {len(conditions)} ({setting}): {culprit} gives no finite number{also}: "
        "correct its formula or its numbers, or leave these settings out"
    )


def _without_number(
    prediction: Prediction, deviations: Mapping[str, Array] | None = None
) -> NDArray[np.bool_]:
    """Rows in which some quantity, or some deviation, is not finite, shape (rows,)."""
    shown = [v for q in QUANTITIES if (v := getattr(prediction, q)) is not None]
    finite = np.isfinite([*shown, *(deviations or {}).values()])
    return np.asarray(~finite.all(axis=0))


_UNEXPLAINED = (
    "the data of this fit confirms no law: what its runs differ by is part of the deviation"
)


def _beyond_measured(measured: Measured, conditions: Conditions) -> list[str]:
    """Sentences on rows outside the measured ranges or off the line of settings varied together."""
    found, beyond, outside = [], [], np.zeros(len(conditions), dtype=bool)
    for name, ends in measured.settings.items():
        rows = measured.beyond(name, conditions)
        outside |= rows
        if rows.any():
            beyond.append(f"{words(name)} {setting_words(name, ends)}")
    if beyond:
        some = "" if outside.all() else f" in {int(outside.sum())} of {outside.size} rows"
        found.append(f"extrapolated{some}: measured was {', '.join(beyond)}; the deviations hold "
                     "if the law holds there, too")  # fmt: skip
    for one in measured.tied:
        if one.other in conditions and one.setting in conditions:
            off = one.off(conditions)
            if off.any():
                some = "" if off.all() else f" in {int(off.sum())} of {off.size} rows"
                found.append(
                    f"{words(one.other)} and {words(one.setting)} were varied together: off that line{some} "
                    "nothing was measured, and the number rests on laws that this data could not test"
                )
    return found


def predict_conditions(
    calibrated: CalibratedModel, conditions: Conditions
) -> tuple[UncertainPrediction, tuple[str, ...]]:
    """Predict with standard deviations, and with notes on what the predictions rest on.

    Parameters
    ----------
    calibrated
        The model; with rivals, the prediction is that of their mean (`mixture.mixed`).
    conditions
        Settings, SI units, shape (rows,) each.

    Returns
    -------
    result
        Predictions and deviations, shape (rows,), SI units.
    notes
        Sentences to be shown, each once: on rivals, on data that confirms no law, on extrapolation and, with
        slip, on strength that was not measured.

    Raises
    ------
    ModelError
        Where a covariate of an effect is missing, or a row's soil is not the model's.
    """
    notes = []
    if calibrated.rivals:
        notes.append(
            f"the data could not tell these models apart: {rivals_text(calibrated)}. The number is that "
            "of their mean by probability, and its deviation includes what they differ by"
        )
    models = [rival for _, rival in calibrated.rivals] or [calibrated]
    for one in models:
        if one.measured.unexplained:
            notes.append(_UNEXPLAINED)
        notes += _beyond_measured(one.measured, conditions)
    if "slip" in conditions:  # of rivals what is not determined in one of them
        notes += max(
            (with_usual_strength(one)[1] for one in models), key=lambda said: len("".join(said))
        )
    return predict_of(calibrated, conditions), tuple(dict.fromkeys(notes))


def predict_table(calibrated: CalibratedModel, settings: Mapping[str, Array]) -> PredictionTable:
    """Predict every combination of the settings.

    Parameters
    ----------
    calibrated
        The model, on one soil.
    settings
        load (N), diameter, width (m) and any covariate (SI) by name, each of shape (values,).

    Returns
    -------
    PredictionTable
        One row for each combination; the last setting changes fastest.

    Raises
    ------
    PredictionError, ConditionsError, ModelError
        Where a value is blank (NaN) or implausible, for more than 200,000 combinations, where an effect
        cannot be used on the settings, and where a prediction is not a finite number.
    """
    count = int(np.prod([v.size for v in settings.values()]))
    if count > _MOST:
        raise PredictionError(f"{count} combinations, at most {_MOST}: widen the steps")
    for name, values in settings.items():
        _refuse_absurd(name, values)
    lugs, radius = settings.get("grouser_height", np.zeros(1)), 0.5 * settings["diameter"].min()
    if lugs.max() > radius:
        raise PredictionError(
            f"grouser_height is {lugs.max():g} m, expected at most the wheel's radius, {radius:g} m"
        )
    grid = np.meshgrid(*settings.values(), indexing="ij")
    columns = {name: g.reshape(-1) for name, g in zip(settings, grid, strict=True)}
    conditions = Conditions.of(**columns)
    with np.errstate(all="ignore"):  # what is no number is refused below, by name
        result, notes = predict_conditions(calibrated, conditions)
        _refuse_no_number(calibrated.model, conditions, columns, result)
    varied = tuple(name for name, v in settings.items() if v.size > 1)
    return PredictionTable(columns, varied, result, notes + calibrated.model.cautions(conditions))


def predict_rows(calibrated: CalibratedModel, table: Measurements) -> PredictionTable:
    """Predict each row of a table, in its order.

    Parameters
    ----------
    calibrated
        The model. With several soils, each row's `soil` names its own; a single one holds for all rows,
        whatever their soil is called.
    table
        The rows; measured values, if it has any, are passed on to the result and not used.

    Raises
    ------
    PredictionError
        For more than 200,000 rows, and as `predict_table` does.
    """
    if len(table) > _MOST:
        raise PredictionError(
            f"{table.source or 'data'}: {len(table)} rows, at most {_MOST}: predict it in parts"
        )
    given = table.conditions
    conditions = given if len(calibrated.soils) > 1 else replace(given, soil=None)
    columns = {n: given[n] for n in ("load", "diameter", "width", *given.covariates)}
    with np.errstate(all="ignore"):  # what is no number is refused below, by name
        result, notes = predict_conditions(calibrated, conditions)
        _refuse_no_number(calibrated.model, conditions, columns, result)
    names = {"run": table.run} if table.runs_given else {}
    names |= {} if given.soil is None else {"soil": given.soil}
    measured = {f"measured_{name}": values for name, values in table.channels.items()}
    measured |= {f"measured_{name}_std": values for name, values in table.declared_std.items()}
    return PredictionTable(
        columns,
        tuple(name for name, values in columns.items() if varies(values)),
        result,
        (*table.understood, *table.warnings, *notes, *calibrated.model.cautions(conditions)),
        names,
        measured,
    )
