# SPDX-License-Identifier: Apache-2.0
"""`smallwheel node`, and the first lines of the node: short, whole, and none of them twice.

Tests `parameters.py` and `session.py`.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from node_peer import ONE_WHEEL, Peer

from smallwheel_ros.cli import main
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.intake.inputs import topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline

NAMES = st.from_regex(r"[a-z_]{1,30}(\.[a-z_]{1,30})?", fullmatch=True)
VALUES = st.one_of(
    st.floats(allow_nan=False),
    st.integers(),
    st.booleans(),
    st.from_regex(r"[\w/-]{0,80}", fullmatch=True),
)


def vehicle(wheels: dict[str, float], **changes: Any) -> NodeSettings:
    """Settings of a vehicle. wheels: diameters by name; changes: __ for the point."""
    values: dict[str, Any] = {"wheels": list(wheels)}
    for wheel, diameter in wheels.items():
        values |= {f"{wheel}.diameter": diameter, f"{wheel}.width": 0.1}
    values |= {name.replace("__", "."): value for name, value in changes.items()}
    return settings_from(values)


@given(st.dictionaries(NAMES, VALUES, max_size=60))
def test_parameters_come_in_short_lines_and_none_is_lost(changed: dict[str, Any]) -> None:
    pytest.importorskip("rclpy")
    from smallwheel_ros.ros.parameters import parameter_lines

    lines = parameter_lines(changed)
    longest = max((len(f"{name}={value},") for name, value in changed.items()), default=0)
    assert all(len(line) <= max(148, longest + 2) for line in lines)
    text = " ".join(line.strip() for line in lines)
    assert text.startswith("effective parameters")
    assert all(f"{name}={str(value).strip()}" in text for name, value in changed.items())


@pytest.mark.parametrize(
    ("changes", "groups"),
    [
        ({}, {"load": 2, "sinkage": 2, "wheel speed": 1, "odometry": 1}),
        ({"load__source": "static", "vehicle__mass": 20.0}, {"sinkage": 2, "wheel speed": 1, "odometry": 1}),
        (
            {"load__source": "joint_states", "velocity_topic": "/radar", "imu_topic": "/imu"},
            {"sinkage": 2, "wheel speed and load": 1, "odometry": 1, "velocity over ground": 1, "slope": 1},
        ),
        (
            {"a__drawbar_pull_topic": "a/load", "b__range_height": 0.3},
            {"load and drawbar pull": 1, "load": 1, "sinkage": 2, "wheel speed": 1, "odometry": 1},
        ),
        ({"a__contact": "pressed", "b__contact": "pressed"}, {"load": 2, "sinkage": 2}),
    ],
)  # fmt: skip
def test_each_topic_is_waited_for_in_the_line_of_its_group(
    changes: dict[str, Any], groups: dict[str, int]
) -> None:
    pytest.importorskip("rclpy")
    from smallwheel_ros.ros.inputs import input_lines

    settings = vehicle({"a": 0.25, "b": 0.25}, **changes)
    topics = {f"/here/{topic.name}": topic for topic in topics_of(settings)}
    lines = input_lines(topics)
    found: dict[str, int] = {}
    for line in lines:
        what, named = re.fullmatch(r"waits for ([\w ]+): (.*) \([\w/]+\)", line).groups()
        found[what] = found.get(what, 0) + len(named.split(", "))
    assert found == groups
    for topic in topics:
        assert sum(topic in re.split(r"[ ,]+", line) for line in lines) >= 1
    assert len({*lines}) == len(lines)


@pytest.mark.parametrize(
    ("wheels", "changes", "words"),
    [
        ({"a": 0.25}, {}, "estimates n and k D^m of the soil; its strength stays as configured; sin"),
        ({"a": 0.25, "b": 0.4}, {}, "k, n and m of the soil; its strength stays as configured;"),
        ({"a": 0.25}, {"vehicle__mass": 9.0}, "soil and its strength by the balance of the vehicle's"),
        ({"a": 0.25}, {"a__torque_per_effort": 1.0}, "soil and its strength by torque;"),
        (
            {"a": 0.25, "b": 0.4},
            {"a__drawbar_pull_topic": "pull", "vehicle__mass": 9.0},
            "k, n and m of the soil and its strength by the balance of the vehicle's forces and"
            " drawbar pull; sinkage, resistance, thrust and drawbar pull of a, b",
        ),
        (
            {"a": 0.25, "b": 0.4},
            {"odometry_from_wheels": True, "vehicle__mass": 9.0},
            "stays as configured; sinkage and resistance (no slip, thrust, pull: odometry comes from the"
            " wheels) of a, b",
        ),
        ({"a": 0.25}, {"a__sinkage_topic": ""}, "nothing of the soil's law (no sinkage is measured)"),
        ({"a": 0.25, "b": 0.4}, {"b__sinkage_topic": ""}, "estimates n and k D^m of the soil"),
        # U8: what each status says is unknown is not said to be estimated.
        (
            {"a": 0.25},
            {"a__sinkage_topic": ""},
            "estimates nothing of the soil's law (no sinkage is measured); its strength stays as configured;"
            " thrust, drawbar pull and margin (no sinkage, resistance: nothing measures sinkage, and no soil"
            " is named) of a",
        ),
        (
            {"a": 0.25},
            {"a__sinkage_topic": "", "odometry_from_wheels": True},
            "margin (no sinkage, resistance: nothing measures sinkage, and no soil is named; no slip, thrust,"
            " pull: odometry comes from the wheels) of a",
        ),
        (
            {"a": 0.25},
            {"a__sinkage_topic": "", "soil__name": "dry_sand"},
            "drawbar pull (sinkage, resistance: as in the soil that is named) of a",
        ),
        ({"a": 0.2, "b": 0.4}, {"a__contact": "pressed"}, "drawbar pull of b; sinkage of a"),
    ],
)  # fmt: skip
def test_what_is_estimated_goes_by_what_there_is(
    wheels: dict[str, float], changes: dict[str, Any], words: str
) -> None:
    pytest.importorskip("rclpy")
    from smallwheel_ros.ros.inputs import estimates

    settings = vehicle(wheels, **changes).onboard
    assert words in estimates(settings, Pipeline(settings).undeterminable)


# --- The command


def refused(*arguments: str) -> str:
    result = CliRunner().invoke(main, ["node", *arguments])
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.stderr
    return result.stderr


def test_the_command_asks_for_a_file_that_is_there(tmp_path: Path) -> None:
    assert "Missing option '--params-file'" in refused()
    assert "nowhere.yaml' does not exist" in refused("--params-file", "nowhere.yaml")
    assert "is a directory" in refused("--params-file", str(tmp_path))


@pytest.mark.parametrize("module", ["rclpy", "smallwheel_ros.msg"])
def test_without_ros_it_says_how_to_get_it(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if module != "rclpy":
        pytest.importorskip("rclpy")
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / "rover.yaml").write_text(ONE_WHEEL)
    said = refused("--params-file", str(tmp_path / "rover.yaml"))
    assert f"this Python has no {'ROS 2' if module == 'rclpy' else 'messages'}" in said
    assert "run `make env` in a checkout" in said
    assert "source an installation of ROS 2 Jazzy" in said


def test_files_remaps_and_further_arguments_reach_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    from smallwheel_ros.ros import mobility_estimator

    heard: list[list[str]] = []
    monkeypatch.setattr(mobility_estimator, "main", lambda words: heard.append(words) or 0)
    files = [str(tmp_path / name) for name in ("a.yaml", "b c.yaml")]
    for file in files:
        Path(file).write_text(ONE_WHEEL)
    options = ["--params-file", files[0], "--remap", "odom:=/o", "--params-file", files[1]]
    result = CliRunner().invoke(main, ["node", *options, "--", "-p", "use_sim_time:=true"])
    assert result.exit_code == 0, result.output
    wanted = ["--params-file", files[0], "--params-file", files[1], "-r", "odom:=/o"]
    assert heard == [["--ros-args", *wanted, "-p", "use_sim_time:=true"]]


def started(*arguments: str, log: Path) -> subprocess.Popen[bytes]:
    with log.open("w") as stream:
        command = [sys.executable, "-m", "smallwheel_ros", "node", *arguments]
        return subprocess.Popen(command, stdout=stream, stderr=stream)


@pytest.mark.dds
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["surplus"], "cannot start: arguments that ROS does not know: ['surplus']"),
        (["--", "-p", "front.width:=true"], "front.width is bool True, expected a double"),
        (["--", "-p", "x:="], "cannot start: "),
    ],
)
def test_what_ros_is_given_wrongly_ends_it(
    arguments: list[str], words: str, tmp_path: Path
) -> None:
    (tmp_path / "rover.yaml").write_text(ONE_WHEEL)
    log = tmp_path / "log"
    process = started("--params-file", str(tmp_path / "rover.yaml"), *arguments, log=log)
    assert process.wait(60) == 2
    assert words in log.read_text()
    assert "Traceback" not in log.read_text()


@pytest.mark.dds
def test_its_first_lines_are_short_and_none_comes_twice(peer: Peer, tmp_path: Path) -> None:
    (tmp_path / "rover.yaml").write_text(ONE_WHEEL)
    log = tmp_path / "log"
    process = started("--params-file", str(tmp_path / "rover.yaml"), log=log)
    try:
        peer.wait_for_node()
        peer.spin_until(lambda: "still waiting for /odom" in log.read_text(), "what is missing")
        assert "inputs are here" not in log.read_text()
        end = time.monotonic() + 6.0  # a further turn of that timer
        peer.spin_until(lambda: time.monotonic() > end, "time passes")
        peer.drive(0.0, 1.0)
        peer.spin_until(lambda: "inputs are here" in log.read_text(), "all inputs")
        peer.drive(1.0, 2.0)
        peer.wait_for_turn()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    lines = [line.split("]: ", 1)[1] for line in log.read_text().splitlines()]
    assert len({*lines}) == len(lines), lines
    assert [line for line in lines if len(line) > 250] == []
    for topic in ("/front/load", "/front/sinkage", "/joint_states", "/odom"):
        assert sum(line.startswith("waits for ") and topic in line for line in lines) == 1
    (here,) = (line for line in lines if "inputs are here" in line)
    assert here == (
        "all 4 inputs are here: estimates n and k D^m of the soil; its strength stays as configured;"
        " sinkage, resistance, thrust and drawbar pull of front"
    )


@pytest.mark.dds
def test_an_input_that_is_only_refused_is_not_here(peer: Peer, tmp_path: Path) -> None:
    (tmp_path / "rover.yaml").write_text(ONE_WHEEL)
    log = tmp_path / "log"
    process = started("--params-file", str(tmp_path / "rover.yaml"), log=log)
    try:
        peer.wait_for_node()
        peer.drive(0.0, 0.6, load=-60.0)
        peer.spin_until(lambda: "expected more than 0" in log.read_text(), "loads are refused")
        peer.wait_for_turn()
        assert "inputs are here" not in log.read_text()
        peer.drive(0.6, 1.2)
        peer.spin_until(lambda: "all 4 inputs are here" in log.read_text(), "all inputs")
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
