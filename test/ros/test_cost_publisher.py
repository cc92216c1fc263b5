# SPDX-License-Identifier: Apache-2.0
"""When the node's grids are sent: on change, again after a while, and after a correction by tf.

Tests `cost_publisher.py` and `conversions.py`.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from smallwheel_ros.costmap.grid import Grid, Pose
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.tables import Estimates, none_of
from smallwheel_ros.ros.cost_publisher import CostPublisher

WHEEL = Wheel("front", 0.2, 0.1)
SETTINGS = settings_from({"wheels": ["front"], "front.diameter": 0.2, "front.width": 0.1})


def transforms(x: float, yaw: float, child: str = "odom") -> Any:
    """A message of /tf with the fields that are read."""
    turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    moved = SimpleNamespace(translation=SimpleNamespace(x=x, y=0.0, z=0.0), rotation=turn)
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(frame_id="map"), child_frame_id=child, transform=moved
            )
        ]
    )


@pytest.fixture
def sent() -> list[Any]:
    return []


def made_with(sent: list[Any]) -> CostPublisher:
    """One whose spread grids are kept; the bare ones go to a list of their own."""
    publishers = [SimpleNamespace(publish=each.append) for each in ([], sent)]
    return CostPublisher(SETTINGS, publishers, lambda *_: None)


@pytest.fixture
def publisher(sent: list[Any]) -> CostPublisher:
    """One that has published an empty grid in odom."""
    from nav_msgs.msg import OccupancyGrid

    made = made_with(sent)
    grid = OccupancyGrid()
    grid.header.frame_id = "odom"
    grid.info.resolution, grid.info.width, grid.info.height = 0.1, 100, 100
    grid.info.origin.position.x = grid.info.origin.position.y = -5.0
    made._send([grid, grid])
    return made


@pytest.mark.parametrize(
    ("x", "yaw", "child", "again"),
    [
        (1.0, 0.2, "odom", False),  # as it was
        (1.02, 0.2, "odom", False),  # less than half a cell
        (1.06, 0.2, "odom", True),
        (1.0, 0.202, "odom", False),
        (1.0, 0.21, "odom", True),  # the far corner, 7 m away, moves by 7 cm
        (9.0, 0.2, "base_link", False),  # the vehicle drives
        (math.nan, 0.2, "odom", True),
    ],
)
def test_a_correction_of_its_frame_sends_the_grid_again_and_once(
    publisher: CostPublisher, sent: list[Any], x: float, yaw: float, child: str, again: bool
) -> None:
    publisher.on_transforms(transforms(1.0, 0.2))
    publisher.on_transforms(transforms(x, yaw, child))
    publisher.publish(1)
    assert len(sent) == 1 + again
    publisher.publish(1)
    assert len(sent) == 1 + again


def test_nothing_is_sent_before_there_is_a_grid(sent: list[Any]) -> None:
    made = made_with(sent)
    made.on_transforms(transforms(1.0, 0.0))
    made.publish(1)
    assert not sent


def test_a_frame_that_is_told_of_once_and_before_any_odometry_is_placed(
    publisher: CostPublisher,
) -> None:
    """N23: a map -> odom of static_transform_publisher was not heard."""
    old = Grid("map", 0.5, (10.0, 0.0), np.full((2, 2), 77, np.int8))
    publisher.map.remember(old)
    publisher.on_static_transforms(transforms(10.0, 0.0))
    publisher.map.add(WHEEL, "odom", Pose(0.2, 0.2, 0.0), 0.0, None)
    assert publisher.map.problem.startswith("the saved cost map is in frame map")
    publisher.take(none_of(Estimates), none_of(VehicleEstimates), "odom")
    assert publisher.map.problem == ""
    grid = publisher.map.grids().bare
    assert grid.cells[grid.cell(0.7, 0.7)] == 77


def test_a_static_frame_that_is_no_pose_is_left_out(publisher: CostPublisher) -> None:
    publisher.on_static_transforms(transforms(math.nan, 0.0))
    assert not publisher._static


def test_what_is_said_once_of_frames_is_heard_by_whoever_comes_late(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """tf2_msgs is no package of PyPI: a stand-in for its message, and for the node."""
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    from smallwheel_ros.ros import inputs

    heard: dict[str, tuple[Any, Any]] = {}

    def subscribe(kind: Any, topic: str, to: Any, profile: Any, **_: Any) -> str:
        heard[topic] = to, profile
        return topic

    monkeypatch.setattr(inputs, "TFMessage", object)
    node = SimpleNamespace(
        resolve_topic_name=lambda name: name if name.startswith("/") else f"/robot1/{name}",
        create_subscription=subscribe,
    )
    monkeypatch.setattr(inputs, "topics_of", lambda _: [])
    listening = inputs.Inputs(
        node,
        SimpleNamespace(elevation_topic="", terrain_classes_topic="terrain_classes"),
        SimpleNamespace(),
    )
    listening.listen(print, "moving", "static", print)
    for topic in ("/tf", "/robot1/tf"):
        assert heard[topic][0] == "moving"
        assert heard[topic][1].durability != DurabilityPolicy.TRANSIENT_LOCAL
        to, profile = heard[f"{topic}_static"]
        assert to == "static"
        assert profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert profile.reliability == ReliabilityPolicy.RELIABLE
