"""What the estimator may become sure of, and what it may not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.bulldozing import Rankine
from smallwheel_ros.effects.slip_sinkage import Exponential
from smallwheel_ros.estimator.beside import sinkage_beside, wheel_of
from smallwheel_ros.estimator.bounded_exponent import (
    coordinate_of,
    exponent_of,
    exponent_slope,
)
from smallwheel_ros.estimator.coordinates import OfReference
from smallwheel_ros.estimator.identifiability import before_driving
from smallwheel_ros.estimator.load_level import LoadLevel
from smallwheel_ros.estimator.point_sinkage import point_pressure, point_sinkage
from smallwheel_ros.estimator.sinkage_observation import resistance_observation
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    Outcome,
    SinkageMeasurement,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil, soil
from smallwheel_ros.simulate.truth import motion_resistance, static_sinkage

GOOD = SinkageMeasurement(
    time=1.0,
    wheel="left",
    sinkage=0.012,
    variance=1e-6,
    load=60.0,
    load_variance=1.0,
    diameter=0.2,
    width=0.1,
    distance=5.0,
)


def estimator(**settings: float) -> SoilEstimator:
    return SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), EstimatorSettings(**settings))


# ---- Coordinates


def test_exponent_stays_inside_and_is_straight_in_between() -> None:
    for n in (0.01, 0.2, 0.8, 1.5, 2.2, 2.99):
        q = coordinate_of(n)
        assert exponent_of(q) == pytest.approx(n, rel=1e-12)
        step = 1e-6
        slope = (exponent_of(q + step) - exponent_of(q - step)) / (2 * step)
        assert exponent_slope(q) == pytest.approx(slope, rel=1e-6)
    assert coordinate_of(0.8) == pytest.approx(0.8, abs=1e-6)
    assert 0.0 < exponent_of(-1.0) < exponent_of(4.0) < 3.0


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


@given(
    wheels=st.tuples(*2 * (st.floats(5.0, 300.0), st.floats(0.1, 0.5), st.floats(0.03, 0.3))),
    n=st.floats(0.2, 2.8),
    log_ratio=st.floats(-7.0, -1.6),
    log_factor=st.floats(-1.0, 1.0),
)
def test_sinkage_beside_is_that_by_way_of_the_modulus(
    wheels: tuple[float, ...], n: float, log_ratio: float, log_factor: float
) -> None:
    """One wheel's sinkage from another's: as by the soil that the other one shows."""
    first, other = wheels[:3], wheels[3:]
    log_z = log_ratio + math.log(first[1])
    soil_law = point_pressure(*first, log_z, n)
    z = point_sinkage(*other, soil_law.log_modulus + log_factor, n)
    got = sinkage_beside(wheel_of(*other), wheel_of(*first), log_z, n, log_factor)
    if got is None:  # left to point_sinkage: deep, or far apart
        assert max(math.exp(z.log_sinkage) / other[1], math.exp(log_ratio)) > 0.1
        return
    log_sinkage, by_reference, by_n, by_load = got
    assert log_sinkage == pytest.approx(z.log_sinkage, abs=1e-6)
    assert by_load == pytest.approx(z.slope_load, rel=2e-3)
    assert by_reference == pytest.approx(-z.slope_load * soil_law.slope_sinkage, rel=2e-3)
    by_exponent = z.slope_exponent - z.slope_load * soil_law.slope_exponent
    assert by_n == pytest.approx(by_exponent, abs=1e-2)
    if math.exp(max(z.log_sinkage - math.log(other[1]), log_ratio)) < 0.1:
        assert log_sinkage == pytest.approx(z.log_sinkage, abs=2e-8)
        assert by_n == pytest.approx(by_exponent, abs=2e-4)


def test_the_reference_wheel_beside_itself_sinks_as_far() -> None:
    wheel = wheel_of(60.0, 0.3, 0.1)
    log_z, by_reference, by_exponent, _ = sinkage_beside(wheel, wheel, -4.6, 0.8, 0.0) or ()
    assert log_z == pytest.approx(-4.6, abs=1e-12)
    assert by_reference == pytest.approx(1.0, abs=1e-9)
    assert by_exponent == pytest.approx(0.0, abs=1e-9)
    assert sinkage_beside(wheel, wheel, math.log(0.14), 0.8, 0.0) is None


def test_reference_turns_there_and_back() -> None:
    reference = OfReference(60.0, 0.3, 0.1)
    soil_law = np.array([10.0, coordinate_of(0.7), 0.3])
    there, jacobian = reference.from_direct(soil_law)
    back, slopes = reference.to_direct(tuple(there.tolist()))
    inverse = np.eye(3)
    inverse[0] = slopes
    np.testing.assert_allclose(back, soil_law, atol=1e-10)
    np.testing.assert_allclose(jacobian @ inverse, np.eye(3), atol=1e-6)


# ---- Noise of the load cell


def test_constant_load_is_its_mean_and_a_varied_one_passes() -> None:
    rng = np.random.default_rng(2)
    constant, varied = LoadLevel(), LoadLevel()
    off, passed = [], []
    for i in range(3000):
        noise = 0.03 * rng.standard_normal(2)
        off.append(math.log(constant.follow(60.0 * math.exp(noise[0]), 9e-4)[0] / 60.0))
        true = 60.0 * math.exp(0.3 * math.sin(0.05 * i))
        passed.append(math.log(varied.follow(true * math.exp(noise[1]), 9e-4)[0] / true))
    assert np.std(off[500:]) < 0.006
    assert np.std(passed[500:]) == pytest.approx(0.03, rel=0.1)
    assert LoadLevel().follow(61.0, 0.0) == (61.0, 0.0)


def test_a_wheel_that_is_loaded_anew_is_followed_at_once() -> None:
    level = LoadLevel()
    for _ in range(400):
        level.follow(60.0, 4e-4)
    load, variance = level.follow(90.0, 4e-4)
    assert load == pytest.approx(90.0, rel=0.02)
    assert variance > 3e-4


# ---- One load


def drive_on(e: SoilEstimator, loads: np.ndarray, noise: float, rng: np.random.Generator) -> None:
    """Roll over fresh soil; sinkage from an integral that is not the estimator's."""
    sand = soil("dry_sand")
    k = 0.6 * sand.k * np.exp(0.06 * rng.standard_normal(loads.size)) * 0.2**sand.m
    n = 0.55
    full = np.full(loads.size, 0.2)
    z = static_sinkage(
        lambda depth: (k * 0.01 ** (sand.n - n))[:, None] * depth**n, loads, full, 0.5 * full
    )
    z = z * np.exp(0.03 * rng.standard_normal(loads.size))
    measured = loads * np.exp(noise * rng.standard_normal(loads.size))
    for i, (load, sinkage) in enumerate(zip(measured, z, strict=True)):
        e.update(
            replace(
                GOOD,
                time=float(i),
                distance=0.5 * i,
                load=float(load),
                load_variance=float((noise * load) ** 2),
                sinkage=float(sinkage),
                variance=float((0.03 * sinkage) ** 2),
            )
        )


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_one_load_leaves_n_open_however_long(noise: float) -> None:
    """Whether the load cell is noisy or not: its noise is no variation of the load."""
    e = estimator()
    drive_on(e, np.full(3000, 60.0), noise, np.random.default_rng(3))
    estimate = e.estimate()
    assert e.accepted > 2950
    assert math.sqrt(estimate.log_covariance[1, 1]) > 0.25
    assert not estimate.identifiable.n
    assert not estimate.identifiable.m
    assert any(words.startswith("n not determined: load") for words in estimate.status)


def test_varied_load_determines_n() -> None:
    e = estimator()
    rng = np.random.default_rng(4)
    drive_on(e, 60.0 * np.exp(rng.uniform(-0.6, 0.6, 600)), 0.02, rng)
    estimate = e.estimate()
    assert estimate.identifiable.n
    deviation = math.sqrt(estimate.log_covariance[1, 1])
    assert deviation < 0.06
    assert abs(estimate.n - 0.55) < 3 * deviation


@pytest.mark.parametrize("relative", [0.0, 0.02])
@pytest.mark.parametrize("variance", [1e-8, 1e-10])
def test_a_wheel_pressed_down_is_followed(variance: float, relative: float) -> None:
    """Exact and steep: sinkage in proportion to load, a hundredfold, far from the prior's n."""
    e = estimator()
    outcomes = []
    for i in range(1, 100):
        depth = 0.0003 * i
        load = 3000.0 * depth / 0.01
        one = replace(
            GOOD,
            time=0.05 * i,
            sinkage=depth,
            variance=variance,
            load=load,
            load_variance=(relative * load) ** 2,
            diameter=0.116,
            width=0.05,
            distance=depth,
            contact="pressed",
        )
        outcomes.append(e.update(one).outcome)
    assert outcomes.count(Outcome.ACCEPTED) > 80
    estimate = e.estimate()
    assert estimate.n == pytest.approx(0.53, abs=0.05)  # load in proportion to z^(n + 1/2)
    predicted = e.predict(5000.0, 0.116, 0.05, contact="pressed", wheel="left")
    assert predicted.sinkage == pytest.approx(5000.0 * 0.01 / 3000.0, rel=0.05)


# ---- What cannot be used


def test_what_cannot_be_computed_does_not_block_what_can() -> None:
    for change in ({"load": 1e300}, {"width": 1e-300}, {"load": 1e-300}):
        e = estimator()
        for time in (5.0, 7.0):
            refused = e.update(replace(GOOD, time=time, distance=time + 1.0, **change))
            assert refused.reason == "numerical"
            assert e.update(replace(GOOD, time=time - 1.0)).outcome is Outcome.ACCEPTED
        assert e.estimate().refused == {"numerical": 2}


# ---- What is determined


def test_verdicts_and_directions_tell_what_the_data_knows() -> None:
    e = estimator()
    assert all(
        words.startswith("not determined: 100 %") for words in e.estimate().verdicts.values()
    )
    drive_on(e, np.full(500, 60.0), 0.0, np.random.default_rng(6))
    estimate = e.estimate()
    assert estimate.verdicts["reference_pressure"].startswith("determined")
    assert estimate.verdicts["n"].startswith("not determined")
    assert estimate.remaining["m"] == pytest.approx(1.0, abs=1e-6)
    best, *others = estimate.directions
    assert best.remaining < 0.1
    assert all(one.remaining > 0.9 for one in others)
    weights = np.array([[d.log_pressure, d.n, d.m] for d in estimate.directions])
    np.testing.assert_allclose(weights @ weights.T, np.eye(3), atol=1e-12)


def test_one_wheel_size_is_said_before_driving() -> None:
    assert before_driving([0.25, 0.4]) == ()
    assert before_driving([]) == ()
    (words,) = before_driving([0.25, 0.25, 0.251])
    assert "one diameter (0.25 m)" in words
    assert "m stays" in words


# ---- Resistance


def test_resistance_determines_n_under_one_load() -> None:
    """Sinkage says how much the soil carries, resistance how the pressure rises to that."""
    rng = np.random.default_rng(9)
    count, sand, n = 300, soil("dry_sand"), 0.55
    k = 0.6 * sand.k * np.exp(0.06 * rng.standard_normal(count)) * 0.2**sand.m
    modulus = (k * 0.01 ** (sand.n - n))[:, None]
    full = np.ones(count)
    z = static_sinkage(lambda depth: modulus * depth**n, 60.0 * full, 0.2 * full, 0.1 * full)
    resistance = motion_resistance(lambda depth: modulus * depth**n, 0.2 * full, 0.1 * full, z)
    e = estimator()
    outcomes = []
    for i in range(count):
        one = replace(
            GOOD,
            time=float(i),
            distance=0.5 * i,
            sinkage=float(z[i] * np.exp(0.03 * rng.standard_normal())),
            variance=float((0.03 * z[i]) ** 2),
            load_variance=0.0,
            resistance=float(resistance[i] * np.exp(0.03 * rng.standard_normal())),
            resistance_variance=float((0.03 * resistance[i]) ** 2),
        )
        outcomes.append(e.update(one).resistance.outcome)
    assert outcomes.count(Outcome.ACCEPTED) > 0.98 * count
    estimate = e.estimate()
    assert estimate.identifiable.n
    assert not estimate.identifiable.m
    deviation = math.sqrt(estimate.log_covariance[1, 1])
    assert deviation < 0.1
    assert abs(estimate.n - n) < 3.0 * deviation


def test_resistance_that_cannot_be_used_leaves_the_sinkage() -> None:
    for value, variance, reason in (
        (math.nan, 1.0, "resistance_not_finite"),
        (5.0, 0.0, "resistance_variance_not_positive"),
        (5.0, math.nan, "resistance_variance_not_positive"),
    ):
        e = estimator()
        result = e.update(replace(GOOD, resistance=value, resistance_variance=variance))
        assert result.outcome is Outcome.ACCEPTED
        assert result.resistance.reason == reason
        assert e.estimate().refused == {reason: 1}
    e = estimator()
    for i in range(20):
        e.update(replace(GOOD, time=float(i)))
    result = e.update(replace(GOOD, time=30.0, resistance=500.0, resistance_variance=0.1))
    assert result.resistance.reason == "gate"
    assert "500.00 N measured" in result.resistance.message
    assert (e.resistance_outliers, e.outliers, e.soil_changes) == (1, 0, 0)
    pressed = replace(GOOD, time=31.0, contact="pressed", sinkage=0.008, resistance=5.0)
    assert e.update(pressed).resistance is None


@pytest.mark.parametrize("effects", [(), (Exponential(a=0.7),), (Rankine(),)])
def test_resistance_is_the_model(effects: tuple[Effect, ...]) -> None:
    observe = resistance_observation(effects, 70.0, 0.25, 0.08, 0.2, 0.15)

    def shown(s: float, n: float, load: float) -> float:
        law = Soil("one", math.exp(s - n * math.log(0.01)), n)
        conditions = Conditions.of(load, 0.25, 0.08, slip=0.2, speed=0.15)
        return float(predict(Model(law, effects=effects), conditions).resistance[0])

    got, step = observe(10.2, 0.8), 1e-4
    assert got.value == pytest.approx(shown(10.2, 0.8, 70.0), rel=1e-8)
    for slope, at in (
        (got.by_pressure, lambda h: shown(10.2 + h, 0.8, 70.0)),
        (got.by_exponent, lambda h: shown(10.2, 0.8 + h, 70.0)),
        (got.by_load, lambda h: shown(10.2, 0.8, 70.0 * math.exp(h))),
    ):
        assert slope == pytest.approx((at(step) - at(-step)) / (2 * step), rel=1e-3)


def test_the_example_of_the_documentation_runs(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (repository / "docs" / "estimator.md").read_text(encoding="utf-8")
    code = text.split("```python\n")[1].split("```")[0]
    exec(compile(code, "docs/estimator.md", "exec"), {})
    assert "ACCEPTED" in capsys.readouterr().out
