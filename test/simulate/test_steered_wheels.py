# SPDX-License-Identifier: Apache-2.0
"""Steered wheels of the truth simulator (`steered_wheels.py`): they roll, and a drive of them is replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smallwheel_ros.simulate.drive import simulate_drive
from smallwheel_ros.simulate.settings import DriveSettings
from smallwheel_ros.simulate.steered_wheels import SteeredWheels
from smallwheel_ros.simulate.world import ROVERS, steered

ROVER = ROVERS["six_steered"]
ALL = replace(ROVER, wheels=steered(ROVER.wheels, "front", "middle", "rear"))


def turned(rover, rim: float, turning: float, crab: float = 0.0) -> SteeredWheels:
    wheels = SteeredWheels(rover)
    while not wheels.turn_to(rim, turning, crab, 0.04):
        pass
    return wheels


@pytest.mark.parametrize(
    ("rover", "rim", "turning", "crab"),
    [(ROVER, 0.2, 0.2, 0.0), (ROVER, 0.0, 0.5, 0.0), (ALL, 0.2, 0.0, 0.5), (ALL, 0.2, 0.1, -0.4)],
    ids=["bend", "on the spot", "crab", "crab in a bend"],
)
def test_no_wheel_goes_across_its_heading(rover, rim, turning, crab) -> None:
    wheels = turned(rover, rim, turning, crab)
    ahead, left = wheels.velocities(rim, turning)
    across = left * np.cos(wheels.angle) - ahead * np.sin(wheels.angle)
    along = ahead * np.cos(wheels.angle) + left * np.sin(wheels.angle)
    assert np.abs(across).max() < 1e-9
    assert along == pytest.approx(wheels.share * rim + wheels.lever * turning)
    assert np.abs(along).min() > 0.05


def test_wheels_turn_at_rest_before_the_vehicle_turns_on_the_spot() -> None:
    wheels = SteeredWheels(ROVER)
    assert not wheels.turn_to(0.0, 0.5, 0.0, 0.04)
    assert np.abs(wheels.angle).max() == pytest.approx(0.8 * 0.04)
    assert (wheels.angle[2:4] == 0.0).all()


def test_a_steered_drive_records_the_angles_that_its_way_needs() -> None:
    drive = simulate_drive(
        DriveSettings(seed=2, distance=6.0, terrain="single", wheels="six_steered")
    )
    truth = drive.truth
    moves = np.abs(truth.speed) > 0.05
    radius = truth.speed[moves] / np.where(truth.rate[moves] == 0.0, np.nan, truth.rate[moves])
    for j, wheel in enumerate(drive.rover.wheels):
        if wheel.steered:
            true = np.arctan(wheel.x / (radius - wheel.y))
            off = np.abs(truth.steering[moves, j] - true)
            # Slip makes the vehicle a little slower than the rims that the wheels were turned for.
            assert np.nanmedian(off) < 0.05
            _, shown = drive.rows[f"{wheel.name}/steering"]
            assert np.abs(shown[:, 0]).max() > 0.1
    assert drive.rows["odom"][1].shape[1] == 11
