# SPDX-License-Identifier: Apache-2.0
"""The node's cost map, markers and services over real DDS."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from node_peer import SECOND, Peer
from scipy.special import ndtr

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds
FAST = {
    "cost.size": "8.0",
    "cost.spread": "0.0",
    "cost.unknown": "none",
}


def assert_nav2_takes_it(message: Any, frame: str) -> None:
    """The rules of nav2_util::validateMsg for an OccupancyGrid, and of KeepoutFilter's masks."""
    assert message.header.frame_id == frame != ""
    assert 0 <= message.header.stamp.nanosec < SECOND
    info = message.info
    assert math.isfinite(info.resolution)
    assert info.resolution > 0
    position, turn = info.origin.position, info.origin.orientation
    assert all(math.isfinite(v) for v in (position.x, position.y, position.z))
    length = turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2
    assert abs(length - 1.0) < 1e-3
    assert turn.w == 1.0
    assert len(message.data) == info.width * info.height > 0
    cells = np.asarray(message.data)
    assert cells.min() >= -1
    assert cells.max() <= 100


def cells_of(message: Any) -> np.ndarray:
    return np.asarray(message.data).reshape(message.info.height, message.info.width)


def cost_at(message: Any, x: float, y: float) -> int:
    info = message.info
    row = math.floor((y - info.origin.position.y) / info.resolution)
    column = math.floor((x - info.origin.position.x) / info.resolution)
    return int(cells_of(message)[row, column])


def class_grid(peer: Peer, cells: np.ndarray, frame: str = "odom", **info: Any) -> Any:
    from nav_msgs.msg import OccupancyGrid

    message = OccupancyGrid()
    peer.stamp(message)
    message.header.frame_id = frame
    message.info.resolution = 0.5
    message.info.height, message.info.width = cells.shape
    message.info.origin.position.x, message.info.origin.position.y = -1.0, -1.0
    message.info.origin.orientation.w = 1.0
    for name, value in info.items():
        setattr(message.info, name, value)
    message.data = cells.ravel().tolist()
    return message


def test_crossed_ground_becomes_a_grid_that_nav2_takes(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from nav_msgs.msg import OccupancyGrid
    from visualization_msgs.msg import Marker, MarkerArray

    grids, arrays = peer.latched(OccupancyGrid, "cost"), []
    peer.listen(MarkerArray, "markers", arrays.append)
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, FAST) as node:
        peer.wait_for_node()
        assert grids == []
        begin = time.monotonic()
        peer.drive(0.0, 2.0)
        peer.spin_until(
            lambda: grids and cost_at(grids[-1], 1.5, 0.01) >= 0, "a grid with the ground's cost"
        )
        peer.wait_for_turn()
        elapsed = time.monotonic() - begin
        grid = grids[-1]
        for each in grids:
            assert_nav2_takes_it(each, "odom")
        assert 0 <= cost_at(grid, 1.5, 0.01) <= 100
        assert cost_at(grid, 1.5, 1.0) == -1
        assert cost_at(grid, 3.0, 0.0) == -1
        assert len(grids) <= elapsed / 0.2 + 1

        # Who comes late gets the newest grid.
        late = peer.latched(OccupancyGrid, "cost")
        peer.spin_until(lambda: bool(late), "the latched grid")
        assert late[0] == grid
        # A robot that stands sends the same again: map -> odom may have been corrected.
        count = len(grids)
        peer.spin_until(lambda: len(grids) > count, "the same grid once more")
        assert grids[-1] == grid

        column, text = arrays[-1].markers
        assert (column.type, text.type) == (Marker.CYLINDER, Marker.TEXT_VIEW_FACING)
        assert column.header.frame_id == "odom"
        assert column.pose.position.x == pytest.approx(2.0, abs=0.3)
        assert column.scale.z == pytest.approx(0.08, abs=0.04)
        assert text.text.startswith("front\n")
        assert "mm" in text.text
        status = peer.entry("cost")
        assert status.message == "crossed ground"

        answer = peer.trigger("reset")
        assert answer.success
        peer.spin_until(lambda: cells_of(grids[-1]).max() == -1, "an empty grid after the reset")
        assert_nav2_takes_it(grids[-1], "odom")
        # Viewers keep markers for ever: those that were published are deleted, once.
        deletion = [Marker.DELETEALL]
        peer.spin_until(lambda: [m.action for m in arrays[-1].markers] == deletion, "their end")
        count = len(arrays)
        peer.wait_for_turn()
        assert len(arrays) == count
        assert node.death() is None
    assert "Traceback" not in log.read_text()


def test_a_grid_is_sent_when_it_changes_and_again_after_5_s(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from smallwheel_ros.costmap.grid import Pose
    from smallwheel_ros.onboard.parameters import settings_from
    from smallwheel_ros.ros import cost_publisher

    clock, bare, sent = [100.0], [], []
    monkeypatch.setattr(cost_publisher.time, "monotonic", lambda: clock[0])
    publishers = [SimpleNamespace(publish=each.append) for each in (bare, sent)]
    settings = settings_from({"wheels": ["front"], "front.diameter": 0.2, "front.width": 0.1})
    cost = cost_publisher.CostPublisher(settings, publishers, lambda *_: None)
    (wheel,) = settings.onboard.wheels

    def passes(seconds: float) -> int:
        """How many grids are sent at the end of so many seconds."""
        clock[0] += seconds
        before = len(sent)
        cost.publish(7)
        return len(sent) - before

    assert passes(20.0) == 0  # there is none
    cost.map.add(wheel, "odom", Pose(0.0, 0.0, 0.0), 0.0, None)
    assert [passes(1.0), passes(1.0), passes(3.9), passes(0.2)] == [1, 0, 0, 1]
    assert sent[1] == sent[0]
    cost.map.add(wheel, "odom", Pose(30.0, 0.0, 0.0), 30.0, None)
    assert [passes(1.0), passes(4.9), passes(0.2)] == [1, 0, 1]
    assert sent[2] != sent[1]
    # While it moves there is one each second, also where no cell changes: a local costmap rolls along.
    for x in (30.1, 30.2, 30.3):
        cost.map.add(wheel, "odom", Pose(x, 0.0, 0.0), x, None)
        assert passes(1.0) == 1
    assert cost.published == len(sent) == len(bare)


def test_terrain_classes_in_costs_out(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    from nav_msgs.msg import OccupancyGrid
    from rclpy.qos import DurabilityPolicy, QoSProfile

    # As of a map server: there before the node, and latched.
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = peer.node.create_publisher(OccupancyGrid, "/terrain_classes", latched)
    cells = np.full((8, 12), 7, dtype=np.int8)
    cells[:, 8:] = 3
    cells[0, 0] = -1
    publisher.publish(class_grid(peer, cells))
    grids = peer.latched(OccupancyGrid, "cost")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, FAST) as node:
        peer.wait_for_node()
        # Before anything is known of any class, the whole grid is unknown.
        peer.spin_until(lambda: bool(grids), "a grid")
        assert set(np.unique(cells_of(grids[-1]))) == {-1}
        peer.drive(0.0, 2.0)

        def spread() -> bool:
            return bool(cells_of(grids[-1])[7, 5] >= 0)

        peer.spin_until(spread, "the class's cost in cells that nobody has crossed")
        peer.wait_for_turn()
        grid = grids[-1]
        assert_nav2_takes_it(grid, "odom")
        assert (grid.info.width, grid.info.height, grid.info.resolution) == (12, 8, 0.5)
        costs = cells_of(grid)
        assert (costs[cells == 3] == -1).all()
        assert costs[0, 0] == -1
        far = costs[4:, :8]
        assert len(set(far.ravel().tolist())) == 1

        # What the class holds can be asked for; nobody has been on the other one.
        answer = peer.trigger("terrain_margins")
        (known,) = json.loads(answer.message).items()
        assert known[0] == "7"
        assert known[1]["places"] > 3
        assert known[1]["standard_deviation"] > 0.0
        # It is stuck only where it makes no way: what is gained up to there makes it cheaper.
        at_reference = 100 * ndtr(-known[1]["margin"] / known[1]["standard_deviation"])
        assert 0 <= far[0, 0] <= round(at_reference)

        # Grids that cannot be used are counted, and the last good one stays.
        # One after the other: the publisher keeps only the newest.
        for count, bad in (
            ("1", class_grid(peer, cells, width=13)),
            ("2", class_grid(peer, cells, frame="")),
        ):
            publisher.publish(bad)
            wanted = {"/terrain_classes: malformed_grid": count}
            peer.spin_until(
                lambda wanted=wanted: wanted.items() <= peer.counts().items(), f"counted {wanted}"
            )
        assert cells_of(grids[-1]).shape == (8, 12)
        # A grid of another frame: said, and unknown.
        publisher.publish(class_grid(peer, cells, frame="map"))
        peer.spin_until(lambda: grids[-1].header.frame_id == "map", "the grid of the other frame")
        assert_nav2_takes_it(grids[-1], "map")
        peer.spin_until(
            lambda: "in frame map, positions are in odom" in peer.entry("cost").message,
            "the frame in diagnostics",
        )
        assert node.death() is None
    text = log.read_text()
    assert "has 96 cells, expected width * height = 13 * 8" in text
    assert "Traceback" not in text


def test_a_cleanup_empties_what_nav2_has(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from nav_msgs.msg import OccupancyGrid

    grids = peer.latched(OccupancyGrid, "cost")
    with NodeProcess([one_wheel], tmp_path / "node.log", FAST) as node:
        peer.wait_for_node()
        peer.drive(0.0, 2.0)
        peer.spin_until(lambda: grids and cost_at(grids[-1], 1.5, 0.01) >= 0, "the ground's cost")
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
            request = ChangeState.Request(transition=Transition(id=transition))
            assert peer.call(ChangeState, "change_state", request).success
        peer.spin_until(lambda: cells_of(grids[-1]).max() == -1, "an empty grid")
        assert node.death() is None


def test_the_map_is_saved_with_the_soil_and_restored(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from nav_msgs.msg import OccupancyGrid

    saved = {**FAST, "soil.file": str(tmp_path / "soil.json")}
    grids = peer.latched(OccupancyGrid, "cost")
    with NodeProcess([one_wheel], tmp_path / "first.log", saved):
        peer.wait_for_node()
        peer.drive(0.0, 2.0)
        peer.spin_until(lambda: grids and cost_at(grids[-1], 1.5, 0.01) >= 0, "the ground's cost")
        answer = peer.trigger("save_soil")
        assert answer.success
        assert "soil.json.cost_map.yaml in odom" in answer.message
    assert (tmp_path / "soil.json.cost_map.pgm").exists()
    grids.clear()
    precious = tmp_path / "other.json.cost_map.pgm"
    precious.write_text("precious")
    with NodeProcess([one_wheel], tmp_path / "second.log", saved):
        peer.wait_for_node()
        peer.drive(0.0, 0.4)
        peer.spin_until(
            lambda: grids and cost_at(grids[-1], 1.5, 0.01) >= 0, "the way of the first drive"
        )
        peer.configure_with("soil.file", str(tmp_path / "other.json"))
        peer.spin_until(lambda: peer.load.get_subscription_count() == 1, "it listens")
        peer.drive(0.4, 1.4)
        peer.spin_until(
            lambda: "the cost map is not saved" in peer.trigger("save_soil").message, "refused"
        )
    assert precious.read_text() == "precious"
    assert "cost map restored from" in (tmp_path / "second.log").read_text()


def test_what_param_dump_writes_can_be_loaded(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    """`ros2 param dump` has null for what is not set; ROS reads that as the text 'null'."""
    dumped = tmp_path / "dump.yaml"
    dumped.write_text(
        "/mobility_estimator:\n  ros__parameters:\n    soil:\n      k: null\n      name: null\n"
        "    vehicle:\n      mass: null\n    cost:\n      spread: null\n"
    )
    with NodeProcess([one_wheel, dumped], tmp_path / "node.log") as node:
        peer.wait_for_node()
        assert node.death() is None
    assert "null" not in (tmp_path / "node.log").read_text()


@pytest.mark.parametrize("after", [0.0, 0.3, 1.5])
def test_interrupts_end_it_without_a_traceback(
    peer: Peer, one_wheel: Path, tmp_path: Path, after: float
) -> None:
    """A launch file passes on what the process group has had already: two of them."""
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log) as node:
        peer.wait_for_node()
        for pause in (after, 0.05):
            time.sleep(pause)
            os.kill(node.process_id, signal.SIGINT)
        peer.spin_until(lambda: node.death() is not None, "its end")
        assert str(node.death()).startswith("exit code 0")
    assert "Traceback" not in log.read_text()


def test_a_bag_that_loops_clears_the_grid(peer: Peer, one_wheel: Path, tmp_path: Path) -> None:
    from nav_msgs.msg import OccupancyGrid

    grids = peer.latched(OccupancyGrid, "cost")
    log = tmp_path / "node.log"
    begin = peer.now() - 100 * SECOND
    old = {"timing.maximum_age": "1000.0"}
    # Without a clock of its own to go by, the node sees stamps only: a simulated one that stands.
    with NodeProcess([one_wheel], log, {**FAST, **old, "use_sim_time": "true"}) as node:
        peer.wait_for_node()
        peer.drive(0.0, 2.0, begin=begin)
        peer.spin_until(lambda: grids and cost_at(grids[-1], 1.5, 0.01) >= 0, "the first way")
        peer.drive(0.0, 0.8, begin=begin)
        peer.spin_until(lambda: cost_at(grids[-1], 1.5, 0.01) == -1, "the old way is forgotten")
        peer.spin_until(lambda: cost_at(grids[-1], 0.5, 0.01) >= 0, "the new way")
        assert "/odom: time_jump" in " ".join(peer.counts()) or any(
            "time_jump" in key for key in peer.counts()
        )
        assert node.death() is None
    assert "time went back by" in log.read_text()
