# SPDX-License-Identifier: Apache-2.0
"""How far a prediction may be off: by the law, and for one row of one new run.

    law     J C J', J the slopes of the prediction by the fitted parameters and C their covariance, plus the
            error of the law itself: of pull and torque (`ForceLaw`), of the others from setting to setting
    run     in addition (tau dy / d ln k)^2, the soil of a new run, and scatter of its instruments and rows
            (`RunScatter`)

For models that the data could not tell apart, the prediction m is that of the one model that stands
for them (`mixture.mixed`), as in compare, node and replay; with their probabilities w its variance
is sum w (s_i^2 + (m_i - m)^2).
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

_STEP = 1e-4  # of a standard deviation: far from rounding, close enough to be a slope
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
    """A prediction and its standard deviations by quantity; arrays of shape (rows,), SI units.

    Attributes
    ----------
    standard_deviation
        Standard deviation of the law's prediction; empty if the model file has no covariance.
    run_deviation
        Standard deviation of a row measured in a new run; empty if the model has no scatter of runs and rows.
    """

    prediction: Prediction
    standard_deviation: Mapping[str, Array]
    run_deviation: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Sloped:
    """A prediction with its slopes by the parameters of a covariance. slopes: by quantity, (names, rows)."""

    prediction: Prediction
    calibrated: CalibratedModel
    slopes: Mapping[str, Array]

    def deviations(self, of: Callable[[str], bool] = lambda _: True) -> dict[str, Array]:
        """Standard deviation of each quantity. of: only due to the parameters for which this is true."""
        kept = [i for i, name in enumerate(self.calibrated.names) if of(name)]
        # The square root of the covariance turns the propagation into a sum of squares over directions.
        values, vectors = np.linalg.eigh(self.calibrated.covariance[np.ix_(kept, kept)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return {q: np.sqrt(np.sum((root.T @ s[kept]) ** 2, axis=0)) for q, s in self.slopes.items()}

    def by_stiffness(self, quantity: str) -> Array:
        """Change of a quantity with ln k, shape (rows,)."""
        names = self.calibrated.names
        mine = [i for i, name in enumerate(names) if name.endswith(".log_reference_pressure")]
        return np.asarray(self.slopes[quantity][mine].sum(axis=0))


def predict_with_uncertainty(
    calibrated: CalibratedModel, conditions: Conditions
) -> UncertainPrediction:
    """Predict, with the standard deviations that follow from those of the parameters, to first order.

    Parameters
    ----------
    calibrated
        The model; the covariance is that of its parameters `names`.
    conditions
        Settings, SI units, shape (rows,) each.
    """
    found = _sloped(calibrated, conditions)
    return UncertainPrediction(found.prediction, found.deviations())


def predict_of(calibrated: CalibratedModel, conditions: Conditions) -> UncertainPrediction:
    """Predict with both standard deviations, of the law and of a new run; rivals are combined into one model.

    Numbers of the strength that the model's covariance lacks get the deviations of usual soils
    (`with_usual_strength`).

    Parameters
    ----------
    calibrated
        The model, or several that the data could not tell apart.
    conditions
        Settings, SI units, shape (rows,) each.
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
        ):  # of the sinkage's law nothing is known: forces of the balance alone
            laws = {name: laws[name] for name in _BY_STRENGTH}
    return _of_runs(found, laws, conditions, calibrated.measured)


def _sloped(calibrated: CalibratedModel, conditions: Conditions) -> _Sloped:
    """A prediction and its slopes by differences, one-sided at the edge of a parameter's domain."""
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
        Name of the parameter as in a model file: `SOIL.n`, `EFFECT.a`.
    change
        Change of the parameter, in the unit of its standard deviation.

    Raises
    ------
    ModelError
        Where the model has no such parameter.
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
    """The deviations with what the law of pull and torque is itself off by.

    Of a wheel that was measured, at slips that were, the fit knows what it is off by, strength included
    (`ForceLaw.known`). Elsewhere strength and law are off, the law by what this table says or, where pull or
    torque was not measured, by what other rigs say.
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
            # Strength was fitted at the sinkage as it is predicted: at these loads that error is in it.
            known = np.hypot(np.where(heavier, of_soil[name], 0.0), law.known * size)
            laws[name] = np.where(here, np.minimum(known, laws[name]), laws[name])
    return laws


def _of_runs(
    found: _Sloped, laws: Mapping[str, Array], conditions: Conditions, measured: Measured
) -> UncertainPrediction:
    """With what the law is off by from setting to setting, and the deviation of a row of a new run.

    Its soil, its instruments and its rows scatter. Where no law describes the data, what runs differ by may
    be an error of the law, and counts as one.
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
    """One prediction for models with their probabilities: their deviations, and what they are off it."""

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

# Of the parameters of a wheel on a soil, in words.
_WHEEL_WORDS = {
    "rolling_share": "share of rolling in the shear",
    "rim_friction": "bare rim's friction over the soil's",
    "pressure_peak": "place of the largest pressure on the arc at slip 1",
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
    """The model with deviations of its strength, and a note on which of these were not measured.

    A fit without pull and torque leaves the strength unchanged, and pull would look as if it were known
    exactly. What the covariance lacks is filled with the deviations among soils of one kind
    (`usual_strength`), as in the estimator, and among rigs (`WHEEL_PARAMETERS`).
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
