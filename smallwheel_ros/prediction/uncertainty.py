# SPDX-License-Identifier: Apache-2.0
"""Predictions with standard deviations, from the covariance of a model's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting.parameters import WHEEL_PARAMETERS
from smallwheel_ros.model.model import Model, ModelError, Prediction, predict
from smallwheel_ros.model.model_file import CalibratedModel
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil, SoilError

Array = NDArray[np.float64]

QUANTITIES = (
    "sinkage", "compaction_resistance", "resistance", "thrust", "rolling_resistance", "drawbar_pull",
    "torque",
)  # fmt: skip
_STEP = 1e-4  # of a standard deviation: far from rounding, close enough to be a slope


@dataclass(frozen=True)
class UncertainPrediction:
    """A prediction and, by quantity, its standard deviation; arrays of shape (rows,), SI units.

    standard_deviation is empty where the model file has no covariance. It holds what follows
    from the parameters: not the scatter of a single measurement, nor what the model lacks; of pull and torque
    `prediction` adds what their law is off by.
    """

    prediction: Prediction
    standard_deviation: Mapping[str, Array]


def with_parameter(model: Model, name: str, change: float) -> Model:
    """The model with one parameter, named as in a model file, changed by an amount.

    Raises ModelError where the model has no such parameter.
    """
    owner, _, parameter = name.rpartition(".")
    for i, soil in enumerate(model.soils):
        if soil.name == owner:
            soils = list(model.soils)
            soils[i] = _changed_soil(soil, parameter, change)
            return Model(soils, model.geometry, model.effects, model.thrust_form)
    for i, effect in enumerate(model.effects):
        if effect.id == owner and hasattr(effect, parameter):
            effects = list(model.effects)
            values = dict(effect.values())
            effects[i] = replace(effect, **{parameter: values[parameter] + change})
            return Model(model.soils, model.geometry, effects, model.thrust_form)
    raise ModelError(f"the covariance names '{name}', which is no parameter of the model")


def _changed_soil(soil: Soil, parameter: str, change: float) -> Soil:
    if parameter == "log_shear_displacement":
        longer = soil.shear_displacement * float(np.exp(change))
        return replace(soil, shear_displacement=longer)
    if parameter in ("cohesion", "friction_angle", *WHEEL_PARAMETERS):
        return replace(soil, **{parameter: getattr(soil, parameter) + change})
    law = {
        "log_reference_pressure": soil.log_reference_pressure,
        "n": soil.n,
        "m": soil.m,
    }
    if parameter not in law:
        raise ModelError(f"the covariance names '{soil.name}.{parameter}': no parameter of a soil")
    law[parameter] += change
    return soil.with_parameters(**law)


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
