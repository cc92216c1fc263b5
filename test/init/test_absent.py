# SPDX-License-Identifier: Apache-2.0
"""Why a bag gives no topic of a type: each reason with bags in which the others hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from smallwheel_ros.bags import BagReader, BagWriter, message_type
from smallwheel_ros.cli import main
from smallwheel_ros.init.absent import absent, of_transforms

ODOMETRY, JOINTS, TF = (
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/JointState",
    "tf2_msgs/msg/TFMessage",
)


def joint_states(writer: BagWriter, topic: str, names: list[str], turns: bool = True) -> None:
    kind, time = message_type(JOINTS), message_type("builtin_interfaces/msg/Time")
    header = message_type("std_msgs/msg/Header")
    for i in range(50):
        at = 10**18 + i * 20_000_000
        stamp = time(sec=at // 10**9, nanosec=at % 10**9)
        speed = np.full(len(names), 2.0 if turns else 0.0)
        columns = speed * i * 0.02, speed, np.empty(0)
        writer.write(topic, JOINTS, at, kind(header(stamp, ""), names, *columns))


def made(target: Path, *fill: Callable[[BagWriter], object]) -> Path:
    with BagWriter(target) as writer:
        for one in fill:
            one(writer)
    return target


def transforms(writer: BagWriter) -> None:
    writer.write("/tf", TF, 10**18, message_type(TF)(transforms=[]))


def test_each_reason_is_its_own(tmp_path: Path) -> None:
    empty = made(tmp_path / "empty", lambda w: w.add("/odom", ODOMETRY), transforms)
    with BagReader(empty) as reader:
        assert absent(reader, ODOMETRY) == f"no message of /odom ({ODOMETRY})"
        assert absent(reader, JOINTS) == f"no topic of type {JOINTS}"
        assert "/tf may tell the pose, but is not read" in of_transforms(reader)
    other = made(tmp_path / "other", lambda w: joint_states(w, "/a/joint_states", ["wheel"]))
    with BagReader(other) as reader:
        there = f"no topic of type {JOINTS} in the namespace b, but /a/joint_states"
        assert absent(reader, JOINTS, "/b") == there
        assert of_transforms(reader) == ""


def refused(bag: Path, *more: str) -> str:
    result = CliRunner().invoke(
        main, ["init", str(bag), "-o", str(bag.with_suffix(".yaml")), *more]
    )
    assert result.exit_code == 2
    return result.output


@pytest.mark.parametrize(
    ("names", "turns", "words"),
    [
        (["left_wheel", "right_wheel"], False, "none of them turns: left_wheel, right_wheel"),
        (["pan", "tilt"], True, "its joints are pan, tilt"),
        ([], True, "its messages name none"),
        (None, True, f"(no topic of type {JOINTS})"),
    ],
)
def test_why_no_joint_turns_a_wheel(
    names: list[str] | None, turns: bool, words: str, tmp_path: Path
) -> None:
    fill = (
        [transforms]
        if names is None
        else [lambda w: joint_states(w, "/joint_states", names, turns)]
    )
    said = " ".join(refused(made(tmp_path / "bag", *fill)).split())
    assert words in said
    assert "no robot description with wheels" in said


def test_a_description_that_could_not_be_used_is_the_reason(tmp_path: Path) -> None:
    kind = "std_msgs/msg/String"

    def describe(writer: BagWriter) -> None:
        writer.write(
            "/robot_description", kind, 10**18, message_type(kind)(data="<robot name='a'/>")
        )

    bag = made(tmp_path / "bag", describe, lambda w: joint_states(w, "/joint_states", ["a"]))
    said = " ".join(refused(bag).split())
    assert "the robot description is not used: it has no joint" in said
    assert "no robot description with wheels" not in said


def test_a_namespace_that_no_topic_is_in(tmp_path: Path) -> None:
    bag = made(tmp_path / "bag", lambda w: joint_states(w, "/joint_states", ["a"]))
    said = " ".join(refused(bag, "--namespace", "rover").split())
    assert "no topic is in the namespace 'rover', the bag has no namespace" in said
