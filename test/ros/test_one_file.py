# SPDX-License-Identifier: Apache-2.0
"""The file that `init` writes is enough: the node runs with it alone, on bags of real robots.

Numbers in it may be whole ones, wherever they come from: launch files hand them on as a file, too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_kinds import beginning
from click.testing import CliRunner
from node_peer import ONE_WHEEL, Peer, refused_start

from smallwheel_ros.cli import main
from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds
# Sizes, places and mass, in whole numbers where they are: of each vehicle, as its own file has them.
NUMBERS = {
    "husky": {"diameter": 0.33, "width": 0.125, "track": 0.555, "wheelbase": 0.512, "mass": 75},
    "pathfinder": {"diameter": 0.22, "width": 0.1, "track": 0.6, "wheelbase": 0.4, "mass": 30},
    "warthog": {"diameter": 0.6, "width": 0.25, "track": 1.08, "wheelbase": 0.92, "mass": 280},
}
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    [
        "pathfinder_flat",
        *(
            pytest.param(name, marks=SLOW)
            for name in (
                "husky_snow",
                "husky_wetgrass",
                "warthog_grass",
                "warthog_grass_pose_only",
                "warthog_gravel",
                "warthog_ice",
                "warthog_sand1",
            )
        ),
    ],
)
def test_the_node_runs_with_the_file_of_init_alone(
    name: str, shared_data: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.ros.play import drive_through

    whole = shared_data / "real_drives" / name
    if not whole.exists():
        pytest.skip(f"no recorded drive {whole}")
    config = tmp_path / "rover.yaml"
    said = CliRunner().invoke(main, ["init", str(whole), "-o", str(config)])
    assert said.exit_code == 0, said.output
    text = config.read_text()
    assert text.count(": FILL_IN") == 5
    for key, number in NUMBERS[name.split("_")[0]].items():
        text = text.replace(f" {key}: FILL_IN", f" {key}: {number}")
    config.write_text(text)
    bag, log = beginning(whole, tmp_path / "bag", 15.0), tmp_path / "node.log"
    with NodeProcess([config], log, {"use_sim_time": "true"}) as node:
        recording = drive_through(bag, rate=8.0, alive=node.death)
    assert len(recording.mobility) > 100, log.read_text()
    assert any(row["slip_valid"] for row in recording.mobility)
    text = log.read_text()
    assert "inputs are here" in text
    assert "still waiting for" not in text.partition("inputs are here")[2]


def test_whole_numbers_are_taken_from_file_command_line_and_service_and_a_bool_is_not(
    peer: Peer, tmp_path: Path
) -> None:
    config = tmp_path / "rover.yaml"
    config.write_text(ONE_WHEEL + "    vehicle: {mass: 280}\n")
    with NodeProcess([config], tmp_path / "node.log", {"imu_yaw": "0"}) as node:
        peer.wait_for_node()
        for name, number in (("vehicle.mass", 280.0), ("imu_yaw", 0.0)):
            assert isinstance(peer.value(name), float)
            assert peer.value(name) == number
        assert peer.transition(label="deactivate")
        assert peer.set_parameter("vehicle.mass", 300).successful
        assert isinstance(peer.value("vehicle.mass"), float)
        refused = peer.set_parameter("vehicle.mass", True)
        assert not refused.successful
        assert "vehicle.mass" in refused.reason
        assert peer.value("vehicle.mass") == 300.0
        assert node.death() is None


def test_a_bool_for_a_number_is_refused_by_its_name(
    one_wheel: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    said = refused_start(capfd, "--params-file", str(one_wheel), "-p", "vehicle.mass:=true")
    assert "vehicle.mass is bool True, expected a double" in said


def test_a_joint_named_twice_is_a_count_and_entries_name_what_they_are_of(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from sensor_msgs.msg import JointState

    with NodeProcess([one_wheel], tmp_path / "node.log") as node:
        peer.wait_for_node()
        message = JointState(name=["front_joint", "front_joint"], velocity=[1.0, 2.0])
        peer.stamp(message)
        peer.publish("/joint_states", message)
        key = "/joint_states: no_value"
        peer.spin_until(lambda: key in peer.counts(), "the count")
        assert "names joint front_joint 2 times" in (tmp_path / "node.log").read_text()
        # Without odometry and speeds of wheels the vehicle's message comes all the same.
        for _ in range(20):
            peer.send_load(60.0)
            peer.spin(0.05)
        peer.spin_until(lambda: len(peer.vehicle) > 3, "messages of the vehicle")
        assert {message.level for message in peer.vehicle} == {0}
        own = [
            one for one in peer.diagnostics.values() if one.name.startswith("mobility_estimator")
        ]
        assert own
        assert {one.hardware_id for one in own} == {"mobility_estimator"}
        assert node.death() is None


def test_ground_of_a_class_has_its_margin_until_driving_tells(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from nav_msgs.msg import OccupancyGrid

    grid = OccupancyGrid(data=[0] * 10_000)
    grid.header.frame_id, grid.info.resolution = "odom", 0.1
    grid.info.width = grid.info.height = 100
    grid.info.origin.position.x = grid.info.origin.position.y = -5.0
    grid.info.origin.orientation.w = 1.0
    with NodeProcess([one_wheel], tmp_path / "node.log", {"terrain.names": "[ice]"}) as node:
        peer.wait_for_node()
        places = iter(np.arange(0.0, 40.0, 0.04).tolist())

        def has_been_told() -> bool:
            # Again and again, as a classifier does: its grids are heard at best effort, so one may be lost.
            peer.stamp(grid)
            peer.publish("/terrain_classes", grid)
            place = next(places)
            peer.drive(place, place + 0.04)
            return any(one.margin_source == one.MARGIN_CLASS for one in peer.vehicle)

        peer.spin_until(has_been_told, "its margin")
        first = next(one for one in peer.vehicle if one.margin_source == one.MARGIN_CLASS)
        assert first.margin_valid
        assert first.margin_information > 0.5
        assert first.margin < 0.25  # that of any ground is 0.4
        assert node.death() is None
