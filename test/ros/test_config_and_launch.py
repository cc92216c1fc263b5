# SPDX-License-Identifier: Apache-2.0
"""Shipped configuration and launch files: what can be checked of them without Nav2, RViz, launch."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from smallwheel_ros.bags.types import message_definitions
from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.costmap.crossed_ground import CrossedGround
from smallwheel_ros.costmap.grid import Grid

NODE = "/mobility_estimator"
OUTPUTS = {
    **{
        f"{NODE}/{end}_{side}/mobility": "MobilityEstimate"
        for end in ("front", "rear")
        for side in ("left", "right")
    },
    f"{NODE}/vehicle": "VehicleMobility",
    f"{NODE}/soil": "SoilEstimate",
    f"{NODE}/cost": "",
    f"{NODE}/markers": "",
    "/diagnostics": "",
}
INPUTS = {"/odom", "/terrain_classes"}
COSTMAPS = ["nav2_costmaps.yaml", "nav2_costmaps_without_map.yaml"]
LAUNCH_FILES = ["mobility_estimator", "nav2_cost", "replay"]


def load(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


class TestNav2:
    def test_both_costmaps_have_the_filter_that_the_server_feeds(self, repository: Path) -> None:
        server = load(repository / "config" / "nav2_filter_info.yaml")["/**"]["ros__parameters"]
        assert server == {
            "type": 0,
            # Relative: the launch file gives the server a namespace.
            "filter_info_topic": "soil_filter_info",
            # Full: a costmap would look for a relative name below itself.
            "mask_topic": f"{NODE}/cost",
            "base": 0.0,
            "multiplier": 1.0,
        }
        assert isinstance(server["base"], float)
        assert isinstance(server["multiplier"], float)
        for file in COSTMAPS:
            costmaps = load(repository / "config" / file)
            assert set(costmaps) == {"local_costmap", "global_costmap"}
            for name, above in costmaps.items():
                parameters = above[name]["ros__parameters"]
                if name == "global_costmap":
                    assert parameters["rolling_window"] is True
                    # ROS refuses a width that is no integer.
                    assert type(parameters["width"]) is type(parameters["height"]) is int
                (filter_name,) = parameters["filters"]
                soil = parameters[filter_name]
                assert soil["plugin"] == "nav2_costmap_2d::KeepoutFilter"
                assert soil["enabled"] is True
                assert soil["filter_info_topic"] == f"/{server['filter_info_topic']}"
                assert isinstance(soil["transform_tolerance"], float)

    @pytest.mark.parametrize(
        ("file", "resolution", "gone", "share"),
        [
            # Wherever the robot has gone in the grid's window since.
            ("nav2_costmaps_without_map.yaml", None, 0.0, 1.0),
            ("nav2_costmaps_without_map.yaml", None, 8.0, 1.0),
            # N17: the other file, in silence.
            ("nav2_costmaps.yaml", 0.05, 0.0, 0.06),
            ("nav2_costmaps.yaml", 0.1, 0.0, 0.56),
        ],
    )
    def test_what_arrives_without_a_static_layer(
        self, repository: Path, file: str, resolution: float | None, gone: float, share: float
    ) -> None:
        above = load(repository / "config" / file)["global_costmap"]["global_costmap"]
        parameters = above["ros__parameters"]
        assert "static_layer" not in parameters.get("plugins", ())
        side = resolution or parameters["resolution"]
        settings = CostSettings()
        ground = CrossedGround(settings.size, settings.resolution)
        ground.follow(3.21, -4.56)
        mask = ground.grid("odom")
        mask.cells[:] = np.random.default_rng(1).integers(0, 101, mask.cells.shape)
        corner = 3.21 + gone - parameters["width"] / 2, -4.56 - parameters["height"] / 2
        wanted = under(mask, corner, side, round(parameters["width"] / side))
        # LayeredCostmap and KeepoutFilter 1.3.13, where no layer touches anything: as many cells are worked
        # out as the mask has, from the costmap's own corner (KeepoutFilter::updateBounds).
        costmap = np.full_like(wanted, -1)
        rows, columns = mask.cells.shape
        costmap[:rows, :columns] = wanted[:rows, :columns]
        known = wanted >= 0
        assert known.mean() > 0.4
        assert np.mean(costmap[known] == wanted[known]) == pytest.approx(share, abs=0.01)


def under(mask: Grid, corner: tuple[float, float], side: float, count: int) -> np.ndarray:
    """The mask's cells under the middles of a costmap's, -1 where there are none."""
    middles = side * (np.arange(count) + 0.5)
    row, column = (
        np.floor((start + middles - origin) / mask.resolution).astype(int)
        for start, origin in zip(corner[::-1], mask.origin[::-1], strict=True)
    )
    cells = np.pad(mask.cells, 1, constant_values=-1)
    inside = [
        np.clip(index + 1, 0, length + 1)
        for index, length in zip((row, column), mask.cells.shape, strict=True)
    ]
    return cells[np.ix_(*inside)]


def paths_in(layout: Any) -> Iterator[str]:
    for panel in layout["configById"].values():
        yield from (path["value"] for path in panel.get("paths", ()))
        yield from (panel[key] for key in ("topicPath", "topicToRender") if key in panel)
        yield from panel.get("topics", ())


def panels_in(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        assert tree["direction"] in ("row", "column")
        yield from panels_in(tree["first"])
        yield from panels_in(tree["second"])


class TestPictures:
    def test_rviz_looks_at_what_the_node_publishes(self, repository: Path) -> None:
        displays = load(repository / "config" / "mobility.rviz")["Visualization Manager"][
            "Displays"
        ]
        topics = {d["Topic"]["Value"]: d["Topic"] for d in displays if "Topic" in d}
        assert set(topics) <= set(OUTPUTS) | INPUTS
        assert f"{NODE}/markers" in topics
        # In the palette "costmap" the dearest ground has the colour of obstacles.
        assert {d["Color Scheme"] for d in displays if d["Name"] == "Cost of the ground"} == {"map"}
        # A grid that is published once in a while is missed without this.
        assert topics[f"{NODE}/cost"]["Durability Policy"] == "Transient Local"

    def test_foxglove_paths_are_fields_of_the_messages(self, repository: Path) -> None:
        layout = json.loads((repository / "config" / "foxglove_layout.json").read_text())
        assert sorted(panels_in(layout["layout"])) == sorted(layout["configById"])
        panels = layout["configById"]
        assert all("foxglovePanelTitle" in panels[n] for n in panels if n.startswith("Plot!"))
        assert "/odom" not in panels["3D!ground"]["topics"]
        definitions = message_definitions()
        found = 0
        for path in paths_in(layout):
            topic, _, rest = re.sub(r"\{.*?\}", "", path).partition(".")
            assert topic in OUTPUTS or topic in INPUTS, path
            for flag in re.findall(r"\{(\w+)==true\}", path):
                definition = definitions[f"smallwheel_ros/msg/{OUTPUTS[topic]}"]
                assert re.search(rf"^bool {flag}\b", definition, re.MULTILINE), path
            # What is not valid is 0 in the message, and no point in the plot.
            assert "_valid==true" in path or not topic.endswith("/mobility"), path
            if rest:
                definition = definitions[f"smallwheel_ros/msg/{OUTPUTS[topic]}"]
                assert re.search(rf"^\w+ {rest}\b", definition, re.MULTILINE), path
                found += 1
        assert found > 10

    def test_plotjuggler_curves_are_fields_of_the_messages(self, repository: Path) -> None:
        layout = ElementTree.parse(repository / "config" / "plotjuggler_layout.xml")
        curves = [curve.attrib["name"] for curve in layout.iter("curve")]
        assert len(curves) > 10
        for curve in curves:
            topic, _, field = curve.rpartition("/")
            definition = message_definitions()[f"smallwheel_ros/msg/{OUTPUTS[topic]}"]
            assert re.search(rf"^\w+ {field}\b", definition, re.MULTILINE), curve
        # What is not known is 0, which a line would be drawn to.
        for plot in layout.iter("plot"):
            names = {curve.attrib["name"].split("/")[-2] for curve in plot.iter("curve")}
            assert plot.attrib["style"] == ("Dots" if names & {"mobility", "vehicle"} else "Lines")
        # As many places as it says there are, and shares of one whole.
        for splitter in layout.iter("DockSplitter"):
            sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
            assert len(splitter) == int(splitter.attrib["count"]) == len(sizes)
            assert sum(sizes) == pytest.approx(1.0)


@pytest.mark.parametrize("name", LAUNCH_FILES)
class TestLaunch:
    def source(self, repository: Path, name: str) -> str:
        return (repository / "launch" / f"{name}.launch.py").read_text()

    def calls(self, text: str, function: str) -> list[ast.Call]:
        return [
            node
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == function
        ]

    def texts(self, call: ast.Call) -> list[str]:
        return [n.value for n in ast.walk(call) if isinstance(n, ast.Constant) and n.value]

    def declared(self, repository: Path, name: str) -> set[str]:
        calls = self.calls(self.source(repository, name), "DeclareLaunchArgument")
        return {ast.literal_eval(call.args[0]) for call in calls}

    def test_every_argument_that_is_used_is_declared(self, repository: Path, name: str) -> None:
        used = self.calls(self.source(repository, name), "LaunchConfiguration")
        declared = self.declared(repository, name)
        assert {ast.literal_eval(call.args[0]) for call in used} == declared
        assert "params_file" in declared
        assert "namespace" in declared or name == "replay"

    def test_files_and_executables_exist(self, repository: Path, name: str) -> None:
        text = self.source(repository, name)
        for call in self.calls(text, "PathJoinSubstitution"):
            parts = [part for part in self.texts(call) if part != "smallwheel_ros"]
            if parts[0] in ("config", "launch"):
                assert repository.joinpath(*parts).is_file(), parts
        build = (repository / "CMakeLists.txt").read_text()
        for call in self.calls(text, "Node"):
            values = {
                k.arg: k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)
            }
            if values["package"] == "smallwheel_ros":
                assert re.search(rf"foreach\(name [^)]*{values['executable']}", build)

    def test_included_files_get_arguments_that_they_have(self, repository: Path, name: str) -> None:
        for call in self.calls(self.source(repository, name), "IncludeLaunchDescription"):
            (file,) = [text for text in self.texts(call) if text.endswith(".launch.py")]
            (given,) = [n for n in ast.walk(call) if isinstance(n, ast.Dict)]
            keys = {ast.literal_eval(key) for key in given.keys if key is not None}
            assert keys <= self.declared(repository, file.removesuffix(".launch.py"))

    def test_it_makes_a_description(self, repository: Path, name: str) -> None:
        """Where launch is installed (Ubuntu): the file runs."""
        if importlib.util.find_spec("launch_ros") is None:
            pytest.skip("needs launch_ros")
        module = runpy.run_path(str(repository / "launch" / f"{name}.launch.py"))
        assert module["generate_launch_description"]().entities


class _Anything(ModuleType):
    """A module of launch that has whatever is asked of it."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **given: SimpleNamespace(**given)


@pytest.mark.parametrize("there", [False, True])
def test_parameters_that_are_missing_are_named(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    """N24: launch leaves a file out that is not there, and the node says that it has no wheels."""
    for name in ("launch", "launch_ros"):
        for part in ("", ".actions", ".substitutions", ".parameter_descriptions"):
            monkeypatch.setitem(sys.modules, f"{name}{part}", _Anything(f"{name}{part}"))
    module = runpy.run_path(str(repository / "launch" / "mobility_estimator.launch.py"))
    file = tmp_path / "rover.yaml"
    if there:
        file.write_text("")
    given = {"params_file": str(file), "remaps": "", "tf": "/tf", "respawn": "false"}
    make = module["_node"]
    make.__globals__["LaunchConfiguration"] = lambda name: SimpleNamespace(
        perform=lambda _: given.get(name)
    )
    if there:
        (node,) = make(None)
        assert node.parameters[0] == str(file)
        return
    with pytest.raises(
        FileNotFoundError, match=r"params_file:=.*rover\.yaml: there is no such file"
    ):
        make(None)


def test_installed_files_are_those_of_the_checkout(repository: Path) -> None:
    """CMake installs the two folders whole."""
    build = (repository / "CMakeLists.txt").read_text()
    assert re.search(r"install\(\s*DIRECTORY config launch\s", build)
    assert {p.name.removesuffix(".launch.py") for p in (repository / "launch").glob("*.py")} == set(
        LAUNCH_FILES
    )
