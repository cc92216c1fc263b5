"""Replay against the node over real DDS, on the same bag with the same parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smallwheel_ros.bags import BagReader
from smallwheel_ros.node_process import NodeProcess
from smallwheel_ros.replay.one import replay
from smallwheel_ros.replay.spec import ReplaySpec
from smallwheel_ros.simulate.drive import DriveSettings, simulate_drive
from smallwheel_ros.simulate.drive_bag import write_drive_bag

pytestmark = pytest.mark.dds

SECOND = 10**9


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive over several soils, with outliers and messages that are missing."""
    path = tmp_path_factory.mktemp("bags") / "drive"
    settings = DriveSettings(
        seed=11, distance=13.0, speed=0.7, wheels="two_sizes", outliers=0.02, dropouts=0.02
    )
    write_drive_bag(simulate_drive(settings), path)
    return path


def fields(message: Any) -> dict[str, Any]:
    """A message of a bag as a row with the names of `drive_through`'s."""
    stamp = message.header.stamp
    row = {"stamp": stamp.sec * SECOND + stamp.nanosec, "frame_id": message.header.frame_id}
    names = message.__dataclass_fields__
    return row | {n: getattr(message, n) for n in names if n not in ("header", "__msgtype__")}


def assert_same(found: dict[str, Any], expected: dict[str, Any]) -> None:
    for name, value in found.items():
        other = expected[name]
        if isinstance(value, float | np.ndarray):
            np.testing.assert_allclose(value, other, rtol=1e-9, atol=1e-15, err_msg=name)
        else:
            assert value == other, name


def test_replay_and_node_agree_to_a_billionth(bag: Path, repository: Path, tmp_path: Path) -> None:
    from smallwheel_ros.ros.drive_through import drive_through

    rover = repository / "config" / "two_wheel_sizes.yaml"
    result = replay(ReplaySpec(bag, rover, tmp_path / "out", copy="none"))
    with BagReader(tmp_path / "out" / "bag") as reader:
        mobility = [fields(m.message) for m in reader.messages({"/mobility_estimator/mobility"})]
        soils = [fields(m.message) for m in reader.messages({"/mobility_estimator/soil"})]
    assert result.onboard.soil.soil_changes > 0
    assert {row["status"] for row in mobility} >= {0, 2, 3}  # OK, slip unknown, rejected

    log = tmp_path / "node.log"
    with NodeProcess([rover], log, {"use_sim_time": "true"}) as node:
        recording = drive_through(bag, rate=4.0, alive=node.death)
    assert len(recording.mobility) == len(mobility)
    for row, expected in zip(recording.mobility, mobility, strict=True):
        assert_same(row, expected)
    assert_same(recording.soil[-1], soils[-1])


def test_what_replay_writes_is_read_by_ros_itself(
    bag: Path, repository: Path, tmp_path: Path
) -> None:
    from rclpy.serialization import deserialize_message
    from smallwheel_ros.msg import MobilityEstimate, SoilEstimate

    rover = repository / "config" / "two_wheel_sizes.yaml"
    replay(ReplaySpec(bag, rover, tmp_path / "out", copy="none"))
    classes = {
        "/mobility_estimator/mobility": MobilityEstimate,
        "/mobility_estimator/soil": SoilEstimate,
    }
    with BagReader(tmp_path / "out" / "bag") as reader:
        raw, known = list(reader.raw_messages(classes)), list(reader.messages(classes))
    for data, message in zip(raw, known, strict=True):
        read = deserialize_message(bytes(data.data), classes[data.topic])
        for name, value in fields(message.message).items():
            if name not in ("stamp", "frame_id"):
                np.testing.assert_array_equal(getattr(read, name), value, err_msg=name)
