# SPDX-License-Identifier: Apache-2.0
"""Velocities of joints against what their positions turn."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.onboard.joint_units import VelocityUnit

STEP, WAIT = 20_000_000, 200_000_000  # ns


def usable(unit: VelocityUnit, stamps, velocity, position, wait: int = WAIT) -> np.ndarray:
    """Which messages may be used; of the newest ones it may not be known yet, these wait."""
    found = unit.take(stamps, np.column_stack([velocity, position]), wait)[0]
    assert (np.diff(found) > 0).all()
    return np.isin(stamps, found)


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
    used = usable(unit, stamps, velocity, position)
    assert used.sum() * STEP < (0.2e9 if factor > 1.0 else 0.6e9)
    assert words in unit.wrong
    assert not usable(unit, stamps, velocity, position).any()


@pytest.mark.parametrize("factor", [1.0, 0.9, 1.2, 2 * np.pi, np.pi / 180])
def test_good_velocities_are_left_alone(factor: float) -> None:
    """The last two are of positions in turns and in degrees: velocities are right all the same."""
    unit = VelocityUnit()
    assert usable(unit, *messages(factor)).sum() == pytest.approx(
        600, abs=0 if factor in (1.0, 0.9, 1.2) else 60
    )
    assert unit.wrong == ""


@pytest.mark.parametrize("position", [0.0, np.nan])
def test_positions_that_nobody_fills_in_tell_nothing(position: float) -> None:
    stamps, velocity, _ = messages(10.0)
    unit = VelocityUnit()
    assert usable(unit, stamps, velocity, np.full(600, position)).all()
    assert unit.wrong == ""


def test_a_filter_that_is_late_is_no_unit() -> None:
    stamps, velocity, position = messages(1.0)
    unit = VelocityUnit()
    late = np.concatenate([np.zeros(10), velocity[:-10]])  # 0.2 s
    used = usable(unit, stamps, late, position)
    assert unit.wrong == ""
    # Not while it shows that the joint stands, and the joint turns.
    assert used[stamps - stamps[0] > 10**9].all()
    assert used[:50].sum() > 10


def from_rest(factor: float, ticks: int | None, behind: int = 0):
    """A joint that stands for 2 s and starts with 1 rad/s^2; ticks of its encoder, None: as fine as numbers.

    behind: messages, by which its velocities are older than its positions.
    """
    stamps = 10**18 + STEP * np.arange(300)
    speed = np.clip(STEP * 1e-9 * np.arange(300) - 2.0, 0.0, 2.0)
    position = np.cumsum(speed) * STEP / 1e9
    if ticks:
        position = np.round(position / (2 * np.pi) * ticks) / ticks * 2 * np.pi
    return stamps, factor * np.concatenate([np.zeros(behind), speed])[:300], position


@pytest.mark.parametrize("factor", [30.0 / np.pi, 0.125])
@pytest.mark.parametrize("wraps", [False, True])
def test_no_speed_in_another_unit_is_used_once_a_joint_turns(factor: float, wraps: bool) -> None:
    assert not usable(VelocityUnit(), *messages(factor, wraps)).any()


@pytest.mark.parametrize("ticks", [None, 65536, 4096])
@pytest.mark.parametrize("factor", [30.0 / np.pi, 0.125])
def test_no_speed_in_another_unit_is_used_from_rest(factor: float, ticks: int | None) -> None:
    stamps, velocity, position = from_rest(factor, ticks)
    used = usable(VelocityUnit(), stamps, velocity, position)
    assert used[velocity == 0.0].all()  # that it stands is known in any unit
    assert not used[velocity != 0.0].any()


@pytest.mark.parametrize("ticks", [None, 65536, 4096, 1024, 256])
@pytest.mark.parametrize("behind", [0, 1, 2])
def test_a_joint_that_starts_from_rest_keeps_its_messages(ticks: int | None, behind: int) -> None:
    stamps, velocity, position = from_rest(1.0, ticks, behind)
    unit = VelocityUnit()
    assert usable(unit, stamps, velocity, position).all()
    assert unit.wrong == ""


def test_noise_of_a_joint_that_stands_is_used() -> None:
    """Velocities that flicker, and positions by less than a hundredth of a radian."""
    rng = np.random.default_rng(0)
    stamps = 10**18 + STEP * np.arange(600)
    velocity, position = 0.01 * rng.standard_normal(600), 0.001 * rng.standard_normal(600)
    used = usable(VelocityUnit(), stamps, velocity, position)
    assert used[:-8].all()  # the last 0.15 s wait


def test_messages_wait_no_longer_than_others_are_waited_for() -> None:
    """Where streams do not wait for one another none waits here."""
    stamps, velocity, position = messages(1.0)
    unit = VelocityUnit()
    for i in range(stamps.size):
        row = slice(i, i + 1)
        assert usable(unit, stamps[row], velocity[row], position[row], wait=0).all()


def test_a_joint_that_begins_to_turn_loses_no_message_where_its_unit_is_right() -> None:
    assert usable(VelocityUnit(), *messages(1.0)).all()


@given(st.lists(st.integers(1, 599), max_size=5), st.sampled_from([1.0, 30 / np.pi]))
def test_it_does_not_matter_where_messages_are_cut(cuts: list[int], factor: float) -> None:
    stamps, velocity, position = messages(factor)
    rows = np.column_stack([velocity, position])
    whole, parts = VelocityUnit(), VelocityUnit()
    free, values, _, refused = whole.take(stamps, rows, WAIT)
    at = [0, *sorted(cuts), 600]
    found = [parts.take(stamps[i:k], rows[i:k], WAIT) for i, k in pairwise(at)]
    assert (np.concatenate([one[0] for one in found]) == free).all()
    assert (np.concatenate([one[1] for one in found if len(one[1])] or [values]) == values).all()
    assert (np.concatenate([one[3] for one in found]) == refused).all()
    assert np.union1d(free, refused).size == 600
    assert parts.wrong == whole.wrong
