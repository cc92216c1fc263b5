# SPDX-License-Identifier: Apache-2.0
"""The bag of a simulated drive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from smallwheel_ros.bags import BagMessage, BagWriter, Message, Storage, header
from smallwheel_ros.simulate.drive import Drive
from smallwheel_ros.simulate.sensors import Integers
from smallwheel_ros.simulate.truth import Array

# Shortest and typical further delay between measurement and recording (s).
_DELAYS = {
    "load": (0.002, 0.002),
    "sinkage": (0.055, 0.015),
    "odom": (0.015, 0.005),
    "joint_states": (0.002, 0.001),
    "imu": (0.002, 0.001),
}
Fields = Iterator[dict[str, Any]]  # fields of each message but the header


def write_drive_bag(drive: Drive, path: Path | str, *, storage: Storage = "mcap") -> int:
    """Write the drive's readings as a bag in a new folder; return the number of messages.

    Topics: ``/<wheel>/load`` (geometry_msgs/WrenchStamped, 50 Hz: force.z positive when the soil
    pushes the wheel up, force.x the newest drawbar pull), ``/<wheel>/sinkage``
    (smallwheel_ros/WheelSinkage, 10 Hz), ``/odom`` (nav_msgs/Odometry, 30 Hz, not from the wheels),
    ``/joint_states`` (sensor_msgs/JointState, 50 Hz, joints named ``<wheel>_joint``, effort in N m at
    the wheel, and ``<wheel>_steering_joint`` of wheels that steer) and ``/imu`` (sensor_msgs/Imu, 50 Hz,
    in base_link). Messages are recorded some milliseconds after the instant in their header.

    The folder appears when the bag is complete. A progress bar is shown on a terminal.

    Parameters
    ----------
    drive
        A simulated drive.
    path
        New folder of the bag.
    storage
        Format of the bag, `mcap` or `sqlite3`.

    Returns
    -------
    int
        Number of messages written.

    Raises
    ------
    BagError
        If the folder exists, its parent does not, or it cannot be written.
    """
    with BagWriter(path, storage=storage) as writer:
        # Header stamps and log times do not depend on the order of topics here; ties do.
        messages = sorted(_messages(drive, recorded(drive)), key=lambda m: (m.log_time, m.topic))
        for m in tqdm(messages, "writing the bag", unit=" messages", disable=None, leave=False):
            writer.write(*m)
    return len(messages)


def recorded(drive: Drive) -> dict[str, Integers]:
    """Draw the times at which the messages of each topic are recorded, shortly after their stamps.

    Returns them by topic without its leading slash: ns since 1970, shape (messages,), rising.
    """
    names = [wheel.name for wheel in drive.rover.wheels]
    streams = {f"{name}/{what}": what for name in names for what in ("load", "sinkage")}
    found = {}
    for number, (topic, kind) in enumerate({**streams, "odom": "odom", "imu": "imu"}.items()):
        found[topic] = _delayed(drive, drive.rows[topic][0], kind, number)
    stamps, _ = drive.rows[f"{names[0]}/wheel_speed"]
    return found | {"joint_states": _delayed(drive, stamps, "joint_states", len(found))}


def _delayed(drive: Drive, stamps: Integers, kind: str, number: int) -> Integers:
    shortest, more = _DELAYS[kind]
    rng = np.random.default_rng([drive.settings.seed, 9, number])
    delay = 1e9 * (shortest + rng.exponential(more, stamps.size))
    return np.maximum.accumulate(stamps + np.round(delay).astype(np.int64))


def _messages(drive: Drive, log_times: Mapping[str, Integers]) -> Iterator[BagMessage]:
    names = [wheel.name for wheel in drive.rover.wheels]
    kinds = [("load", "geometry_msgs/msg/WrenchStamped", _loads)]
    kinds += [("sinkage", "smallwheel_ros/msg/WheelSinkage", _sinkages)]
    topics = {
        f"{name}/{what}": (kind, name, drive.rows[f"{name}/{what}"][0], made(drive, name))
        for name in names
        for what, kind, made in kinds
    }
    topics["odom"] = "nav_msgs/msg/Odometry", "odom", drive.rows["odom"][0], _odometry(drive)
    stamps, _ = drive.rows[f"{names[0]}/wheel_speed"]
    topics["joint_states"] = "sensor_msgs/msg/JointState", "", stamps, _joints(drive, names)
    topics["imu"] = "sensor_msgs/msg/Imu", "base_link", drive.rows["imu"][0], _imu(drive)
    for topic, (kind, frame, stamps, each) in topics.items():
        times = zip(stamps.tolist(), log_times[topic].tolist(), each, strict=True)
        for stamp, log_time, fields in times:
            message = Message(header=header(stamp, frame), **fields)
            yield BagMessage(f"/{topic}", kind, log_time, message)


def _vector(x: float, y: float, z: float) -> Message:
    return Message(x=float(x), y=float(y), z=float(z))


def _orientations(roll: Array, pitch: Array, yaw: Array) -> list[Message]:
    """Quaternions of angles (rad, (rows,)), by REP 103: roll lifts the left side, pitch lowers the nose."""
    turned: Array = Rotation.from_euler("xyz", np.stack([roll, pitch, yaw], axis=1)).as_quat()
    return [Message(x=x, y=y, z=z, w=w) for x, y, z, w in turned.tolist()]


def _covariance(*variances: float) -> Array:
    """A diagonal covariance, row-major, each variance three times: shape (9,) for one, (36,) for two."""
    return np.diag(np.repeat(variances, 3)).ravel()


_POSE = _covariance(0.02**2, 0.002**2)
_ANGLE, _RATE, _FELT = (_covariance(deviation**2) for deviation in (6e-3, 5e-3, 0.1))


def _integral(rates: Array, stamps: Integers) -> Array:
    """Integrate rates (1/s) over stamps (ns) from 0; each rate holds since the stamp before it. (rows,)."""
    return np.cumsum(rates * np.diff(stamps, prepend=stamps[:1])) / 1e9


def _loads(drive: Drive, name: str) -> Fields:
    stamps, loads = drive.rows[f"{name}/load"]
    told, pulls = drive.rows[f"{name}/drawbar_pull"]
    newest = np.maximum(np.searchsorted(told, stamps, side="right") - 1, 0)
    for pull, load in zip(pulls[newest, 0], loads[:, 0], strict=True):
        force = _vector(pull, 0.0, load)
        yield {"wrench": Message(force=force, torque=_vector(0.0, 0.0, 0.0))}


def _sinkages(drive: Drive, name: str) -> Fields:
    for sinkage, variance in drive.rows[f"{name}/sinkage"][1].tolist():
        yield {"sinkage": sinkage, "variance": variance}


def _joints(drive: Drive, names: list[str]) -> Fields:
    of = {
        what: np.column_stack([drive.rows[f"{name}/{what}"][1][:, 0] for name in names])
        for what in ("wheel_speed", "torque")
    }
    stamps, _ = drive.rows[f"{names[0]}/wheel_speed"]
    turned = np.column_stack([_integral(speed, stamps) for speed in of["wheel_speed"].T])
    steered = [wheel.name for wheel in drive.rover.wheels if wheel.steered]
    joints = [f"{name}_joint" for name in names] + [f"{name}_steering_joint" for name in steered]
    if steered:
        angles = np.column_stack([drive.rows[f"{name}/steering"][1][:, 0] for name in steered])
        turned = np.hstack([turned, angles])
        rates = np.gradient(angles, stamps / 1e9 - stamps[0] / 1e9, axis=0)
        of["wheel_speed"] = np.hstack([of["wheel_speed"], rates])
        of["torque"] = np.hstack([of["torque"], np.zeros_like(angles)])
    for position, velocity, effort in zip(turned, of["wheel_speed"], of["torque"], strict=True):
        states = {"position": position, "velocity": velocity, "effort": effort}
        yield {"name": joints, **states}


def _odometry(drive: Drive) -> Fields:
    stamps, rows = drive.rows["odom"]
    pitch, roll = rows[:, 8:10].T
    orientations = _orientations(roll, pitch, np.arctan2(rows[:, 5], rows[:, 4]))
    heights = _integral(-rows[:, 0] * np.sin(pitch), stamps)
    for row, z, orientation in zip(rows, heights, orientations, strict=True):
        speed, rate, x, y = row[:4]
        pose = Message(position=_vector(x, y, z), orientation=orientation)
        aside = row[10] if row.size > 10 else 0.0
        twist = Message(linear=_vector(speed, aside, 0.0), angular=_vector(0.0, 0.0, rate))
        yield {
            "child_frame_id": "base_link",
            "pose": Message(pose=pose, covariance=_POSE),
            "twist": Message(twist=twist, covariance=_covariance(*row[6:8])),
        }


def _imu(drive: Drive) -> Fields:
    stamps, rows = drive.rows["imu"]
    ahead, left, up = rows[:, 4:7].T
    yaw = _integral(rows[:, 0], stamps)
    orientations = _orientations(np.arctan2(left, up), -np.arcsin(ahead), yaw)
    for (rate, *felt), orientation in zip(rows[:, :4], orientations, strict=True):
        yield {
            "orientation": orientation,
            "orientation_covariance": _ANGLE,
            "angular_velocity": _vector(0.0, 0.0, rate),
            "angular_velocity_covariance": _RATE,
            "linear_acceleration": _vector(*felt),
            "linear_acceleration_covariance": _FELT,
        }
