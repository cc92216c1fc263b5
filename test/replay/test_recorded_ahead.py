# SPDX-License-Identifier: Apache-2.0
"""What a bag has of the ground ahead is in the cost map of its replay, as in the node's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smallwheel_ros.api.replay import replay
from smallwheel_ros.bags import BagReader, BagWriter, Message, header
from smallwheel_ros.replay.result import SUMMARY
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

GRID_MAP = "grid_map_msgs/msg/GridMap"
GRIDS = "/mobility_estimator/cost_bare"


def placed(x: float, y: float) -> Any:
    point = Message(x=x, y=y, z=0.0)
    return Message(position=point, orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))


def grid_map(stamp: int, heights: np.ndarray, layer: str = "elevation") -> Any:
    """Heights about the origin, rows along y, columns along x, as grid_map lays them out."""
    rows, columns = heights.shape
    dims = [
        Message(label="column_index", size=rows, stride=rows * columns),
        Message(label="row_index", size=columns, stride=columns),
    ]
    data = np.asarray(heights[::-1, ::-1].ravel(), dtype=np.float32)
    info = Message(
        resolution=0.1, length_x=0.1 * columns, length_y=0.1 * rows, pose=placed(0.0, 0.0)
    )
    return Message(
        header=header(stamp, "odom"), info=info, layers=[layer], basic_layers=[],
        data=[Message(layout=Message(dim=dims, data_offset=0), data=data)],
        outer_start_index=0, inner_start_index=0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def replayed(
    repository: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[Any], dict[str, Any], int]:
    """Bare grids of a replay, its summary, and when the map of a hill was recorded (ns)."""
    folder = tmp_path_factory.mktemp("ahead")
    drive = simulate_drive(DriveSettings(seed=3, distance=4.0))
    write_drive_bag(drive, folder / "plain")
    hill = np.zeros((60, 300)) + 0.8 * np.clip(
        0.1 * np.arange(300) - 22.0, 0.0, None
    )  # from 7 m on
    with BagReader(folder / "plain") as reader, BagWriter(folder / "bag") as bag:
        raw = list(reader.raw_messages())
        channels = {topic[:2]: reader.channel(*topic[:2]) for topic in reader.topics}
        middle = raw[len(raw) // 2].log_time
        for layer in ("height", "elevation"):
            bag.write("/elevation", GRID_MAP, middle, grid_map(middle, hill, layer))
        for message in raw:
            channel = channels[message[:2]]
            assert channel is not None
            bag.copy(channel, message.log_time, message.data)
    config = folder / "rover.yaml"
    text = (repository / "config" / "four_wheels.yaml").read_text()
    config.write_text(text.rstrip() + "\n    elevation_topic: /elevation\n")
    result = replay(folder / "bag", config, folder / "out")
    with BagReader(folder / "out" / "bag") as reader:
        grids = [(m.log_time, m.message) for m in reader.messages({GRIDS})]
    summary = json.loads((folder / "out" / SUMMARY).read_text())
    assert result.state == "complete"
    return grids, summary, middle


def cost_at(grid: Any, x: float, y: float) -> int:
    info = grid.info
    column = int((x - info.origin.position.x) / info.resolution)
    row = int((y - info.origin.position.y) / info.resolution)
    return int(np.asarray(grid.data).reshape(info.height, info.width)[row, column])


def test_a_hill_ahead_costs_from_when_it_was_recorded(replayed: Any) -> None:
    grids, _, middle = replayed
    before = [cost_at(grid, 9.0, 0.0) for time, grid in grids if time < middle]
    after = [cost_at(grid, 9.0, 0.0) for time, grid in grids if time > middle + 2 * 10**9]
    assert len(before) > 2
    assert len(after) > 2
    assert set(before) == {-1}
    assert min(after) > 80


def test_a_map_without_the_layer_is_counted(replayed: Any) -> None:
    _, summary, _ = replayed
    assert "malformed_grid" in json.dumps(summary)
