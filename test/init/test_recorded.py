# SPDX-License-Identifier: Apache-2.0
"""Joints and odometry of a drive side by side, where wheels come in messages of their own.

Tests `recorded.py`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from smallwheel_ros.init.recorded import (
    JointSpeeds,
    Speed,
    is_of_wheels,
    signs_of,
    times_the_way,
    unlike_wheels,
)

RADIUS = 0.1
TIMES = 0.01 * np.arange(2000)
FORWARD = 0.3 + 0.1 * np.sin(0.5 * TIMES)
RADII = {"left": RADIUS, "right": RADIUS}


def joints(period: int, *, apart: bool, factor: float = 1.0) -> JointSpeeds:
    """Two joints each `period` instants of 0.01 s, the right one half a period later if they come apart."""
    speeds = np.full((TIMES.size, 2), math.nan)
    for column, first in enumerate((0, period // 2 if apart else 0)):
        speeds[first::period, column] = factor * FORWARD[first::period] / RADIUS
    some = np.isfinite(speeds).any(axis=1)
    return JointSpeeds(TIMES[some], ["left", "right"], speeds[some])


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("period", [4, 10, 20])
def test_an_odometry_of_the_wheels_is_known_whether_or_not_they_share_stamps(
    period: int, apart: bool
) -> None:
    of = joints(period, apart=apart)
    odometry = Speed(TIMES, FORWARD, by_pose=False)
    assert is_of_wheels(unlike_wheels(of, odometry, ["left", "right"]))
    assert times_the_way(of, odometry, RADII) == pytest.approx(1.0, abs=0.01)
    assert signs_of(of, odometry, ["left", "right"]) == {"left": 1, "right": 1}


def test_a_wrong_unit_is_seen_in_wheels_that_come_apart() -> None:
    of = joints(4, apart=True, factor=180.0 / math.pi)
    odometry = Speed(TIMES, FORWARD, by_pose=False)
    assert times_the_way(of, odometry, RADII) == pytest.approx(180.0 / math.pi, rel=0.01)


def test_an_odometry_of_something_else_stays_independent() -> None:
    of = joints(4, apart=True)
    noisy = FORWARD * (1.0 + 0.05 * np.random.default_rng(1).standard_normal(TIMES.size))
    share = unlike_wheels(of, Speed(TIMES, noisy, by_pose=False), ["left", "right"])
    assert share is not None
    assert not is_of_wheels(share)


def test_nothing_is_made_up_where_a_wheel_was_silent() -> None:
    of = joints(4, apart=True)
    late = of.speeds.copy()
    late[of.times > 0.5, 1] = math.nan  # 13 readings, fewer than tell anything
    silent = of._replace(speeds=late)
    odometry = Speed(TIMES, FORWARD, by_pose=False)
    assert unlike_wheels(silent, odometry, ["left", "right"]) is None
