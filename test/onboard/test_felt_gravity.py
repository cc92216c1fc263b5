# SPDX-License-Identifier: Apache-2.0
"""What an imu feels on average is gravity, or what it is instead is named."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.onboard.felt_gravity import unlike_gravity

EARTH, MARS = 9.80665, 3.71


@given(st.sampled_from([EARTH, MARS]), st.floats(0.85, 1.2))
def test_gravity_of_an_accelerometer_that_nobody_calibrated_is_gravity(
    gravity: float, scale: float
) -> None:
    assert unlike_gravity(scale * gravity, gravity) == ""


@pytest.mark.parametrize(
    ("strength", "words"),
    [
        (0.0, "accelerations are all 0"),
        (0.2, "gravity has been taken out"),
        (1.0, "gravity in g?"),
        (EARTH / 2, "gravity has been taken out"),
        (14.0, "it feels 14 m/s^2 on average, expected 9.81"),
        (1000.0, "gravity in mg or cm/s^2?"),
    ],
)
def test_what_is_no_gravity_is_named(strength: float, words: str) -> None:
    assert words in unlike_gravity(strength)
