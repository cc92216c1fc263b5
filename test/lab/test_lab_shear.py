# SPDX-License-Identifier: Apache-2.0
"""Shear tests: cohesion, friction angle, shear modulus, and what the curves cannot tell.

Tests `shear.py` and `strength.py`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lab_truth import shear
from random_examples import examples
from scipy.optimize import curve_fit

import smallwheel_ros as sw
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.lab.lab import fit_lab
from smallwheel_ros.lab.shear import fit_shear
from smallwheel_ros.lab.strength import (
    LabStrength,
    StrengthError,
    shear_text,
    strength_of,
    with_strength,
)
from smallwheel_ros.measurements.measurements import ShearTests
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import read_model, write_model
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.shear import peaked_share, rising_share
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.prediction.uncertainty import predict_with_uncertainty


def strength(tests: ShearTests) -> LabStrength:
    (fit,) = fit_shear(tests)
    return strength_of(fit)


def deviations(found: LabStrength) -> np.ndarray:
    return np.asarray(np.sqrt(np.diag(found.covariance)))


@pytest.mark.parametrize("seed", range(2))
def test_strength_is_that_of_a_direct_fit(seed: int) -> None:
    tests = shear(np.random.default_rng(seed))

    def law(x: np.ndarray, c: float, friction: float, modulus: float) -> np.ndarray:
        return (c + x[0] * friction) * (1 - np.exp(-x[1] / modulus))

    # relative errors, as prepared soils scatter: each row by the size of its strength
    direct, _ = curve_fit(
        law, np.array([tests.normal_stress, tests.displacement]), tests.shear_stress,
        p0=(1e3, 0.5, 0.01), sigma=1e3 + 0.6 * tests.normal_stress,
    )  # fmt: skip
    found = strength(tests)
    c, phi, log_modulus = deviations(found)
    assert abs(found.cohesion - direct[0]) < 1.5 * c
    assert abs(found.friction_angle - np.arctan(direct[1])) < 1.5 * phi
    assert abs(np.log(found.modulus / direct[2])) < 1.5 * log_modulus
    assert abs(found.cohesion - 1500.0) < 2.5 * c
    assert abs(found.friction_angle - np.arctan(0.65)) < 2.5 * phi
    assert abs(np.log(found.modulus / 0.012)) < 2.5 * log_modulus


def test_rows_of_a_curve_are_no_evidence() -> None:
    few, many = (strength(shear(np.random.default_rng(7), rows=rows)) for rows in (60, 2000))
    assert deviations(many) == pytest.approx(deviations(few), rel=0.05)
    assert abs(many.cohesion - few.cohesion) < 0.1 * deviations(many)[0]
    assert abs(many.friction_angle - few.friction_angle) < 0.1 * deviations(many)[1]


@pytest.mark.parametrize("runs", [1, 2])
def test_a_peak_is_seen_where_there_is_one(runs: int) -> None:
    rng = np.random.default_rng(5)
    (peaked,) = fit_shear(shear(rng, residual=0.7, modulus=0.008, runs=runs))
    assert peaked.shows_peak
    residual, std = peaked.peaked.values[3], np.sqrt(peaked.peaked.covariance[3, 3])
    assert abs(residual - 0.7) < 2.5 * std
    assert "peak" in strength_of(peaked).notes[-1]
    (plain,) = fit_shear(shear(rng, runs=runs))
    assert not plain.shows_peak


def test_a_single_curve_tells_a_peak() -> None:
    rng = np.random.default_rng(5)
    assert fit_shear(shear(rng, residual=0.6, modulus=0.008, stresses=(3e4,), runs=1))[0].shows_peak
    assert not fit_shear(shear(rng, stresses=(3e4,), runs=1))[0].shows_peak


def test_rounding_has_no_say_in_what_a_single_curve_tells() -> None:
    tests = shear(np.random.default_rng(5), residual=0.7, modulus=0.008, stresses=(3e4,), runs=1)
    found = []
    for scale in (1.0, 1.7, 3.1, 7.7):
        stresses = {
            name: scale * getattr(tests, name) for name in ("normal_stress", "shear_stress")
        }
        (fit,) = fit_shear(replace(tests, **stresses))
        found.append(np.sqrt(np.diag(fit.peaked.covariance))[2:])
    assert np.all(np.ptp(found, axis=0) < 5e-3 * np.min(found, axis=0))


def test_one_normal_stress_tells_no_friction_angle() -> None:
    found = strength(shear(np.random.default_rng(1), stresses=(30e3,)))
    status = {p.name: p.status for p in found.parameters}
    assert status["cohesion"] == status["friction_angle"] == "not determined"
    assert status["log_shear_displacement"] == "determined"
    assert "cannot be told apart" in found.notes[0]
    # what is measured is the strength there, and it is kept
    at = np.array([1.0, 30e3 / np.cos(found.friction_angle) ** 2, 0.0])
    measured = found.cohesion + 30e3 * np.tan(found.friction_angle)
    assert measured == pytest.approx(21e3, rel=0.1)
    assert np.sqrt(at @ found.covariance @ at) < 0.06 * measured
    assert deviations(found)[0] > 450.0  # 500 Pa before any test


def test_cohesion_under_zero_is_said_and_not_only_clipped() -> None:
    rng = np.random.default_rng(3)
    found = strength(shear(rng, cohesion=-500.0, runs=3))
    assert found.cohesion == 0.0
    assert found.parameters[0].value < 0.0
    assert "compatible with zero" in " ".join(found.notes)
    # with c = 0 the friction angle goes down with it
    assert found.friction_angle < found.parameters[1].value
    bad = strength(shear(rng, cohesion=-5e3, stresses=(30e3, 60e3, 90e3), runs=3))
    assert "no soil has that" in " ".join(bad.notes)


def test_a_curve_that_stops_early_is_said() -> None:
    found = strength(shear(np.random.default_rng(1), travel=0.02, modulus=0.012))
    assert any("3 K" in note for note in found.notes)
    k = found.parameters[2]
    assert k.status == "not determined"
    far = strength(shear(np.random.default_rng(1), modulus=0.012))
    assert deviations(far)[2] < deviations(found)[2]
    assert not far.notes


def test_strength_that_falls_with_normal_stress_is_refused() -> None:
    with pytest.raises(StrengthError, match="falls with the normal stress"):
        strength(shear(np.random.default_rng(1), cohesion=60e3, friction=-0.5))


def test_a_clay_without_friction_is_a_soil() -> None:
    found = strength(shear(np.random.default_rng(2), cohesion=20e3, friction=-0.02, scatter=0.02))
    assert found.friction_angle == 0.0
    assert found.cohesion == pytest.approx(20e3, rel=0.05)
    assert "tan phi came out as" in found.notes[0]


def test_a_curve_without_a_limit_is_no_strength() -> None:
    with pytest.raises(StrengthError, match="shows no limit"):
        strength(shear(np.random.default_rng(1), modulus=5.0, scatter=0.0))


def test_runs_without_curve_are_left_out_or_refused() -> None:
    tests = shear(np.random.default_rng(1))
    short = tests.run == tests.run[0]
    kept = np.flatnonzero(~short | (np.cumsum(short) <= 3))
    mask = np.isin(np.arange(len(tests)), kept)
    (fit,) = fit_shear(tests.take(mask))
    assert f"run '{tests.run[0]}' is left out" in fit.notes[0]
    with pytest.raises(FittingError, match="no shear test can be used"):
        fit_shear(replace(tests, displacement=-tests.displacement))
    with pytest.raises(FittingError, match="is its sign reversed"):
        fit_shear(replace(tests, shear_stress=-tests.shear_stress))


def test_strength_goes_into_the_model_file_with_its_covariance(tmp_path: Path) -> None:
    tests = shear(np.random.default_rng(1))
    known = CalibratedModel(
        Model(soil("dry_sand")),
        ("dry_sand.log_reference_pressure", "dry_sand.cohesion"),
        np.diag([0.04, 1.0]),
    )
    found = fit_lab(None, tests, known=known)
    write_model(tmp_path / "m.yaml", found.model)
    back = read_model(tmp_path / "m.yaml")
    (s,) = found.strengths
    assert back.model.soils[0].cohesion == pytest.approx(s.cohesion)
    assert back.model.soils[0].shear_displacement == pytest.approx(s.modulus)
    assert back.standard_deviation("dry_sand.friction_angle") == pytest.approx(deviations(s)[1])
    assert back.standard_deviation("dry_sand.log_reference_pressure") == pytest.approx(0.2)
    assert back.names.count("dry_sand.cohesion") == 1
    wheel = Conditions.of(60.0, 0.2, 0.1, slip=0.3)
    without = predict_with_uncertainty(known, wheel).standard_deviation["thrust"]
    assert predict_with_uncertainty(back, wheel).standard_deviation["thrust"] > without


@pytest.mark.parametrize("seed", range(3))
def test_shear_alone_tells_the_strength_and_is_no_model(seed: int, tmp_path: Path) -> None:
    tests = shear(np.random.default_rng(seed))
    found, known = fit_lab(None, tests), strength(tests)
    assert (found.cohesion.value, found.cohesion.std) == (
        known.parameters[0].value,
        pytest.approx(deviations(known)[0]),
    )
    assert found["friction_angle"].std == pytest.approx(deviations(known)[1])
    modulus = found["soil.shear_displacement"]
    assert (modulus.value, modulus.unit) == (known.modulus, "m")
    drawn = np.random.default_rng(0).multivariate_normal(
        [known.cohesion, known.friction_angle, np.log(known.modulus)], known.covariance, 20000
    )
    assert modulus.std == pytest.approx(np.exp(drawn[:, 2]).std(), rel=0.05)
    assert found.to_dict()["shear"][0]["parameters"]["shear_displacement"]["std"] == modulus.std
    assert {row["parameter"]: row["std"] for row in found.rows()}["shear_displacement"] == (
        modulus.std
    )
    assert "No model was made: shear tests" in str(found)
    for use in (lambda: found.model, lambda: found.save(tmp_path / "m.yaml")):
        with pytest.raises(StrengthError, match="needs k and n"):
            use()
    with pytest.raises(StrengthError, match="needs k and n"):
        sw.predict(found, load=60, diameter=0.2, width=0.1)  # type: ignore[arg-type]
    assert not (tmp_path / "m.yaml").exists()
    with pytest.raises(KeyError, match=r"no parameter 'k'.*soil\.cohesion, soil\.friction_angle"):
        found["k"]
    made = fit_lab(None, tests, known=CalibratedModel(Model(soil("dry_sand"))))
    assert "No model was made" not in str(made)
    assert made.model.soils[0].cohesion == known.cohesion


def test_the_strength_of_two_soils_is_asked_for_by_their_names() -> None:
    tests = shear(np.random.default_rng(2))
    half = np.where(np.isin(tests.run, np.unique(tests.run)[::2]), "clay", "loam")
    found = fit_lab(None, replace(tests, soil=half))
    assert found["clay.cohesion"] != found["loam.cohesion"]
    with pytest.raises(AttributeError, match=r"clay\.cohesion, loam\.cohesion"):
        _ = found.cohesion


def test_a_soil_that_the_model_does_not_have() -> None:
    tests = shear(np.random.default_rng(1))
    half = np.where(tests.normal_stress > 20e3, "clay", "dry_sand")
    strengths = [replace(strength(tests), soil=name) for name in ("clay", "dry_sand")]
    known = CalibratedModel(Model(soil("dry_sand")))
    with pytest.raises(StrengthError, match="'clay'"):
        with_strength(known, strengths, replace(tests, soil=half))


@given(scale=st.floats(0.01, 100.0), seed=st.integers(0, 3))
@settings(max_examples=examples(2))
def test_units_do_not_matter(scale: float, seed: int) -> None:
    tests = shear(np.random.default_rng(seed), rows=40)
    scaled = replace(
        tests,
        normal_stress=scale * tests.normal_stress,
        shear_stress=scale * tests.shear_stress,
        displacement=scale * tests.displacement,
    )
    first, second = strength(tests), strength(scaled)
    assert second.parameters[0].value == pytest.approx(scale * first.parameters[0].value, rel=1e-2)
    assert second.modulus == pytest.approx(scale * first.modulus, rel=1e-3)


def test_laws_of_shear_at_their_ends() -> None:
    assert rising_share(0.0, 0.01) == 0.0
    assert rising_share(0.03, 0.01) == pytest.approx(0.950, abs=1e-3)
    assert peaked_share(0.01, 0.01, 0.7) == pytest.approx(1.0)
    assert peaked_share(1.0, 0.01, 0.7) == pytest.approx(0.7)


def test_a_real_bevameter(shared_data: Path) -> None:
    """One normal stress, four preparations (SOURCE.md): strength there, and not c apart from phi."""
    import pandas as pd

    table = pd.read_csv(shared_data / "cullinan_bevameter" / "shear.csv")
    tests = ShearTests(
        1e3 * table["normal_stress [kPa]"].to_numpy(float),
        1e3 * table["shear_stress [kPa]"].to_numpy(),
        1e-3 * table["shear_displacement [mm]"].to_numpy(),
        table["run"].to_numpy(np.str_),
        np.full(len(table), ""),
        np.arange(len(table)),
    )
    (fit,) = fit_shear(tests)
    found = strength_of(fit)
    assert 45e3 < found.cohesion + 93e3 * np.tan(found.friction_angle) < 65e3
    assert "cannot be told apart" in shear_text(fit, found)
