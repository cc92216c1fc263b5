# SPDX-License-Identifier: Apache-2.0
"""Steps of the path: slip of a mean and its deviation, which wheels stand, where the way changes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from world_drives import table_of

from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.soil import soil, usual_strength
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.strength.steps import Steps, StepState, steps
from smallwheel_ros.pipeline.tables import Array, Readings

NOISE = 0.008  # m/s
BASE = soil("dry_sand")
SETTINGS = OnboardSettings(
    (Wheel("one", 0.25, 0.1),), SoilPrior.from_soil(BASE), usual_strength(BASE)
)


def driven(
    at: float, slip: float, seconds: float, seed: int = 1, rate: float = 10.0, begin: float = 0.0,
    **columns: Array,
) -> Readings:  # fmt: skip
    """Rows of a wheel that drives at a constant speed (m/s), with the noise of an odometry."""
    rng = np.random.default_rng([seed, 28])
    count = round(seconds * rate)
    rim = at / (1.0 - slip) if slip > 0.0 else at * (1.0 + slip)
    time = begin + np.arange(count) / rate
    no, yes = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    given = {
        "stamp": np.round(1e9 * time).astype(np.int64), "wheel": no.astype(int),
        "load": np.full(count, 60.0), "load_std": np.full(count, 1.0),
        "speed": at + NOISE * rng.standard_normal(count), "speed_std": np.full(count, NOISE),
        "rim_speed": np.full(count, rim), "rim_std": np.full(count, 0.01 * abs(rim)),
        "stands": no, "forward": yes if at > 0.0 else no, "onward": yes, "slope": np.full(count, 0.3),
        "gained": np.zeros(count), "distance": abs(at) * time, "path": abs(at) * time,
        "passes": np.zeros(count), "pass_doubt": np.zeros(count),
        "pass_number": np.full(count, np.nan), "due": yes,
    }  # fmt: skip
    return table_of(**(given | columns))


def taken(rows: Readings, state: StepState | None = None) -> Steps:
    soils = Soils(SETTINGS.prior, SETTINGS.estimator, (), SETTINGS.wheels)
    law = np.zeros(len(rows), dtype=np.int64)
    made = steps(state or StepState(), rows, rows.load, rows.load_std, law, soils, SETTINGS)
    assert made is not None
    return made


@settings(max_examples=examples(20), deadline=None)
@given(speed=st.floats(0.05, 1.0), slip=st.floats(-0.3, 0.6), seed=st.integers(0, 99))
def test_slip_of_a_step_is_right_within_its_deviation(speed: float, slip: float, seed: int) -> None:
    """At any speed: the mean of single slips would be bent at 0.05 m/s, where noise is a sixth of it."""
    made = taken(driven(speed, slip, 20.0, seed))
    off = made.slip - slip
    assert np.all(np.abs(off) < 4.0 * made.slip_std)
    assert abs(off.mean()) < 0.01 + 2.0 * made.slip_std.mean() / math.sqrt(len(off))
    assert made.slip_std.mean() < 0.015 + NOISE / speed


def test_a_step_is_a_tenth_of_a_metre_however_fast() -> None:
    for speed in (0.05, 0.3, 0.9):
        lengths = taken(driven(speed, 0.1, 30.0, rate=20.0)).length
        assert np.mean(lengths) == pytest.approx(0.1, abs=0.04)
    made = taken(driven(0.3, 0.1, 5.0))
    assert (made.force[3], made.force_std[3]) == pytest.approx((0.3, 0.07))


def test_wheels_that_spin_on_one_place_end_steps() -> None:
    nothing = np.zeros(90)
    made = taken(driven(0.3, 0.0, 9.0, distance=nothing, path=nothing, speed=nothing))
    assert 4 <= made.end.size <= 12
    assert made.slip == pytest.approx(1.0, abs=0.1)


def test_a_wheel_that_stands_adds_nothing_and_ends_none() -> None:
    parked = np.zeros(100)
    rows = driven(0.3, 0.0, 10.0, distance=parked, path=parked, stands=np.ones(100, dtype=bool))
    soils = Soils(SETTINGS.prior, SETTINGS.estimator, (), SETTINGS.wheels)
    state, law = StepState(), np.zeros(100, dtype=np.int64)
    assert steps(state, rows, rows.load, rows.load_std, law, soils, SETTINGS) is None
    assert state.open is None or not len(state.open)


def test_a_pause_ends_a_step_and_half_a_step_is_none() -> None:
    state = StepState()
    whole = taken(driven(0.3, 0.1, 0.6), state)  # 0.15 m
    rest = driven(0.3, 0.0, 9.0, begin=40.0)
    after = taken(rest, state)
    assert whole.end.size == 1
    assert after.slip[0] < 0.05  # of the new rows alone
    assert after.end[0] >= rest.stamp[0]


def test_where_the_way_changes_a_step_begins_anew() -> None:
    state = StepState()
    soils = Soils(SETTINGS.prior, SETTINGS.estimator, (), SETTINGS.wheels)
    forth = driven(0.3, 0.1, 0.2)  # 3 cm: not half a step
    law = np.zeros(len(forth), dtype=np.int64)
    assert steps(state, forth, forth.load, forth.load_std, law, soils, SETTINGS) is None
    made = taken(driven(-0.3, 0.3, 2.0, begin=0.2), state)
    assert not made.forward.any()
    assert (made.slip > 0.2).all()


def test_an_acceleration_that_changes_is_less_sure() -> None:
    steady = taken(driven(0.3, 0.1, 5.0))
    changing = taken(driven(0.3, 0.1, 5.0, gained=0.05 * np.arange(50)))
    assert changing.force_std[0] > steady.force_std[0]


def test_a_slope_that_is_not_known_throughout_is_not_known() -> None:
    slope = np.where(np.arange(50) % 3 > 0, np.nan, 0.3)
    assert np.isnan(taken(driven(0.3, 0.1, 5.0, slope=slope)).force).all()
