# SPDX-License-Identifier: Apache-2.0
"""A second publisher that fills in zeros is told from an encoder that begins anew at 0."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.onboard.idle_publisher import IdlePublisher

SECOND = 1_000_000_000


def messages(zeros_at: slice, velocity: float) -> tuple[np.ndarray, ...]:
    """Stamps, velocities and positions of a joint at 1 rad/s, 50 Hz, and zeros in some messages."""
    stamps = SECOND + np.arange(500) * SECOND // 50
    speeds, positions = np.ones(500), 3.0 + np.arange(500) / 50.0
    speeds[zeros_at], positions[zeros_at] = velocity, 0.0
    return stamps, speeds, positions


@pytest.mark.parametrize("velocity", [0.0, np.nan])
def test_zeros_between_others_are_of_another_publisher(velocity: float) -> None:
    stamps, speeds, positions = messages(slice(1, None, 2), velocity)
    idle = IdlePublisher().idle(stamps, speeds, positions)
    assert not idle[::2].any()
    assert idle[1::2].all()


def test_an_encoder_that_begins_anew_and_stands_is_believed_after_a_second() -> None:
    stamps, speeds, positions = messages(slice(250, None), 0.0)
    idle = IdlePublisher().idle(stamps, speeds, positions)
    assert not idle[:250].any()
    assert not idle[301:].any()


def test_a_joint_that_stands_at_0_from_the_beginning_is_believed() -> None:
    zeros = np.zeros(500)
    assert not IdlePublisher().idle(np.arange(500) * SECOND // 50, zeros, zeros).any()


def test_a_time_that_goes_back_is_another_drive() -> None:
    """A bag that loops: its joints turned at its end, and stand at 0 at its beginning."""
    stamps, speeds, positions = messages(slice(0, 0), 0.0)
    idle = IdlePublisher()
    idle.idle(stamps, speeds, positions)
    zeros = np.zeros(100)
    assert not idle.idle(stamps[:100], zeros, zeros).any()


@given(st.lists(st.integers(1, 499), max_size=5))
def test_it_does_not_matter_where_messages_are_cut(cuts: list[int]) -> None:
    rows = messages(slice(1, None, 3), 0.0)
    whole = IdlePublisher().idle(*rows)
    one = IdlePublisher()
    parts = zip(*(np.split(column, sorted(cuts)) for column in rows), strict=True)
    assert np.concatenate([one.idle(*part) for part in parts]).tolist() == whole.tolist()
