# SPDX-License-Identifier: Apache-2.0
"""Replay against the node over real DDS, on the same bag with the same parameters."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawbar_drives import with_pulls

from smallwheel_ros.bags import BagReader
from smallwheel_ros.drive.messages import mobility_columns, soil_fields
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.replay import recording
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.spec import ReplaySpec
from smallwheel_ros.ros import NodeProcess
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag
from smallwheel_ros.simulate.settings import Stretch
from smallwheel_ros.simulate.truth import soil_of_pressure

pytestmark = pytest.mark.dds

SECOND = 10**9

_kinds = importlib.util.spec_from_file_location(
    "bag_kinds", Path(__file__).parents[1] / "bag_kinds.py"
)
assert _kinds is not None
assert _kinds.loader is not None
bag_kinds = importlib.util.module_from_spec(_kinds)
_kinds.loader.exec_module(bag_kinds)


def replayed(bag: Path, rover: Path) -> tuple[list[dict[str, Any]], dict[str, Any], Pipeline]:
    """Rows of estimates as `drive_through` has them, the last soil, and the pipeline at the end."""
    made: list[Pipeline] = []
    rows: list[dict[str, Any]] = []
    settings = settings_from(read_parameters(rover))
    with pytest.MonkeyPatch.context() as patch:
        keep = lambda given: made.append(Pipeline(given)) or made[0]  # noqa: E731
        patch.setattr(recording, "Pipeline", keep)
        for turn in recording.turns_of(bag, settings):
            found = turn.estimates
            columns = mobility_columns(found, made[0])
            for i in range(len(found)):
                name = settings.onboard.wheels[int(found.wheel[i])].name
                row = {"stamp": int(found.stamp[i]), "frame_id": name}
                rows.append(
                    row | {key: np.asarray(column)[i].item() for key, column in columns.items()}
                )
    rows.sort(key=lambda row: (row["stamp"], row["wheel"]))  # wheels have topics of their own
    soil = soil_fields(made[0].soil, made[0].rejected) | {"stamp": rows[-1]["stamp"]}
    return rows, soil, made[0]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive onto softer soil, with outliers and messages that are missing."""
    path = tmp_path_factory.mktemp("bags") / "drive"
    stretches = [
        Stretch(start, soil_of_pressure("sand", pressure, 0.85, 0.35, friction_angle=0.5))
        for start, pressure in ((0.0, 19e3), (3.5, 7e3))
    ]
    settings = DriveSettings(
        seed=11,
        distance=6.0,
        speed=0.7,
        wheels="two_sizes",
        stretches=tuple(stretches),
        outliers=0.02,
        dropouts=0.02,
    )
    write_drive_bag(simulate_drive(settings), path)
    return path


@pytest.fixture(scope="module")
def short(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its first five seconds."""
    return bag_kinds.beginning(bag, tmp_path_factory.mktemp("bags") / "short", 5.0)


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


@pytest.mark.parametrize(
    "pulls",
    [pytest.param(False, id="sinkage", marks=pytest.mark.slow), pytest.param(True, id="and pull")],
)
def test_replay_and_node_agree_to_a_billionth(
    bag: Path, repository: Path, tmp_path: Path, pulls: bool
) -> None:
    from smallwheel_ros.ros.play import drive_through

    rover = repository / "config" / "two_wheel_sizes.yaml"
    rover = with_pulls(rover, tmp_path) if pulls else rover
    mobility, soil, pipeline = replayed(bag, rover)
    assert soil["measurements_accepted"] > 100
    assert (pipeline.strength.sources == {"pull"}) == pulls
    assert {row["status"] for row in mobility} >= {0, 2, 3}  # OK, slip unknown, rejected

    log = tmp_path / "node.log"
    with NodeProcess([rover], log, {"use_sim_time": "true"}) as node:
        recording = drive_through(bag, rate=16.0, alive=node.death)
    assert len(recording.mobility) == len(mobility)
    for row, expected in zip(recording.mobility, mobility, strict=True):
        assert_same(row, expected)
    assert_same(soil, recording.soil[-1])


def test_a_bag_of_ros1_is_played_into_the_node(
    short: Path, repository: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.ros.play import drive_through

    rover = repository / "config" / "two_wheel_sizes.yaml"
    old = bag_kinds.ros1_copy(short, tmp_path / "old.bag")
    expected, _, _ = replayed(old, rover)
    with NodeProcess([rover], tmp_path / "node.log", {"use_sim_time": "true"}) as node:
        recording = drive_through(old, rate=16.0, alive=node.death)
    assert len(recording.mobility) == len(expected) > 100
    for row, other in zip(recording.mobility, expected, strict=True):
        assert_same(row, other)


def test_what_replay_writes_is_read_by_ros_itself(
    short: Path, repository: Path, tmp_path: Path
) -> None:
    from rclpy.serialization import deserialize_message
    from smallwheel_ros.msg import MobilityEstimate, SoilEstimate, VehicleMobility

    rover = repository / "config" / "two_wheel_sizes.yaml"
    replay(ReplaySpec(short, rover, tmp_path / "out", copy="none"))
    classes = {
        "/mobility_estimator/front_left/mobility": MobilityEstimate,
        "/mobility_estimator/vehicle": VehicleMobility,
        "/mobility_estimator/soil": SoilEstimate,
    }
    with BagReader(tmp_path / "out" / "bag") as reader:
        raw, known = list(reader.raw_messages(classes)), list(reader.messages(classes))
    for data, message in zip(raw, known, strict=True):
        read = deserialize_message(bytes(data.data), classes[data.topic])
        for name, value in fields(message.message).items():
            if name not in ("stamp", "frame_id"):
                np.testing.assert_array_equal(getattr(read, name), value, err_msg=name)


def test_a_player_that_cannot_begin_leaves_ros_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next drive in this process can be played all the same."""
    import rclpy

    from smallwheel_ros.ros import play

    def fails(_: str) -> None:
        raise LookupError("no such type")

    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=2.0)), tmp_path / "bag")
    monkeypatch.setattr(play, "message_class", fails)
    for _ in range(2):
        with pytest.raises(LookupError, match="no such type"):
            play.drive_through(tmp_path / "bag")
        assert not rclpy.ok()
