# SPDX-License-Identifier: Apache-2.0
"""`feed` of joint states as robots have them: without velocities, with velocities of 0, of two publishers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.replay.recording import Recording
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

JOINTS = "/joint_states"
Change = Callable[[Any, Any], Iterator[Any]]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive"
    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=6.0)), path)
    return path


def _as(message: Any, **changes: Any) -> Any:
    return type(message)(**{**vars(message), **changes})


def positions_only(message: Any, turned: Any) -> Iterator[Any]:
    yield _as(message, position=turned, velocity=np.empty(0))


def in_a_turn(message: Any, turned: Any) -> Iterator[Any]:
    yield _as(message, position=(turned + np.pi) % (2.0 * np.pi) - np.pi, velocity=np.empty(0))


def always_0(message: Any, turned: Any) -> Iterator[Any]:
    yield _as(message, position=turned, velocity=0.0 * message.velocity)


def in_rpm(message: Any, turned: Any) -> Iterator[Any]:
    yield _as(message, position=turned, velocity=message.velocity * 30.0 / np.pi)


def in_metres(message: Any, turned: Any) -> Iterator[Any]:
    yield _as(message, position=turned, velocity=message.velocity * 0.125)


def and_a_second_one(message: Any, turned: Any) -> Iterator[Any]:
    yield _as(message, position=turned)
    later = _as(message.header.stamp, nanosec=message.header.stamp.nanosec + 1000)
    head = _as(message.header, stamp=later)
    yield _as(message, header=head, position=0.0 * turned, velocity=np.empty(0))


def replayed(bag: Path, rover: Path) -> tuple[Estimates, Pipeline]:
    settings = settings_from(read_parameters(rover))
    with BagReader(bag) as reader:
        pipeline = Pipeline(settings.onboard)
        recording = Recording(reader, settings, pipeline)
        found = [turn.estimates for turns in recording.turns() for turn in turns]
    return Estimates.joined(found), pipeline


@pytest.fixture(scope="module")
def true(bag: Path, repository: Path) -> Estimates:
    """Estimates of the drive as it is."""
    return replayed(bag, repository / "config" / "four_wheels.yaml")[0]


def rewritten(bag: Path, target: Path, change: Change) -> Path:
    """The drive with other joint states. turned: integrals of the velocities (rad)."""
    turned, before = 0.0, None
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for topic, kind, time, message in reader.messages():
            found: Iterator[Any] = iter([message])
            if topic == JOINTS:
                stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
                turned = turned + message.velocity * (stamp - (before or stamp))
                before, found = stamp, change(message, turned)
            for one in found:
                writer.write(topic, kind, time, one)
    return target


@pytest.mark.parametrize("change", [positions_only, in_a_turn, always_0, and_a_second_one])
def test_slip_is_right_whatever_joint_states_lack(
    change: Change, bag: Path, true: Estimates, repository: Path, tmp_path: Path
) -> None:
    rover = repository / "config" / "four_wheels.yaml"
    found, pipeline = replayed(rewritten(bag, tmp_path / "drive", change), rover)
    late = found.distance > 1.0
    known = np.isfinite(found.slip[late])
    assert known.mean() > 0.95 * np.isfinite(true.slip[true.distance > 1.0]).mean()
    expected = np.median(true.slip[np.isfinite(true.slip) & (true.distance > 1.0)])
    assert np.median(found.slip[late][known]) == pytest.approx(expected, abs=0.02)
    reasons = {reason for _, reason in pipeline.problems}
    if change is and_a_second_one:
        assert reasons == {"no_value"}
        assert any(
            "50% of the messages" in text and "publisher" in text for text in pipeline.findings
        )
    else:
        assert pipeline.problems[("front_left/wheel_speed", "by_positions")] == 1


@pytest.mark.parametrize("change", [in_rpm, in_metres, always_0])
def test_a_true_0_is_not_held_over_messages_that_are_not_used(
    change: Change, bag: Path, repository: Path, tmp_path: Path
) -> None:
    """A rover stands, and then turns its wheels: what they do from there on is not known."""
    rover = repository / "config" / "four_wheels.yaml"
    found, pipeline = replayed(rewritten(bag, tmp_path / "drive", change), rover)
    known = found.slip[np.isfinite(found.slip)]
    if change is always_0:
        assert known.min() > -0.5
    else:
        assert known.size == 0
        assert pipeline.problems[("front_left/wheel_speed", "velocity_unit")] > 0
