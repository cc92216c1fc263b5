# SPDX-License-Identifier: Apache-2.0
"""Numbers to readings: a wheel at an instant, its slip and path, and whose track it rolls in.

Tests `align.py`, `slip.py`, `motion.py` and `passes.py`.
"""

from __future__ import annotations

import numpy as np
import pytest
from rows_of_drives import PLACES, G, drive, readings_of, rover, static_rover


def test_slip_speed_and_path_are_those_of_the_drive() -> None:
    rows = readings_of(rover(), drive(20.0, slip=0.2))
    assert len(rows) > 4 * 25 * 15
    rolling = rows.take(rows.stamp > rows.stamp[0] + 3 * 10**9)
    assert np.nanmedian(rolling.slip) == pytest.approx(0.2, abs=0.01)
    assert np.nanmedian(rolling.speed) == pytest.approx(0.3, abs=0.01)
    # It sets off after a second, and is read up to the last sample.
    assert rows.distance.max() == pytest.approx(0.3 * 19.0, abs=0.1)
    for wheel in range(len(PLACES)):
        path = rows.path[rows.wheel == wheel]
        assert (np.diff(path) > -1e-9).all()
        assert path.max() == pytest.approx(0.3 * 19.0, abs=0.1)


@pytest.mark.parametrize("moved", [0.0, 30.0])
def test_over_a_pause_of_the_recording_the_way_is_what_the_places_show(moved: float) -> None:
    """A recording that was paused at 0.3 m/s for a quarter of an hour had gone 270 m in it."""
    pause = 900 * 10**9
    half = 10 * 10**9
    made = drive(20.0)
    first = made[0][1]
    paused = []
    for name, stamp, values, clock in made:
        later = stamp - first > half
        if later and name != "odom" and stamp - first < half + 3 * 10**8:
            continue  # odometry is the first that comes, as in every second pause
        if later and name == "odom":
            values = (*values[:2], values[2] + moved, *values[3:])
        shift = pause * later
        paused.append((name, stamp + shift, values, None if clock is None else clock + shift))
    rows = readings_of(rover(), paused)
    assert rows.stamp[-1] - rows.stamp[0] > pause
    assert rows.distance.max() == pytest.approx(0.3 * 19.0 + moved, abs=0.3)
    assert rows.path.max() == pytest.approx(0.3 * 19.0 + moved, abs=0.3)


def test_a_wheel_that_stands_has_no_slip_and_is_said_to_stand() -> None:
    rows = readings_of(rover(), drive(6.0, speed=lambda t: 0.0 * t))
    assert np.isnan(rows.slip).all()
    assert rows.path.max() == pytest.approx(0.0, abs=0.01)


def test_rear_wheels_roll_in_the_track_of_front_ones() -> None:
    """Passes before this one."""
    rows = readings_of(rover(), drive(20.0))
    names = list(PLACES)
    late = rows.take(rows.distance > 2.0)
    for wheel, name in enumerate(names):
        passes = late.passes[late.wheel == wheel]
        assert np.nanmedian(passes) == (0.0 if name.startswith("f") else 1.0), name


def test_without_sensors_of_the_soil_there_are_readings_all_the_same() -> None:
    rows = readings_of(static_rover(), drive(10.0, soil=False))
    assert np.isnan(rows.sinkage).all()
    assert np.isfinite(rows.slip).mean() > 0.7


@pytest.mark.parametrize("shown_by", ["orientation", "acceleration", "odometry"])
def test_pitch_is_the_slope_s_whatever_measures_it(shown_by: str) -> None:
    """Uphill by 0.1 rad: an imu's slope reaches the sinkage sensors' error with pitch, too."""
    climb = 0.1
    made = []
    for name, stamp, values, clock in drive(20.0, oriented=shown_by == "orientation"):
        new = np.array(values)
        if name == "imu" and shown_by != "odometry":
            new[[1, 3]] += G * np.sin(climb), G * (np.cos(climb) - 1.0)
            if shown_by == "orientation":
                new[4:7] = np.sin(climb), 0.0, np.cos(climb)
        if name == "odom" and shown_by == "odometry":
            new[8] = -climb
        made.append((name, stamp, tuple(new.tolist()), clock))
    imu = {"imu_topic": None} if shown_by == "odometry" else {}
    rows = readings_of(rover(**imu), made)
    late = rows.take(rows.distance > 1.0)
    assert np.mean(late.pitch) == pytest.approx(-climb, abs=0.01)
