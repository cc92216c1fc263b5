# SPDX-License-Identifier: Apache-2.0
"""The bag of a simulated drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from smallwheel_ros.bags import BagMessage, BagWriter, Message, Storage, header
from smallwheel_ros.simulate.drive import Drive
from smallwheel_ros.simulate.sensors import Readings
from smallwheel_ros.simulate.truth import Array


def write_drive_bag(drive: Drive, path: Path | str, *, storage: Storage = "mcap") -> int:
    """Write the drive's readings as a bag in a new folder; return the number of messages.

    Topics: ``/<wheel>/load`` (geometry_msgs/WrenchStamped, 50 Hz: force.z positive when the soil
    pushes the wheel up, force.x what it pushes the wheel forward with), ``/<wheel>/sinkage``
    (smallwheel_ros/WheelSinkage, 10 Hz), ``/odom`` (nav_msgs/Odometry, 30 Hz, not from the wheels),
    ``/joint_states`` (sensor_msgs/JointState, 50 Hz, joints named ``<wheel>_joint``, effort in N m at
    the wheel) and ``/imu`` (sensor_msgs/Imu, 50 Hz, in base_link). Messages are recorded some
    milliseconds after the instant in their header.

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
            writer.write(*m)
    return len(messages)


def _messages(drive: Drive) -> Iterator[BagMessage]:
    wrench, joint_state = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"
    for wheel in (wheel.name for wheel in drive.rover.wheels):
        yield from _topic(f"/{wheel}/load", wrench, wheel, drive.load[wheel], _load)
        kind = "smallwheel_ros/msg/WheelSinkage"
        yield from _topic(f"/{wheel}/sinkage", kind, wheel, drive.sinkage[wheel], _sinkage)
    yield from _topic("/odom", "nav_msgs/msg/Odometry", "odom", drive.odometry, _odometry)
    names = [f"{wheel.name}_joint" for wheel in drive.rover.wheels]

    def joints(of: Readings, i: int) -> dict[str, Any]:
        states = {"position": of.position[i], "velocity": of.velocity[i], "effort": of.effort[i]}
        return {"name": names, **states}

    yield from _topic("/joint_states", joint_state, "", drive.joints, joints)
    yield from _topic("/imu", "sensor_msgs/msg/Imu", "base_link", drive.imu, _imu)


def _topic(
    topic: str,
    kind: str,
    frame: str,
    readings: Readings,
    fields: Callable[[Readings, int], dict[str, Any]],
) -> Iterator[BagMessage]:
    """Give a topic's messages. fields: those of a reading's message, besides its header."""
    times = zip(readings.stamp.tolist(), readings.log_time.tolist(), strict=True)
    for i, (stamp, log_time) in enumerate(times):
        message = Message(header=header(stamp, frame), **fields(readings, i))
        yield BagMessage(topic, kind, log_time, message)


def _vector(x: float, y: float, z: float) -> Message:
    return Message(x=float(x), y=float(y), z=float(z))


def _orientation(of: Readings, i: int) -> Message:
    return Message(**dict(zip("xyzw", of.orientation[i].tolist(), strict=True)))


def _covariance(*deviations: float) -> Array:
    """Row-major, three of each standard deviation: 6x6 of positions (m) and angles (rad), or 3x3."""
    return np.diag(np.repeat(np.square(deviations), 3)).ravel()


_POSE, _TWIST = _covariance(0.02, 0.002), _covariance(0.008, 0.005)
_ANGLE, _RATE, _FELT = _covariance(6e-3), _covariance(3e-3), _covariance(0.1)


def _load(of: Readings, i: int) -> dict[str, Any]:
    force = _vector(of.pull[i], 0.0, of.normal[i])
    return {"wrench": Message(force=force, torque=_vector(0.0, 0.0, 0.0))}


def _sinkage(of: Readings, i: int) -> dict[str, Any]:
    return {"sinkage": float(of.sinkage[i]), "variance": float(of.variance[i])}


def _odometry(of: Readings, i: int) -> dict[str, Any]:
    position = _vector(of.x[i], of.y[i], of.z[i])
    speed, rate = _vector(of.forward_speed[i], 0.0, 0.0), _vector(0.0, 0.0, of.yaw_rate[i])
    pose = Message(position=position, orientation=_orientation(of, i))
    return {
        "child_frame_id": "base_link",
        "pose": Message(pose=pose, covariance=_POSE),
        "twist": Message(twist=Message(linear=speed, angular=rate), covariance=_TWIST),
    }


def _imu(of: Readings, i: int) -> dict[str, Any]:
    return {
        "orientation": _orientation(of, i),
        "orientation_covariance": _ANGLE,
        "angular_velocity": _vector(0.0, 0.0, of.yaw_rate[i]),
        "angular_velocity_covariance": _RATE,
        "linear_acceleration": _vector(*of.acceleration[i]),
        "linear_acceleration_covariance": _FELT,
    }
