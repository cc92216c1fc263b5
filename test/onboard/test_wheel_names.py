# SPDX-License-Identifier: Apache-2.0
"""What names of joints and topics tell of a wheel's place."""

from __future__ import annotations

import pytest

from smallwheel_ros.onboard.wheel_names import PLACES, called_by_place, wheels_named_by, words_of

FOUR = ["front_left", "front_right", "rear_left", "rear_right"]
SIX = [*FOUR[:2], "middle_left", "middle_right", *FOUR[2:]]


@pytest.mark.parametrize(
    ("names", "wheels"),
    [
        (["front_wheel_L", "front_wheel_R", "back_wheel_L", "back_wheel_R"], FOUR),
        (["wheel_FL", "wheel_FR", "wheel_RL", "wheel_RR"], FOUR),
        (["LF", "RF", "LR", "RR"], FOUR),
        (["f_l", "f_r", "r_l", "r_r"], FOUR),
        (["fr_left", "fr_right", "re_left", "re_right"], FOUR),
        (["frontleftwheel", "frontrightwheel", "backleftwheel", "backrightwheel"], FOUR),
        (["FrontLeft", "FrontRight", "RearLeft", "RearRight"], FOUR),
        (["FLWheel", "FRWheel", "BLWheel", "BRWheel"], FOUR),
        (["DRV_LF", "DRV_RF", "DRV_LM", "DRV_RM", "DRV_LR", "DRV_RR"], SIX),
        (["l_f", "r_f", "l_m", "r_m", "l_b", "r_b"], SIX),
        (["front_L", "front_R", "M_L", "M_R", "B_L", "B_R"], SIX),
        (["wheel_L", "wheel_R"], ["left", "right"]),
        (["wheel_F", "wheel_R"], ["front", "rear"]),
        (["wheel_F", "wheel_RL", "wheel_RR"], ["front", "rear_left", "rear_right"]),
        (["wheel_FL", "wheel_FR", "wheel_R"], ["front_left", "front_right", "rear"]),
    ],
)
def test_letters_mean_what_stands_beside_them(names: list[str], wheels: list[str]) -> None:
    assert wheels_named_by(names) == dict(zip(wheels, names, strict=True))


def test_places_name_what_names_do_not() -> None:
    where = {
        "rear_letf": (-1.0, 0.5),
        "rear_right": (-1.0, -0.5),
        "a": (1.0, 0.5),
        "b": (1.02, -0.5),
    }
    assert wheels_named_by(list(where), where) == {
        "front_left": "a", "front_right": "b", "rear_left": "rear_letf", "rear_right": "rear_right",
    }  # fmt: skip


def test_names_stand_where_places_are_others() -> None:
    where = {"front_left": (1.0, -0.5), "front_right": (1.0, 0.5)}
    assert wheels_named_by(list(where), where) == {name: name for name in where}


def test_a_tricycle_and_five_rows() -> None:
    where = {"a": (1.0, 0.0), "b": (0.0, 0.4), "c": (0.0, -0.4)}
    assert called_by_place(where) == {"a": "front", "b": "rear_left", "c": "rear_right"}
    assert called_by_place({str(i): (float(i), 0.5) for i in range(5)}) is None
    assert called_by_place({"twin": (0.0, 0.5), "other": (0.0, 0.52)}) is None


def test_longer_words_are_not_taken_apart() -> None:
    assert words_of("leftover") & {*PLACES} == set()
    assert words_of("frontier_wheel") & {*PLACES} == set()
