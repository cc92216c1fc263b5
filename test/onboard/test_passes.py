# SPDX-License-Identifier: Apache-2.0
"""Pass numbers: from the places of wheels on known paths."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pandas as pd
import pytest

from smallwheel_ros.onboard.ground import PassCounter
from smallwheel_ros.physics.wheel import Wheel

WIDTH, AHEAD = 0.1, 0.35


def wheel(name: str, ahead: float, left: float, contact: str = "rolling") -> Wheel:
    return Wheel(name, 0.25, WIDTH, contact, left, ahead)


ROVER = (wheel("front", AHEAD, 0.28), wheel("rear", -AHEAD, 0.28))


class Path:
    """A vehicle that goes where it is sent; counts what its wheels pass on the way."""

    def __init__(self, wheels: tuple[Wheel, ...] = ROVER, known: bool = True) -> None:
        self.wheels, self.known = wheels, known
        self.counter = PassCounter(wheels)
        self.x = self.y = self.yaw = self.travel = 0.0

    def go(self, distance: float, turn: float = 0.0, step: float = 0.01) -> pd.DataFrame:
        """Drive on a straight line or an arc (turn: 1/m); a row per wheel and step."""
        rows = []
        sign = math.copysign(1.0, distance)
        for _ in range(round(abs(distance) / step)):
            self.x += sign * step * math.cos(self.yaw)
            self.y += sign * step * math.sin(self.yaw)
            self.yaw += sign * step * turn
            self.travel += step
            for one in self.wheels:
                number = self.counter.number(self.result(one, sign))
                rows.append((one.name, self.travel, self.x, number))
        return pd.DataFrame(rows, columns=["wheel", "travel", "x", "number"])

    def result(self, one: Wheel, sign: float) -> SimpleNamespace:
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        ahead, left = one.longitudinal_position, one.lateral_position
        place = (self.x + cosine * ahead - sine * left, self.y + sine * ahead + cosine * left)
        return SimpleNamespace(
            wheel=one,
            distance=self.travel,
            place=place if self.known else None,
            speed=sign * 0.2,
        )


def numbers(table: pd.DataFrame, name: str, after: float = 1.0) -> set[float]:
    rows = table[(table["wheel"] == name) & (table["travel"] > after)]
    return set(rows["number"].fillna(-1.0))


def test_a_wheel_behind_another_runs_in_its_track():
    table = Path().go(4.0)
    assert numbers(table, "front", 0.2) == {1}
    assert numbers(table, "rear") == {2}
    begin = table[(table["wheel"] == "rear") & (table["travel"] < 2 * AHEAD)]
    assert begin["number"].isna().all()  # nobody knows how the vehicle came to stand there


def test_three_wheels_in_a_row_and_one_beside_them():
    wheels = (*ROVER, wheel("middle", 0.0, 0.28), wheel("beside", -AHEAD, -0.28))
    table = Path(wheels).go(4.0)
    found = {one.name: numbers(table, one.name) for one in wheels}
    assert found == {"front": {1}, "middle": {2}, "rear": {3}, "beside": {1}}


@pytest.mark.parametrize(("offset", "expected"), [(0.04, 2), (0.07, -1), (0.12, 1)])
def test_a_track_met_in_part_is_not_known(offset, expected):
    wheels = (wheel("front", AHEAD, 0.28), wheel("rear", -AHEAD, 0.28 + offset))
    assert numbers(Path(wheels).go(3.0), "rear") == {expected}


def test_backwards_the_rear_wheel_is_the_first():
    table = Path().go(-4.0)
    assert numbers(table, "rear", 0.2) == {1}
    assert numbers(table, "front") == {2}


def test_a_circle_driven_again_is_crossed_again():
    wheels = (wheel("front", 0.0, 0.0),)
    path = Path(wheels)
    path.go(3.0)
    lap = math.tau / 0.5
    for expected in (1, 2, 3):
        table = path.go(lap, turn=0.5)
        assert table["number"].mode()[0] == expected


def test_only_where_a_track_is_crossed_it_counts():
    """A figure of 8: once around, then straight across the first line."""
    path = Path((wheel("front", 0.0, 0.0),))
    path.go(6.0)
    path.go(0.75 * math.tau * 1.5, turn=1 / 1.5)
    table = path.go(4.0)
    crossed = table[table["number"] == 2]
    assert 0.5 * WIDTH < crossed["travel"].max() - crossed["travel"].min() < 1.5 * WIDTH
    assert set(table["number"].dropna()) == {1, 2}


def test_going_back_and_forth_counts_each_time():
    path = Path((wheel("front", 0.0, 0.0),))
    path.go(3.0)
    back = path.go(-2.0)
    forth = path.go(2.0)
    assert back["number"].mode()[0] == 2
    assert forth["number"].mode()[0] == 3


def test_without_places_nothing_is_known():
    assert Path(known=False).go(3.0)["number"].isna().all()
    same = (wheel("front", 0.0, 0.0), wheel("rear", 0.0, 0.0))  # nobody has said where they are
    assert Path(same).go(3.0)["number"].isna().all()
    pressed = (wheel("plate", 0.0, 0.0, contact="pressed"),)
    assert Path(pressed).go(3.0)["number"].isna().all()


def test_an_odometry_that_begins_anew_makes_the_ground_unknown_again():
    path = Path()
    path.go(4.0)
    path.x -= 4.0
    table = path.go(3.0)
    rear = table[table["wheel"] == "rear"]
    assert rear["number"].head(20).isna().all()
    assert rear["number"].iloc[-1] == 2
