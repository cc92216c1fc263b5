# SPDX-License-Identifier: Apache-2.0
"""A short drive of one wheel with every kind of input, as messages, for the fuzzing of topics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test"))

from topic_messages import Fed, imu, joints, odometry, sinkage, step, wrench

from smallwheel_ros.drive.messages import mobility_columns, soil_fields
from smallwheel_ros.pipeline.pipeline import Turn

_STEPS = 24
Message = Callable[[], Any]


def fed() -> Fed:
    """A new pipeline that messages are given to."""
    return Fed(**{"vehicle.mass": 6.0, "imu_topic": "imu", "front.torque_per_effort": 1.0})


@cache
def drive() -> tuple[tuple[str, Message, int], ...]:
    """Topic, what makes a message of it, and its stamp, in the order of arrival."""
    return tuple(_messages())


def _messages() -> Iterator[tuple[str, Message, int]]:
    for i in range(_STEPS):
        stamp = step(i)
        yield "odom", partial(odometry, stamp, 0.01 * i, 0.5), stamp
        yield "imu", partial(imu, stamp, 0.0, (0.0, 0.0, 9.8)), stamp
        yield "joint_states", partial(joints, stamp, [4.4], [2.0], ["front_joint"]), stamp
        yield "front/load", partial(wrench, stamp, 60.0), stamp
        yield "front/sinkage", partial(sinkage, stamp, 0.008 + 1e-4 * (i % 3)), stamp


def numbers(fed: Fed, turn: Turn) -> Iterator[float]:
    """Every number that node and replay would write of a turn."""
    columns = mobility_columns(turn.estimates, fed.pipeline)
    soil = soil_fields(fed.pipeline.soil, fed.pipeline.rejected)
    for value in (*columns.values(), *soil.values()):
        if not isinstance(value, str):
            of_numbers = np.asarray(value)
            if of_numbers.dtype.kind in "fiub":
                yield from of_numbers.astype(float).ravel().tolist()
