# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.onboard.joint_motion import SECOND, JointMotion

RATE = 50  # Hz


def messages(seconds: float, speed: float, start: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    stamps = 1_000 * SECOND + np.arange(int(seconds * RATE)) * (SECOND // RATE)
    return stamps, start + speed * (stamps - stamps[0]) / SECOND


def taken(stamps, velocity, position, has=True, joint=None):
    joint = joint or JointMotion()
    count = stamps.size
    columns = (np.broadcast_to(np.asarray(one, dtype=float), count) for one in (velocity, position))
    at, speed, number = joint.take(stamps, *columns, np.broadcast_to(has, count))
    assert at.size == speed.size == number.size
    assert (np.diff(at) > 0).all()
    return at, speed, number, joint


def test_a_velocity_is_taken_as_it_is() -> None:
    stamps, position = messages(2.0, 3.0)
    velocity = np.where(np.arange(stamps.size) < 20, 0.0, 3.0)
    velocity[40] = math.nan  # counted by who takes it
    place = np.where(velocity == 0.0, position[0], position)
    at, speed, number, joint = taken(stamps, velocity, place)
    assert (at == stamps).all()
    np.testing.assert_array_equal(speed, velocity)
    assert (number == np.arange(stamps.size)).all()
    assert not joint.by_positions


@pytest.mark.parametrize("has", [True, False], ids=["always 0", "missing"])
@pytest.mark.parametrize("wrapped", ["no", "half", "whole"])
@pytest.mark.parametrize("rate", [3.0, -7.0])
def test_positions_tell_what_velocities_do_not(has: bool, wrapped: str, rate: float) -> None:
    stamps, position = messages(4.0, rate, start=2.0)
    if wrapped != "no":
        low = math.pi if wrapped == "half" else 0.0
        position = (position + low) % math.tau - low
    at, speed, _, joint = taken(stamps, 0.0 if has else math.nan, position, has)
    assert joint.by_positions
    known = (at - stamps[0]) / SECOND > 0.5 / abs(rate)
    np.testing.assert_allclose(speed[known], rate, rtol=1e-9)
    assert known.sum() > 150
    assert (speed[~known] == 0.0).sum() <= 2  # so little that a rover may have settled


def test_the_middle_of_a_tenth_of_a_second_is_meant() -> None:
    stamps, _ = messages(3.0, 0.0)
    time = (stamps - stamps[0]) / SECOND
    at, speed, _, _ = taken(stamps, math.nan, 2.0 * time**2, False)
    np.testing.assert_allclose(speed, 4.0 * (at - stamps[0]) / SECOND, atol=1e-6)


def test_a_velocity_of_0_is_not_believed_while_its_position_turns() -> None:
    stamps, position = messages(1.6, 0.3)
    at, _, _, joint = taken(stamps, 0.0, position)
    assert not joint.by_positions  # a rover that settles may have turned it
    assert at.size == 5  # a tenth of a second, after which it is known to turn
    assert {*at} | {*joint.unknown} == {*stamps}


def test_a_joint_that_stands_has_a_speed_of_0() -> None:
    stamps, _ = messages(5.0, 0.0)
    ticks = 0.006 * (np.arange(stamps.size) % 2)
    at, speed, _, joint = taken(stamps, 0.0, ticks)
    assert at.size == stamps.size
    assert not speed.any()
    assert not joint.by_positions
    _, speed, _, _ = taken(stamps, math.nan, np.zeros(stamps.size), False)
    assert not speed.any()


def test_another_publisher_without_velocities_is_left_out() -> None:
    stamps, position = messages(4.0, 3.0)
    real = np.arange(stamps.size) % 2 == 0
    _, speed, number, joint = taken(
        stamps, np.where(real, 3.0, math.nan), np.where(real, position, 0.0), real
    )
    assert (speed == 3.0).all()
    assert real[number].all()
    assert joint.left_out == (~real).sum()


def test_a_gap_is_no_speed() -> None:
    stamps, position = messages(2.0, 3.0)
    stamps = np.where(np.arange(stamps.size) < 50, stamps, stamps + 30 * SECOND)
    at, speed, _, _ = taken(stamps, math.nan, position + (stamps - stamps[0]) / SECOND, False)
    np.testing.assert_allclose(speed, 4.0)  # 3, and 1 more of what went on in the gap
    middle = stamps[49] + 15 * SECOND
    assert (abs(at - middle) > 14 * SECOND).all()


@given(st.lists(st.integers(0, 199), max_size=6), st.sampled_from(["zero", "missing", "late"]))
def test_cuts_change_nothing(cuts: list[int], kind: str) -> None:
    stamps, position = messages(4.0, 3.0)
    has = kind != "missing"
    velocity = np.zeros(stamps.size)
    if kind == "late":
        velocity[120:] = 3.0
    whole = taken(stamps, velocity, position, has)
    joint, parts = JointMotion(), []
    for part in np.split(np.arange(stamps.size), sorted(cuts)):
        parts.append(taken(stamps[part], velocity[part], position[part], has, joint)[:2])
    for one, other in zip(whole[:2], zip(*parts, strict=True), strict=True):
        np.testing.assert_array_equal(one, np.concatenate(other))
