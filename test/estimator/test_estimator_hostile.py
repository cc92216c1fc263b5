# SPDX-License-Identifier: Apache-2.0
"""Whatever comes in: no exception, no NaN, a covariance that is one."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from wheel_drives import READING, changed

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorError,
    EstimatorSettings,
    Outcome,
    SoilEstimate,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil

GOOD = changed(READING, slip=0.1, speed=0.2)
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
            "load_std": sane.map(lambda x: x**2),
            "diameter": sane.map(lambda x: 0.3 * x),
            "width": sane.map(lambda x: 0.1 * x),
            "wheel": st.sampled_from("abcd"),
            "contact": st.sampled_from(["rolling", "pressed", "rolling", "plate"]),
        }
    ),
    st.sampled_from(
        [
            *("time", "distance", "sinkage", "load", "load_std", "diameter"),
            *("width", "slip", "speed", "path", "pitch"),
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


class Failing(Effect):
    """An effect of the user's own that fails at small loads."""

    id: ClassVar[str] = "failing"

    def modulus_factor(self, conditions: Conditions) -> np.ndarray:
        if conditions.load.min() < 30.0:
            raise KeyError("no such load")
        return np.ones(len(conditions))


class Lifting(Effect):
    """An effect of the user's own that takes more load than there may be."""

    id: ClassVar[str] = "lifting"

    def normal_load(self, load: np.ndarray, conditions: Conditions) -> np.ndarray:
        return load - 30.0


@pytest.mark.parametrize("failing", [Failing(), Lifting()])
def test_an_effect_that_fails_or_leaves_no_load_refuses_the_reading(failing: Effect) -> None:
    e = SoilEstimator(PRIOR, effects=(failing,))
    assert e.update(GOOD).outcome is Outcome.ACCEPTED
    result = e.update(changed(GOOD, time=2.0, distance=6.0, load=20.0))
    assert (result.outcome, result.reason) == (Outcome.REFUSED, "numerical")
    assert failing.id in result.message or "the effects make the load -10" in result.message
    assert e.update(changed(GOOD, time=3.0, distance=6.0)).outcome is Outcome.ACCEPTED
    with pytest.raises(EstimatorError, match="under 20 N"):
        e.predict(20.0, 0.2, 0.1, slip=0.1, wheel="left")


@settings(max_examples=examples(80))
@given(st.lists(st.tuples(measurement, st.booleans()), max_size=25), st.booleans())
def test_hostile_measurements_do_no_harm(
    rows: list[tuple[dict[str, object], bool]], with_effect: bool
) -> None:
    e = SoilEstimator(PRIOR, effects=(Exponential(a=1.5),) if with_effect else ())
    way, refused = 5.0, 0
    for i, (change, moving) in enumerate(rows):
        way += 0.3 * moving
        one = changed(GOOD, time=1.0 + i, distance=way)
        result = e.update(changed(one, **change))
        if result.outcome is Outcome.REFUSED:
            assert result.message
            refused += 1
        else:
            assert math.isfinite(result.predicted_sinkage + result.innovation_variance)
            assert result.innovation_variance > 0.0
            assert result.predicted_variance >= -1e-18
        check(e.estimate())
    # It still works.
    assert e.update(changed(GOOD, wheel="new", time=1e6)).outcome is Outcome.ACCEPTED
    estimate = e.estimate()
    assert estimate.accepted + estimate.outliers + refused <= len(rows)


@settings(max_examples=examples(30))
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
            changed(
                GOOD,
                time=float(i),
                distance=0.2 * i,
                diameter=diameter,
                sinkage=float(0.4 * diameter * rng.uniform() ** 3),
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
    for i in range(300):
        e.update(
            changed(
                GOOD,
                time=float(i),
                distance=0.15 * i,
                sinkage=float(0.012 * np.exp(0.2 * rng.standard_normal())),
                load=float(60 * np.exp(0.3 * rng.standard_normal())),
            )
        )
    check(e.estimate())


# ---- Long runs


@pytest.mark.slow
def test_memory_stays_over_a_million_readings() -> None:
    """Hours through the whole estimator, soil changing now and then, and turns on the spot."""
    rng = np.random.default_rng(8)
    e = SoilEstimator(PRIOR)
    distance = 0.0
    for i in range(1_000_000):
        turning = (i // 5_000) % 10 == 9
        distance += 0.0 if turning else 0.005
        factor = 1.0 if (i // 50_000) % 2 else 1.8
        load = 60.0 * math.exp(0.3 * math.sin(0.01 * i))
        z = 0.011 * factor * (load / 60.0) ** 0.75 * math.exp(0.05 * rng.standard_normal())
        e.update(
            changed(
                GOOD,
                wheel="abcd"[i % 4],
                time=0.01 * i,
                distance=distance,
                path=0.005 * i,
                load=load,
                sinkage=z,
            )
        )
        if i % 100_000 == 0:
            check(e.estimate())
    assert 15 <= e.soil_changes <= 25
    assert len(e._soils._remembered) <= 4
    assert len(e._soils.test.waiting) <= 4 * 9
    assert all(len(kept) < 400 for kept in e._watch._pieces._kept.values())
    law = e._soils.law
    assert law is not None
    assert len(law._store) <= 360


def test_turning_on_the_spot_for_ever_does_not_fill_the_memory() -> None:
    """Segments wait by the vehicle's travel, and a wheel travels without it."""
    e = SoilEstimator(PRIOR)
    rng = np.random.default_rng(1)
    for i in range(800):
        for wheel in "ab":
            z = 0.012 * math.exp(0.05 * rng.standard_normal())
            e.update(changed(GOOD, wheel=wheel, time=0.1 * i, path=0.06 * i, sinkage=z))
    assert len(e._soils.test.waiting) <= 2 * 9
    assert e.accepted > 1200
    check(e.estimate())
