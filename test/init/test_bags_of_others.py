# SPDX-License-Identifier: Apache-2.0
"""Joint states of other robots: `init` names what is wrong, and a replay shows no slip that is none.

One made drive of 15 s, whose rims run 1.1 times the way of the odometry: slip is 0.09 everywhere. Each case
changes its joint states, and nothing else.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "onboard"))
import robots

import smallwheel_ros as sw
from smallwheel_ros.bags import BagWriter, message_type
from smallwheel_ros.cli import main

RADIUS, SLIP = 0.1, 0.1 / 1.1
NAMES = [f"{wheel}_joint" for wheel in robots.CORNERS]


class States(NamedTuple):
    """Joint states: names, and position, velocity and effort, as their message has them."""

    names: list[str]
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


Change = Callable[[int, States], list[States]]
NONE = np.empty(0)


def drive(target: Path, change: Change) -> Path:
    """Joint states at 50 Hz, and an odometry, an imu."""
    time_type, header = (
        message_type("builtin_interfaces/msg/Time"),
        message_type("std_msgs/msg/Header"),
    )
    joints, imu, odometry = (
        message_type(kind)
        for kind in ("sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry")
    )
    kinds = (
        "Vector3",
        "Pose",
        "PoseWithCovariance",
        "Twist",
        "TwistWithCovariance",
        "Point",
        "Quaternion",
    )
    vector, pose, with_pose, twist, with_twist, point, turned = (
        message_type(f"geometry_msgs/msg/{kind}") for kind in kinds
    )
    still, upright = vector(x=0.0, y=0.0, z=0.0), turned(x=0.0, y=0.0, z=0.0, w=1.0)
    rng = np.random.default_rng(0)
    place, angle = 0.0, np.zeros(4)
    with BagWriter(target) as writer:
        for i in range(750):
            at = 1_700_000_000 * 10**9 + i * 20_000_000
            head = header(stamp=time_type(sec=at // 10**9, nanosec=at % 10**9), frame_id="odom")
            speed = min(max(0.02 * i - 2.0, 0.0), 1.0) * (0.3 + 0.1 * math.sin(0.05 * i))
            rates = 1.1 * speed / RADIUS * (1.0 + 0.01 * rng.standard_normal(4))
            for states in change(i, States(NAMES, angle.copy(), rates, np.ones(4))):
                message = joints(head, *states)
                writer.write("/joint_states", "sensor_msgs/msg/JointState", at, message)
            angle += 0.02 * rates
            felt = vector(x=0.0, y=0.0, z=9.81)
            none = np.array([-1.0, *np.zeros(8)])
            writer.write(
                "/imu", "sensor_msgs/msg/Imu", at, imu(head, upright, none, still, none, felt, none)
            )
            place += 0.02 * speed
            there = with_pose(pose(point(x=place, y=0.0, z=0.0), upright), np.zeros(36))
            shown = speed * (1.0 + 0.02 * rng.standard_normal())
            moves = with_twist(twist(vector(x=shown, y=0.0, z=0.0), still), np.zeros(36))
            writer.write(
                "/odom", "nav_msgs/msg/Odometry", at, odometry(head, "base_link", there, moves)
            )
    return target


def times(factor: float) -> Change:
    return lambda _, s: [s._replace(velocity=factor * s.velocity)]


def with_zeros(*, first: bool, velocity: bool) -> Change:
    """A second publisher that knows the joints' names alone."""

    def change(_: int, states: States) -> list[States]:
        zero = np.zeros(4)
        idle = States(NAMES, zero, zero if velocity else NONE, zero if velocity else NONE)
        return [idle, states] if first else [states, idle]

    return change


def with_an_arm(i: int, states: States) -> list[States]:
    """Joints of an arm before those of the wheels, in an order that changes; effort is NaN."""
    order = [*range(6)] if i % 2 else [*range(6)][::-1]
    names = ["joint2", "gripper", *states.names]
    columns = (np.concatenate([[math.nan, 0.68], c]) for c in states[1:3])
    position, velocity = (column[order] for column in columns)
    return [States([names[k] for k in order], position, velocity, np.full(6, math.nan))]


def wrapped(_: int, states: States) -> list[States]:
    """Positions alone, that begin anew at each turn."""
    return [States(NAMES, np.remainder(states.position, math.tau), NONE, NONE)]


# What is done to the joint states; what `init` says of it; whether slip is known by a replay.
CASES: dict[str, tuple[Change, str, bool]] = {
    "as it should be": (times(1.0), "", True),
    "velocity 0": (times(0.0), "its velocity is missing or always 0: its speed is the difference", True),
    "positions alone": (wrapped, "its velocity is missing or always 0", True),
    "degrees alone": (
        lambda _, s: [States(NAMES, np.degrees(s.position), NONE, NONE)],
        "63 times the distance by the odometry: in deg (positions)? expected rad", False,
    ),
    "rpm": (times(30.0 / math.pi), "perhaps in rpm: expected rad/s; it will not be used", False),
    "deg/s": (times(180.0 / math.pi), "perhaps in deg/s: expected rad/s; it will not be used", False),
    "m/s": (times(RADIUS), "perhaps in m/s at the rim: expected rad/s; it will not be used", False),
    "rpm without positions": (
        lambda _, s: [States(NAMES, NONE, 30.0 / math.pi * s.velocity, NONE)],
        "10.5 times the distance by the odometry: in rpm? expected rad", False,
    ),
    "m/s without positions": (
        lambda _, s: [States(NAMES, NONE, RADIUS * s.velocity, NONE)],
        "0.11 times the distance by the odometry: in turns/s or m/s at the rim? expected rad", False,
    ),
    "zeros after": (with_zeros(first=False, velocity=True), "", True),
    "zeros before": (with_zeros(first=True, velocity=True), "", True),
    "positions of zero": (with_zeros(first=True, velocity=False), "", True),
    "an arm, and effort NaN": (with_an_arm, "", True),
}  # fmt: skip
ODD = ("perhaps", "times the distance", "difference of")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags")
    body = f"cylinder radius='{RADIUS}' length='0.08'"
    (path / "robot.urdf").write_text(robots.four(body=body))
    return path


def smallwheel(*arguments: Any) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("name", CASES)
def test_joint_states_of_other_robots(name: str, folder: Path) -> None:
    change, words, known = CASES[name]
    called = name.replace("/", " per ")
    bag, config = drive(folder / called, change), folder / f"{called}.yaml"
    said = smallwheel("init", bag, "--urdf", folder / "robot.urdf", "-o", config)
    assert words in said
    assert words or not any(odd in said for odd in ODD)
    config.write_text(config.read_text().replace("FILL_IN", "24.0"))
    if "without positions" in name or name == "degrees alone":
        return  # a replay cannot tell: `init` has named it
    out = folder / f"{called} out"
    sw.replay(bag, config, out, copy="none")  # no page, which takes longest
    rows = pd.read_csv(out / "estimates.csv")
    slip = rows["slip"].dropna()
    share = slip.size / len(rows)
    if known:
        late = slip[len(rows) // 4 :]
        assert share > 0.5
        assert abs(float(late.median()) - SLIP) < 0.02
    else:
        assert share < 0.03  # until a joint has turned by 0.05 rad nothing tells
    summary = json.loads((out / "replay.json").read_text())
    reasons = {drop["reason"] for drop in summary["not_used"]}
    assert ("velocity_unit" in reasons) == (not known)


@pytest.mark.parametrize("name", ["zeros before", "zeros after"])
def test_half_of_the_messages_of_two_publishers_are_refused(name: str, folder: Path) -> None:
    out = folder / f"{name} out" / "replay.json"
    if not out.is_file():
        test_joint_states_of_other_robots(name, folder)
    summary = json.loads(out.read_text())
    refused = [drop for drop in summary["not_used"] if drop["stream"] == "front_left/wheel_speed"]
    assert sum(drop["count"] for drop in refused) == pytest.approx(750, rel=0.1)
    assert {drop["reason"] for drop in refused} <= {"no_value", "duplicate"}
    assert all("publisher" in drop["example"] for drop in refused)


def test_an_odometry_that_looks_back_shows_no_slip_and_warns_of_nothing(folder: Path) -> None:
    """Which of the two looks back, odometry or all joints, nobody can tell: from the first metre on."""

    def against(_: int, states: States) -> list[States]:
        return [states._replace(position=-states.position, velocity=-states.velocity)]

    bag, config, out = drive(folder / "back", against), folder / "back.yaml", folder / "back out"
    assert "the odometry looks back" in smallwheel(
        "init", bag, "--urdf", folder / "robot.urdf", "-o", config
    )
    config.write_text(config.read_text().replace("FILL_IN", "24.0"))
    said = smallwheel("replay", bag, "--config", config, "-o", out, "--copy", "none")
    assert "No warning of getting stuck" in said
    assert "all wheels turn against the travel" in said
    rows = pd.read_csv(out / "estimates.csv")
    unknown = rows[rows["time"] > 3.5]  # it has gone 0.05 m by then
    assert unknown["slip"].isna().all()
    # Before that it goes backward, as far as anybody can tell: nothing is learnt of it.
    vehicle = pd.read_csv(out / "vehicle.csv")
    assert vehicle["margin"].nunique() == 1
    assert vehicle["level"].max() == 1
    costs = (out / "cost_map.pgm").read_bytes()[-20 * 20 :]
    assert {*costs} <= {0, 255}
    assert unknown["status_text"].str.contains("goes backward|odom is doubted").all()


def test_a_damaged_bag_with_few_joint_states_is_set_up_from_what_it_holds(folder: Path) -> None:
    def few(i: int, states: States) -> list[States]:
        return [states] if i % 50 == 0 else []

    bag = drive(folder / "damaged", few)
    inside = next(bag.glob("*.mcap"))
    os.truncate(inside, int(inside.stat().st_size * 0.9))
    config = folder / "damaged.yaml"
    smallwheel("init", bag, "--urdf", folder / "robot.urdf", "-o", config)
    assert all(f"{wheel}:" in config.read_text() for wheel in robots.CORNERS)
