# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of predictions, against sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smallwheel_ros.effects.registry import effect
from smallwheel_ros.model.model import CalibratedModel, Model, ModelError, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.prediction.prediction import (
    QUANTITIES,
    predict_with_uncertainty,
    with_parameter,
)

SAND = replace(soil("dry_sand"), cohesion=300.0)
MODEL = Model(SAND) + effect("slip_sinkage", a=0.8) + effect("bulldozing", scale=1.0)
NAMES = (
    "dry_sand.log_reference_pressure",
    "dry_sand.n",
    "dry_sand.m",
    "dry_sand.cohesion",
    "dry_sand.friction_angle",
    "dry_sand.log_shear_displacement",
    "slip_sinkage.a",
    "bulldozing.scale",
)
SPREAD = np.array([0.02, 0.01, 0.02, 20.0, 0.01, 0.05, 0.03, 0.05])
AT = Conditions.of([20.0, 60.0, 110.0], [0.1, 0.2, 0.3], 0.1, slip=[0.1, 0.3, 0.6])


def covariance() -> np.ndarray:
    """Strongly correlated, as fits are."""
    rng = np.random.default_rng(11)
    half = rng.normal(size=(8, 8)) + 2.0 * np.eye(8)
    full = half @ half.T
    unit = np.sqrt(np.diag(full))
    return np.asarray(full / np.outer(unit, unit) * np.outer(SPREAD, SPREAD))


def test_against_sampling() -> None:
    calibrated = CalibratedModel(MODEL, NAMES, covariance())
    claimed = predict_with_uncertainty(calibrated, AT)
    rng = np.random.default_rng(12)
    draws = rng.multivariate_normal(np.zeros(8), covariance(), size=3000)
    seen: dict[str, list[np.ndarray]] = {q: [] for q in QUANTITIES}
    for draw in draws:
        model = MODEL
        for name, change in zip(NAMES, draw, strict=True):
            model = with_parameter(model, name, float(change))
        predicted = predict(model, AT)
        for q in QUANTITIES:
            seen[q].append(getattr(predicted, q))
    for q in QUANTITIES:
        sampled = np.std(seen[q], axis=0)
        # 3000 draws know a standard deviation to 1.3 %; the rest is what is not linear
        assert claimed.standard_deviation[q] == pytest.approx(sampled, rel=0.06), q
    assert claimed.prediction.sinkage == pytest.approx(predict(MODEL, AT).sinkage)


def test_a_single_parameter_by_hand() -> None:
    # z ~ 1 / p_ref^slope: ln z has the slope of the load, so sigma_z = z slope sigma
    calibrated = CalibratedModel(
        Model(SAND), ("dry_sand.log_reference_pressure",), np.array([[0.04]])
    )
    result = predict_with_uncertainty(calibrated, AT)
    z = result.prediction.sinkage
    softer = replace(SAND, k=SAND.k * np.exp(-1e-6))
    slope = np.log(predict(Model(softer), AT).sinkage / z) / 1e-6
    assert result.standard_deviation["sinkage"] == pytest.approx(z * slope * 0.2, rel=1e-4)


def test_nothing_known_nothing_claimed() -> None:
    assert dict(predict_with_uncertainty(CalibratedModel(MODEL), AT).standard_deviation) == {}
    sure = CalibratedModel(MODEL, ("dry_sand.n",), np.zeros((1, 1)))
    assert (predict_with_uncertainty(sure, AT).standard_deviation["sinkage"] == 0).all()


def test_without_slip_there_is_no_pull() -> None:
    calibrated = CalibratedModel(Model(SAND), ("dry_sand.n",), np.array([[1e-4]]))
    result = predict_with_uncertainty(calibrated, Conditions.of(60, 0.2, 0.1))
    assert set(result.standard_deviation) == {"sinkage", "compaction_resistance", "resistance"}


def test_a_parameter_at_the_edge_of_its_domain() -> None:
    edge = Model(SAND) + effect("slip_sinkage", a=0.0)
    inside = Model(SAND) + effect("slip_sinkage", a=1e-6)
    at = [
        predict_with_uncertainty(
            CalibratedModel(m, ("slip_sinkage.a",), np.array([[0.01]])), AT
        ).standard_deviation["sinkage"]
        for m in (edge, inside)
    ]
    assert at[0] == pytest.approx(at[1], rel=1e-4)


@pytest.mark.parametrize("name", ["wet_sand.n", "dry_sand.x", "slip_sinkage.b", "n"])
def test_unknown_parameters_are_named(name: str) -> None:
    calibrated = CalibratedModel(MODEL, (name,), np.eye(1))
    with pytest.raises(ModelError, match=f"the covariance names '{name}'"):
        predict_with_uncertainty(calibrated, AT)
