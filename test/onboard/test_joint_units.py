# SPDX-License-Identifier: Apache-2.0
"""Velocities of joints against what their positions turn."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.onboard.joint_units import VelocityUnit

STEP = 20_000_000  # ns


def messages(factor: float, wraps: bool = False, count: int = 600):
    """Stamps, velocities and positions of a joint that starts and stops, whose encoder has 4,096 ticks."""
    stamps = 10**18 + STEP * np.arange(count)
    speed = 4.0 + 3.0 * np.sin(0.02 * np.arange(count))
    position = np.cumsum(speed) * STEP / 1e9
    ticks = np.round(position / (2 * np.pi) * 4096) / 4096 * 2 * np.pi
    if wraps:
        ticks = np.mod(ticks + np.pi, 2 * np.pi) - np.pi
    return stamps, factor * speed, ticks


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (30 / np.pi, "in rpm"),
        (180 / np.pi, "in deg/s"),
        (0.5 / np.pi, "in turns/s"),
        (0.125, "in m/s at the rim"),
        (37.0, "of a motor before its gear"),
    ],
)
@pytest.mark.parametrize("wraps", [False, True])
def test_a_velocity_in_another_unit_is_named(factor: float, words: str, wraps: bool) -> None:
    stamps, velocity, position = messages(factor, wraps)
    unit = VelocityUnit()
    usable = unit.usable(stamps, velocity, position)
    assert usable.sum() * STEP < (0.2e9 if factor > 1.0 else 0.6e9)
    assert words in unit.wrong
    assert not unit.usable(stamps, velocity, position).any()


@pytest.mark.parametrize("factor", [1.0, 0.9, 1.2, 2 * np.pi, np.pi / 180])
def test_good_velocities_are_left_alone(factor: float) -> None:
    """The last two are of positions in turns and in degrees: velocities are right all the same."""
    unit = VelocityUnit()
    assert unit.usable(*messages(factor)).sum() == pytest.approx(
        600, abs=0 if factor in (1.0, 0.9, 1.2) else 60
    )
    assert unit.wrong == ""


@pytest.mark.parametrize("position", [0.0, np.nan])
def test_positions_that_nobody_fills_in_tell_nothing(position: float) -> None:
    stamps, velocity, _ = messages(10.0)
    unit = VelocityUnit()
    assert unit.usable(stamps, velocity, np.full(600, position)).all()
    assert unit.wrong == ""


def test_a_filter_that_is_late_is_no_unit() -> None:
    stamps, velocity, position = messages(1.0)
    unit = VelocityUnit()
    late = np.concatenate([np.zeros(10), velocity[:-10]])  # 0.2 s
    used = unit.usable(stamps, late, position)
    assert unit.wrong == ""
    # Not while it shows that the joint stands, and the joint turns.
    assert used[stamps - stamps[0] > 10**9].all()
    assert used[:50].sum() > 10


@pytest.mark.parametrize("factor", [30.0 / np.pi, 0.125])
def test_no_speed_in_another_unit_is_used_from_the_first_turn_on(factor: float) -> None:
    """From 0.05 rad on: a tenth of a second of a wheel at 1 rad/s."""
    stamps, velocity, position = messages(factor)
    used = VelocityUnit().usable(stamps, velocity, position)
    assert not used[np.abs(position - position[0]) > 0.11].any()


def test_a_joint_that_begins_to_turn_loses_no_message_where_its_unit_is_right() -> None:
    stamps, velocity, position = messages(1.0)
    assert VelocityUnit().usable(stamps, velocity, position).all()


@given(st.lists(st.integers(1, 599), max_size=5), st.sampled_from([1.0, 30 / np.pi]))
def test_it_does_not_matter_where_messages_are_cut(cuts: list[int], factor: float) -> None:
    columns = messages(factor)
    whole, parts = VelocityUnit(), VelocityUnit()
    usable = whole.usable(*columns)
    at = [0, *sorted(cuts), 600]
    found = [parts.usable(*(column[i:k] for column in columns)) for i, k in pairwise(at)]
    assert (np.concatenate(found) == usable).all()
    assert parts.wrong == whole.wrong
