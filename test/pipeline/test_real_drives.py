# SPDX-License-Identifier: Apache-2.0
"""The front half over drives of real robots: how often slip is known, and how often it is in its band.

The drives are not part of the repository: without the recorded data the tests skip.
"""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.tables import Readings
from smallwheel_ros.replay.recording import turns_of

DRIVES = {
    "warthog_grass": ("warthog", "icp_odom"),
    "warthog_grass_pose_only": ("warthog", "icp_odom"),
    "warthog_sand1": ("warthog", "icp_odom"),
    "pathfinder_flat": ("pathfinder", "gnss/odom"),
    "husky_snow": ("husky", "husky_velocity_controller/odom"),
}


@pytest.fixture
def drives(shared_data: Path) -> Path:
    """The folder of the real drives."""
    return shared_data / "real_drives"


@cache
def _readings(folder: Path, name: str) -> Readings:
    robot, odometry = DRIVES[name]
    settings = settings_from(read_parameters(str(folder / f"{robot}.yaml")))
    turns = turns_of(folder / name, settings, remap={"odom": odometry})
    return Readings.joined([turn.readings for turn in turns])


@cache
def _truth(folder: Path, name: str) -> list[tuple[float, int, float]]:
    """Stamp (s), wheel and slip, where the ground's speed is one that such a vehicle has.

    Lidar poses jump: what is over twice the rim's speed is no driving.
    """
    found = []
    with (folder / f"{name}_truth.csv").open() as file:
        for stamp, side, rim, ground, slip in list(csv.reader(file))[1:]:
            if abs(float(ground)) <= 2.0 * abs(float(rim)) + 0.3 and np.isfinite(float(slip)):
                found.append((float(stamp), 0 if side == "left" else 1, float(slip)))
    return found


def _known(rows: Readings) -> float:
    """Share of the time in which rims move at over 0.15 m/s in which slip is known."""
    return float(np.isfinite(rows.slip[np.abs(rows.rim_speed) > 0.15]).mean())


def _in_band(rows: Readings, truth: list[tuple[float, int, float]]) -> float:
    """Share of the true slips in the 95 % band of the nearest row within 0.15 s."""
    inside = []
    for stamp, wheel, slip in truth:
        mine = np.flatnonzero((rows.wheel == wheel) & np.isfinite(rows.slip))
        i = mine[np.abs(rows.stamp[mine] / SECOND - stamp).argmin()]
        if abs(rows.stamp[i] / SECOND - stamp) < 0.15:
            inside.append(abs(rows.slip[i] - slip) <= 1.96 * rows.slip_std[i])
    assert len(inside) > 50
    return float(np.mean(inside))


@pytest.mark.parametrize(
    "name", ["warthog_grass", "warthog_grass_pose_only", "warthog_sand1", "pathfinder_flat"]
)
def test_slip_is_known_while_the_vehicle_moves(drives: Path, name: str) -> None:
    known = _known(_readings(drives, name))
    print(f"{name}: slip known in {known:.3f} of the moving time")
    assert known > 0.85


@pytest.mark.parametrize("name", ["warthog_grass", "warthog_sand1"])
def test_slip_is_in_its_band(drives: Path, name: str) -> None:
    share = _in_band(_readings(drives, name), _truth(drives, name))
    print(f"{name}: {share:.3f} of true slips in the band")
    assert share > 0.85


def test_odometry_of_the_wheels_shows_no_slip_on_snow(drives: Path) -> None:
    rows = _readings(drives, "husky_snow")
    seconds = (rows.stamp - rows.stamp[0]) / SECOND
    assert np.isnan(rows.slip[seconds > 60.0]).all()


def test_an_imu_that_looks_down_feels_gravity_up(drives: Path) -> None:
    assert np.nanmedian(_readings(drives, "pathfinder_flat").vertical) == pytest.approx(
        9.8, abs=0.1
    )
