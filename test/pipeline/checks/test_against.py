# SPDX-License-Identifier: Apache-2.0
"""An odometry that goes against all rims. Tests `lateness.py`."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.pipeline.checks.lateness import Against

STEP = 0.1  # s


def flags(rims: np.ndarray, speed: np.ndarray, turn: float = 0.0) -> np.ndarray:
    return Against().take(rims, np.full(rims.size, turn), speed, np.full(rims.size, STEP))


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


def test_it_goes_on_over_cuts() -> None:
    rims, speed = np.full(60, 0.3), np.where(np.arange(60) < 30, -0.3, 0.3)
    whole, parts = flags(rims, speed), Against()
    none, passed = np.zeros(60), np.full(60, STEP)
    found = [
        parts.take(*(c[i : i + 7] for c in (rims, none, speed, passed))) for i in range(0, 60, 7)
    ]
    assert (np.concatenate(found) == whole).all()
