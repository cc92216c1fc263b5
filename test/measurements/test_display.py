# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.measurements.display import brief, display, number, sentence, words


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (0.7, "0.700"),
        (0.0007 * 1e3, "0.700"),
        (-0.09999, "-0.100"),
        (12.34, "12.3"),
        (9.999, "10.0"),
        (123.4, "123"),
        (4131.0, "4130"),
        (1.5e7, "1.50e+07"),
        (1.5e-12, "1.50e-12"),
        (None, "-"),
        (float("nan"), "-"),
        (float("inf"), "-"),
    ],
)
def test_numbers_have_three_digits(value: float | None, shown: str) -> None:
    assert number(value) == shown


@given(st.floats(1e-300, 1e300) | st.floats(-1e300, -1e-300))
def test_what_is_shown_is_the_number_to_half_a_percent(value: float) -> None:
    assert float(number(value)) == pytest.approx(value, rel=5.1e-3)


def test_lengths_are_shown_in_millimetres_and_angles_in_degrees() -> None:
    assert display("sinkage", "m") == (1e3, "sinkage [mm]", "mm")
    assert display("slip_angle", "rad").scale == pytest.approx(180 / np.pi)
    assert display("moisture", "").label == "moisture"
    assert display("slip", "1").label == "slip"


def test_words() -> None:
    assert words("drawbar_pull") == "drawbar pull"
    assert sentence("slip is odd") == "Slip is odd."
    assert brief(20.0) == "20"
    assert brief(0.5) == "0.5"
