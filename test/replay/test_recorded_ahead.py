# SPDX-License-Identifier: Apache-2.0
"""What a bag has of the ground ahead is in the cost map of its replay, as in the node's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from smallwheel_ros.api.replay import replay
from smallwheel_ros.bags import BagReader, BagWriter, Message, header
from smallwheel_ros.pipeline.mobility.status import MarginSource
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
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int]]:
    """A bag of 4 m, and when each of its messages was recorded (ns)."""
    bag = tmp_path_factory.mktemp("plain") / "bag"
    write_drive_bag(simulate_drive(DriveSettings(seed=3, distance=4.0)), bag)
    with BagReader(bag) as reader:
        return bag, [message.log_time for message in reader.raw_messages()]


def replayed_with(
    plain: Path, folder: Path, config: str, messages: list[tuple[str, str, int, Any]]
) -> Path:
    """The folder of a replay of that bag with further messages."""
    with BagReader(plain) as reader, BagWriter(folder / "bag") as bag:
        channels = {topic[:2]: reader.channel(*topic[:2]) for topic in reader.topics}
        for message in messages:
            bag.write(*message)
        for raw in reader.raw_messages():
            channel = channels[raw[:2]]
            assert channel is not None
            bag.copy(channel, raw.log_time, raw.data)
    (folder / "rover.yaml").write_text(config)
    assert replay(folder / "bag", folder / "rover.yaml", folder / "out").state == "complete"
    return folder / "out"


@pytest.fixture(scope="module")
def replayed(
    repository: Path, plain: tuple[Path, list[int]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[Any], dict[str, Any], int]:
    """Bare grids of a replay, its summary, and when the map of a hill was recorded (ns)."""
    hill = np.zeros((60, 300)) + 0.8 * np.clip(
        0.1 * np.arange(300) - 22.0, 0.0, None
    )  # from 7 m on
    middle = plain[1][len(plain[1]) // 2]
    maps = [
        ("/elevation", GRID_MAP, middle, grid_map(middle, hill, layer))
        for layer in ("height", "elevation")
    ]
    text = (repository / "config" / "four_wheels.yaml").read_text().rstrip()
    config = f"{text}\n    elevation_topic: /elevation\n"
    out = replayed_with(plain[0], tmp_path_factory.mktemp("ahead"), config, maps)
    with BagReader(out / "bag") as reader:
        grids = [(m.log_time, m.message) for m in reader.messages({GRIDS})]
    return grids, json.loads((out / SUMMARY).read_text()), middle


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


def classes(stamp: int) -> Any:
    """Grass, number 0, up to 1.5 m along x, and ice, number 1, from there on."""
    cells = np.zeros((100, 400), dtype=np.int8)
    cells[:, 215:] = 1
    info = Message(
        map_load_time=Message(sec=0, nanosec=0), resolution=0.1, width=400, height=100,
        origin=placed(-20.0, -5.0),
    )  # fmt: skip
    return Message(header=header(stamp, "odom"), info=info, data=cells.ravel())


def test_a_margin_that_nothing_tells_is_that_of_the_class_where_the_vehicle_is(
    repository: Path, plain: tuple[Path, list[int]], tmp_path: Path
) -> None:
    bag, recorded = plain
    text = (repository / "config" / "without_soil_sensors.yaml").read_text().rstrip()
    config = f"{text}\n    terrain_classes_topic: /classes\n    terrain.names: [grass, ice]\n"
    grid = ("/classes", "nav_msgs/msg/OccupancyGrid", recorded[0], classes(recorded[0]))
    out = replayed_with(bag, tmp_path, config, [grid])
    vehicle, wheels = (pd.read_csv(out / f"{name}.csv") for name in ("vehicle", "estimates"))
    known = wheels[wheels["x"].notna()]
    newest = np.searchsorted(known["stamp"], vehicle["stamp"], side="left") - 1
    by_class = vehicle["margin_source"] == MarginSource.CLASS
    assert by_class.any()
    assert not (vehicle["margin_source"][newest >= 0] == MarginSource.ANY_GROUND).any()
    on_ice = pd.Series(known["x"].to_numpy()[np.maximum(newest, 0)] >= 1.5)
    margins = [vehicle["margin"][by_class & there] for there in (~on_ice, on_ice)]
    assert len(margins[0]) > 5
    assert (abs(margins[0] - 0.44) < 0.02).all()  # nothing was measured on either
    assert (abs(margins[1] - 0.08) < 0.02).all()
    with BagReader(out / "bag") as reader:
        name = next(t.name for t in reader.topics if t.name.endswith("/vehicle"))
        sent = [m.message.margin_source for m in reader.messages({name})]
    assert sent.count(MarginSource.CLASS) == by_class.sum()
