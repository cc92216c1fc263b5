# SPDX-License-Identifier: Apache-2.0
"""A short drive of one wheel with every kind of input, as messages, for the fuzzing of topics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test" / "onboard"))

from test_feed import header, joints, make, odometry, sinkage, step, topic, vector, wrench

from smallwheel_ros.bags import message_type
from smallwheel_ros.onboard.result import Result, mobility_fields, soil_fields

_STEPS = 24
Message = Callable[[], Any]


def imu(stamp: int) -> Any:
    """Return an upright imu that feels gravity."""
    return message_type("sensor_msgs/msg/Imu")(
        header=header(stamp),
        orientation=message_type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=odometry(stamp, 0.0, 0.0).pose.covariance[:9].copy(),
        angular_velocity=vector(),
        angular_velocity_covariance=odometry(stamp, 0.0, 0.0).pose.covariance[:9].copy(),
        linear_acceleration=vector(z=9.8),
        linear_acceleration_covariance=odometry(stamp, 0.0, 0.0).pose.covariance[:9].copy(),
    )


def feed() -> dict[str, Callable[[Any, int | None], list[Result]]]:
    """Return a new estimator's way in, by topic."""
    changes = {"vehicle.mass": 6.0, "imu_topic": "imu", "front.torque_source": "effort"}
    made = make(**changes)
    return {name: topic(made, name).handle for name in (t.name for t in made.topics)}


@cache
def drive() -> tuple[tuple[str, Message, int], ...]:
    """Topic, what makes a message of it, and its stamp, in the order of arrival."""
    return tuple(_messages())


def _messages() -> Iterator[tuple[str, Message, int]]:
    for i in range(_STEPS):
        stamp = step(i)
        yield "odom", partial(odometry, stamp, 0.04 * i, 0.5), stamp
        yield "imu", partial(imu, stamp), stamp
        yield "joint_states", partial(joints, stamp, [4.4], [2.0], ["front_joint"]), stamp
        yield "front/load", partial(wrench, stamp, 60.0), stamp
        yield "front/sinkage", partial(sinkage, stamp, 0.008 + 1e-4 * (i % 3)), stamp


def numbers(result: Result) -> Iterator[float]:
    """Every number that node and replay would write of a result."""
    for fields in (mobility_fields(result), soil_fields(result.soil, result.rejected)):
        for value in fields.values():
            if isinstance(value, float | int):
                yield float(value)
            elif not isinstance(value, str):
                yield from map(float, value)
