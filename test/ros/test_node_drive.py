# SPDX-License-Identifier: Apache-2.0
"""The node over real DDS: a bag through it, against the library called directly.

Tests `play.py`.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_kinds import beginning

from smallwheel_ros.bags import BagReader
from smallwheel_ros.drive.messages import status_texts
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.ros import NodeProcess
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

pytestmark = pytest.mark.dds


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive's first seconds: it stands, sets off and rolls."""
    folder = tmp_path_factory.mktemp("bags")
    drive = simulate_drive(DriveSettings(seed=5, distance=2.0, wheels="two_sizes"))
    write_drive_bag(drive, folder / "whole")
    return beginning(folder / "whole", folder / "drive", 7.0)


@pytest.fixture
def rover(repository: Path) -> Path:
    return repository / "config" / "two_wheel_sizes.yaml"


def directly(bag: Path, parameters: Path) -> tuple[Pipeline, Estimates, list[str]]:
    """Give the bag's messages to the library, in the order of recording: estimates, status in words."""
    settings = settings_from(read_parameters(parameters))
    pipeline = Pipeline(settings.onboard)
    add = pipeline.streams.add
    wheel_of = {inputs.joint: wheel for wheel, inputs in settings.inputs.items()}
    found: list[Estimates] = []
    words: list[str] = []
    with BagReader(bag) as reader:
        for topic, _, _, message in reader.messages():
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            if topic.endswith("/load"):
                add(topic[1:], stamp, (message.wrench.force.z,))
            elif topic.endswith("/sinkage"):
                add(topic[1:], stamp, (message.sinkage, message.variance))
            elif topic == "/odom":
                place, twist = message.pose.pose.position, message.twist.twist
                q, spread = message.pose.pose.orientation, message.twist.covariance
                yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
                pitch = math.asin(2.0 * (q.w * q.y - q.z * q.x))
                roll = math.atan2(2.0 * (q.w * q.x + q.y * q.z), 1.0 - 2.0 * (q.x**2 + q.y**2))
                moves = (twist.linear.x, twist.angular.z, place.x, place.y)
                turned = (math.cos(yaw), math.sin(yaw), spread[0], spread[35], pitch, roll)
                add("odom", stamp, (*moves, *turned))
            elif topic == "/joint_states":
                for name, velocity in zip(message.name, message.velocity, strict=True):
                    add(f"{wheel_of[name]}/wheel_speed", stamp, (float(velocity),))
    for turn in pipeline.turns(last=True):
        found.append(turn.estimates)
        words += status_texts(turn.estimates, pipeline)
    return pipeline, Estimates.joined(found), words


# Quantities of the message that are not called so in the table.
CALLED = {"sinkage_predicted": "sinkage", "mobility_margin": "margin", "energy_per_metre": "energy"}
QUANTITIES = (
    "load", "slip", "sinkage_measured", "sinkage_predicted", "compaction_resistance", "other_resistance",
    "rolling_resistance_coefficient", "thrust", "drawbar_pull", "mobility_margin", "steepest_slope",
    "energy_per_metre",
)  # fmt: skip
FLAGS = {
    "load_valid": "load",
    "slip_valid": "slip",
    "sinkage_measured_valid": "sinkage_measured",
    "prediction_valid": "sinkage",
    "traction_valid": "drawbar_pull",
    "margin_valid": "margin",
    "energy_valid": "energy",
}


def expected_row(found: Estimates, i: int, text: str, wheels: list[str]) -> dict[str, Any]:
    """What the message of an estimate must say, written out here once more."""

    def of(column: str) -> float:
        return float(np.nan_to_num(getattr(found, column)[i]))

    row: dict[str, Any] = {
        "stamp": int(found.stamp[i]),
        "frame_id": wheels[found.wheel[i]],
        "status": int(found.status[i]),
        "status_text": text,
        "wheel": wheels[found.wheel[i]],
        "slip_angle": 0.0,
        "steering_angle": 0.0,
        "probability_drawbar_pull_positive": of("probability_drawbar_pull_positive"),
    }
    row |= {flag: not math.isnan(getattr(found, name)[i]) for flag, name in FLAGS.items()}
    for name in QUANTITIES:
        column, known = (
            CALLED.get(name, name),
            not math.isnan(getattr(found, CALLED.get(name, name))[i]),
        )
        row[name] = of(column)
        row[f"{name}_standard_deviation"] = of(f"{column}_std") if known else 0.0
    return row


def assert_same_row(found: dict[str, Any], expected: dict[str, Any]) -> None:
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        if isinstance(value, float):
            assert np.isfinite(found[name]), name
            assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-15), name
        else:
            assert found[name] == value, name


def test_a_drive_over_dds_gives_what_the_library_gives(
    bag: Path, rover: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.msg import SoilEstimate

    from smallwheel_ros.ros.play import drive_through

    pipeline, expected, texts = directly(bag, rover)
    wheels = [wheel.name for wheel in pipeline.settings.wheels]
    parameters = [rover]
    log = tmp_path / "node.log"
    with NodeProcess(parameters, log, {"use_sim_time": "true"}) as node:
        first = drive_through(bag, rate=16.0, alive=node.death)
        assert node.death() is None
        assert first.sinkages == len(expected)
        assert first.unanswered == 0
        assert first.published == message_count(bag)
        # Answers come in one order, that of the stamps, whatever DDS did to the topics.
        assert len(first.mobility) == len(expected)
        for i, row in enumerate(first.mobility):
            assert_same_row(row, expected_row(expected, i, texts[i], wheels))

        last, soil = first.soil[-1], pipeline.soil
        assert last["stamp"] == expected.stamp[-1]
        assert last["frame_id"] == "odom"
        assert (last["k"], last["n"], last["m"]) == pytest.approx(
            (soil.k, soil.n, soil.m), rel=1e-9
        )
        np.testing.assert_allclose(last["covariance"], soil.covariance.ravel(), rtol=1e-9)
        modulus, deviation = soil.effective_modulus()
        assert last["effective_modulus"] == pytest.approx(modulus, rel=1e-9)
        assert last["effective_modulus_standard_deviation"] == pytest.approx(deviation, rel=1e-9)
        assert last["reference_pressure"] == pytest.approx(soil.reference_pressure, rel=1e-9)
        assert last["measurements_accepted"] == soil.accepted
        assert last["measurements_rejected"] == pipeline.rejected
        assert last["m_identifiable"] == soil.identifiable.m
        # Before the first measurement the soil is the configured one.
        assert first.soil[0]["status"] == SoilEstimate.STATUS_PRIOR_ONLY
        assert last["status"] == SoilEstimate.STATUS_OK
        stamps = [row["stamp"] for row in first.soil[1:]]
        assert stamps == sorted(set(stamps))
        assert any("inputs" in name for name in first.diagnostics)
        assert sum("wheel" in name for name in first.diagnostics) == 4

        # Whoever comes late gets the newest soil: drive_through waits for one before it plays, and
        # the same bag once more is a time that jumps back, after which all begins anew.
        again = drive_through(bag, rate=16.0, alive=node.death)
        for name in ("stamp", "k", "n", "m", "measurements_accepted", "status_text"):
            assert again.soil[0][name] == last[name]
        # A message or two may come before /clock has gone back, and are refused as too old.
        assert len(expected) - 3 <= len(again.mobility) <= len(expected)
        # What they tell is lost: n is another one, within what is not known of it two borders after a metre.
        spread = math.sqrt(last["covariance"][4])
        assert again.soil[-1]["n"] == pytest.approx(last["n"], abs=spread)
        assert again.soil[-1]["measurements_accepted"] <= last["measurements_accepted"]
    assert "time went back by" in log.read_text()
    assert "Traceback" not in log.read_text()


def message_count(bag: Path) -> int:
    with BagReader(bag) as reader:
        return reader.message_count


def test_a_node_that_dies_is_one_clear_message(bag: Path, tmp_path: Path) -> None:
    from smallwheel_ros.ros.play import PlayError, drive_through

    bad = tmp_path / "bad.yaml"
    bad.write_text(
        "/**:\n  ros__parameters:\n    wheels: [a]\n    a: {diameter: 0.0, width: 0.1}\n"
    )
    with (
        NodeProcess([bad], tmp_path / "node.log") as node,
        pytest.raises(PlayError, match=r"has died: exit code 2; .*a\.diameter is 0\.0"),
    ):
        drive_through(bag, alive=node.death)


def test_play_publishes_everything(bag: Path, ros_domain: int) -> None:
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from rclpy.qos import QoSProfile
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu, JointState
    from smallwheel_ros.msg import WheelSinkage

    with BagReader(bag) as reader:
        expected = {topic.name: topic.message_count for topic in reader.topics}
        # At most 100 Hz of the bag's time.
        ticks: list[int] = []
        for raw in reader.raw_messages():
            if not ticks or raw.log_time >= ticks[-1] + 10_000_000:
                ticks.append(raw.log_time)
    kinds = {"load": WrenchStamped, "sinkage": WheelSinkage, "odom": Odometry, "imu": Imu}
    received: Counter[str] = Counter()
    clocks: list[int] = []
    rclpy.init(args=[])
    command = [sys.executable, "-m", "smallwheel_ros.cli", "play", str(bag)]
    process = subprocess.Popen(
        [*command, "--rate", "4", "--wait", "120"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    node = Node("listener")
    try:

        def count(name: str) -> Callable[[Any], None]:
            return lambda _: received.update([name])

        for name in expected:
            kind = kinds.get(name.rsplit("/", 1)[1], JointState)
            node.create_subscription(kind, name, count(name), QoSProfile(depth=5000))
        node.create_subscription(
            Clock,
            "/clock",
            lambda m: clocks.append(m.clock.sec * 10**9 + m.clock.nanosec),
            QoSProfile(depth=5000),
        )
        total = sum(expected.values())
        deadline = time.monotonic() + 300.0
        while (received.total() < total or len(clocks) < len(ticks)) and process.poll() in (
            None,
            0,
        ):
            assert time.monotonic() < deadline, f"{received} of {expected}, {len(clocks)} ticks"
            rclpy.spin_once(node, timeout_sec=0.05)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
        node.destroy_node()
        rclpy.try_shutdown()
    assert process.returncode == 0, err
    assert f"{total} messages published" in out
    assert dict(received) == expected
    assert clocks == ticks
