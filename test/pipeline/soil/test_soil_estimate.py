# SPDX-License-Identifier: Apache-2.0
"""The soil in the terms of the field: before any measurement, behind a reset; its prior and settings.

Tests `identifiability.py`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rows_of_drives import drive, rover, run

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families
from smallwheel_ros.onboard.prior import (
    EstimatorError,
    EstimatorSettings,
    SoilPrior,
)
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import SOILS, soil, usual_strength
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.pipeline import Pipeline

GIVEN = {"load", "diameter", "width", "slip", "speed"}  # what the streams say of a wheel
UNUSABLE = [form for forms in families().values() for form in forms if set(form().needs) - GIVEN]
WHEELS = (Wheel("one", 0.2, 0.1),)


def settings(
    name: str = "dry_sand", effects: tuple[Effect, ...] = (), **more: object
) -> OnboardSettings:
    base = soil(name)
    return OnboardSettings(
        WHEELS,
        SoilPrior.from_soil(base),
        usual_strength(base),
        effects=effects,
        **more,  # type: ignore[arg-type]
    )


def test_before_any_measurement_it_is_the_prior() -> None:
    prior = replace(
        SoilPrior.from_soil(soil("dry_sand")), log_reference_pressure_std=0.5, n_std=0.2, m_std=0.3
    )
    strength = usual_strength(soil("dry_sand"))
    estimate = Pipeline(OnboardSettings(WHEELS, prior, strength)).soil
    sand = soil("dry_sand")
    assert estimate.k == pytest.approx(sand.k)
    assert (estimate.n, estimate.m) == pytest.approx((sand.n, sand.m))
    np.testing.assert_allclose(
        estimate.log_covariance, np.diag([0.25, 0.04, 0.09]), rtol=1e-9, atol=1e-12
    )
    assert not any(estimate.identifiable)
    assert estimate.status == ("no measurement yet: soil and uncertainty are the prior's",)
    # Linearised at the estimate: k = exp(L - n ln z - m ln D)
    jacobian = sand.k * np.array([1.0, -np.log(0.01), -np.log(0.2)])
    variance = jacobian @ estimate.log_covariance @ jacobian
    assert estimate.covariance[0, 0] == pytest.approx(variance)
    modulus, std = estimate.effective_modulus(0.35)
    assert modulus == pytest.approx(sand.k * 0.35**sand.m)
    by_hand = np.array([1.0, -np.log(0.01), np.log(0.35 / 0.2)])
    assert std == pytest.approx(modulus * np.sqrt(by_hand @ estimate.log_covariance @ by_hand))


def test_a_reset_is_a_new_start_and_the_counts_go_on() -> None:
    vehicle, rows = rover(), drive(12.0)
    pipeline = Pipeline(vehicle.onboard)
    fresh = pipeline.soil
    run(vehicle, rows, pipeline=pipeline)
    assert pipeline.soil.accepted > 0
    assert pipeline.soil.log_covariance[0, 0] < fresh.log_covariance[0, 0]
    pipeline.streams.add("fl/load", rows[-1][1] + 1, (math.nan,))
    pipeline.reset()
    again = pipeline.soil
    assert again.status == fresh.status
    assert (again.accepted, again.outliers) == (0, 0)
    np.testing.assert_array_equal(again.covariance, fresh.covariance)
    assert pipeline.problems["fl/load", "not_finite"] == 1


@pytest.mark.parametrize("name", list(SOILS))
def test_every_soil_of_the_library_makes_a_prior(name: str) -> None:
    assert Pipeline(settings(name)).soil.log_pressure == pytest.approx(
        soil(name).log_reference_pressure
    )


@pytest.mark.parametrize("form", UNUSABLE, ids=str)
def test_effects_of_what_the_streams_do_not_say_are_refused(form: type[Effect]) -> None:
    with pytest.raises(EstimatorError, match="not given"):
        Pipeline(settings(effects=(form(),)))


def test_wrong_priors_and_settings_are_refused_by_name() -> None:
    sand = soil("dry_sand")
    with pytest.raises(EstimatorError, match=r"dry_sand.*n_std is 0"):
        replace(SoilPrior.from_soil(sand), n_std=0.0)
    with pytest.raises(EstimatorError, match="log_reference_pressure_std is nan"):
        replace(SoilPrior.from_soil(sand), log_reference_pressure_std=math.nan)
    for name, value in (
        ("soil_scatter", 0.0),
        ("sinkage_zero_std", -0.001),
        ("sinkage_std", math.nan),
    ):
        with pytest.raises(EstimatorError, match=name):
            EstimatorSettings(**{name: value})


def test_the_example_of_the_page_runs(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (repository / "docs" / "estimator.md").read_text(encoding="utf-8")
    code = text.split("```python\n")[1].split("```")[0]
    exec(compile(code, "docs/estimator.md", "exec"), {})
    turn, soil = capsys.readouterr().out.strip().splitlines()
    assert all(math.isfinite(float(number)) for number in turn.split())
    assert "determined" in soil
