# SPDX-License-Identifier: Apache-2.0
"""A rover that steers: the node over real DDS gives what replay gives, slip angles and course too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smallwheel_ros.drive.messages import mobility_columns, vehicle_columns
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.replay import recording
from smallwheel_ros.ros import NodeProcess
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

pytestmark = pytest.mark.dds

WHEELS = tuple(f"{a}_{b}" for a in ("front", "middle", "rear") for b in ("left", "right"))


def replayed(bag: Path, rover: Path) -> tuple[dict[tuple[str, int], dict[str, Any]], float]:
    """Fields of each message by wheel and stamp, and the largest course."""
    settings = settings_from(read_parameters(rover))
    made: list[Pipeline] = []
    rows, course = {}, 0.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "Pipeline", lambda given: made.append(Pipeline(given)) or made[0])
        for turn in recording.turns_of(bag, settings):
            found = turn.estimates
            columns = mobility_columns(found, made[0])
            for i in range(len(found)):
                key = settings.onboard.wheels[int(found.wheel[i])].name, int(found.stamp[i])
                rows[key] = {name: np.asarray(column)[i] for name, column in columns.items()}
            courses = vehicle_columns(turn.vehicle)["course"]
            course = max(course, float(np.abs(courses).max(initial=0.0)))
    return rows, course


def test_a_steered_rover_in_replay_and_node(repository: Path, tmp_path: Path) -> None:
    from smallwheel_ros.ros.play import drive_through

    drive = simulate_drive(
        DriveSettings(seed=5, distance=2.0, terrain="single", wheels="six_steered")
    )
    write_drive_bag(drive, tmp_path / "drive")
    rover = repository / "config" / "six_wheel_rover.yaml"
    expected, course = replayed(tmp_path / "drive", rover)
    assert {wheel for wheel, _ in expected} == set(WHEELS)
    steered = [row for (wheel, _), row in expected.items() if not wheel.startswith("middle")]
    assert max(abs(row["steering_angle"]) for row in steered) > 0.1
    assert {
        row["steering_angle"] for (w, _), row in expected.items() if w.startswith("middle")
    } == {0.0}
    assert course < 0.2

    with NodeProcess([rover], tmp_path / "node.log", {"use_sim_time": "true"}) as node:
        heard = drive_through(tmp_path / "drive", rate=4.0, alive=node.death)
    assert len(heard.mobility) == len(expected) > 100
    for row in heard.mobility:
        other = expected[row["wheel"], row["stamp"]]
        for name in ("slip", "slip_angle", "steering_angle", "slip_standard_deviation"):
            assert row[name] == pytest.approx(other[name], rel=1e-9, abs=1e-15), name
