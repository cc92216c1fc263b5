# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of predictions, against sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.effects.registry import effect
from smallwheel_ros.model.measured import Measured, RunScatter, Tied
from smallwheel_ros.model.model import CalibratedModel, Model, ModelError, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.prediction.prediction import predict_conditions
from smallwheel_ros.prediction.uncertainty import (
    QUANTITIES,
    predict_of,
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


# Two deviations, mixtures, and what was not measured

RUNS = {"sinkage": RunScatter(run=0.03, zero=2e-4, absolute=1e-4, relative=0.02)}
PLAIN = Conditions.of([20.0, 60.0, 110.0], 0.2, 0.1)


def fitted(soil_name: str = "dry_sand", std: float = 0.02, **more: object) -> CalibratedModel:
    """A model whose ln pressure and n are known, and how runs scatter about it."""
    names = (f"{soil_name}.log_reference_pressure", f"{soil_name}.n")
    known = Measured(stiffness=0.05, runs=RUNS, **more)  # type: ignore[arg-type]
    return CalibratedModel(Model(soil(soil_name)), names, np.eye(2) * std**2, measured=known)


def test_the_deviation_of_one_run_is_what_fresh_rows_differ_by() -> None:
    """Fresh rows are drawn with the scatter of soil, run and row; the law is exactly right."""
    model = fitted(std=1e-6)
    claimed = predict_of(model, PLAIN)
    assert claimed.standard_deviation["sinkage"] == pytest.approx(0.0, abs=1e-6)
    rng, scatter = np.random.default_rng(3), RUNS["sinkage"]
    name, drawn = "dry_sand.log_reference_pressure", []
    for _ in range(3000):
        firmer = with_parameter(model.model, name, 0.05 * rng.normal())
        z = predict(firmer, PLAIN).sinkage
        z = z * (1 + scatter.run * rng.normal()) + scatter.zero * rng.normal()
        drawn.append(
            z * (1 + scatter.relative * rng.normal(size=3)) + scatter.absolute * rng.normal(size=3)
        )
    assert claimed.run_deviation["sinkage"] == pytest.approx(np.std(drawn, axis=0), rel=0.06)


@given(law=st.floats(0.0, 0.2))
def test_what_the_law_is_off_by_from_setting_to_setting_is_in_both_deviations(law: float) -> None:
    bare = fitted()
    runs = {"sinkage": replace(RUNS["sinkage"], law=law)}
    more = bare.changed(measured=replace(bare.measured, runs=runs))
    before, after = (predict_of(model, PLAIN) for model in (bare, more))
    off = law * before.prediction.sinkage
    for name in ("standard_deviation", "run_deviation"):
        expected = np.hypot(getattr(before, name)["sinkage"], off)
        assert getattr(after, name)["sinkage"] == pytest.approx(expected, rel=1e-9)


def test_rivals_give_one_number_for_their_mean_and_the_deviation_of_draws_from_them_about_it() -> (
    None
):
    parts = [(0.7, fitted("dry_sand", 0.1)), (0.3, fitted("moist_earth", 0.02))]
    base = parts[0][1].changed(rivals=tuple(parts))
    claimed, each = predict_of(base, PLAIN), [predict_of(one, PLAIN) for _, one in parts]
    rng = np.random.default_rng(5)
    which = rng.choice(2, p=[0.7, 0.3], size=20_000)
    draws = np.array([
        each[i].prediction.sinkage + each[i].standard_deviation["sinkage"] * rng.normal() for i in which
    ])  # fmt: skip
    apart = np.abs(each[0].prediction.sinkage - each[1].prediction.sinkage)
    off = np.abs(claimed.prediction.sinkage - draws.mean(axis=0))
    assert (off < 0.15 * apart).all()  # soils a factor of four apart: ln k has the mean
    about = np.sqrt(np.mean((draws - claimed.prediction.sinkage) ** 2, axis=0))
    assert claimed.standard_deviation["sinkage"] == pytest.approx(about, rel=0.03)
    spread = claimed.run_deviation["sinkage"] ** 2 - claimed.standard_deviation["sinkage"] ** 2
    assert (spread > 0).all()


def test_what_runs_differ_by_is_an_error_of_a_law_that_does_not_hold() -> None:
    held, not_held = (predict_of(fitted(unexplained=no), PLAIN) for no in (False, True))
    assert (not_held.standard_deviation["sinkage"] > 2 * held.standard_deviation["sinkage"]).all()
    assert (not_held.standard_deviation["sinkage"] < not_held.run_deviation["sinkage"]).all()


def test_beyond_the_ranges_and_off_a_line_there_is_a_note() -> None:
    line = Tied("load", "slip", at=0.0, slope=0.005, deviation=0.01)
    model = fitted(ranges={"load": (20.0, 100.0), "slip": (0.1, 0.5)}, tied=(line,))

    def notes(load: float, slip: float) -> str:
        return " ".join(predict_conditions(model, Conditions.of(load, 0.2, 0.1, slip=slip))[1])

    assert "extrapolated" not in notes(60.0, 0.3)
    assert "varied together" not in notes(60.0, 0.3)
    assert "extrapolated: measured was load 20 N to 100 N" in notes(140.0, 0.45)
    assert "slip and load were varied together" in notes(25.0, 0.45)


@pytest.mark.parametrize(
    ("measured", "asked", "beyond"),
    [
        ({}, None, False), ({}, 9.81, False), ({}, 1.62, True),
        ({"gravity": (1.62, 1.62)}, None, True), ({"gravity": (1.62, 1.62)}, 1.62, False),
        ({"gravity": (1.62, 9.8)}, 3.7, False), ({"gravity": (1.62, 3.7)}, 9.8, True),
    ],
)  # fmt: skip
def test_another_gravity_than_was_measured_under_is_noted(
    measured: dict[str, tuple[float, float]], asked: float | None, beyond: bool
) -> None:
    model = fitted(ranges={"load": (20.0, 100.0), **measured})
    given = {} if asked is None else {"gravity": asked}
    notes = " ".join(predict_conditions(model, Conditions.of(60.0, 0.2, 0.1, **given))[1])
    assert ("extrapolated: measured was gravity" in notes) == beyond


def test_rivals_are_named_with_their_probabilities() -> None:
    parts = ((0.6, fitted()), (0.4, fitted() + effect("slip_sinkage", a=1.0)))
    notes = predict_conditions(fitted().changed(rivals=parts), AT)[1]
    assert "could not tell these models apart: no effect (0.60), slip sinkage (0.40)" in notes[0]
