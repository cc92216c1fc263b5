# SPDX-License-Identifier: Apache-2.0
"""Bags whose sensors are wrong, or exact, through a replay: what is doubted is used no more.

Skid-steered vehicles of 280 kg, written message by message: every rim slips by a tenth, by construction.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import smallwheel_ros as sw
from smallwheel_ros.bags import BagWriter, Message, header

BEGIN = 1_800_000_000  # s
RADIUS, HALF_TRACK, SLIP = 0.3, 0.54, 0.1
WHEELS = {
    "front_left": (1, 1),
    "front_right": (1, -1),
    "rear_left": (-1, 1),
    "rear_right": (-1, -1),
}
JOINTS = [f"{name}_joint" for name in WHEELS]
CONFIG = {
    "vehicle.mass": 280.0, "imu_topic": "/imu/data", "load.source": "static",
    "twist.publish": "true", "twist.rim_delay": 0.0,
}  # fmt: skip
NONE, UNKNOWN = np.zeros(9), np.diag([-1.0, 0.0, 0.0]).ravel()


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Message:
    return Message(x=x, y=y, z=z)


def turned(yaw: float) -> Message:
    return Message(x=0.0, y=0.0, z=float(np.sin(0.5 * yaw)), w=float(np.cos(0.5 * yaw)))


class Bag:
    """Writes a vehicle's messages, stamped as they are recorded."""

    def __init__(self, writer: BagWriter) -> None:
        self.writer = writer

    def joints(self, stamp: int, left: float, right: float) -> None:
        state = Message(
            header=header(stamp, ""), name=JOINTS, position=np.array([]), effort=np.array([]),
            velocity=np.array([left, right, left, right]),
        )  # fmt: skip
        self.writer.write("/joint_states", "sensor_msgs/msg/JointState", stamp, state)

    def imu(self, stamp: int, rate: float, felt: tuple[float, float, float]) -> None:
        message = Message(
            header=header(stamp, "imu"), orientation=turned(0.0), orientation_covariance=UNKNOWN,
            angular_velocity=vector(z=rate), angular_velocity_covariance=NONE,
            linear_acceleration=vector(*felt), linear_acceleration_covariance=NONE,
        )  # fmt: skip
        self.writer.write("/imu/data", "sensor_msgs/msg/Imu", stamp, message)

    def odometry(
        self, stamp: int, pose: tuple[float, float, float], speeds: tuple[float, float]
    ) -> None:
        x, y, yaw = pose
        placed = Message(position=vector(x, y), orientation=turned(yaw))
        twist = Message(linear=vector(speeds[0]), angular=vector(z=speeds[1]))
        covariance = np.zeros(36)
        message = Message(
            header=header(stamp, "odom"), child_frame_id="base_link",
            pose=Message(pose=placed, covariance=covariance),
            twist=Message(twist=twist, covariance=covariance),
        )  # fmt: skip
        self.writer.write("/odom", "nav_msgs/msg/Odometry", stamp, message)


def arcs(path: Path, sign: float) -> None:
    """90 s of arcs at about 1 m/s; odometry and wheels are right, the gyro's rate has a sign."""
    rng = np.random.default_rng(1)
    x = y = yaw = 0.0
    with BagWriter(path) as writer:
        bag = Bag(writer)
        for k in range(1800):
            t, stamp = 0.05 * k, (BEGIN * 1000 + 50 * k) * 10**6
            moves = t > 3.0
            speed, rate = moves * (1.0 + 0.2 * np.sin(t / 7.0)), moves * 0.5 * np.sin(t / 5.0)
            x, y = x + 0.05 * speed * np.cos(yaw), y + 0.05 * speed * np.sin(yaw)
            yaw += 0.05 * rate
            rims = [
                (speed + side * HALF_TRACK * rate) / (1.0 - SLIP) / RADIUS * rng.normal(1.0, 0.002)
                for side in (-1, 1)
            ]
            bag.joints(stamp, *rims)
            felt = rng.normal((0.0, speed * rate, 9.81), 0.05)
            bag.imu(stamp, float(sign * rate + rng.normal(0.0, 0.003)), tuple(felt.tolist()))
            if k % 2 == 0:
                noisy = float(speed + rng.normal(0.0, 0.01)), float(rate + rng.normal(0.0, 0.005))
                bag.odometry(stamp, (float(x), float(y), float(yaw)), noisy)


def one_side_first(path: Path) -> None:
    """Without any noise, nor odometry: at rest for 3 s, the left side for one, then both."""
    with BagWriter(path) as writer:
        bag = Bag(writer)
        for k in range(200):
            t, stamp = 0.05 * k, (BEGIN * 1000 + 50 * k) * 10**6
            bag.joints(stamp, 2.0 * (t >= 3.0), 2.0 * (t >= 4.0))
            bag.imu(stamp, 0.0, (0.0, 0.0, 9.81))


def replayed(bag: Path, folder: Path) -> dict:
    config = folder / "rover.yaml"
    lines = [f"{name}: {value}" for name, value in CONFIG.items()]
    for name, (ahead, left) in WHEELS.items():
        lines += [
            f"{name}.diameter: {2.0 * RADIUS}", f"{name}.width: 0.25", f"{name}.sinkage_topic: ''",
            f"{name}.lateral_position: {HALF_TRACK * left}", f"{name}.joint: {name}_joint",
            f"{name}.longitudinal_position: {0.46 * ahead}",
        ]  # fmt: skip
    head = ["/**:", "  ros__parameters:", f"    wheels: [{', '.join(WHEELS)}]"]
    config.write_text("\n".join([*head, *(f"    {line}" for line in lines)]) + "\n")
    return sw.replay(bag, config, folder / "out", copy="none").to_dict()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_slip_is_right_whichever_sign_the_gyro_has(sign: float, tmp_path: Path) -> None:
    """A wrong gyro is named, once; from there on turning is the odometry's, and bands hold the truth."""
    arcs(tmp_path / "bag", sign)
    summary = replayed(tmp_path / "bag", tmp_path)
    named = [
        event for event in summary["events"] if event["kind"] == "sensor" and "imu" in event["text"]
    ]
    assert len(named) == (sign < 0.0), summary["events"]
    table = pd.read_csv(tmp_path / "out" / "estimates.csv")
    time = table["stamp"] * 1e-9 - BEGIN
    begin = named[0]["time"] if named else 10.0
    late = table[(time > begin + 5.0) & table["slip"].notna()]
    assert len(late) > 1000
    off = late["slip"] - SLIP
    assert np.sqrt((off**2).mean()) < 0.02
    assert (off.abs() <= 1.96 * late["slip_standard_deviation"]).mean() > 0.95


def test_a_side_at_rest_ends_no_replay(tmp_path: Path) -> None:
    """Its slip is not known; the twist is finite to the end, and its deviation positive."""
    one_side_first(tmp_path / "bag")
    replayed(tmp_path / "bag", tmp_path)
    twists = pd.read_csv(tmp_path / "out" / "twists.csv")
    numbers = twists.select_dtypes("number")
    assert len(twists) > 150
    assert np.isfinite(numbers.to_numpy()).all()
    assert (numbers[[name for name in numbers if name.endswith("_var")]] > 0.0).all().all()
