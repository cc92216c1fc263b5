# SPDX-License-Identifier: Apache-2.0
"""Messages of a rover of one wheel as topics carry them, and a pipeline that takes them serialised."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from smallwheel_ros.bags import message_type, typestore
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.feed import Message, feed
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.intake.decoder import Decoder
from smallwheel_ros.pipeline.intake.inputs import topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import Estimates, Readings

START = 1_700_000_000 * SECOND
ONE_WHEEL: dict[str, object] = {
    "wheels": ["front"],
    "front.diameter": 0.25,
    "front.width": 0.1,
    "timing.reorder_time": 0.05,
    "mobility.rate": 0.0,
}


def step(i: int) -> int:
    """Stamp of the i-th instant of a drive at 50 Hz."""
    return START + i * SECOND // 50


def header(stamp: int, frame: str = "odom") -> Any:
    time = message_type("builtin_interfaces/msg/Time")(sec=stamp // SECOND, nanosec=stamp % SECOND)
    return message_type("std_msgs/msg/Header")(stamp=time, frame_id=frame)


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return message_type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)


def wrench(stamp: int, force: float, pull: float = 0.0) -> Any:
    forces = message_type("geometry_msgs/msg/Wrench")(
        force=vector(x=pull, z=force), torque=vector()
    )
    return message_type("geometry_msgs/msg/WrenchStamped")(header=header(stamp), wrench=forces)


def twist(speed: float, turn: float = 0.0) -> Any:
    linear, angular = vector(x=speed), vector(z=turn)
    return message_type("geometry_msgs/msg/Twist")(linear=linear, angular=angular)


def velocity(stamp: int, speed: float) -> Any:
    stamped = message_type("geometry_msgs/msg/TwistStamped")
    return stamped(header=header(stamp), twist=twist(speed))


def odometry(
    stamp: int,
    x: float,
    speed: float,
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    turn: float = 0.0,
    variances: tuple[float, float] = (0.0, 0.0),
) -> Any:
    """variances: of speed and yaw rate."""
    names = dict(zip("xyzw", orientation, strict=True))
    quaternion = message_type("geometry_msgs/msg/Quaternion")(**names)
    place = message_type("geometry_msgs/msg/Point")(x=x, y=2.0, z=0.0)
    pose = message_type("geometry_msgs/msg/Pose")(position=place, orientation=quaternion)
    covariance = np.zeros(36)
    covariance[[0, 35]] = variances
    with_covariance = message_type("geometry_msgs/msg/PoseWithCovariance")
    return message_type("nav_msgs/msg/Odometry")(
        header=header(stamp),
        child_frame_id="base_link",
        pose=with_covariance(pose=pose, covariance=np.zeros(36)),
        twist=message_type("geometry_msgs/msg/TwistWithCovariance")(
            twist=twist(speed, turn), covariance=covariance
        ),
    )


def joints(stamp: int, velocity: list[float], effort: list[float], names: list[str]) -> Any:
    return message_type("sensor_msgs/msg/JointState")(
        header=header(stamp),
        name=names,
        position=np.zeros(len(names)),
        velocity=np.array(velocity),
        effort=np.array(effort),
    )


def sinkage(stamp: int, value: float, variance: float = 1e-6) -> Any:
    return message_type("smallwheel_ros/msg/WheelSinkage")(
        header=header(stamp), sinkage=value, variance=variance
    )


def distance(stamp: int, value: float, low: float = 0.05, high: float = 2.0) -> Any:
    return message_type("sensor_msgs/msg/Range")(
        header=header(stamp),
        radiation_type=0,
        field_of_view=0.1,
        min_range=low,
        max_range=high,
        range=value,
        variance=4e-6,
    )


def nose_up(angle: float) -> tuple[float, float, float, float]:
    """Quaternion of a vehicle that climbs by an angle (rad): a turn about y is nose down."""
    return 0.0, math.sin(-angle / 2), 0.0, math.cos(angle / 2)


def imu(stamp: int, climb: float | None, felt: tuple[float, float, float]) -> Any:
    """climb: rad, None: it has no orientation; felt: specific force, m/s^2."""
    names = dict(zip("xyzw", nose_up(climb or 0.0), strict=True))
    covariance = np.zeros(9)
    if climb is None:
        covariance[0] = -1.0
    return message_type("sensor_msgs/msg/Imu")(
        header=header(stamp, "base_link"),
        orientation=message_type("geometry_msgs/msg/Quaternion")(**names),
        orientation_covariance=covariance,
        angular_velocity=vector(),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*felt),
        linear_acceleration_covariance=np.zeros(9),
    )


class Fed:
    """A pipeline that messages are given to one by one, as a node's callbacks would."""

    def __init__(self, **changes: object) -> None:
        self.settings = settings_from({**ONE_WHEEL, **changes})
        self.pipeline = Pipeline(self.settings.onboard)
        self.topics = {topic.name: topic for topic in topics_of(self.settings)}
        self._decoders = {
            name: Decoder(typestore(), topic.type) for name, topic in self.topics.items()
        }

    def give(self, name: str, message: Any, now: int = 0) -> None:
        """Give a message of a topic. now: what the clock says, ns; 0: there is none."""
        raw = bytes(typestore().serialize_cdr(message, self.topics[name].type))
        chunk: list[Message] = [(name, raw, now)]
        feed(self.pipeline, self.topics, self._decoders, chunk)

    def turns(self, *, last: bool = False) -> Iterator[Turn]:
        """As the pipeline's."""
        return self.pipeline.turns(last=last)

    def rest(self) -> tuple[Readings, Estimates]:
        """Rows and estimates of all that has come."""
        turns = list(self.turns(last=True))
        return (
            Readings.joined([turn.readings for turn in turns]),
            Estimates.joined([turn.estimates for turn in turns]),
        )

    @property
    def counts(self) -> dict[tuple[str, str], int]:
        """How many messages were not used, or not wholly, by stream and reason."""
        return dict(self.pipeline.problems)
