# SPDX-License-Identifier: Apache-2.0
"""How far a vehicle slows down: by its warnings, and until it has gone on without one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from smallwheel_ros.drive.speed_limit import SpeedLimit
from smallwheel_ros.pipeline.mobility.status import Condition


class Rows(SimpleNamespace):
    """Rows of two wheels at one instant, with the columns that are read."""

    def __len__(self) -> int:
        return 2


def rows(distance: float, level: int = 0, stuck: bool = False) -> Any:
    warned = int(Condition.WARNED) if level else 0
    return Rows(
        stamp=np.full(2, int(1e9 * distance)), distance=np.full(2, distance),
        conditions=np.full(2, warned), digging_in=np.full(2, level == 2), spins=np.full(2, stuck),
    )  # fmt: skip


def test_half_after_a_warning_until_two_metres_without_and_a_fifth_where_it_gets_stuck() -> None:
    limit = SpeedLimit()
    told = []
    for distance, level in (
        (0.0, 0),
        (1.0, 1),
        (1.5, 0),
        (2.9, 0),
        (3.1, 0),
        (4.0, 2),
        (4.1, 1),
        (5.0, 0),
    ):
        changed = limit.take(rows(distance, level))
        told.append((limit.percent, changed))
    assert told == [
        (0.0, False), (50.0, True), (50.0, False), (50.0, False), (0.0, True), (20.0, True),
        (50.0, True), (50.0, False),
    ]  # fmt: skip


def test_stuck_is_slow_and_a_new_start_is_free() -> None:
    limit = SpeedLimit()
    assert limit.take(rows(3.0, stuck=True))
    assert limit.percent == 20.0
    limit.clear()
    assert not limit.take(rows(0.5))
    assert limit.percent == 0.0
