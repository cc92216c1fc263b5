"""From messages to `Onboard`: which topics there are, and what of each message counts.

A topic says which fields of its messages it reads. Node and replay give messages, those of rclpy and of
rosbags, to `Topic.handle`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from typing import Any

from smallwheel_ros.onboard.arrivals import ODOMETRY, VELOCITY
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.parameters import (
    LoadSource,
    NodeSettings,
    SinkageSource,
    WheelInputs,
)
from smallwheel_ros.onboard.streams import SECOND

JOINT_STATES = "joint_states"
Fields = tuple[Any, ...]
Taker = Callable[[Fields, int | None], list[Result]]

_WRENCH = "geometry_msgs/msg/WrenchStamped"
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_ODOMETRY_FIELDS = (
    *_STAMP,
    "header.frame_id",
    "pose.pose.position.x",
    "pose.pose.position.y",
    *(f"pose.pose.orientation.{part}" for part in "xyzw"),
    "twist.twist.linear.x",
    "twist.twist.angular.z",
    "twist.covariance",
)
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
    streams
        Streams of the estimate that come by it, each with a word on its part of the message.
    fields
        What is read of a message, such as ``header.stamp.sec``.
    take
        Takes the values of these fields, in their order, and what the clock says (ns, None without
        a clock), and returns what they have made ready.
    newer
        Fields that older definitions of the type lack; their values, 0 then, come after the others.
    """

    name: str
    type: str
    streams: dict[str, str]
    fields: tuple[str, ...]
    take: Taker
    newer: tuple[str, ...] = ()

    @cached_property
    def values_of(self) -> Callable[[Any], Fields]:
        """What gives the values for `take`; raises AttributeError where a message lacks a field."""
        needed, newer = attrgetter(*self.fields), self.newer
        if not newer:
            return needed
        return lambda message: (*needed(message), *(getattr(message, n, 0.0) for n in newer))

    def handle(self, message: Any, now: int | None) -> list[Result]:
        """Take a message: any object with the type's fields."""
        return self.take(self.values_of(message), now)


class Feed:
    """Knows the topics of a vehicle, and feeds `Onboard` with their messages.

    topics: one entry for each topic. odometry_frame: frame of the newest odometry, or empty.
    """

    def __init__(self, onboard: Onboard, settings: NodeSettings, odometry_frame: str = "") -> None:
        self.onboard = onboard
        self.settings = settings
        self.odometry_frame = odometry_frame
        self._by_joint: dict[str, str] = {}  # wheel speed
        self._by_load_joint: dict[str, str] = {}
        self._joints: tuple[str, ...] = ()  # of the newest joint states
        self._speeds_at: list[tuple[int, str]] = []  # among them, and whose it is
        self._loads_at: list[tuple[int, str]] = []
        self.topics: tuple[Topic, ...] = tuple(self._topics())

    def _topics(self) -> list[Topic]:
        streams, settings = self.onboard.streams, self.settings
        topics: list[Topic] = []
        joints: dict[str, str] = {}
        for wheel, inputs in settings.inputs.items():
            pulled = f"{wheel}/drawbar_pull" in streams
            if settings.load_source is LoadSource.WRENCH:
                both = pulled and inputs.drawbar_pull_topic == inputs.load_topic
                pulled = pulled and not both
                topics.append(
                    Topic(
                        inputs.load_topic,
                        _WRENCH,
                        {f"{wheel}/load": ""}
                        | ({f"{wheel}/drawbar_pull": ", force.x"} if both else {}),
                        (*_STAMP, "wrench.force.z", *(("wrench.force.x",) if both else ())),
                        partial(self._on_both if both else self._on_load, wheel),
                    )
                )
            elif settings.load_source is LoadSource.JOINT_STATES:
                self._by_load_joint[inputs.load_joint] = wheel
                joints[f"{wheel}/load"] = f", effort of joint {inputs.load_joint}"
            if pulled:
                topics.append(
                    Topic(
                        inputs.drawbar_pull_topic,
                        _WRENCH,
                        {f"{wheel}/drawbar_pull": ", force.x"},
                        (*_STAMP, "wrench.force.x"),
                        partial(self._on_pull, wheel),
                    )
                )
            if f"{wheel}/wheel_speed" in streams:
                self._by_joint[inputs.joint] = wheel
                joints[f"{wheel}/wheel_speed"] = f", joint {inputs.joint}"
            if f"{wheel}/sinkage" in streams:
                topics.append(self._sinkage_topic(wheel, inputs))
        if joints:
            kind = "sensor_msgs/msg/JointState"
            arrays = (*_STAMP, "name", "velocity", "effort")
            topics.append(Topic(JOINT_STATES, kind, joints, arrays, self._on_joint_states))
        if ODOMETRY in streams:
            kind = "nav_msgs/msg/Odometry"
            topics.append(
                Topic(ODOMETRY, kind, {ODOMETRY: ""}, _ODOMETRY_FIELDS, self._on_odometry)
            )
        if VELOCITY in streams:
            kind = "geometry_msgs/msg/TwistStamped"
            fields = (*_STAMP, "twist.linear.x", "twist.linear.y", "twist.angular.z")
            name = settings.velocity_topic
            topics.append(Topic(name, kind, {VELOCITY: ""}, fields, self._on_velocity))
        return topics

    def _sinkage_topic(self, wheel: str, inputs: WheelInputs) -> Topic:
        name, streams = inputs.sinkage_topic, {f"{wheel}/sinkage": ""}
        if inputs.sinkage_source is SinkageSource.RANGE:
            kind = "sensor_msgs/msg/Range"
            distance = (*_STAMP, "range", "min_range", "max_range")
            take = partial(self._on_range, wheel)
            # Messages before Jazzy have no variance; 0 means "not known".
            return Topic(name, kind, streams, distance, take, newer=("variance",))
        kind, fields = "smallwheel_ros/msg/WheelSinkage", (*_STAMP, "sinkage", "variance")
        return Topic(name, kind, streams, fields, partial(self._on_sinkage, wheel))

    def _on_load(self, wheel: str, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, force = values
        load = self.settings.inputs[wheel].load_sign * force
        return self.onboard.on_load(wheel, sec * SECOND + nanosec, load, now=now)

    def _on_pull(self, wheel: str, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, force = values
        return self.onboard.on_drawbar_pull(wheel, sec * SECOND + nanosec, force, now=now)

    def _on_both(self, wheel: str, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, load, pull = values
        found = self._on_pull(wheel, (sec, nanosec, pull), now)
        return found + self._on_load(wheel, (sec, nanosec, load), now)

    def _on_sinkage(self, wheel: str, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, sinkage, variance = values
        return self.onboard.on_sinkage(wheel, sec * SECOND + nanosec, sinkage, variance, now=now)

    def _on_range(self, wheel: str, values: Fields, now: int | None) -> list[Result]:
        """Take the distance to the ground: what the sensor is nearer to it, the wheel is deeper."""
        height = self.settings.inputs[wheel].range_height
        assert height is not None
        sec, nanosec, distance, low, high, variance = values
        limited = high > low  # drivers that do not know the limits leave both at 0
        if not math.isfinite(distance) or (limited and not low <= distance <= high):
            text = f"range is {distance:g} m, expected a number from {low:g} to {high:g} m"
            self.onboard.refuse(f"{wheel}/sinkage", "range_out_of_limits", text)
            return []
        stamp = sec * SECOND + nanosec
        return self.onboard.on_sinkage(wheel, stamp, height - distance, variance, now=now)

    def _on_odometry(self, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, self.odometry_frame, x, y, *orientation, speed, yaw_rate, spread = values
        yaw, pitch = yaw_and_pitch_of(*orientation)
        if yaw is None:
            text = "the orientation is no unit quaternion: nobody knows where the wheels are"
            self.onboard.report(ODOMETRY, "no_orientation", text)
        return self.onboard.on_odometry(
            sec * SECOND + nanosec,
            x,
            y,
            speed,
            yaw_rate,
            yaw,
            pitch=pitch,
            # Row by row over x, y, z, and rotation about them; all 0 where nobody filled it in.
            variances=(float(spread[0]), float(spread[35])),
            now=now,
        )

    def _on_velocity(self, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, ahead, left, yaw_rate = values
        turn = self.settings.velocity_yaw
        speed = math.cos(turn) * ahead - math.sin(turn) * left
        return self.onboard.on_velocity(sec * SECOND + nanosec, speed, yaw_rate, now=now)

    def _on_joint_states(self, values: Fields, now: int | None) -> list[Result]:
        sec, nanosec, names, speeds, efforts = values
        stamp, joints = sec * SECOND + nanosec, tuple(names)
        if joints != self._joints:  # they hardly ever change
            self._joints = joints
            self._speeds_at = _places(joints, self._by_joint)
            self._loads_at = _places(joints, self._by_load_joint)
        results: list[Result] = []
        if self._speeds_at and self._as_many("wheel_speed", "velocities", len(speeds)):
            inputs = self.settings.inputs
            turning = [(w, inputs[w].joint_sign * float(speeds[i])) for i, w in self._speeds_at]
            results += self.onboard.on_wheel_speeds(stamp, turning, now=now)
        if self._loads_at and self._as_many("load", "efforts", len(efforts)):
            for i, wheel in self._loads_at:
                newtons = self.settings.inputs[wheel].load_sign * self.settings.load_per_effort
                results += self.onboard.on_load(wheel, stamp, newtons * float(efforts[i]), now=now)
        return results

    def _as_many(self, what: str, values: str, count: int) -> bool:
        """Whether a message has as many values as joints; counted for each wheel where not."""
        joints = len(self._joints)
        if count != joints:
            text = f"{joints} joints have {count} {values}, expected as many"
            for _, wheel in self._speeds_at if what == "wheel_speed" else self._loads_at:
                self.onboard.refuse(f"{wheel}/{what}", f"no_{values}", text)
        return count == joints


def _places(joints: tuple[str, ...], wheels: dict[str, str]) -> list[tuple[int, str]]:
    """Where among the joints those of wheels are, and the wheels."""
    return [(i, wheels[joint]) for i, joint in enumerate(joints) if joint in wheels]


def yaw_and_pitch_of(x: float, y: float, z: float, w: float) -> tuple[float | None, float]:
    """Yaw and pitch (rad) of a quaternion; None and 0 where it has not the length of 1."""
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _UNIT:
        return None, 0.0
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return yaw, math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
