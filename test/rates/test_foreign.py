# SPDX-License-Identifier: Apache-2.0
"""The rover of another author: it shares nothing with the package, and its truth keeps its own laws."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rates import foreign_rover
from rates.foreign import WORLDS, judged
from rates.foreign_rover import GRAVITY, WHEELS, driven

SHORT = {
    name: replace(WORLDS[name], distance=5.0) for name in ("plain", "hardpan", "no soil sensors")
}


@pytest.fixture(scope="module")
def drive():
    return driven(SHORT["plain"], 3)


def test_the_simulator_imports_nothing_of_the_package() -> None:
    tree = ast.parse(Path(foreign_rover.__file__).read_text(encoding="utf-8"))
    names = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in names} <= {
        "__future__",
        "dataclasses",
        "typing",
        "numpy",
    }


def test_a_vehicle_that_rolls_evenly_pulls_what_its_slope_asks_for(drive) -> None:
    truth = drive.truth
    steady = (np.abs(truth.gain) < 0.02) & (truth.speed > 0.2) & (truth.path > 1.0)
    asked = truth.mass * GRAVITY * np.sin(truth.climb) + truth.mass * truth.gain
    off = (truth.pull.sum(axis=1) - asked)[steady]
    assert steady.sum() > 50
    # Turning, inner and outer wheels slip apart, and the slip follows with 0.15 s.
    assert np.abs(np.median(off)) < 0.02 * truth.mass * GRAVITY
    weight = truth.mass * GRAVITY * np.cos(truth.climb) * np.cos(truth.across)
    assert truth.load.sum(axis=1) == pytest.approx(weight, rel=0.05)


def test_slip_is_what_rims_and_ground_make_it(drive) -> None:
    truth, aside = drive.truth, np.array([wheel.y for wheel in WHEELS])
    ground = truth.speed[:, None] - truth.yaw_rate[:, None] * aside
    drives = (truth.rim > 0.1) & (truth.rim > ground)
    assert (1.0 - ground / np.where(drives, truth.rim, 1.0))[drives] == pytest.approx(
        truth.slip[drives]
    )


def test_sensors_show_the_truth_but_for_their_noise(drive) -> None:
    stamps, moves = drive.rows["odom"]
    i = drive.at(stamps)
    assert np.std(moves[:, 0] - drive.truth.speed[i]) == pytest.approx(0.012, rel=0.4)
    stamps, turned = drive.rows["front_left/wheel_speed"]
    assert np.median(np.abs(turned[:, 0] - drive.truth.turned[drive.at(stamps), 0])) < 0.1
    share = stamps.size / (drive.truth.time[-1] / 0.02)
    assert share == pytest.approx(1.0 - drive.world.lost, abs=0.03)


def test_a_seed_is_a_drive(drive) -> None:
    again = driven(SHORT["plain"], 3)
    assert np.array_equal(again.rows["imu"][1], drive.rows["imu"][1])
    assert driven(SHORT["plain"], 4).truth.soil != drive.truth.soil


@pytest.mark.parametrize("name", list(SHORT))
def test_a_drive_is_judged(name: str) -> None:
    line = judged(driven(SHORT[name], 3))
    assert json.loads(json.dumps(line)) == line
    assert line["length"] == pytest.approx(5.0, abs=0.03)
    assert line["counts"]["slip"] > 100
    assert ("sinkage" in line["counts"]) == (name != "no soil sensors")


@pytest.mark.parametrize("seed", [22, 35])
def test_slip_that_grows_as_wheels_start_is_no_late_odometry(seed: int) -> None:
    """A lag of 0.25 to 0.3 s explains the speed best: correlation 0.89 and 0.96."""
    ground = replace(WORLDS["gives way slowly"], distance=8.0)
    assert judged(driven(ground, seed))["accused"] == []
