# SPDX-License-Identifier: Apache-2.0
"""Ground ahead, limits of the speed and costs that are forgotten, over real DDS.

grid_map_msgs and nav2_msgs are in no index of Python packages: their messages are generated here as those of
this package are.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_peer import Peer, refused_start

from smallwheel_ros.ros import NodeProcess

MESSAGES = {
    "grid_map_msgs": {
        "GridMapInfo": "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n",
        "GridMap": "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\nstring[] layers\n"
        "string[] basic_layers\nstd_msgs/Float32MultiArray[] data\nuint16 outer_start_index\n"
        "uint16 inner_start_index\n",
    },
    "nav2_msgs": {
        "SpeedLimit": "std_msgs/Header header\nbool percentage\nfloat64 speed_limit\n",
    },
}
CMAKE = """cmake_minimum_required(VERSION 3.20)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(std_msgs REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces({name} {files} DEPENDENCIES std_msgs geometry_msgs)
ament_package()
"""
PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name><version>0.0.0</version><description>Messages</description>
  <maintainer email="nobody@example.com">nobody</maintainer><license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>std_msgs</depend><depend>geometry_msgs</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""
FAST = {"cost.size": "20.0", "cost.spread": "0.0"}


def generated(name: str, folder: Path) -> None:
    """Generate, build and install the messages of a package."""
    source, prefix = folder / name, folder / "prefix"
    (source / "msg").mkdir(parents=True)
    for message, text in MESSAGES[name].items():
        (source / "msg" / f"{message}.msg").write_text(text)
    files = " ".join(f"msg/{message}.msg" for message in MESSAGES[name])
    (source / "CMakeLists.txt").write_text(CMAKE.format(name=name, files=files))
    (source / "package.xml").write_text(PACKAGE.format(name=name))
    venv = Path(sys.prefix)
    tools = {"AMENT_PREFIX_PATH": str(venv), "CMAKE_PREFIX_PATH": str(venv)}
    for command in (
        ["-S", source, "-B", source / "build", "-G", "Ninja",
         f"-DCMAKE_MAKE_PROGRAM={venv / 'bin' / 'ninja'}", f"-DCMAKE_INSTALL_PREFIX={prefix}",
         f"-DCMAKE_INSTALL_RPATH={prefix / 'lib'};{venv / 'lib'}",
         f"-DPython3_EXECUTABLE={sys.executable}", "-DPython3_FIND_VIRTUALENV=ONLY"],
        ["--build", source / "build", "--target", "install"],
    ):  # fmt: skip
        words = [str(word) for word in (venv / "bin" / "cmake", *command)]
        done = subprocess.run(
            words, env={**os.environ, **tools}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Environment of a process that has both packages; this one has them, too."""
    pytest.importorskip("rclpy")
    if not (Path(sys.prefix) / "bin" / "cmake").exists():
        pytest.skip("messages are generated with the CMake of this package's environment")
    folder = tmp_path_factory.mktemp("messages")
    for name in MESSAGES:
        generated(name, folder)
    (library,) = (folder / "prefix").glob("lib/python*/site-packages")
    before = dict(os.environ)
    found = {"PYTHONPATH": str(library), "LD_LIBRARY_PATH": str(folder / "prefix" / "lib")}
    for variable, value in found.items():
        found[variable] = os.pathsep.join(filter(None, [value, before.get(variable, "")]))
    # Libraries of type support are looked for by name: what is loaded already is found.
    for file in sorted((folder / "prefix" / "lib").glob("*.so"), key=lambda one: len(one.name)):
        ctypes.CDLL(str(file), mode=ctypes.RTLD_GLOBAL)
    sys.path.insert(0, str(library))
    yield found
    sys.path.remove(str(library))


@pytest.mark.parametrize(
    ("parameter", "package"),
    [("elevation_topic", "grid_map_msgs"), ("speed_limit_topic", "nav2_msgs")],
)
def test_a_topic_whose_package_is_not_there_is_refused_by_its_name(
    parameter: str, package: str, one_wheel: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    said = refused_start(capfd, "--params-file", str(one_wheel), "-p", f"{parameter}:=/ahead")
    assert f"{parameter} needs package {package}, which is not installed" in said
    assert f"ros-jazzy-{package.replace('_', '-')}" in said


@pytest.mark.dds
def test_costs_are_forgotten_and_the_soil_is_not(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from nav_msgs.msg import OccupancyGrid

    grids = peer.latched(OccupancyGrid, "cost_bare")
    with NodeProcess([one_wheel], tmp_path / "node.log", FAST) as node:
        peer.wait_for_node()
        answer = peer.trigger("clear_cost")
        assert not answer.success
        assert "there is no cost yet" in answer.message
        peer.spin_until(
            lambda: "1" in [v for k, v in peer.counts().items() if "no_cost" in k], "the count"
        )
        peer.drive(0.0, 2.0)
        peer.spin_until(lambda: grids and np.asarray(grids[-1].data).max() >= 0, "costs")
        answer = peer.trigger("clear_cost")
        assert answer.success
        assert "cells are forgotten" in answer.message
        peer.spin_until(lambda: np.asarray(grids[-1].data).max() == -1, "an empty grid")
        assert peer.entry("soil").message != ""
        assert peer.trigger("save_soil").message.startswith("nothing saved: parameter soil.file")
        assert node.death() is None


def grid_map(peer: Peer, heights: np.ndarray, frame: str = "odom", layer: str = "elevation") -> Any:
    """A map of elevations about the origin. heights: rows along y, columns along x."""
    from grid_map_msgs.msg import GridMap
    from std_msgs.msg import Float32MultiArray, MultiArrayDimension

    message = GridMap(layers=[layer])
    peer.stamp(message)
    message.header.frame_id = frame
    rows, columns = heights.shape
    message.info.resolution = 0.1
    message.info.length_x, message.info.length_y = 0.1 * columns, 0.1 * rows
    message.info.pose.orientation.w = 1.0
    array = Float32MultiArray(data=heights[::-1, ::-1].T.flatten(order="F").tolist())
    for label, size, stride in (
        ("column_index", rows, rows * columns),
        ("row_index", columns, columns),
    ):
        array.layout.dim.append(MultiArrayDimension(label=label, size=size, stride=stride))
    message.data = [array]
    return message


@pytest.mark.dds
@pytest.mark.slow
def test_a_hill_ahead_has_a_cost_and_bad_maps_are_counted(
    packages: dict[str, str], peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from grid_map_msgs.msg import GridMap
    from nav2_msgs.msg import SpeedLimit
    from nav_msgs.msg import OccupancyGrid

    grids, limits = peer.latched(OccupancyGrid, "cost_bare"), []
    peer.node.create_subscription(SpeedLimit, "/speed_limit", limits.append, 10)
    publisher = peer.node.create_publisher(GridMap, "/ahead", 10)
    given = {**FAST, "elevation_topic": "/ahead", "speed_limit_topic": "/speed_limit"}
    level = np.zeros((100, 120))
    hill = level + 0.8 * np.clip(0.1 * np.arange(120) - 9.0, 0.0, None)  # from 3 m ahead on
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, given, packages) as node:
        peer.wait_for_node()
        peer.drive(0.0, 1.0)
        publisher.publish(grid_map(peer, hill))

        def cost_at(x: float, y: float) -> int:
            info = grids[-1].info
            column = int((x - info.origin.position.x) / info.resolution)
            row = int((y - info.origin.position.y) / info.resolution)
            return int(np.asarray(grids[-1].data)[row * info.width + column])

        peer.spin_until(lambda: grids and cost_at(5.0, 1.0) > 80, "the hill's cost")
        assert 80 < cost_at(5.0, 1.0) <= 99
        assert 0 <= cost_at(1.5, 2.0) < 20
        for reason, bad in (
            ("malformed_grid", grid_map(peer, hill, layer="height")),
            ("other_frame", grid_map(peer, hill, frame="map")),
        ):
            publisher.publish(bad)
            peer.spin_until(
                lambda reason=reason: any(reason in key for key in peer.counts()), reason
            )
        peer.spin_until(lambda: bool(limits), "a limit of the speed")
        assert limits[-1].percentage
        assert limits[-1].speed_limit == 0.0
        assert node.death() is None
    assert "Traceback" not in log.read_text()
