# SPDX-License-Identifier: Apache-2.0
"""The topics of a vehicle, and functions that turn their messages into rows of streams.

A reader takes the numbers of a topic's messages as columns by path, each of shape (messages, count), and
returns rows of its streams. For a single message the columns have length one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, NodeSettings
from smallwheel_ros.onboard.steering_angle import SteeringReader
from smallwheel_ros.pipeline.tables import Array

from .plausible import FASTEST

Fields = Mapping[str, Array]  # of a topic's messages, (messages, count) each
Rows = dict[str, Array]  # of streams, (messages, width) each; NaN throughout: not to be kept
WRENCH, SINKAGE, RANGE = (
    "geometry_msgs/msg/WrenchStamped", "smallwheel_ros/msg/WheelSinkage", "sensor_msgs/msg/Range",
)  # fmt: skip
JOINTS, ODOM, TWIST, IMU_TYPE = (
    "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped",
    "sensor_msgs/msg/Imu",
)  # fmt: skip
_UNIT = 0.01  # by which a quaternion's squared length may differ from 1


@dataclass(frozen=True)
class Topic:
    """A topic to subscribe to, and the function that reads its messages.

    Attributes
    ----------
    name
        Name of the topic.
    type
        Type of its messages, such as `sensor_msgs/msg/Imu`.
    read
        Function that computes rows from messages. Its arguments are the messages' numbers by path, such as
        `twist.twist.linear.x`, each of shape (messages, count), and the joints' names in joint states, in the
        messages' order (any list for other types). It returns rows by stream, each of shape (messages,
        width), SI units; a row that is NaN throughout is not to be kept.
    streams
        Names of the streams that its messages fill.
    joints
        For joint states: name of the joint that each stream belongs to, by stream.
    """

    name: str
    type: str
    read: Callable[[Fields, list[str]], Rows]
    streams: tuple[str, ...]
    joints: Mapping[str, str] = field(default_factory=dict)


def topics_of(settings: NodeSettings) -> list[Topic]:
    """Return the topics from which the streams of a vehicle are read, each with its reader."""
    streams = set(settings.onboard.streams)
    forces: dict[str, list[tuple[str, str, float]]] = {}
    found: list[Topic] = []
    velocities: dict[str, list[tuple[str, float]]] = {}
    efforts: dict[str, list[tuple[str, float]]] = {}
    angles: dict[str, list[tuple[str, SteeringReader]]] = {}
    steered = settings.onboard.steered
    for wheel, own in settings.inputs.items():
        if settings.load.source == "wrench":
            forces.setdefault(own.load_topic, []).append((f"{wheel}/load", "z", own.load_sign))
        elif settings.load.source == "joint_states":
            newtons = own.load_sign * settings.load.per_effort
            efforts.setdefault(own.load_joint, []).append((f"{wheel}/load", newtons))
        if f"{wheel}/drawbar_pull" in streams:
            forces.setdefault(own.drawbar_pull_topic, []).append(
                (f"{wheel}/drawbar_pull", "x", 1.0)
            )
        if f"{wheel}/torque" in streams:
            geared = own.joint_sign * own.torque_per_effort
            efforts.setdefault(own.joint, []).append((f"{wheel}/torque", geared))
        if f"{wheel}/wheel_speed" in streams:
            turns = (f"{wheel}/wheel_speed", float(own.joint_sign))
            velocities.setdefault(own.joint, []).append(turns)
        if wheel in steered:
            reader = SteeringReader(
                own.steering_sign, own.steering_zero, steered[wheel].linkage, own.lateral_position
            )
            angles.setdefault(own.steering_joint, []).append((f"{wheel}/steering", reader))
        if f"{wheel}/sinkage" in streams:
            kind, read = SINKAGE, _sinkage(wheel)
            if own.range_height is not None:
                kind, read = RANGE, _range(f"{wheel}/sinkage", own.range_height)
            found.append(Topic(own.sinkage_topic, kind, read, (f"{wheel}/sinkage",)))
    for name, parts in forces.items():
        found.append(Topic(name, WRENCH, _force(parts), tuple(part[0] for part in parts)))
    turned = {part[0]: joint for joint, parts in angles.items() for part in parts}
    apart = settings.steering_topic not in ("", settings.joint_states_topic)
    if velocities or efforts or (turned and not apart):
        of = {
            part[0]: joint
            for all_ in (velocities, efforts)
            for joint, parts in all_.items()
            for part in parts
        }
        of |= {} if apart else turned
        read = _joints(velocities, efforts, {} if apart else angles)
        found.append(Topic(settings.joint_states_topic, JOINTS, read, tuple(of), of))
    if turned and apart:
        read = _joints({}, {}, angles)
        found.append(Topic(settings.steering_topic, JOINTS, read, tuple(turned), turned))
    if ODOMETRY in streams:
        read = _odometry_aside if steered else _odometry
        found.append(Topic(settings.odom_topic, ODOM, read, (ODOMETRY,)))
    if VELOCITY in streams:
        read = _velocity_aside if steered else _velocity
        found.append(Topic(settings.velocity_topic, TWIST, read, (VELOCITY,)))
    if IMU in streams:
        found.append(Topic(settings.imu_topic, IMU_TYPE, _imu(settings.imu_yaw), (IMU,)))
    return found


def _force(parts: list[tuple[str, str, float]]) -> Callable[[Fields, list[str]], Rows]:
    return lambda of, _: {stream: sign * of[f"wrench.force.{axis}"] for stream, axis, sign in parts}


def _sinkage(wheel: str) -> Callable[[Fields, list[str]], Rows]:
    return lambda of, _: {f"{wheel}/sinkage": np.hstack([of["sinkage"], of["variance"]])}


def _range(stream: str, height: float) -> Callable[[Fields, list[str]], Rows]:
    """Reader of sinkages (m) from distances to the ground: mounting height less distance.

    A distance at or beyond the sensor's limits is no reading (REP 117): drivers that write no infinity write
    the limit.
    """

    def read(of: Fields, _: list[str]) -> Rows:
        distance, low, high = of["range"], of["min_range"], of["max_range"]
        good = np.isfinite(distance) & ((high <= low) | ((low < distance) & (distance < high)))
        variance = of.get("variance", np.zeros_like(distance))
        return {stream: np.hstack([np.where(good, height - distance, np.nan), variance])}

    return read


def _joints(
    velocities: Mapping[str, list[tuple[str, float]]],
    efforts: Mapping[str, list[tuple[str, float]]],
    angles: Mapping[str, list[tuple[str, SteeringReader]]],
) -> Callable[[Fields, list[str]], Rows]:
    """Reader of joint states: loads and torques from efforts, steering angles from positions, wheel speeds.

    A row of a wheel speed is velocity (rad/s), position (rad), and 1 if the message has velocities, else 0.
    A joint that a message names twice is not read. Arguments: by joint, pairs of a stream and the factor, or
    the reader of its angle.
    """

    def column(of: Fields, name: str, joints: list[str], i: int) -> Array | None:
        values = of.get(name)
        return None if values is None or values.shape[1] != len(joints) else values[:, i : i + 1]

    def read(of: Fields, joints: list[str]) -> Rows:
        found: Rows = {}
        for i, joint in enumerate(joints):
            if joints.count(joint) > 1:
                continue  # which of its values is right is unknown
            effort = column(of, "effort", joints, i)
            if effort is not None:
                for stream, factor in efforts.get(joint, ()):
                    found[stream] = factor * effort
            velocity, position = (column(of, name, joints, i) for name in ("velocity", "position"))
            if position is not None:
                for stream, reader in angles.get(joint, ()):
                    found[stream] = reader.angle(position)
            there = position if velocity is None else velocity
            if there is None:
                continue  # counted by the replay: the joint states have none
            none, has = np.full_like(there, np.nan), np.full_like(there, velocity is not None)
            both = [none if one is None else one for one in (velocity, position)]
            for stream, factor in velocities.get(joint, ()):
                found[stream] = np.hstack([*(factor * one for one in both), has])
        return found

    return read


def angles_of(x: Array, y: Array, z: Array, w: Array) -> tuple[Array, Array, Array, Array]:
    """Compute yaw, pitch and roll of unit quaternions, the yaw as its cosine and sine.

    Parameters
    ----------
    x, y, z, w
        Components of the quaternions, of one shape.

    Returns
    -------
    cosine, sine : ndarray
        Of the yaw, same shape; NaN where the squared length is not 1 within 0.01.
    pitch, roll : ndarray
        Same shape, rad; pitch is positive nose down. 0 where the squared length is not 1 within 0.01.
    """
    unit = np.abs(x * x + y * y + z * z + w * w - 1.0) <= _UNIT
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    turned = np.where(unit, np.cos(yaw), np.nan), np.where(unit, np.sin(yaw), np.nan)
    return *turned, np.where(unit, pitch, 0.0), np.where(unit, roll, 0.0)


def _odometry(of: Fields, _: list[str]) -> Rows:
    pose, twist = "pose.pose.", "twist.twist."
    angles = angles_of(*(of[f"{pose}orientation.{axis}"] for axis in "xyzw"))
    spread = of["twist.covariance"]
    variances = [
        np.where((v > 0.0) & (v < math.inf), v, 0.0) for v in (spread[:, :1], spread[:, 35:])
    ]
    moves = [of[f"{twist}linear.x"], of[f"{twist}angular.z"]]
    moves += [of[f"{pose}position.x"], of[f"{pose}position.y"]]
    return {ODOMETRY: np.hstack([*moves, *angles[:2], *variances, *angles[2:]])}


def _odometry_aside(of: Fields, joints: list[str]) -> Rows:
    """Rows of the odometry with the sideways speed as last column, NaN where that is implausible."""
    aside = of["twist.twist.linear.y"]
    aside = np.where(np.abs(aside) <= FASTEST, aside, np.nan)
    return {ODOMETRY: np.hstack([_odometry(of, joints)[ODOMETRY], aside])}


def _velocity(of: Fields, _: list[str]) -> Rows:
    speed = of["twist.linear.x"]
    return {VELOCITY: np.hstack([speed, of["twist.angular.z"], np.zeros_like(speed)])}


def _velocity_aside(of: Fields, _: list[str]) -> Rows:
    """Rows of the velocity with the sideways speed as last column, NaN where that is implausible."""
    columns = [of[f"twist.{name}"] for name in ("linear.x", "angular.z", "linear.y")]
    columns[2] = np.where(np.abs(columns[2]) <= FASTEST, columns[2], np.nan)
    return {VELOCITY: np.hstack(columns)}


def _imu(yaw: float) -> Callable[[Fields, list[str]], Rows]:
    """Reader of an imu whose x points `yaw` (rad) to the left of the vehicle's.

    A row is yaw rate (rad/s), specific force along x, y, z (m/s^2), unit vector that points up (NaN without
    an orientation) and pitch rate (rad/s, positive nose down), in axes of the vehicle; if z of the imu points
    down, so does z here.
    """
    cosine, sine = math.cos(yaw), math.sin(yaw)

    def turned(x: Array, y: Array) -> tuple[Array, Array]:
        return cosine * x - sine * y, sine * x + cosine * y

    def read(of: Fields, _: list[str]) -> Rows:
        x, y, z, w = (of[f"orientation.{axis}"] for axis in "xyzw")
        ahead, left, above = (of[f"linear_acceleration.{axis}"] for axis in "xyz")
        there = np.abs(x * x + y * y + z * z + w * w - 1.0) <= _UNIT
        there &= of["orientation_covariance"][:, :1] != -1.0  # "there is none" (sensor_msgs/Imu)
        up = *turned(2.0 * (x * z - w * y), 2.0 * (y * z + w * x)), 1.0 - 2.0 * (x * x + y * y)
        known = [np.where(there, axis, np.nan) for axis in up]
        pitch_rate = turned(of["angular_velocity.x"], of["angular_velocity.y"])[1]
        felt = [*turned(ahead, left), above]
        return {IMU: np.hstack([of["angular_velocity.z"], *felt, *known, pitch_rate])}

    return read
