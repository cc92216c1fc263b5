# SPDX-License-Identifier: Apache-2.0
"""What checks doubt reaches all that is derived of it, from its stamp on, wherever blocks are cut.

Tests `doubts.py`, `believed.py` and `sensor_checks.py`; each stage alone: `test/pipeline/test_stages.py`.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from rows_of_drives import (
    SECOND,
    FirstStages,
    Row,
    assert_same,
    drive,
    readings_of,
    run,
    static_rover,
)

from smallwheel_ros.onboard.settings import IMU, ODOMETRY
from smallwheel_ros.pipeline.checks.doubts import Doubts
from smallwheel_ros.pipeline.tables import Estimates, Readings


def test_a_doubt_holds_behind_its_stamp_until_the_next() -> None:
    doubts = Doubts()
    stamps = np.array([9, 10, 11, 20, 21])
    assert not doubts.now.at(IMU, stamps).any()
    doubts.hold(10, {IMU})
    doubts.hold(15, {IMU})  # the same: nothing new
    doubts.hold(20, {ODOMETRY})
    assert doubts.now.at(IMU, stamps).tolist() == [False, False, True, True, False]
    assert doubts.now.at(ODOMETRY, stamps).tolist() == [False] * 4 + [True]
    values = np.ones((5, 2))
    unknown = np.isnan(doubts.now.believed(IMU, stamps, values)).all(axis=1)
    assert unknown.tolist() == [False, False, True, True, False]
    assert doubts.began == [10, 20]
    doubts.forget(20)
    assert doubts.now.at(IMU, stamps[2:]).tolist() == [True, True, False]


def _turned(rows: list[Row]) -> list[Row]:
    """The gyro with the other sign."""
    return [(n, s, (-v[0], *v[1:]) if n == IMU else v, now) for n, s, v, now in rows]


def _held(rows: list[Row], name: str) -> list[Row]:
    """One stream shows one and the same row from the middle on."""
    middle = rows[len(rows) // 2][1]
    last = next(v for n, s, v, _ in rows if n == name and s > middle)
    return [(n, s, last if n == name and s > middle else v, now) for n, s, v, now in rows]


TURNS = {"turn": lambda t: 0.4 * np.sin(0.7 * t)}
FAULTS = {
    "gyro turned": (_turned, IMU),
    "imu frozen": (lambda rows: _held(rows, IMU), IMU),
    "odometry repeats": (lambda rows: _held(rows, ODOMETRY), ODOMETRY),
    "encoder holds": (lambda rows: _held(rows, "fl/wheel_speed"), "fl/wheel_speed"),
}


@cache
def _good() -> Readings:
    return readings_of(static_rover(), drive(40.0, soil=False, **TURNS))


@cache
def _whole(fault: str) -> tuple[list[Row], Readings, Estimates]:
    rows = FAULTS[fault][0](drive(40.0, soil=False, **TURNS))
    return rows, *run(static_rover(), rows)


@pytest.mark.parametrize("fault", FAULTS)
def test_slip_is_right_or_unknown_once_a_sensor_is_named(fault: str) -> None:
    make, stream = FAULTS[fault]
    pipeline = FirstStages(static_rover().onboard)
    pipeline.checks.doubts.forget = lambda before: None  # type: ignore[method-assign]
    rows = readings_of(static_rover(), make(drive(40.0, soil=False, **TURNS)), pipeline=pipeline)
    doubted = pipeline.checks.doubts.now.at(stream, rows.stamp)
    assert doubted[-1]
    good = _good()
    late = doubted & (rows.stamp > rows.stamp[doubted][0] + SECOND)
    known = late & np.isfinite(rows.slip)
    off = np.abs(rows.slip - good.slip)[known]
    within = off <= 3.0 * np.hypot(rows.slip_std, good.slip_std)[known] + 0.01
    assert within.sum() >= 0.98 * known.sum()
    if stream == IMU:
        assert known.sum() > 0.9 * late.sum()  # by the yaw rate of the odometry
        assert np.isnan(rows.vertical[late]).all()
    elif stream == ODOMETRY:
        assert not known.any()
        for column in ("speed", "vehicle_speed", "slip", "x", "heading"):
            assert np.isnan(getattr(rows, column)[late]).all(), column
    else:
        mine = late & (rows.wheel == 0)
        assert np.isnan(rows.slip[mine]).all()
        assert np.isnan(rows.rim_speed[mine]).all()
        assert np.isfinite(rows.slip[late & (rows.wheel == 1)]).mean() > 0.9


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    "cuts",
    [range(500, 9000, 500), pytest.param((3000, 3001, 3007, 7000), marks=pytest.mark.slow)],
)
def test_cuts_do_not_matter_to_doubts(fault: str, cuts: tuple[int, ...]) -> None:
    rows, readings, estimates = _whole(fault)
    cuts = tuple(cut for cut in cuts if cut < len(rows))
    found, made = run(static_rover(), rows, cuts, span=SECOND // 3)
    assert_same(readings, found)
    assert_same(estimates, made)
