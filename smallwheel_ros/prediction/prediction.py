# SPDX-License-Identifier: Apache-2.0
"""One wheel, or a grid of settings, on one soil, with deviations: behind `smallwheel predict`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.result import Result
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting.constants import FORCE_LAW
from smallwheel_ros.fitting.noise import of_load, wheel_discrepancy
from smallwheel_ros.fitting.parameters import WHEEL_PARAMETERS, soil_from, soil_numbers
from smallwheel_ros.measurements.columns import COLUMNS, OTHER, SETTINGS, unit_of
from smallwheel_ros.measurements.display import listed, words
from smallwheel_ros.model.model import CalibratedModel, Model, ModelError, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil, SoilError, usual_strength

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

# SI units of the settings; any other column is in SI whatever its unit.
UNITS = {name: unit_of(name) for name in ("load", "diameter", "width", *SETTINGS)}
_MOST = 200_000
_STEP = 1e-4  # of a standard deviation: far from rounding, close enough to be a slope
SUNK = "immobilised: sunk to the axle"


class PredictionError(SmallwheelError):
    """Settings that cannot be predicted."""


# What a prediction gives, in the order in which it is shown: title, factor on SI units.
SHOWN = {
    "sinkage": ("sinkage [mm]", 1e3),
    "compaction_resistance": ("compaction resistance [N]", 1.0),
    "resistance": ("resistance [N]", 1.0),
    "thrust": ("thrust [N]", 1.0),
    "rolling_resistance": ("rolling resistance [N]", 1.0),
    "drawbar_pull": ("drawbar pull [N]", 1.0),
    "torque": ("torque [N m]", 1.0),
}
QUANTITIES = tuple(SHOWN)


@dataclass(frozen=True)
class UncertainPrediction:
    """A prediction and, by quantity, its standard deviation; arrays of shape (rows,), SI units.

    standard_deviation is empty where the model file has no covariance. It holds what follows
    from the parameters: not the scatter of a single measurement, nor what the model lacks; of pull and torque
    `prediction` adds what their law is off by.
    """

    prediction: Prediction
    standard_deviation: Mapping[str, Array]


@dataclass(frozen=True, repr=False)
class PredictionTable(Result, shown="views.prediction"):
    """Settings by name and what the model says of each combination; arrays of shape (rows,), SI.

    notes: what the numbers rest on that was not measured.
    """

    settings: Mapping[str, Array]
    varied: tuple[str, ...]
    result: UncertainPrediction
    notes: tuple[str, ...] = ()

    def headline(self) -> str:
        """The quantities of one setting, or how many settings there are."""
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
        """As `smallwheel predict --json` writes it: one mapping a row; null where the wheel is sunk."""
        return {"schema": 1, "rows": self.rows(), "notes": list(self.notes)}

    def plot(self, ax: Axes | None = None, quantity: str = "sinkage") -> Axes:
        """Draw a quantity over the setting of most values, a curve for each combination of the others.

        quantity: sinkage, resistance, drawbar_pull, torque, thrust or compaction_resistance.
        """
        return self._drawn(ax, quantity)

    def rows(self) -> list[dict[str, Any]]:
        """One mapping a row; None where the wheel is sunk."""
        prediction = self.result.prediction
        rows = []
        for i in range(prediction.sinkage.size):
            sunk = bool(prediction.immobilised[i])
            row: dict[str, Any] = {name: float(v[i]) for name, v in self.settings.items()}
            for quantity in QUANTITIES:
                values = getattr(prediction, quantity)
                if values is None:
                    continue
                row[quantity] = None if sunk else float(values[i])
                deviation = self.result.standard_deviation.get(quantity)
                if deviation is not None:
                    row[f"{quantity}_std"] = None if sunk else float(deviation[i])
            row["status"] = SUNK if sunk else "ok"
            rows.append(row)
        return rows


def cell(row: Mapping[str, Any], quantity: str) -> str:
    """A quantity as it is shown, with four digits whatever the size of the wheel."""
    value, std, factor = row[quantity], row.get(f"{quantity}_std"), SHOWN[quantity][1]
    if value is None:
        return "-"
    shown = value * factor
    text = f"{shown:#.4g}".rstrip(".") if abs(shown) < 1e5 else f"{shown:.4g}"
    return text if std is None else f"{text} +- {std * factor:.2g}"


def on_one_soil(calibrated: CalibratedModel, name: str | None, source: str) -> CalibratedModel:
    """Keep one soil of a model, by its name; None where the model has but one.

    Raises PredictionError, naming `source`, where the soil is not there or must be chosen.
    """
    model = calibrated.model
    names = [soil.name for soil in model.soils]
    if name is None and len(names) > 1:
        raise PredictionError(f"{source}: has several soils ({', '.join(names)}): say which")
    if name is not None and name not in names:
        raise PredictionError(f"{source}: has no soil '{name}': {nearest(name, names)}")
    kept = model.soils[names.index(name)] if name is not None else model.soils[0]
    others = tuple(f"{other}." for other in names if other != kept.name)
    rows = [i for i, known in enumerate(calibrated.names) if not known.startswith(others)]
    return CalibratedModel(
        replace(model, soils=(kept,)),
        tuple(calibrated.names[i] for i in rows),
        calibrated.covariance[np.ix_(rows, rows)],
        calibrated.provenance,
    )


# Of the parameters of a wheel on a soil, in words.
_WHEEL_WORDS = {
    "rolling_share": "share of rolling in the shear",
    "rim_friction": "bare rim's friction over the soil's",
    "pressure_peak": "peak of the pressure at slip 1, of the arc",
}


def _assumed_strength(soil: Soil, names: tuple[str, ...]) -> dict[str, tuple[float, str]]:
    """What pull and torque rest on that the model's covariance does not have.

    By parameter, named as in a covariance: its deviation there, and words with value and deviation.
    """
    usual = usual_strength(soil)
    c, phi, kappa = usual.cohesion, usual.friction_angle, usual.shear_displacement
    relative = kappa.standard_deviation / kappa.value
    # Deviation in a covariance; words, value in SI, factor on both and unit for people.
    known = {
        "cohesion": (c.standard_deviation, "cohesion", c.value, 1.0, " Pa"),
        "friction_angle": (
            phi.standard_deviation, "friction angle", phi.value, 180.0 / math.pi, " deg",
        ),
        "log_shear_displacement": (relative, "shear displacement", 1.0, 1e3 * kappa.value, " mm"),
    }  # fmt: skip
    for name, (_, prior) in WHEEL_PARAMETERS.items():
        known[name] = (prior.deviation, _WHEEL_WORDS[name], getattr(soil, name), 1.0, "")
    return {
        name: (
            deviation,
            f"{words} ({factor * value:.4g} +- {float(f'{factor * deviation:.2g}'):g}{unit})",
        )
        for name, (deviation, words, value, factor, unit) in known.items()
        if f"{soil.name}.{name}" not in names
    }


def with_usual_strength(calibrated: CalibratedModel) -> tuple[CalibratedModel, tuple[str, ...]]:
    """The model with a covariance of the strength too, and a note of what of it was not measured.

    A fit without pull and torque leaves the strength where it was: pull would look as if that were known
    exactly. What the covariance lacks gets the deviations among soils of one kind (`usual_strength`), as
    in the estimator, and among rigs (`WHEEL_PARAMETERS`).
    """
    names, covariance, notes = calibrated.names, calibrated.covariance, []
    for soil in calibrated.model.soils:
        assumed = _assumed_strength(soil, calibrated.names)
        if not assumed:
            continue
        unmeasured = listed([text for _, text in assumed.values()])
        notes.append(
            f"no measurement determines {unmeasured}: thrust, pull and torque "
            "rest on usual values, with the deviations among soils of one kind and among rigs"
        )
        names += tuple(f"{soil.name}.{name}" for name in assumed)
        covariance = block_diag(covariance, np.diag([d**2 for d, _ in assumed.values()]))
    return CalibratedModel(calibrated.model, names, covariance, calibrated.provenance), tuple(notes)


def with_parameter(model: Model, name: str, change: float) -> Model:
    """The model with one parameter, named as in a model file, changed by an amount.

    Raises ModelError where the model has no such parameter.
    """
    owner, _, parameter = name.rpartition(".")
    for i, soil in enumerate(model.soils):
        if soil.name == owner:
            numbers = soil_numbers(soil)
            if parameter not in numbers:
                raise ModelError(f"the covariance names '{name}': no parameter of a soil")
            changed = soil_from(soil, {parameter: numbers[parameter] + change})
            return replace(model, soils=(*model.soils[:i], changed, *model.soils[i + 1 :]))
    for i, effect in enumerate(model.effects):
        values = dict(effect.values())
        if effect.id == owner and parameter in values:
            other = replace(effect, **{parameter: values[parameter] + change})
            return replace(model, effects=(*model.effects[:i], other, *model.effects[i + 1 :]))
    raise ModelError(f"the covariance names '{name}', which is no parameter of the model")


def predict_with_uncertainty(
    calibrated: CalibratedModel, conditions: Conditions
) -> UncertainPrediction:
    """Predict, with standard deviations to first order: J C J', J by differences.

    Where a parameter stands at the edge of its domain the difference is one-sided.
    """
    prediction = predict(calibrated.model, conditions)
    if not calibrated.names:
        return UncertainPrediction(prediction, {})
    wanted = [q for q in QUANTITIES if getattr(prediction, q) is not None]
    # The square root of the covariance turns the propagation into a sum of squares over directions.
    values, vectors = np.linalg.eigh(calibrated.covariance)
    spread = np.sqrt(np.maximum(np.diag(calibrated.covariance), 0.0))
    slopes = {q: np.zeros((len(calibrated.names), len(conditions))) for q in wanted}
    for i, name in enumerate(calibrated.names):
        step = _STEP * spread[i]
        if step == 0.0:
            continue
        ends: list[Prediction] = []
        width = 0.0
        for sign in (1.0, -1.0):
            try:
                changed = with_parameter(calibrated.model, name, sign * step)
            except (SoilError, EffectError):
                ends.append(prediction)
                continue
            ends.append(predict(changed, conditions))
            width += step
        for q in wanted if width else ():
            slopes[q][i] = (getattr(ends[0], q) - getattr(ends[1], q)) / width
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    deviations = {q: np.sqrt(np.sum((root.T @ slopes[q]) ** 2, axis=0)) for q in wanted}
    return UncertainPrediction(prediction, deviations)


def _with_law_error(
    result: UncertainPrediction, conditions: Conditions, sinkage_known: bool
) -> UncertainPrediction:
    """The deviations with what the law of pull and torque is itself off by, of a wheel not measured before.

    sinkage_known: whether the model says how well its law of sinkage is known; else only forces of the
    balance have a deviation, at the sinkage as it is predicted.
    """
    share = np.hypot(FORCE_LAW, wheel_discrepancy(conditions))
    found = dict(result.standard_deviation)
    for name in ("thrust", "drawbar_pull", "torque"):
        found[name] = np.hypot(found[name], share * of_load(conditions, name))
    if not sinkage_known:
        found = {name: found[name] for name in ("thrust", "drawbar_pull", "torque")}
    return replace(result, standard_deviation=found)


def _refuse_absurd(name: str, values: Array) -> None:
    """Refuse what a table of measurements refuses too: numbers that no wheel can have."""
    spec = COLUMNS.get(name, OTHER)
    bad = np.flatnonzero(spec.bad(values) | np.isnan(values))
    if bad.size:
        raise PredictionError(f"{name} is {values[bad[0]]:g}, expected {spec.expected()}")


def _refuse_no_number(
    model: Model, conditions: Conditions, columns: Mapping[str, Array], result: UncertainPrediction
) -> None:
    """Refuse a prediction that is no number: name its row, the setting, and the effect that makes it.

    A wheel that is sunk has a number too, though it is not shown: an infinite sinkage is no sunk wheel.
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
    """Rows of which some quantity is not finite, shape (rows,)."""
    shown = [v for q in QUANTITIES if (v := getattr(prediction, q)) is not None]
    finite = np.isfinite([*shown, *(deviations or {}).values()])
    return np.asarray(~finite.all(axis=0))


def predict_conditions(
    calibrated: CalibratedModel, conditions: Conditions
) -> tuple[UncertainPrediction, tuple[str, ...]]:
    """A prediction with deviations in which the law's own error is, and what was not measured, in words."""
    if "slip" not in conditions:
        return predict_with_uncertainty(calibrated, conditions), ()
    known, notes = with_usual_strength(calibrated)
    result = predict_with_uncertainty(known, conditions)
    return _with_law_error(result, conditions, bool(calibrated.names)), notes


def predict_table(calibrated: CalibratedModel, settings: Mapping[str, Array]) -> PredictionTable:
    """Predict every combination of the settings.

    settings: load, diameter, width (N, m) and any covariate by name, each of shape (values,).
    Raises PredictionError, ConditionsError or ModelError where a value is missing or wrong, and
    where an effect of the user's own gives no number.
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
