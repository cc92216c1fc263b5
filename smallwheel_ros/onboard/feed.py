"""From messages to `Onboard`: which topics there are, and what of each message counts.

Works with any objects that have the fields of the ROS messages, those of rclpy and of a bag alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from smallwheel_ros.onboard.arrivals import ODOMETRY, VELOCITY
from smallwheel_ros.onboard.onboard import Onboard, Result
from smallwheel_ros.onboard.parameters import LoadSource, NodeSettings, SinkageSource
from smallwheel_ros.onboard.streams import SECOND

JOINT_STATES = "joint_states"
Handler = Callable[[Any, int | None], list[Result]]

_WRENCH = "geometry_msgs/msg/WrenchStamped"
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
    handle
        Takes a message and what the clock says (ns, None without a clock), and returns what it has
        made ready.
    """

    name: str
    type: str
    streams: dict[str, str]
    handle: Handler


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
                        partial(self._on_both if both else self._on_wrench, wheel),
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
                        partial(self._on_pull, wheel),
                    )
                )
            if f"{wheel}/wheel_speed" in streams:
                self._by_joint[inputs.joint] = wheel
                joints[f"{wheel}/wheel_speed"] = f", joint {inputs.joint}"
            if f"{wheel}/sinkage" not in streams:
                continue
            by_range = inputs.sinkage_source is SinkageSource.RANGE
            topics.append(
                Topic(
                    inputs.sinkage_topic,
                    "sensor_msgs/msg/Range" if by_range else "smallwheel_ros/msg/WheelSinkage",
                    {f"{wheel}/sinkage": ""},
                    partial(self._on_range if by_range else self._on_sinkage, wheel),
                )
            )
        if joints:
            kind = "sensor_msgs/msg/JointState"
            topics.append(Topic(JOINT_STATES, kind, joints, self._on_joint_states))
        if ODOMETRY in streams:
            kind = "nav_msgs/msg/Odometry"
            topics.append(Topic(ODOMETRY, kind, {ODOMETRY: ""}, self._on_odometry))
        if VELOCITY in streams:
            kind = "geometry_msgs/msg/TwistStamped"
            topics.append(Topic(settings.velocity_topic, kind, {VELOCITY: ""}, self._on_velocity))
        return topics

    def _on_wrench(self, wheel: str, message: Any, now: int | None) -> list[Result]:
        load = self.settings.load_sign * message.wrench.force.z
        return self.onboard.on_load(wheel, stamp_of(message), load, now=now)

    def _on_pull(self, wheel: str, message: Any, now: int | None) -> list[Result]:
        pull = message.wrench.force.x
        return self.onboard.on_drawbar_pull(wheel, stamp_of(message), pull, now=now)

    def _on_both(self, wheel: str, message: Any, now: int | None) -> list[Result]:
        return self._on_pull(wheel, message, now) + self._on_wrench(wheel, message, now)

    def _on_sinkage(self, wheel: str, message: Any, now: int | None) -> list[Result]:
        return self.onboard.on_sinkage(
            wheel, stamp_of(message), message.sinkage, message.variance, now=now
        )

    def _on_range(self, wheel: str, message: Any, now: int | None) -> list[Result]:
        """Take the distance to the ground: what the sensor is nearer to it, the wheel is deeper."""
        height = self.settings.inputs[wheel].range_height
        assert height is not None
        distance, low, high = message.range, message.min_range, message.max_range
        limited = high > low  # drivers that do not know the limits leave both at 0
        if not math.isfinite(distance) or (limited and not low <= distance <= high):
            text = f"range is {distance:g} m, expected a number from {low:g} to {high:g} m"
            self.onboard.refuse(f"{wheel}/sinkage", "range_out_of_limits", text)
            return []
        # Messages before Jazzy have no variance; 0 means "not known".
        variance = getattr(message, "variance", 0.0)
        return self.onboard.on_sinkage(
            wheel, stamp_of(message), height - distance, variance, now=now
        )

    def _on_odometry(self, message: Any, now: int | None) -> list[Result]:
        self.odometry_frame = message.header.frame_id
        place, twist = message.pose.pose.position, message.twist.twist
        yaw = yaw_of(message.pose.pose.orientation)
        if yaw is None:
            text = "the orientation is no unit quaternion: nobody knows where the wheels are"
            self.onboard.report(ODOMETRY, "no_orientation", text)
        return self.onboard.on_odometry(
            stamp_of(message), place.x, place.y, twist.linear.x, twist.angular.z, yaw, now=now
        )

    def _on_velocity(self, message: Any, now: int | None) -> list[Result]:
        twist = message.twist
        return self.onboard.on_velocity(stamp_of(message), twist.linear.x, twist.angular.z, now=now)

    def _on_joint_states(self, message: Any, now: int | None) -> list[Result]:
        results: list[Result] = []
        stamp, count = stamp_of(message), len(message.name)
        speeds, efforts = message.velocity, message.effort
        for i, joint in enumerate(message.name):
            wheel = self._by_joint.get(joint)
            if wheel is not None:
                if len(speeds) == count:
                    results += self.onboard.on_wheel_speed(wheel, stamp, float(speeds[i]), now=now)
                else:
                    self._refuse_joint(f"{wheel}/wheel_speed", "velocities", count, len(speeds))
            wheel = self._by_load_joint.get(joint)
            if wheel is not None:
                if len(efforts) == count:
                    load = self.settings.load_sign * self.settings.load_per_effort * efforts[i]
                    results += self.onboard.on_load(wheel, stamp, float(load), now=now)
                else:
                    self._refuse_joint(f"{wheel}/load", "efforts", count, len(efforts))
        return results

    def _refuse_joint(self, stream: str, what: str, joints: int, values: int) -> None:
        text = f"{joints} joints have {values} {what}, expected as many"
        self.onboard.refuse(stream, f"no_{what}", text)


def stamp_of(message: Any) -> int:
    """The header's stamp, ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def yaw_of(orientation: Any) -> float | None:
    """Yaw (rad) of a quaternion; None where it has not the length of 1, as one never filled in."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _UNIT:
        return None
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
