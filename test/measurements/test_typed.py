# SPDX-License-Identifier: Apache-2.0
"""Numbers as people type them for a setting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.common.errors import ArgumentError
from smallwheel_ros.measurements.typed import (
    RangeError,
    check_setting,
    levels_of,
    number_of,
    typed,
    weighed,
)


@pytest.mark.parametrize(
    ("name", "text", "unit", "values"),
    [
        ("load", "60", "N", [60.0]),
        ("load", "20:50:10", "N", [20.0, 30.0, 40.0, 50.0]),
        ("slip", "0..60%", "1", [0.0, 0.3, 0.6]),
        ("diameter", "17 cm", "m", [0.17]),
        ("load", "20,40,60", "N", [20.0, 40.0, 60.0]),
        ("diameter", "0,17; 0,25", "m", [0.17, 0.25]),
    ],
)
def test_ways_to_type(name: str, text: str, unit: str, values: list[float]) -> None:
    np.testing.assert_allclose(typed(name, text, unit).values, values)


@pytest.mark.parametrize("text", ["", "a", "1:2", "5..1", "1:0:1", "0:1e9:1", "1 N, 2 m", "1e999"])
def test_what_is_no_number_is_named(text: str) -> None:
    with pytest.raises(RangeError, match="load"):
        typed("load", text, "N")


@pytest.mark.parametrize(("load", "newtons"), [("5kg", 8.1), ("5kgf", 49.03325), ("5", 5.0)])
def test_a_mass_weighs_by_the_gravity_that_was_typed(load: str, newtons: float) -> None:
    """What a load cell shows as kg is kgf."""
    levels = weighed({"load": levels_of("load", load), "gravity": levels_of("gravity", "1.62")})
    assert levels["load"].values == pytest.approx([newtons])
    assert ("1.62 m/s^2" in levels["load"].said) == (load == "5kg")


@pytest.mark.parametrize("gravity", ["0", "-1.62", "1000"])
def test_a_gravity_that_there_is_not_is_refused(gravity: str) -> None:
    levels = {"load": levels_of("load", "5"), "gravity": levels_of("gravity", gravity)}
    with pytest.raises(
        RangeError, match=r"gravity: found .*, expected 0\.01 to 100 m/s\^2; 9\.80665 on the earth"
    ):
        weighed(levels)


def test_a_mass_under_several_gravities_is_refused() -> None:
    levels = {"load": levels_of("load", "5kg"), "gravity": levels_of("gravity", "1.62,3.7")}
    with pytest.raises(RangeError, match="give the load in N, or one gravity at a time"):
        weighed(levels)


def test_a_mass_is_said_to_be_a_weight() -> None:
    read = number_of("load", "2 kg")
    assert read.values == pytest.approx([19.6133])
    assert "weight" in read.said


def test_one_slip_of_the_keyboard_is_refused() -> None:
    check_setting("moisture")
    with pytest.raises(ArgumentError, match="nearly 'diameter'"):
        check_setting("diamter")


@given(st.lists(st.floats(-1e6, 1e6), min_size=1))
def test_numbers_stay_what_they_are(values: list[float]) -> None:
    np.testing.assert_array_equal(levels_of("load", values).values, values)
