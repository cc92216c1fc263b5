# SPDX-License-Identifier: Apache-2.0
"""Wheels that steer (`steering.py`): slip, slip angle and course, and an angle that does not come.

The drives are those of `steered_drives`, which knows kinematics alone.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from rows_of_drives import FirstStages
from steered_drives import CAR, FOUR, ROVER, SIX_OF_SIX, bend, crab, spot, steered_drive, weave

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import mobility_columns

WAYS = {
    "radius 1.5 m": (bend(1.5), ROVER),
    "radius 0.8 m": (bend(0.8), ROVER),
    "crab at 30 degrees": (crab(math.radians(30.0)), SIX_OF_SIX),
    "on the spot": (spot(), ROVER),
    "weaving": (weave(), ROVER),
    "car": (weave(), CAR),
    "double Ackermann": (weave(), FOUR),
}


@pytest.mark.parametrize(("odometry", "arm"), [("own", 0.0), ("own", 0.05), ("pose", 0.05)])
@pytest.mark.parametrize("name", WAYS)
def test_slip_of_steered_wheels_has_no_bias(name, arm, odometry) -> None:
    if name == "on the spot" and odometry == "pose":
        pytest.skip("places of a vehicle that turns on the spot do not move")
    way, wheels = WAYS[name]
    drive = steered_drive(way, wheels, seconds=18.0, arm=arm, odometry=odometry)
    _, rows, estimates = drive.run()
    off = drive.error(rows).astype(float)
    assert np.abs(off.mean(axis=1)).max() < 0.005
    assert np.sqrt((off**2).mean(axis=1)).max() < 0.015
    late = rows.stamp > drive.stamps[0] + 5 * SECOND
    assert np.abs(rows.slip_angle[late]).max() < (0.05 if odometry == "own" else 0.2)
    if name.startswith("crab"):
        assert np.abs(rows.course[late] - math.radians(30.0)).max() < 0.02
        assert np.abs(rows.vehicle_speed[late] - 0.3).max() < 0.01
    assert set(np.unique(estimates.wheel)) == set(range(len(wheels)))


def test_without_its_steering_joints_the_same_drive_is_off() -> None:
    drive = steered_drive(bend(0.8), ROVER, seconds=25.0, given=False)
    _, rows, _ = drive.run(kind=FirstStages)
    assert np.abs(drive.error(rows).astype(float).mean(axis=1)).max() > 0.08


def test_crab_without_a_speed_aside_goes_by_the_wheels() -> None:
    drive = steered_drive(crab(0.5), FOUR, seconds=25.0, linear_y=False)
    _, rows, _ = drive.run(kind=FirstStages)
    assert np.abs(drive.error(rows).astype(float).mean(axis=1)).max() < 0.005


def test_an_angle_that_does_not_come_makes_that_wheel_unknown_and_no_other() -> None:
    drive = steered_drive(weave(), ROVER, seconds=15.0)
    rows = dict(drive.rows)
    del rows["front_left/steering"]
    pipeline, readings, estimates = replace(drive, rows=rows).run()
    late = readings.stamp > drive.stamps[0] + 5 * SECOND
    known = np.isfinite(readings.slip[late])
    assert not known[readings.wheel[late] == 0].any()
    assert known[readings.wheel[late] != 0].all()
    texts = mobility_columns(estimates, pipeline)["status_text"]
    assert any("no steering angle of this wheel" in text for text in texts)
