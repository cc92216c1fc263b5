# SPDX-License-Identifier: Apache-2.0
"""What is determined of the soil, and by what; wheels that are pressed down; the model's forces."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from wheel_drives import READING, N, changed, follow, rolled, varied

from smallwheel_ros.estimator.identifiability import before_driving
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    Outcome,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.estimator.wheel_sinkage import point_pressure, point_sinkage
from smallwheel_ros.physics.soil import soil

GOOD = READING


def estimator(**settings: float) -> SoilEstimator:
    return SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), EstimatorSettings(**settings))


def test_point_pressure_inverts_point_sinkage() -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        wheel = 10 ** rng.uniform(0.5, 3), rng.uniform(0.1, 1.0), rng.uniform(0.03, 0.4)
        n, log_modulus = rng.uniform(0.1, 2.5), math.log(10 ** rng.uniform(4, 8))
        z = point_sinkage(*wheel, log_modulus, n)
        back = point_pressure(*wheel, z.log_sinkage, n)
        assert back.log_modulus == pytest.approx(log_modulus, abs=1e-9)
        step = 1e-5
        for place, slope in ((0, back.slope_sinkage), (1, back.slope_exponent)):
            if math.exp(z.log_sinkage) > 0.499 * wheel[1]:
                continue  # the continuation beyond the axle has a kink
            either = []
            for sign in (1, -1):
                point = [z.log_sinkage, n]
                point[place] += sign * step
                either.append(point_pressure(*wheel, point[0], point[1]).log_modulus)
            assert slope == pytest.approx((either[0] - either[1]) / (2 * step), rel=1e-4, abs=1e-4)
    with pytest.raises(ValueError, match="not a number"):
        point_pressure(60.0, 0.2, 0.1, math.nan, 0.8)


# ---- Loads


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_one_load_leaves_n_open_however_long(noise: float) -> None:
    """Whether the load cell is noisy or not: its noise is no variation of the load."""
    e = follow(estimator(), rolled(np.full(2000, 60.0), 3, load_noise=noise))
    estimate = e.estimate()
    assert e.accepted > 1900
    assert math.sqrt(estimate.log_covariance[1, 1]) > 0.2
    assert not estimate.identifiable.n
    assert not estimate.identifiable.m
    assert any(words.startswith("n not determined: load") for words in estimate.status)


@pytest.mark.parametrize(("load_noise", "told"), [(0.012, 1.0), (0.1, 1.0), (0.1, 0.5)])
def test_varied_load_determines_n_whatever_the_load_cells_noise(
    load_noise: float, told: float
) -> None:
    """Noise of the load makes n too small where it is taken for variation (R14)."""
    readings = [
        changed(one, load_std=told * one.load.standard_deviation)
        for one in rolled(varied(1500), 4, load_noise=load_noise)
        if one.load is not None
    ]
    estimate = follow(estimator(sinkage_zero_std=3e-4), readings).estimate()
    deviation = math.sqrt(estimate.log_covariance[1, 1])
    assert estimate.identifiable.n
    assert deviation < 0.15
    assert abs(estimate.n - N) < 3 * deviation
    assert abs(estimate.n - N) < 0.2


def test_a_zero_that_nobody_knows_leaves_n_less_sure() -> None:
    readings = rolled(varied(800), 4)
    known, told = (
        follow(estimator(sinkage_zero_std=zero), readings).estimate() for zero in (3e-4, 4e-3)
    )
    assert told.log_covariance[1, 1] > 2.0 * known.log_covariance[1, 1]


@pytest.mark.parametrize("relative", [0.0, 0.02])
def test_a_wheel_pressed_down_is_followed(relative: float) -> None:
    """Sinkage in proportion to load, a hundredfold: its path is how deep it goes."""
    e = estimator(scatter_length=0.002, sinkage_zero_std=1e-4, sinkage_std=1e-5)
    rng = np.random.default_rng(1)
    for i in range(1, 400):
        depth = 0.000075 * i
        load = 200.0 * depth / 0.01
        one = changed(
            GOOD,
            time=0.05 * i,
            sinkage=depth + 1e-5 * float(rng.standard_normal()),
            load=load * math.exp(relative * float(rng.standard_normal())),
            load_std=relative * load,
            diameter=0.116,
            width=0.05,
            distance=depth,
            contact="pressed",
        )
        assert e.update(one).outcome is not Outcome.REFUSED
    assert e.soil_changes == 0
    estimate = e.estimate()
    # Load in proportion to z^(n + 1/2).
    assert abs(estimate.n - 0.53) < 3.0 * math.sqrt(estimate.log_covariance[1, 1])
    assert estimate.n == pytest.approx(0.53, abs=0.15)
    predicted = e.predict(300.0, 0.116, 0.05, contact="pressed", wheel="left")
    assert predicted.sinkage == pytest.approx(0.015, rel=0.05)


# ---- What cannot be used


def test_what_cannot_be_computed_does_not_block_what_can() -> None:
    for change in ({"load": 1e300}, {"width": 1e-300}, {"load": 1e-300}):
        e = estimator()
        for time in (5.0, 7.0):
            refused = e.update(changed(GOOD, time=time, distance=time + 1.0, **change))
            assert refused.reason == "numerical"
            assert e.update(changed(GOOD, time=time - 1.0)).outcome is Outcome.ACCEPTED


# ---- What is determined


def test_verdicts_tell_what_the_data_knows() -> None:
    e = estimator(sinkage_zero_std=3e-4)
    assert all(
        words.startswith("not determined: 100 %") for words in e.estimate().verdicts.values()
    )
    follow(e, rolled(np.full(500, 60.0), 6))
    estimate = e.estimate()
    assert estimate.verdicts["reference_pressure"].startswith("determined")
    assert estimate.verdicts["n"].startswith("not determined")
    assert estimate.remaining["m"] == pytest.approx(1.0, abs=0.01)


def test_one_wheel_size_is_said_before_driving() -> None:
    assert before_driving([0.25, 0.4]) == ()
    assert before_driving([]) == ()
    (words,) = before_driving([0.25, 0.25, 0.251])
    assert "one diameter (0.25 m)" in words
    assert "m stays" in words


# ---- Resistance, for the drawbar pull


def test_the_example_of_the_documentation_runs(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (repository / "docs" / "estimator.md").read_text(encoding="utf-8")
    code = text.split("```python\n")[1].split("```")[0]
    exec(compile(code, "docs/estimator.md", "exec"), {})
    assert "ACCEPTED" in capsys.readouterr().out
