# SPDX-License-Identifier: Apache-2.0
"""From messages to `Onboard`: which topics there are, and what of each message counts.

A topic reads the values of its streams from a message. Node and replay give messages, those of
rclpy and of rosbags, to `Topic.handle`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, NodeSettings
from smallwheel_ros.onboard.streams import Motion
from smallwheel_ros.onboard.synchroniser import Measured

JOINT_STATES = "joint_states"
_WRENCH = "geometry_msgs/msg/WrenchStamped"
_UPRIGHT = 0.5  # no vehicle drives on 60 degrees
_UNIT = 0.01  # a quaternion's length may differ from 1 by so much


@dataclass(frozen=True)
class Topic:
    """A topic to listen to.

    Attributes
    ----------
    name
        As the parameters have it, to be resolved or remapped.
    type
        Such as ``nav_msgs/msg/Odometry``.
    onboard
        What takes its messages.
    streams
        Streams of the estimate that come by it, each with a word on its part of the message.
    read
        Gives the readings in a message.
    """

    name: str
    type: str
    onboard: Onboard
    streams: dict[str, str]
    read: Callable[[Any], Iterable[Measured]]

    def handle(self, message: Any, now: int | None) -> list[Result]:
        """Take a message, any object with the type's fields; return what it has made ready.

        now: what the clock says (ns), None without a clock.
        """
        stamp = message.header.stamp
        return self.onboard.add(stamp.sec * SECOND + stamp.nanosec, self.read(message), now)


class Feed:
    """Knows the topics of a vehicle, and feeds `Onboard` with their messages.

    topics: one entry for each topic. odometry_frame: frame of the newest odometry, or empty.
    """

    def __init__(self, onboard: Onboard, settings: NodeSettings) -> None:
        self.onboard = onboard
        self.settings = settings
        self.odometry_frame = ""
        # By joint: the stream that its velocity or its effort is of, and the factor to that.
        self._velocities: dict[str, list[tuple[str, float]]] = {}
        self._efforts: dict[str, list[tuple[str, float]]] = {}
        self._joints: tuple[str, ...] = ()  # of the newest joint states
        self._places: tuple[list[tuple[int, str, float]], ...] = ([], [])  # of those among them
        topics = [topic for wheel in settings.inputs for topic in self._of_wheel(wheel)]
        details = {
            stream: f", {what}joint {joint}"
            for what, wanted in (("", self._velocities), ("effort of ", self._efforts))
            for joint, parts in wanted.items()
            for stream, _ in parts
        }
        if details:
            kind = "sensor_msgs/msg/JointState"
            topics.append(Topic(JOINT_STATES, kind, onboard, details, self._joint_states))
        if ODOMETRY in onboard.streams:
            kind = "nav_msgs/msg/Odometry"
            topics.append(Topic(ODOMETRY, kind, onboard, {ODOMETRY: ""}, self._odometry))
        if VELOCITY in onboard.streams:
            name, kind = settings.velocity_topic, "geometry_msgs/msg/TwistStamped"
            topics.append(Topic(name, kind, onboard, {VELOCITY: ""}, self._velocity))
        if IMU in onboard.streams:
            kind = "sensor_msgs/msg/Imu"
            topics.append(Topic(settings.imu_topic, kind, onboard, {IMU: ""}, self._slope))
        self.topics = tuple(topics)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names in the newest joint states."""
        return self._joints

    def _of_wheel(self, wheel: str) -> list[Topic]:
        """Topics of a wheel; what of it comes by joint states is noted."""
        onboard, settings, inputs = self.onboard, self.settings, self.settings.inputs[wheel]
        wrenches: dict[str, list[tuple[str, str, int]]] = {}  # streams, axes of the force, signs
        if settings.load_source == "wrench":
            wrenches[inputs.load_topic] = [(f"{wheel}/load", "z", inputs.load_sign)]
        elif settings.load_source == "joint_states":
            newtons = inputs.load_sign * settings.load_per_effort
            self._efforts.setdefault(inputs.load_joint, []).append((f"{wheel}/load", newtons))
        if f"{wheel}/torque" in onboard.streams:
            geared = inputs.joint_sign * inputs.gear_ratio * inputs.gear_efficiency
            self._efforts.setdefault(inputs.joint, []).append((f"{wheel}/torque", geared))
        if f"{wheel}/drawbar_pull" in onboard.streams:
            pull = (f"{wheel}/drawbar_pull", "x", 1)
            wrenches.setdefault(inputs.drawbar_pull_topic, []).append(pull)
        if f"{wheel}/wheel_speed" in onboard.streams:
            velocity = (f"{wheel}/wheel_speed", inputs.joint_sign)
            self._velocities.setdefault(inputs.joint, []).append(velocity)
        topics = []
        for name, parts in wrenches.items():
            words = {stream: "" if axis == "z" else f", force.{axis}" for stream, axis, _ in parts}
            topics.append(Topic(name, _WRENCH, onboard, words, partial(_forces, parts)))
        stream, name = f"{wheel}/sinkage", inputs.sinkage_topic
        if stream in onboard.streams:
            kind, read = "smallwheel_ros/msg/WheelSinkage", partial(_sinkage, stream)
            if inputs.sinkage_source == "Range":
                kind, read = "sensor_msgs/msg/Range", partial(self._range, wheel)
            topics.append(Topic(name, kind, onboard, {stream: ""}, read))
        return topics

    def _range(self, wheel: str, message: Any) -> Iterable[Measured]:
        """Read the distance to the ground: what the sensor is nearer to it, the wheel is deeper."""
        distance, low, high = message.range, message.min_range, message.max_range
        limited = high > low  # drivers that do not know the limits leave both at 0
        if not math.isfinite(distance) or (limited and not low <= distance <= high):
            text = f"range is {distance:g} m, expected a number from {low:g} to {high:g} m"
            self.onboard.refuse(f"{wheel}/sinkage", "range_out_of_limits", text)
            return ()
        height = self.settings.inputs[wheel].range_height
        assert height is not None
        # Messages before Jazzy have no variance; 0 means "not known".
        return ((f"{wheel}/sinkage", (height - distance, getattr(message, "variance", 0.0))),)

    def _odometry(self, message: Any) -> Iterable[Measured]:
        self.odometry_frame = message.header.frame_id
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        yaw, pitch, roll = angles_of(turn.x, turn.y, turn.z, turn.w)
        if yaw is None:
            text = "the orientation is no unit quaternion: nobody knows where the wheels are"
            self.onboard.problems.add(ODOMETRY, "no_orientation", text, unused=False)
        speed, yaw_rate = message.twist.twist.linear.x, message.twist.twist.angular.z
        # Row by row over x, y, z, and rotation about them; all 0 where nobody filled it in.
        spread = message.twist.covariance
        variances = (float(spread[0]), float(spread[35]))
        moves = place.x, place.y, speed, yaw_rate, yaw, pitch, variances, roll
        return ((ODOMETRY, Motion.of(*moves)),)

    def _velocity(self, message: Any) -> Iterable[Measured]:
        turn, over_ground = self.settings.velocity_yaw, message.twist.linear
        speed = math.cos(turn) * over_ground.x - math.sin(turn) * over_ground.y
        return ((VELOCITY, (speed, message.twist.angular.z, 0.0)),)

    def _slope(self, message: Any) -> Iterable[Measured]:
        """Read what gravity pulls the vehicle back and to the right with, m/s^2.

        Without orientation, all that is felt.
        """
        ahead, aside = math.cos(self.settings.imu_yaw), math.sin(self.settings.imu_yaw)
        felt, turn = message.linear_acceleration, message.orientation
        squares = turn.x * turn.x + turn.y * turn.y + turn.z * turn.z + turn.w * turn.w  # ** raises
        # -1 says "there is none" (sensor_msgs/Imu).
        oriented = abs(squares - 1.0) <= _UNIT and message.orientation_covariance[0] != -1.0
        if oriented:
            up = (
                2.0 * (turn.x * turn.z - turn.w * turn.y),
                2.0 * (turn.y * turn.z + turn.w * turn.x),
                1.0 - 2.0 * (turn.x**2 + turn.y**2),
            )
            felt_x, felt_y = GRAVITY * up[0], GRAVITY * up[1]
        else:
            up = felt.x / GRAVITY, felt.y / GRAVITY, felt.z / GRAVITY
            felt_x, felt_y = felt.x, felt.y
        if not up[2] > _UPRIGHT:
            self.onboard.refuse(
                IMU,
                "imu_not_upright",
                f"of its z axis {up[2]:.2f} is up, expected more than {_UPRIGHT}: it is in another frame"
                " than base_link (publish it in base_link), or has neither orientation nor gravity",
            )
            return ()
        force, across = ahead * felt_x - aside * felt_y, aside * felt_x + ahead * felt_y
        return ((IMU, (force, math.nan, across) if oriented else (math.nan, force, across)),)

    def _joint_states(self, message: Any) -> Iterable[Measured]:
        joints = tuple(message.name)
        if joints != self._joints:  # they hardly ever change
            self._joints = joints
            self._places = tuple(
                [(i, *part) for i, joint in enumerate(joints) for part in wanted.get(joint, ())]
                for wanted in (self._velocities, self._efforts)
            )
        found: list[Measured] = []
        for what, values, places in zip(
            ("velocities", "efforts"), (message.velocity, message.effort), self._places, strict=True
        ):
            count = len(values)
            if count == len(joints):
                found += [(name, (by * float(values[i]),)) for i, name, by in places]
                continue
            text = f"{len(joints)} joints have {count} {what}, expected as many"
            for _, name, _ in places:
                self.onboard.refuse(name, f"no_{what}", text)
        return found


def _forces(parts: Iterable[tuple[str, str, int]], message: Any) -> Iterable[Measured]:
    force = message.wrench.force
    return [(stream, (sign * getattr(force, axis),)) for stream, axis, sign in parts]


def _sinkage(stream: str, message: Any) -> Iterable[Measured]:
    return ((stream, (message.sinkage, message.variance)),)


def angles_of(x: float, y: float, z: float, w: float) -> tuple[float | None, float, float]:
    """Yaw, pitch and roll (rad) of a quaternion; None, 0 and 0 where it has not the length of 1."""
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _UNIT:
        return None, 0.0, 0.0
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    return yaw, pitch, math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
