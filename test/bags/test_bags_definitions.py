# SPDX-License-Identifier: Apache-2.0
"""Bags that define types otherwise than this package: said, and the rest goes on."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner
from rosbags.convert.converter import migrate_bytes
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from smallwheel_ros.bags import BagReader, typestore
from smallwheel_ros.cli import main
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

SINKAGE = "smallwheel_ros/msg/WheelSinkage"
SEPARATOR = "=" * 80 + "\n"
HEADER = (
    f"{SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
WHEEL = "std_msgs/Header header\nfloat64 sinkage\nfloat64 variance\n" + HEADER


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive"
    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=3.0)), path)
    return path


@pytest.fixture(scope="module")
def rover(repository) -> Path:
    return repository / "config" / "four_wheels.yaml"


def replayed(bag: Path, rover: Path, folder: Path, code: int) -> str:
    arguments = ["replay", str(bag), "--config", str(rover), "-o", str(folder), "--copy", "none"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == code, (result.output, result.exception)
    return result.stderr


def redefined(bag: Path, target: Path, kind: str, text: str) -> Path:
    """The messages of a bag as they are, with another definition of one type."""
    writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
    with BagReader(bag) as reader, writer:
        connections = {}
        for topic in reader.topics:
            options = {"typestore": typestore()}
            if topic.type == kind:
                options = {"msgdef": text, "rihs01": "RIHS01_" + "0" * 64}
            connections[topic.name] = writer.add_connection(topic.name, topic.type, **options)
        for raw in reader.raw_messages():
            writer.write(connections[raw.topic], raw.log_time, raw.data)
    return target


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (WHEEL.replace("float64 sinkage", "string sinkage"), "sinkage is string, expected float64"),
        (WHEEL.replace("string frame_id", "float64 frame_id"),
         "header.frame_id is float64, expected string"),
        (WHEEL.replace("int32 sec", "string sec"), "Time' is already present with"),
        (WHEEL.replace("float64 sinkage", "float64[3] sinkage"),
         "sinkage is float64[3], expected float64"),
        (WHEEL.replace("float64 sinkage", "float64[] sinkage"),
         "sinkage is float64[], expected float64"),
    ],
)  # fmt: skip
def test_an_input_of_another_definition_is_named(drive, rover, tmp_path, text, expected):
    bag = redefined(drive, tmp_path / "bag", SINKAGE, text)
    stderr = replayed(bag, rover, tmp_path / "out", 2)
    assert "nothing can be estimated" in stderr
    assert f"/front_left/sinkage ({SINKAGE}): " in stderr
    assert expected in stderr


def test_without_the_input_of_another_definition_the_rest_goes_on(drive, rover, tmp_path):
    kind = "sensor_msgs/msg/JointState"
    text = "std_msgs/Header header\nstring[] name\nstring velocity\n" + HEADER
    stderr = replayed(redefined(drive, tmp_path / "bag", kind, text), rover, tmp_path / "out", 1)
    assert f"type {kind}: the bag defines it otherwise than here: position is missing" in stderr
    assert (tmp_path / "out" / "estimates.csv").read_text().count("\n") > 100


def test_a_definition_with_more_fields_is_read(drive, rover, tmp_path):
    """A sensor's own version of the message, with a temperature behind it."""
    text = WHEEL.replace("float64 variance\n", "float64 variance\nfloat64 temperature\n")
    target = tmp_path / "bag"
    writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
    with BagReader(drive) as reader, writer:
        connections = {}
        for topic in reader.topics:
            options = {"typestore": typestore()}
            if topic.type == SINKAGE:
                options = {"msgdef": text, "rihs01": "RIHS01_" + "0" * 64}
            connections[topic.name] = writer.add_connection(topic.name, topic.type, **options)
        for raw in reader.raw_messages():
            more = bytes(8) if raw.type == SINKAGE else b""
            writer.write(connections[raw.topic], raw.log_time, raw.data + more)
    replayed(target, rover, tmp_path / "out", 0)


# --- ROS 1: definitions without those of the messages in them


def ros1(bag: Path, target: Path, broken: set[str]) -> Path:
    """Odometry and joint states of a bag as ROS 1 has them; those of some topics lack their parts."""
    old, names = get_typestore(Stores.ROS1_NOETIC), {"/odom", "/joint_states"}
    with BagReader(bag) as reader, Ros1Writer(target) as writer:
        connections = {}
        for topic in reader.topics:
            if topic.name in names:
                text, digest = old.generate_msgdef(topic.type)
                if topic.name in broken:
                    text = text.split("=" * 80)[0].replace("std_msgs/Header", "Header")
                options = {"typestore": old, "msgdef": text, "md5sum": digest}
                connections[topic.name] = writer.add_connection(topic.name, topic.type, **options)
        for raw in reader.raw_messages(names):
            convert = partial(migrate_bytes, typestore(), old, raw.type, raw.type, {})
            data = convert(raw.data, src_is2=True, dst_is2=False)
            writer.write(connections[raw.topic], raw.log_time, data)
    return target


@pytest.mark.parametrize("broken", [set(), {"/odom"}, {"/odom", "/joint_states"}])
def test_a_definition_of_ros1_without_its_parts_is_the_standard_one(drive, tmp_path, broken):
    bag = ros1(drive, tmp_path / "old.bag", broken)
    with BagReader(drive) as one, BagReader(bag) as other:
        wanted = [
            (m.topic, m.message.header.stamp) for m in one.messages({"/odom", "/joint_states"})
        ]
        found = [
            (m.topic, m.message.header.stamp) for m in other.messages({"/odom", "/joint_states"})
        ]
        assert found == wanted
        assert not other.damage
