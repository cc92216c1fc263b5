# SPDX-License-Identifier: Apache-2.0
"""Write a simulated drive as the rosbag2 bag that the rover would have recorded.

Topics: ``/<wheel>/load`` (geometry_msgs/WrenchStamped, 50 Hz: force.z positive when the soil pushes
the wheel up, force.x what it pushes the wheel forward with), ``/<wheel>/sinkage``
(smallwheel_ros/WheelSinkage, 10 Hz), ``/odom`` (nav_msgs/Odometry, 30 Hz, not from the wheels),
``/joint_states`` (sensor_msgs/JointState, 50 Hz, joints named ``<wheel>_joint``, effort in N m at the
wheel) and ``/imu`` (sensor_msgs/Imu, 50 Hz, in base_link). Messages are recorded some milliseconds after
the instant in their header.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from smallwheel_ros.bags import BagWriter, Message, Storage, header
from smallwheel_ros.simulate.contact import Array
from smallwheel_ros.simulate.drive import Drive
from smallwheel_ros.simulate.sensors import (
    ImuReadings,
    JointReadings,
    LoadReadings,
    OdometryReadings,
    Readings,
    SinkageReadings,
)

LOAD = "geometry_msgs/msg/WrenchStamped"
SINKAGE = "smallwheel_ros/msg/WheelSinkage"
ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"


class _Recorded(NamedTuple):
    log_time: int
    topic: str
    kind: str
    message: Any


def write_drive_bag(drive: Drive, path: Path | str, *, storage: Storage = "mcap") -> int:
    """Write the drive's readings as a bag in a new folder; return the number of messages.

    The folder appears when the bag is complete. A progress bar is shown on a terminal.

    Raises
    ------
    BagError
        If the folder exists, its parent does not, or it cannot be written.
    """
    with BagWriter(path, storage=storage) as writer:
        # Header stamps and log times do not depend on the order of topics here; ties do.
        messages = sorted(_messages(drive), key=lambda m: (m.log_time, m.topic))
        for m in tqdm(messages, "writing the bag", unit=" messages", disable=None, leave=False):
            writer.write(m.topic, m.kind, m.log_time, m.message)
    return len(messages)


def _times(readings: Readings) -> Iterator[tuple[int, int]]:
    """Give the stamp and the time of recording (ns) of each reading."""
    return zip(readings.stamp.tolist(), readings.log_time.tolist(), strict=True)


def _messages(drive: Drive) -> Iterator[_Recorded]:
    for wheel in drive.rover.wheels:
        yield from _loads(wheel.name, drive.load[wheel.name])
        yield from _sinkages(wheel.name, drive.sinkage[wheel.name])
    yield from _odometry(drive.odometry)
    yield from _joints([f"{w.name}_joint" for w in drive.rover.wheels], drive.joints)
    yield from _imu(drive.imu)


def _vector(x: float, y: float, z: float) -> Message:
    return Message(x=float(x), y=float(y), z=float(z))


def _loads(wheel: str, readings: LoadReadings) -> Iterator[_Recorded]:
    torque = _vector(0.0, 0.0, 0.0)
    for i, (stamp, log_time) in enumerate(_times(readings)):
        wrench = Message(force=_vector(readings.pull[i], 0.0, readings.normal[i]), torque=torque)
        message = Message(header=header(stamp, wheel), wrench=wrench)
        yield _Recorded(log_time, f"/{wheel}/load", LOAD, message)


def _sinkages(wheel: str, readings: SinkageReadings) -> Iterator[_Recorded]:
    for i, (stamp, log_time) in enumerate(_times(readings)):
        message = Message(
            header=header(stamp, wheel),
            sinkage=float(readings.sinkage[i]),
            variance=float(readings.variance[i]),
        )
        yield _Recorded(log_time, f"/{wheel}/sinkage", SINKAGE, message)


def _quaternion(roll: float, pitch: float, yaw: float) -> Message:
    """Orientation of REP 103's fixed-axis roll, pitch, yaw (rad)."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a / 2), np.cos(a / 2)) for a in (roll, pitch, yaw))
    return Message(
        x=float(sr * cp * cy - cr * sp * sy),
        y=float(cr * sp * cy + sr * cp * sy),
        z=float(cr * cp * sy - sr * sp * cy),
        w=float(cr * cp * cy + sr * sp * sy),
    )


def _covariance(*deviations: float) -> Array:
    """Row-major, three of each standard deviation: 6x6 of positions (m) and angles (rad), or 3x3."""
    return np.diag(np.repeat(np.square(deviations), 3)).ravel()


def _odometry(readings: OdometryReadings) -> Iterator[_Recorded]:
    pose_covariance, twist_covariance = _covariance(0.02, 0.002), _covariance(0.008, 0.005)
    for i, (stamp, log_time) in enumerate(_times(readings)):
        pose = Message(
            position=_vector(readings.x[i], readings.y[i], readings.z[i]),
            orientation=_quaternion(readings.roll[i], readings.pitch[i], readings.yaw[i]),
        )
        twist = Message(
            linear=_vector(readings.forward_speed[i], 0.0, 0.0),
            angular=_vector(0.0, 0.0, readings.yaw_rate[i]),
        )
        message = Message(
            header=header(stamp, "odom"),
            child_frame_id="base_link",
            pose=Message(pose=pose, covariance=pose_covariance),
            twist=Message(twist=twist, covariance=twist_covariance),
        )
        yield _Recorded(log_time, "/odom", ODOMETRY, message)


def _joints(names: list[str], readings: JointReadings) -> Iterator[_Recorded]:
    for i, (stamp, log_time) in enumerate(_times(readings)):
        message = Message(
            header=header(stamp, ""),
            name=names,
            position=readings.position[i],
            velocity=readings.velocity[i],
            effort=readings.effort[i],
        )
        yield _Recorded(log_time, "/joint_states", JOINTS, message)


def _imu(readings: ImuReadings) -> Iterator[_Recorded]:
    angle, rate, felt = (_covariance(spread) for spread in (6e-3, 3e-3, 0.1))
    for i, (stamp, log_time) in enumerate(_times(readings)):
        message = Message(
            header=header(stamp, "base_link"),
            orientation=_quaternion(readings.roll[i], readings.pitch[i], readings.yaw[i]),
            orientation_covariance=angle,
            angular_velocity=_vector(0.0, 0.0, readings.yaw_rate[i]),
            angular_velocity_covariance=rate,
            linear_acceleration=_vector(*readings.acceleration[i]),
            linear_acceleration_covariance=felt,
        )
        yield _Recorded(log_time, "/imu", IMU, message)
