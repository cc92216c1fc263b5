"""Whatever comes in: no exception, no NaN, a covariance that is one."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.effects.slip_sinkage import Exponential
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    Outcome,
    SinkageMeasurement,
    SoilEstimate,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.estimator.soil_filter import SoilFilter
from smallwheel_ros.physics.soil import soil

GOOD = SinkageMeasurement(1.0, "left", 0.012, 1e-6, 60.0, 1.0, 0.2, 0.1, 5.0, 0.1, 0.2)
PRIOR = SoilPrior.from_soil(soil("dry_sand"))

any_number = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -1.0, 1e-300, 1e300, 5e-324, 1e-9, 1.0, 1e9]),
)
sane = st.floats(0.2, 5.0)
measurement = st.builds(
    lambda change, name, value: {**change, name: value},
    st.fixed_dictionaries(
        {
            "sinkage": sane.map(lambda x: 0.012 * x),
            "load": sane.map(lambda x: 60.0 * x),
            "variance": sane.map(lambda x: 1e-6 * x**6),
            "load_variance": sane.map(lambda x: x**4),
            "diameter": sane.map(lambda x: 0.3 * x),
            "width": sane.map(lambda x: 0.1 * x),
            "wheel": st.sampled_from("abcd"),
            "contact": st.sampled_from(["rolling", "pressed", "rolling", "plate"]),
        }
    ),
    st.sampled_from(
        [
            *("time", "distance", "sinkage", "variance", "load", "load_variance", "diameter"),
            *("width", "slip", "speed"),
        ]
    ),
    any_number,
)


def check(estimate: SoilEstimate) -> None:
    """Everything is a finite number, every covariance symmetric and positive definite."""
    for field in fields(estimate):
        value = getattr(estimate, field.name)
        if isinstance(value, float):
            assert math.isfinite(value), field.name
    assert 0.0 < estimate.n < 3.0
    assert estimate.k > 0.0
    for covariance in (estimate.covariance, estimate.log_covariance):
        assert np.isfinite(covariance).all()
        np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(estimate.log_covariance).min() > 0.0


@settings(max_examples=examples(150))
@given(st.lists(st.tuples(measurement, st.booleans()), max_size=25), st.booleans())
def test_hostile_measurements_do_no_harm(
    rows: list[tuple[dict[str, object], bool]], with_effect: bool
) -> None:
    e = SoilEstimator(PRIOR, effects=(Exponential(a=1.5),) if with_effect else ())
    for i, (change, moving) in enumerate(rows):
        one = replace(GOOD, time=1.0 + i, distance=5.0 + 0.3 * i * moving)
        result = e.update(replace(one, **change))
        if result.outcome is Outcome.REFUSED:
            assert result.message
        else:
            assert math.isfinite(result.predicted_sinkage + result.innovation_variance)
            assert result.innovation_variance > 0.0
            assert result.predicted_variance >= -1e-18
        check(e.estimate())
    # It still works.
    estimate = e.estimate()
    total = estimate.accepted + estimate.outliers + sum(estimate.refused.values())
    assert total == len(rows)


@settings(max_examples=examples(60))
@given(
    st.floats(0.05, 2.9),
    st.floats(-2.5, 2.5),
    st.floats(4.0, 14.0),
    st.floats(0.05, 2.5),
    st.integers(0, 2**31),
)
def test_any_prior_and_any_soil(
    n: float, m: float, pressure: float, spread: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    prior = SoilPrior(PRIOR.soil, pressure, n, m, spread, min(spread, 0.5), spread)
    e = SoilEstimator(prior)
    for i in range(40):
        diameter = float(rng.choice([0.1, 0.25, 0.6]))
        e.update(
            replace(
                GOOD,
                time=float(i),
                distance=0.2 * i,
                diameter=diameter,
                sinkage=float(0.4 * diameter * rng.uniform() ** 3),
                variance=float(10 ** rng.uniform(-10, -4)),
                load=float(10 ** rng.uniform(0, 3.5)),
                wheel=str(rng.integers(4)),
            )
        )
        check(e.estimate())


@pytest.mark.parametrize(
    ("process_noise", "scatter", "gate"),
    [(0.0, 0.06, 0.999), (5.0, 1.0, 0.5), (0.02, 0.001, 0.9999)],
)
def test_odd_settings_stay_sound(process_noise: float, scatter: float, gate: float) -> None:
    rng = np.random.default_rng(3)
    e = SoilEstimator(
        PRIOR,
        EstimatorSettings(process_noise=process_noise, soil_scatter=scatter, gate_probability=gate),
    )
    for i in range(400):
        e.update(
            replace(
                GOOD,
                time=float(i),
                distance=0.1 * i,
                sinkage=float(0.012 * np.exp(0.2 * rng.standard_normal())),
                load=float(60 * np.exp(0.3 * rng.standard_normal())),
            )
        )
    check(e.estimate())


# ---- Long runs


def soak(updates: int) -> tuple[SoilFilter, list[float]]:
    """The filter below, with rows as a drive makes them, very exact and very coarse in turn."""
    rng = np.random.default_rng(7)
    filter_ = SoilFilter(np.diag([0.3, 0.09, 0.16]), 2450.0)
    spots = [filter_.add(0.06**2, 0.2) for _ in range(4)]
    block = 10_000
    largest = []
    for start in range(0, updates, block):
        u = rng.standard_normal((block, 4))
        for i in range(block):
            if i % 4 == 0:
                filter_.travel(0.0 if (start // block) % 5 == 4 else 0.05)
            z = 0.01 * math.exp(0.5 * u[i, 0])
            row = [0.0] * 7
            row[0], row[1], row[2] = z, -0.6 * z * u[i, 1], 0.4 * z * (i % 2)
            row[spots[i % 4]] = -0.77 * z
            noise = (1e-5 if i % 1000 < 10 else 6e-4) ** 2
            filter_.update(6e-4 * u[i, 2], row, noise)
        covariance = filter_.covariance
        assert np.array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        largest.append(float(np.max(np.diag(covariance) / np.diag(filter_.stationary))))
    return filter_, largest


def test_covariance_is_sound_over_many_updates() -> None:
    filter_, largest = soak(40_000)
    assert max(largest) <= 1.0 + 1e-9
    assert np.isfinite(filter_.deviation).all()


@pytest.mark.slow
def test_covariance_is_sound_over_ten_million_updates() -> None:
    """Accelerated: the filter below the estimator, rows as a drive makes them."""
    filter_, largest = soak(10_000_000)
    assert max(largest) <= 1.0 + 1e-9
    assert np.isfinite(filter_.deviation).all()


@pytest.mark.slow
def test_memory_and_time_stay_over_a_million_measurements() -> None:
    """Eleven hours at 25 Hz through the whole estimator, soil changing now and then."""
    rng = np.random.default_rng(8)
    e = SoilEstimator(PRIOR)
    for i in range(1_000_000):
        factor = 1.0 if (i // 50_000) % 2 else 1.8
        load = 60.0 * math.exp(0.3 * math.sin(0.01 * i))
        z = 0.011 * factor * (load / 60.0) ** 0.75 * math.exp(0.05 * rng.standard_normal())
        e.update(
            replace(
                GOOD,
                wheel="abcd"[i % 4],
                time=0.01 * i,
                distance=0.005 * i,
                load=load,
                sinkage=z,
                variance=(0.04 * z) ** 2,
            )
        )
        if i % 100_000 == 0:
            check(e.estimate())
    assert 19 <= e.soil_changes <= 25
    assert e.outliers < 0.01 * e.accepted
    assert len(e._soils._known) <= 4
    assert all(len(pieces) < 400 for pieces in e._watch._pieces._done.values())


# ---- The library below


def test_update_is_the_textbook_one() -> None:
    """Against matrices by hand, whichever filterpy is installed."""
    rng = np.random.default_rng(2)
    root = rng.standard_normal((3, 3))
    prior = root @ root.T
    filter_ = SoilFilter(prior, math.inf)
    row = np.array([0.3, -1.0, 2.0])
    assert filter_.update(1.2, row.tolist(), 0.5)
    gain = prior @ row / (row @ prior @ row + 0.5)
    np.testing.assert_allclose(filter_.deviation, 1.2 * gain, rtol=1e-12)
    np.testing.assert_allclose(
        filter_.covariance, prior - np.outer(gain, row @ prior), rtol=1e-10, atol=1e-12
    )
    before = filter_.state
    assert not filter_.update(math.nan, row.tolist(), 0.5)
    assert not filter_.update(1.0, [math.inf, 0.0, 0.0], 0.5)
    for was, now in zip(before[:2], filter_.state[:2], strict=True):
        np.testing.assert_array_equal(was, now)
    assert isinstance(filter_._kalman, KalmanFilter)
