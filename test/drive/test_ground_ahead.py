# SPDX-License-Identifier: Apache-2.0
"""Messages of the ground ahead go into the cost map; of one that cannot be used it is said why."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_elevation import STORE, grid_map, laid_out, other_size

from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.drive.ground_ahead import AheadInputs
from smallwheel_ros.drive.ground_map import cost_map_of
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.physics.wheel import Quantity

SETTINGS = settings_from(
    {"wheels": ["front"], "front.diameter": 0.2, "front.width": 0.1, "elevation_topic": "/ahead"}
)
LEVEL = np.zeros((40, 60))


class Heard:
    """The map of a vehicle that stands in odom, what takes messages into it, and what that has reported."""

    def __init__(self) -> None:
        self.map = cost_map_of(SETTINGS)
        self.said: list[tuple[str, str, str]] = []
        self.inputs = AheadInputs(SETTINGS, self.map, lambda *words: self.said.append(words))
        (wheel,) = SETTINGS.onboard.wheels
        self.map.add(wheel, "odom", Pose(0.0, 0.0, 0.0), 0.0, Quantity(0.3, 0.05))


def classes(cells: int = 12, frame: str = "odom") -> Any:
    """A grid of 4 by 3 cells that says it has 12, as a bag has it."""
    one = STORE.types
    time = one["builtin_interfaces/msg/Time"](5, 0)
    place = one["geometry_msgs/msg/Pose"](
        one["geometry_msgs/msg/Point"](0.0, 0.0, 0.0),
        one["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    info = one["nav_msgs/msg/MapMetaData"](time, 0.5, 4, 3, place)
    header = one["std_msgs/msg/Header"](time, frame)
    return one["nav_msgs/msg/OccupancyGrid"](header, info, np.zeros(cells, dtype=np.int8))


def test_each_topic_that_is_listened_to_has_its_type() -> None:
    kinds = {name: kind for name, (kind, _) in Heard().inputs.topics.items()}
    assert kinds == {
        "terrain_classes": "nav_msgs/msg/OccupancyGrid",
        "/ahead": "grid_map_msgs/msg/GridMap",
    }


def test_a_good_one_is_in_the_map_and_nothing_is_said() -> None:
    heard = Heard()
    assert heard.inputs.take_elevation(grid_map({"elevation": LEVEL}))
    assert heard.inputs.take_classes(classes())
    assert heard.map.ahead.elevation is not None
    assert heard.map.ahead.class_grid is not None
    assert (heard.inputs.elevations, heard.inputs.grids) == (1, 1)
    assert heard.said == []


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (grid_map({"height": LEVEL}), "no layer 'elevation', it has height"),
        (grid_map({"elevation": LEVEL * np.nan}), "all are NaN"),
        (laid_out(grid_map({"elevation": LEVEL}), "x", "y"), "has the layout x, y"),
        (other_size(grid_map({"elevation": LEVEL})), "2400 cells, 60 by 40"),
        (grid_map({"elevation": LEVEL}, frame=""), "header.frame_id is empty"),
        (grid_map({"elevation": LEVEL}, inner_start_index=40), "inner_start_index is 40"),
    ],
)
def test_a_bad_map_is_counted_and_the_one_before_is_kept(message: Any, words: str) -> None:
    heard = Heard()
    heard.inputs.take_elevation(grid_map({"elevation": LEVEL}))
    before = heard.map.ahead.elevation
    assert not heard.inputs.take_elevation(message)
    assert heard.map.ahead.elevation is before
    ((topic, reason, text),) = heard.said
    assert (topic, reason) == ("/ahead", "malformed_grid")
    assert "not used" in text
    assert words in text


def test_a_grid_of_another_size_is_counted() -> None:
    heard = Heard()
    assert not heard.inputs.take_classes(classes(11))
    ((topic, reason, text),) = heard.said
    assert (topic, reason) == ("terrain_classes", "malformed_grid")
    assert "11 cells, expected width * height = 4 * 3" in text


def test_classes_of_another_frame_are_counted_and_the_map_goes_on() -> None:
    heard = Heard()
    assert heard.inputs.take_classes(classes(frame="map"))
    ((topic, reason, text),) = heard.said
    assert (topic, reason) == ("terrain_classes", "other_frame")
    assert "map" in text
    assert "odom" in text
    assert heard.map.grids() is not None


def test_while_tf_is_gone_a_map_of_another_frame_waits_and_is_counted_each_time() -> None:
    heard = Heard()
    for _ in range(2):
        assert heard.inputs.take_elevation(grid_map({"elevation": LEVEL}, frame="map"))
    assert [reason for _, reason, _ in heard.said] == ["other_frame"] * 2
    assert "is used once tf relates the two" in heard.said[0][2]

    def known() -> int:
        grids = heard.map.grids()
        assert grids is not None
        return int((grids.bare.cells >= 0).sum())

    without = known()
    heard.map.place_frame("map", Pose(1.0, 0.0, 0.0))
    assert known() > without + 1000
    assert heard.inputs.take_elevation(grid_map({"elevation": LEVEL}, frame="map"))
    assert len(heard.said) == 2
