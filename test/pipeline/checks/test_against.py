# SPDX-License-Identifier: Apache-2.0
"""An odometry that goes against all rims. Tests `lateness.py`."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.pipeline.checks.lateness import Against

STEP = 0.1  # s


def flags(
    rims: np.ndarray, speed: np.ndarray, turn: float = 0.0, rise: float = np.nan
) -> np.ndarray:
    turns, passed, rises, felt = (np.full(rims.size, value) for value in (turn, STEP, rise, np.nan))
    return Against().take(rims, turns, speed, passed, rises, felt)[0]


def test_from_its_first_way_on_it_is_known_to_contradict() -> None:
    rims = np.full(100, 0.3)
    found = flags(rims, -0.9 * rims)
    assert (found[2:] > 0.0).all()
    assert not flags(rims, 0.9 * rims).any()


def test_wheels_that_spin_in_place_are_no_contradiction() -> None:
    """The vehicle stands, and its odometry's noise is under the rims' speed."""
    noise = 0.03 * np.random.default_rng(0).standard_normal(500)
    assert not flags(np.full(500, 0.5), noise).any()


def test_who_slides_back_after_driving_ahead_is_believed() -> None:
    rims = np.full(100, 0.3)
    speed = np.where(np.arange(100) < 20, 0.28, -0.1001)
    assert not flags(rims, speed).any()


def test_a_turn_on_the_spot_says_nothing() -> None:
    assert not flags(np.full(100, 0.2), np.full(100, -0.3), turn=0.5).any()


def test_no_vehicle_slides_along_level_ground_nor_up() -> None:
    rims = np.full(100, 0.3)
    for share in (0.4, 1.0, 2.0):
        for rise in (0.0, 0.05, -0.3):
            assert (flags(rims, -share * rims, rise=rise)[5:] > 0.0).all()
        assert (flags(-rims, share * rims, rise=0.3)[5:] > 0.0).all()


def test_down_a_slope_a_vehicle_may_slide_and_is_believed() -> None:
    rims = np.full(100, 0.3)
    for share in (0.4, 1.0, 2.0):
        assert not flags(rims, -share * rims, rise=0.2).any()
        assert not flags(-rims, share * rims, rise=-0.2).any()
    longer = np.full(400, 0.3)
    assert flags(longer, -longer, rise=0.2)[-1] > 5.0, "none slides 5 m as fast as its wheels drive"
    assert not flags(longer, -2.0 * longer, rise=0.2).any()


def test_where_nothing_tells_the_slope_what_looks_back_goes_as_far_as_the_rims() -> None:
    rims = np.full(100, 0.3)
    assert not flags(rims, -0.4 * rims)[20:].any()
    assert not flags(rims, -2.0 * rims)[20:].any()
    assert (flags(rims, -0.8 * rims)[5:] > 0.0).all()


@pytest.mark.parametrize("rise", [np.nan, 0.0, 0.2])
def test_it_goes_on_over_cuts(rise: float) -> None:
    stands = np.arange(60) < 8
    rims, speed = np.where(stands, 0.0, 0.3), np.where(np.arange(60) < 30, -0.3, 0.3) * ~stands
    felt = 0.1 * np.random.default_rng(0).standard_normal(60)
    columns = rims, np.zeros(60), speed, np.full(60, STEP), np.full(60, rise), felt
    whole, parts = Against().take(*columns), Against()
    found = [parts.take(*(c[i : i + 7] for c in columns)) for i in range(0, 60, 7)]
    for one, of_parts in zip(whole, zip(*found, strict=True), strict=True):
        assert (np.concatenate(of_parts) == one).all()


@pytest.mark.parametrize("rise", [np.nan, 0.0, 0.2])
def test_an_imu_that_stood_before_feels_which_way_the_vehicle_goes(rise: float) -> None:
    """Whatever the slope seems to be, and a mounting or a zero that stays: from a second and a half on."""
    time = np.arange(100) * STEP
    rims = 0.4 * np.clip(time - 2.0, 0.0, 1.0)
    gain = 0.4 * ((time > 2.0) & (time < 3.0)) + 0.05 * np.random.default_rng(0).standard_normal(
        100
    )
    none, passed, rises = np.zeros(100), np.full(100, STEP), np.full(100, rise)
    for sign, slides in ((1.0, False), (-1.0, True)):
        way, may_be = Against().take(rims, none, -rims, passed, rises, sign * gain - 0.4)
        assert (may_be[35:] == slides).all()
        assert ((way[35:] > 0.0) != slides).all()


def test_a_slide_that_comes_to_rest_on_level_ground_stays_one() -> None:
    rims = np.concatenate([np.full(40, 0.3), np.full(40, 0.3), np.zeros(20)])
    speed = np.concatenate([np.full(40, -0.6), np.full(10, -0.3), np.zeros(50)])
    rise = np.concatenate([np.full(40, 0.25), np.zeros(60)])
    unknown, none, passed = np.full(100, np.nan), np.zeros(100), np.full(100, STEP)
    way, _ = Against().take(rims, none, speed, passed, rise, unknown)
    assert not way.any()
