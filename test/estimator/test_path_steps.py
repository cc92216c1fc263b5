# SPDX-License-Identifier: Apache-2.0
"""Steps of the path: slip of a mean and its deviation, who stands, who turns back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.estimator.path_steps import PathStep, PathSteps, Sample
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.physics.wheel import Wheel

NOISE = 0.008  # m/s
ONE = Wheel("one", 0.25, 0.1)
LAW = LocalLaw(np.zeros(3), 0.0, 0.0, np.zeros((5, 5)))


def driven(
    speed: float, slip: float, seconds: float, seed: int = 1, rate: float = 10.0, begin: float = 0.0
) -> list[Reading]:
    """Readings of a wheel at a constant speed, with the noise of an odometry."""
    rng = np.random.default_rng([seed, 28])
    rim = speed / (1.0 - slip) if slip > 0.0 else speed * (1.0 + slip)
    shown = speed + NOISE * rng.standard_normal(round(seconds * rate))
    return [
        Reading(
            ONE,
            round(1e9 * (begin + i / rate)),
            None,
            None,
            None,
            float(v),
            abs(speed) * (begin + i / rate),
            abs(speed) * (begin + i / rate),
            speed_std=NOISE,
            rim_speed=rim,
            rim_std=0.01 * abs(rim),
            forward=speed > 0.0,
            slope_force=0.3,
            gained_force=0.0,
        )
        for i, v in enumerate(shown)
    ]


def taken(samples: list[Reading], steps: PathSteps | None = None) -> list[PathStep]:
    steps = steps or PathSteps(lambda _: {})
    made = (steps.add(Sample(reading, LAW, None)) for reading in samples)
    return [step for step in made if step is not None]


@settings(max_examples=examples(20), deadline=None)
@given(speed=st.floats(0.05, 1.0), slip=st.floats(-0.3, 0.6), seed=st.integers(0, 99))
def test_slip_of_a_step_is_right_within_its_deviation(speed: float, slip: float, seed: int) -> None:
    """At any speed: the mean of single slips would be bent at 0.05 m/s, where noise is a sixth of it."""
    made = taken(driven(speed, slip, 20.0, seed))
    found = [step.wheels["one"].slip for step in made]
    off = np.array([one.value - slip for one in found])
    stated = np.array([one.standard_deviation for one in found])
    assert np.all(np.abs(off) < 4.0 * stated)
    assert abs(off.mean()) < 0.01 + 2.0 * stated.mean() / math.sqrt(len(off))
    assert stated.mean() < 0.015 + NOISE / speed


def test_a_step_is_a_tenth_of_a_metre_however_fast() -> None:
    for speed in (0.05, 0.3, 0.9):
        lengths = [step.length for step in taken(driven(speed, 0.1, 30.0, rate=20.0))]
        assert np.mean(lengths) == pytest.approx(0.1, abs=0.04)
    force = taken(driven(0.3, 0.1, 5.0))[3].force
    assert force is not None
    assert (force.value, force.standard_deviation) == pytest.approx((0.3, 0.07))


def test_wheels_that_spin_on_one_place_end_steps() -> None:
    samples = [one._replace(distance=0.0, speed=0.0) for one in driven(0.3, 0, 9)]
    made = taken(samples)
    assert 4 <= len(made) <= 12
    assert all(step.wheels["one"].slip.value == pytest.approx(1.0, abs=0.1) for step in made)


def test_a_pause_ends_a_step_and_half_a_step_is_none() -> None:
    steps = PathSteps(lambda _: {})
    whole = taken(driven(0.3, 0.1, 0.6), steps)  # 0.15 m
    rest = taken(
        [one._replace(distance=one.distance - 12.0) for one in driven(0.3, 0, 9, begin=40)], steps
    )
    assert [step.follows for step in (*whole, *rest)][:3] == [False, False, True]
    assert rest[0].wheels["one"].slip.value < 0.05


def test_who_turns_back_begins_anew() -> None:
    steps = PathSteps(lambda _: {})
    taken(driven(0.3, 0.1, 0.2), steps)  # 3 cm: not half a step
    back = [one._replace(distance=one.distance) for one in driven(-0.3, 0.3, 2.0, begin=0.2)]
    made = taken(back, steps)
    assert not any(step.forward for step in made)
    assert all(step.wheels["one"].slip.value > 0.2 for step in made)


def test_an_acceleration_that_changes_is_less_sure() -> None:
    samples = driven(0.3, 0.1, 5.0)
    steady = taken(samples)
    changing = taken([one._replace(gained_force=0.5 * one.time) for one in samples])
    assert changing[0].deviation > steady[0].deviation


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_is_left_out(value: float) -> None:
    samples = driven(0.3, 0.1, 5.0)
    bad = [one._replace(slope_force=value) if i % 3 else one for i, one in enumerate(samples)]
    assert all(math.isfinite(step.slope or 0.0) for step in taken(bad))
