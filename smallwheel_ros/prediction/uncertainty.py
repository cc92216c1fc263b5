# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a prediction: of the law, and of one row measured in a new run.

The variances are:

    law     J C J', J the derivatives of the prediction with respect to the fitted parameters, C their
            covariance, plus the error of the law itself: of pull and torque (`ForceLaw`), of the
            others from setting to setting
    run     in addition (tau dy / d ln k)^2, the soil of a new run, and scatter of its instruments and rows
            (`RunScatter`)

For models that the data could not tell apart, the prediction m is that of the model that combines
them (`mixture.mixed`), as in compare, node and replay; with their probabilities w, predictions m_i and
deviations s_i its variance is sum w_i (s_i^2 + (m_i - m)^2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting.constants import FORCE_LAW
from smallwheel_ros.fitting.noise import of_load, wheel_discrepancy
from smallwheel_ros.fitting.parameters import (
    STRENGTH_PARAMETERS,
    WHEEL_PARAMETERS,
    soil_from,
    soil_numbers,
)
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.measurements.display import listed
from smallwheel_ros.model.measured import Measured
from smallwheel_ros.model.mixture import mixed
from smallwheel_ros.model.model import CalibratedModel, Model, ModelError, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil, SoilError, usual_strength

Array = NDArray[np.float64]

_STEP = 1e-4  # standard deviations of a parameter: well above rounding, small enough for a slope
_BY_STRENGTH = ("thrust", "drawbar_pull", "torque")
_STRENGTH = STRENGTH_PARAMETERS | WHEEL_PARAMETERS
QUANTITIES = (
    "sinkage",
    "compaction_resistance",
    "resistance",
    "thrust",
    "rolling_resistance",
    "drawbar_pull",
    "torque",
)


@dataclass(frozen=True)
class UncertainPrediction:
    """A prediction and its standard deviations by quantity (`QUANTITIES`); arrays of shape (rows,), SI units.

    Attributes
    ----------
    prediction
        The predicted values.
    standard_deviation
        Standard deviation of the law's prediction, for quantities of which it is known: without a covariance
        those of pull, thrust and torque at most.
    run_deviation
        Standard deviation of a row measured in a new run, for channels whose scatter the model has.
    """

    prediction: Prediction
    standard_deviation: Mapping[str, Array]
    run_deviation: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Sloped:
    """A prediction with its derivatives with respect to the parameters of a covariance.

    Attributes
    ----------
    prediction
        The predicted values, shape (rows,).
    calibrated
        The model, with names and covariance of the parameters.
    slopes
        Derivatives of each quantity with respect to the parameters, shape (names, rows), SI units; empty
        without names.
    """

    prediction: Prediction
    calibrated: CalibratedModel
    slopes: Mapping[str, Array]

    def deviations(self, of: Callable[[str], bool] = lambda _: True) -> dict[str, Array]:
        """Standard deviation of each quantity, (rows,), due to the parameters whose name `of` accepts."""
        kept = [i for i, name in enumerate(self.calibrated.names) if of(name)]
        # The square root of the covariance turns the propagation into a sum of squares over directions.
        values, vectors = np.linalg.eigh(self.calibrated.covariance[np.ix_(kept, kept)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return {q: np.sqrt(np.sum((root.T @ s[kept]) ** 2, axis=0)) for q, s in self.slopes.items()}

    def by_stiffness(self, quantity: str) -> Array:
        """Derivative of a quantity with respect to ln k (of all soils together), shape (rows,)."""
        names = self.calibrated.names
        mine = [i for i, name in enumerate(names) if name.endswith(".log_reference_pressure")]
        return np.asarray(self.slopes[quantity][mine].sum(axis=0))


def predict_with_uncertainty(
    calibrated: CalibratedModel, conditions: Conditions
) -> UncertainPrediction:
    """Predict with the standard deviations due to the fitted parameters alone, to first order.

    Errors of the law, scatter of runs and rivals are left out; `predict_of` includes them.

    Parameters
    ----------
    calibrated
        The model, with names and covariance of its parameters.
    conditions
        Settings, SI units, shape (rows,) each.

    Returns
    -------
    UncertainPrediction
        Without `run_deviation`; without a covariance `standard_deviation` is empty, too.

    Raises
    ------
    ModelError
        Where the covariance names a parameter that the model lacks, and as by `model.predict`.
    """
    found = _sloped(calibrated, conditions)
    return UncertainPrediction(found.prediction, found.deviations())


def predict_of(calibrated: CalibratedModel, conditions: Conditions) -> UncertainPrediction:
    """Predict with both standard deviations, of the law and of a row of a new run; rivals are combined.

    Where there is slip, parameters of the strength that the model's covariance lacks get the deviations of
    usual soils (`with_usual_strength`).

    Parameters
    ----------
    calibrated
        The model, with its rivals if it has some.
    conditions
        Settings, SI units, shape (rows,) each.

    Returns
    -------
    UncertainPrediction
        Arrays of shape (rows,); with rivals, the prediction of `mixture.mixed`, and deviations that include
        the differences between the rivals.

    Raises
    ------
    ModelError
        Where the covariance names a parameter that the model lacks, and as by `model.predict`.
    """
    if calibrated.rivals:
        parts = [(share, predict_of(rival, conditions)) for share, rival in calibrated.rivals]
        return _about(predict(mixed(calibrated), conditions), parts)
    if "slip" not in conditions:
        found = _sloped(calibrated, conditions)
        laws = found.deviations()
    else:
        found = _sloped(with_usual_strength(calibrated)[0], conditions)
        laws = _with_law_error(found, conditions, calibrated.measured)
        if (
            not calibrated.names
        ):  # nothing is known of the law of sinkage: only thrust, pull and torque have a deviation
            laws = {name: laws[name] for name in _BY_STRENGTH}
    return _of_runs(found, laws, conditions, calibrated.measured)


def _sloped(calibrated: CalibratedModel, conditions: Conditions) -> _Sloped:
    """Predict, with derivatives from central differences (one-sided at the edge of a parameter's domain)."""
    prediction = predict(calibrated.model, conditions)
    if not calibrated.names:
        return _Sloped(prediction, calibrated, {})
    wanted = [q for q in QUANTITIES if getattr(prediction, q) is not None]
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
    return _Sloped(prediction, calibrated, slopes)


def with_parameter(model: Model, name: str, change: float) -> Model:
    """Return a model with one parameter changed.

    Parameters
    ----------
    model
        The model, which is not changed.
    name
        Name of the parameter as in a covariance: `SOIL.n`, `EFFECT.a`.
    change
        Difference to the parameter's value, in its SI unit; of ln where the name begins with `log_`.

    Raises
    ------
    ModelError
        Where the model has no such parameter.
    SoilError, EffectError
        Where the changed number is outside its domain.
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


def _with_law_error(found: _Sloped, conditions: Conditions, measured: Measured) -> dict[str, Array]:
    """The law's standard deviations by quantity, with the error of the law of pull and torque included.

    For a wheel and slips that were measured, the fit states that error, which includes the error of the
    strength (`ForceLaw.known`). Elsewhere the errors of the strength and of the law both count; the latter
    is that of `measured` or, where pull or torque was not measured, the usual one of other rigs.

    Returns
    -------
    dict of ndarray
        Shape (rows,), SI units.
    """
    laws, usual = found.deviations(), np.hypot(FORCE_LAW, wheel_discrepancy(conditions))
    here, heavier = measured.has_wheel(conditions), measured.beyond("load", conditions)
    of_soil = found.deviations(lambda name: name.rpartition(".")[2] not in _STRENGTH)
    for name in _BY_STRENGTH:
        # Thrust is pull and the resistance that goes with it.
        law = measured.forces.get("drawbar_pull" if name == "thrust" else name)
        size = of_load(conditions, name)
        laws[name] = np.hypot(laws[name], size * (usual if law is None else law.elsewhere))
        if law is not None and name != "thrust":
            # Strength was fitted at the predicted sinkage: at the measured loads `known` includes its error.
            known = np.hypot(np.where(heavier, of_soil[name], 0.0), law.known * size)
            laws[name] = np.where(here, np.minimum(known, laws[name]), laws[name])
    return laws


def _of_runs(
    found: _Sloped, laws: Mapping[str, Array], conditions: Conditions, measured: Measured
) -> UncertainPrediction:
    """Add the error of the law from setting to setting to `laws`, and the deviation of a row of a new run.

    The new run's soil, instruments and rows scatter. Where the data confirms no law, the differences between
    runs may be errors of the law, and count as such.

    Parameters
    ----------
    found
        The prediction.
    laws
        Standard deviations of the law by quantity, SI units, shape (rows,); channels that are not in it get
        neither deviation.
    conditions
        Settings, SI units, shape (rows,) each.
    measured
        Scatter of the measurements.
    """
    laws, runs = dict(laws), {}
    for name, scatter in measured.runs.items():
        value = getattr(found.prediction, name)
        if value is None or name not in laws:
            continue
        level = of_load(conditions, name) if name in FORCES else np.abs(value)
        laws[name] = np.sqrt(laws[name] ** 2 + scatter.of_law(level))
        of_run = (measured.stiffness * found.by_stiffness(name)) ** 2 + scatter.of_run(level)
        runs[name] = np.sqrt(laws[name] ** 2 + of_run + scatter.of_row(level))
        if measured.unexplained:
            laws[name] = np.sqrt(laws[name] ** 2 + of_run)
    return UncertainPrediction(found.prediction, laws, runs)


def _about(
    middle: Prediction, parts: Sequence[tuple[float, UncertainPrediction]]
) -> UncertainPrediction:
    """Standard deviations of a prediction that stands for several, from theirs and their differences from it.

    parts: probability and prediction of each. A quantity has none if one of the predictions lacks it.
    """

    def off(deviations: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        known = set.intersection(*(set(one) for one in deviations))
        return {
            name: np.sqrt(sum(
                share * (own[name] ** 2 + (getattr(one.prediction, name) - getattr(middle, name)) ** 2)
                for (share, one), own in zip(parts, deviations, strict=True)
            ))
            for name in QUANTITIES if name in known
        }  # fmt: skip

    return UncertainPrediction(
        middle,
        off([one.standard_deviation for _, one in parts]),
        off([one.run_deviation for _, one in parts]),
    )


# --- Strength that was not measured

# Parameters of a wheel on a soil, in words.
_WHEEL_WORDS = {
    "rolling_share": "share of rolling in the shear",
    "rim_friction": "bare rim's friction over the soil's",
    "pressure_peak": "place of the largest pressure on the arc at slip 1",
}


def _assumed_strength(soil: Soil, names: tuple[str, ...]) -> dict[str, tuple[float, str]]:
    """The parameters of a soil's strength that the model's covariance lacks, with usual deviations.

    names: those of the covariance. Returns by parameter, named as in a covariance but without the soil: its
    standard deviation there (SI; of ln for `log_`), and words with value and deviation.
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
    """Complete a model's covariance with usual deviations of the strength that was not measured.

    A fit without pull and torque leaves the strength unchanged, and pull would look as if it were known
    exactly. What the covariance lacks is filled, without correlations, with the deviations among soils of one
    kind (`usual_strength`), as in the estimator, and among rigs (`WHEEL_PARAMETERS`).

    Returns
    -------
    model
        With the completed names and covariance.
    notes
        One sentence for each soil of which something was not measured.
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
    return calibrated.changed(names=names, covariance=covariance), tuple(notes)
