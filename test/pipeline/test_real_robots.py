# SPDX-License-Identifier: Apache-2.0
"""What real robots send: odometry without a twist, late, noisy, frozen, of the wheels; an imu upside down."""

from __future__ import annotations

import numpy as np
import pytest
from rows_of_drives import (
    PLACES,
    SECOND,
    START,
    FirstStages,
    Row,
    drive,
    readings_of,
    rover,
    static_rover,
)

from smallwheel_ros.pipeline.checks.believed import Trust
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Readings


def _drive(**how: object) -> tuple[Readings, Pipeline]:
    vehicle = static_rover()
    pipeline = FirstStages(vehicle.onboard)
    rows = drive(soil=False, **how)  # type: ignore[arg-type]
    return readings_of(vehicle, rows, range(0, len(rows), 500), pipeline=pipeline), pipeline


def _while(rows: Readings, begin: float, end: float) -> Readings:
    seconds = (rows.stamp - START) / SECOND
    return rows.take((seconds > begin) & (seconds < end))


def _counts(pipeline: Pipeline) -> dict[str, int]:
    return {reason: n for (_, reason), n in pipeline.streams.problems.items()}


# --- Odometry without a twist (R3)


@pytest.mark.parametrize("rate", [20.0, 4.0, 1.0])
def test_without_a_twist_the_speed_is_that_of_the_pose(rate: float) -> None:
    rows, pipeline = _drive(seconds=25.0, twist=False, odometry_rate=rate, slip=0.15, wave=0.2)
    steady = _while(rows, 6.0, 22.0)
    assert np.isfinite(steady.slip).mean() > 0.9
    assert np.nanmedian(steady.slip) == pytest.approx(0.15, abs=0.02)
    assert rows.distance[-1] == pytest.approx(0.3 * 24.0, rel=0.03 if rate > 1.0 else 0.12)
    assert sum("odometry has no twist" in words for words in pipeline.findings) == 1


def test_backward_and_in_turns_without_a_twist() -> None:
    rows, _ = _drive(
        seconds=25.0, twist=False, speed=lambda t: -0.3 + 0.0 * t, turn=lambda t: 0.2 + 0.0 * t
    )
    steady = _while(rows, 3.0, 24.0)
    assert np.nanmedian(steady.vehicle_speed) == pytest.approx(-0.3, abs=0.01)
    assert not steady.forward.any()
    assert np.nanmedian(steady.slip) == pytest.approx(0.1, abs=0.01)


def test_a_twist_is_used_where_there_is_one() -> None:
    rows, pipeline = _drive()
    assert not pipeline.findings
    assert (
        np.nanstd(_while(rows, 3.0, 11.0).vehicle_speed) > 0.003
    )  # the twist's noise, not the pose


# --- What an odometry is off by


@pytest.mark.parametrize("noise", [0.02, 0.1])
@pytest.mark.parametrize("rate", [3.6, 20.0])
def test_the_deviation_of_a_speed_is_learnt(noise: float, rate: float) -> None:
    rows, _ = _drive(seconds=40.0, noise=noise, odometry_rate=rate, speed=lambda t: 0.5 + 0.0 * t)
    steady = _while(rows, 15.0, 39.0)
    assert np.median(steady.speed_std) == pytest.approx(noise, rel=0.35)
    inside = np.abs(steady.slip - 0.1) <= 1.96 * steady.slip_std
    assert inside[np.isfinite(steady.slip)].mean() > 0.88
    assert np.isfinite(steady.slip).mean() > 0.98


def trust_of(pipeline: Pipeline, stamp: int) -> Trust:
    """What is believed of the speed at a stamp."""
    return pipeline.checks.ground.believed(stamp, stamp).trust(np.array([stamp]))


def test_late_poses_are_not_taken_for_slip() -> None:
    """0.5 s late: in starts and stops the speed is not that of the rims, and the deviation says so."""

    def speed(t: np.ndarray) -> np.ndarray:
        return np.where((t % 8.0) < 4.0, 0.8, 0.0) * np.ones_like(t)

    def turn(t: np.ndarray) -> np.ndarray:
        return 0.8 * np.sin(1.5 * t)

    rows, pipeline = _drive(seconds=60.0, late=0.5, speed=speed, turn=turn, noise=0.01)
    lag = trust_of(pipeline, int(rows.stamp[-1])).lag[0]
    assert lag == pytest.approx(0.5, abs=0.11)
    # Before it is known how late they come, they may be late.
    first = _while(rows, 0.5, 12.0)
    known = np.isfinite(first.slip) & (np.abs(first.rim_speed) > 0.1)
    assert (np.abs(first.slip - 0.1) <= 1.96 * first.slip_std)[known].mean() > 0.85
    learnt = _while(rows, 25.0, 59.0)
    known = np.isfinite(learnt.slip)
    moves = np.abs(learnt.rim_speed) > 0.1
    assert known[moves].mean() > 0.85
    inside = np.abs(learnt.slip - 0.1) <= 1.96 * learnt.slip_std
    assert inside[known & moves & (learnt.slip >= 0.0)].mean() > 0.85
    _, on_time = _drive(seconds=60.0, speed=speed, turn=turn, noise=0.01)
    assert trust_of(on_time, int(rows.stamp[-1])).lag[0] == 0.0


@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_poses_whose_stamps_are_off_are_as_unsure_as_that_makes_them(jitter: float) -> None:
    """Lidar odometries stamp a scan somewhere within its turn, or when they are done with it."""
    vehicle = static_rover()
    random = np.random.default_rng(3)
    rows = []
    for name, stamp, values, now in drive(
        60.0,
        soil=False,
        twist=False,
        odometry_rate=4.0,
        wave=0.2,
        speed=lambda t: 0.8 + 0.1 * np.sin(t),
    ):
        if name == "odom":
            v, w, x, *rest = values
            values = (v, w, x + 0.8 * jitter * random.standard_normal(), *rest)
        rows.append((name, stamp, values, now))
    found = readings_of(vehicle, rows, range(0, len(rows), 500))
    late = _while(found, 10.0, 59.0)
    known = np.isfinite(late.slip)
    assert known.mean() > 0.95
    assert (np.abs(late.slip - 0.1) <= 1.96 * late.slip_std)[known].mean() > 0.85
    if jitter:
        wrong = np.sqrt(np.mean((late.slip[known] - 0.1) ** 2))
        assert np.sqrt(np.mean(late.slip_std[known] ** 2)) == pytest.approx(wrong, rel=0.6)
    else:
        assert np.median(late.speed_std) < 0.4  # a scan of 0.1 s


def test_a_lag_that_is_known_stays_known_when_the_ground_gives_way() -> None:
    """A speed that does not follow the rims any more comes no later for it."""
    vehicle = static_rover()
    pipeline = FirstStages(vehicle.onboard)
    rows = []
    for name, stamp, values, now in drive(
        60.0, soil=False, noise=0.01, speed=lambda t: 0.5 + 0.2 * np.sin(t)
    ):
        seconds = (stamp - START) / SECOND
        if name == "odom" and seconds > 15.0:
            values = (0.25 - 0.2 * np.sin(seconds), *values[1:])
        rows.append((name, stamp, values, now))
    found = readings_of(vehicle, rows, range(0, len(rows), 500), pipeline=pipeline)
    assert trust_of(pipeline, START + 58 * SECOND).lag[0] == 0.0
    sure = _while(found, 20.0, 59.0)
    assert np.median(sure.slip_std) < 0.1


def test_frozen_odometry_is_not_believed_after_half_a_second() -> None:
    vehicle = static_rover()
    rows = drive(soil=False)
    still = next(row[2] for row in rows if row[0] == "odom" and row[1] > START + 6 * SECOND)
    rows = [
        (n, s, still if n == "odom" and s > START + 6 * SECOND else v, now) for n, s, v, now in rows
    ]
    found = readings_of(vehicle, rows)
    assert np.isfinite(_while(found, 4.0, 6.4).slip).all()
    frozen = _while(found, 6.7, 11.9)
    assert np.isnan(frozen.slip).all()
    assert not frozen.stands.any()


# --- Odometry made of the wheels (R5)


def test_odometry_made_of_the_wheels_gives_no_slip() -> None:
    rows, pipeline = _drive(seconds=40.0, of_wheels=True, slip=0.3)
    assert np.isnan(_while(rows, 25.0, 40.0).slip).all()
    assert any("shows no slip" in words for words in pipeline.findings)


def test_until_it_is_known_what_the_odometry_is_made_of_slip_is_as_unsure_as_it_may_hide() -> None:
    of_wheels, _ = _drive(seconds=40.0, of_wheels=True, slip=0.3)
    known = np.isfinite(of_wheels.slip)
    assert known.any()
    inside = np.abs(of_wheels.slip - 0.3) < 1.96 * of_wheels.slip_std
    assert inside[known].mean() > 0.98  # but for the first instants of the start
    # One of its own is told by the first metres: it wanders, or shows more than radii are off by.
    for slip, noise in ((0.1, 0.05), (0.25, 1e-4)):
        own, _ = _drive(seconds=40.0, slip=slip, noise=noise)
        after = own.distance > 1.2
        assert np.median(own.slip_std[after & np.isfinite(own.slip)]) < 0.25


def test_nor_on_the_spot() -> None:
    rows, pipeline = _drive(
        seconds=60.0,
        of_wheels=True,
        slip=0.3,
        speed=lambda t: 0.0 * t,
        turn=lambda t: 0.6 * np.sin(0.3 * t),
    )
    assert np.isnan(_while(rows, 50.0, 60.0).slip).all()
    assert any("shows no slip" in words for words in pipeline.findings)


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_good_odometry_is_not_said_to_be_made_of_the_wheels(noise: float) -> None:
    def slips(t: np.ndarray) -> np.ndarray:
        return 0.3 * (1.0 + 0.1 * np.sin(0.7 * t))  # as much on soil: slip is not one number

    vehicle = static_rover()
    rows = []
    for name, stamp, values, now in drive(
        40.0, soil=False, noise=noise, turn=lambda t: 0.2 * np.sin(t)
    ):
        t = (stamp - START) / SECOND
        if name == "odom":
            values = (values[0] * float(slips(np.array(t))) / 0.3, *values[1:])
        rows.append((name, stamp, values, now))
    pipeline = FirstStages(vehicle.onboard)
    found = readings_of(vehicle, rows, pipeline=pipeline)
    assert not pipeline.made_of_wheels
    assert np.isfinite(_while(found, 3.0, 39.0).slip).mean() > 0.98


# --- The imu (R6), torques


@pytest.mark.parametrize("oriented", [False, True])
def test_an_imu_that_looks_down_is_turned_over(oriented: bool) -> None:
    def turn(t: np.ndarray) -> np.ndarray:
        return 0.3 * np.sin(t)

    up, _ = _drive(turn=turn, oriented=oriented)
    down, pipeline = _drive(turn=turn, oriented=oriented, imu_down=True)
    for name in ("vertical", "yaw_rate", "slope", "across", "slip"):
        np.testing.assert_allclose(getattr(down, name), getattr(up, name), atol=1e-9, err_msg=name)
    assert np.isfinite(_while(down, 2.0, 11.0).slope).all()
    assert sum("looks down" in words for words in pipeline.findings) == 1


def test_the_speed_of_each_side_goes_by_the_gyro() -> None:
    """An odometry that shows half of the turn: with the gyro each side's slip is right."""
    vehicle = static_rover()
    rows: list[Row] = []
    for name, stamp, values, now in drive(soil=False, turn=lambda t: 0.4 + 0.0 * t):
        if name == "odom":
            values = (values[0], 0.5 * values[1], *values[2:])
        rows.append((name, stamp, values, now))
    found = readings_of(vehicle, rows)
    steady = _while(found, 3.0, 11.0)
    for wheel in range(len(PLACES)):
        assert np.nanmedian(steady.slip[steady.wheel == wheel]) == pytest.approx(0.1, abs=0.01)


def _with_torque(torque: np.ndarray) -> tuple[Readings, Pipeline]:
    vehicle = rover(**{f"{name}.torque_per_effort": 1.0 for name in PLACES})
    rows = drive(8.0)
    for name in PLACES:
        for k in range(400):
            stamp = START + k * SECOND // 50
            rows.append((f"{name}/torque", stamp, (float(torque[k]),), stamp))
    pipeline = FirstStages(vehicle.onboard)
    return readings_of(vehicle, sorted(rows, key=lambda row: row[1]), pipeline=pipeline), pipeline


def test_a_motor_current_of_0_at_standstill_is_no_fault() -> None:
    rows, pipeline = _with_torque(np.where(np.arange(400) < 150, 0.0, 1.5))
    assert not pipeline.streams.problems
    assert np.median(_while(rows, 4.0, 7.5).torque) == pytest.approx(1.5)


def test_a_driver_that_leaves_the_effort_empty_has_no_torque() -> None:
    rows, _ = _with_torque(np.zeros(400))
    assert np.isnan(rows.torque).all()


# --- Each way of driving and being fed, once


def test_a_velocity_topic_takes_the_place_of_odometry() -> None:
    vehicle = static_rover(velocity_topic="radar")
    rows = drive(soil=False, turn=lambda t: 0.3 * np.sin(t))
    radar = [("velocity", s, (v[0], v[1], 0.0), now) for n, s, v, now in rows if n == "odom"]
    rows = [(n, s, (9.0, *v[1:]) if n == "odom" else v, now) for n, s, v, now in rows]
    found = readings_of(vehicle, sorted([*rows, *radar], key=lambda row: row[1]))
    assert np.nanmedian(_while(found, 3.0, 11.0).vehicle_speed) == pytest.approx(0.3, abs=0.01)
    assert np.nanmedian(_while(found, 3.0, 11.0).slip) == pytest.approx(0.1, abs=0.01)


def test_a_pressed_wheel_comes_along_by_going_deeper() -> None:
    from smallwheel_ros.onboard.parameters import settings_from

    vehicle = settings_from(
        {"wheels": ["rig"], "rig.diameter": 0.25, "rig.width": 0.1, "rig.contact": "pressed"}
    )
    rows: list[Row] = []
    for k in range(400):
        stamp = START + k * SECOND // 20
        depth = 0.02 * np.sin(np.pi * k / 200.0)
        rows += [("rig/load", stamp, (max(1.0, 3000.0 * depth),), stamp)]
        rows += [("rig/sinkage", stamp, (float(depth), 0.0), stamp)]
    found = readings_of(vehicle, rows)
    assert found.path[-1] == pytest.approx(0.02)
    assert (np.diff(found.path) >= 0.0).all()
    assert found.distance[-1] == pytest.approx(0.02)


def test_static_loads_go_with_slope_and_gain_of_speed() -> None:
    found, _ = _drive(speed=lambda t: 0.25 * t)
    gaining = _while(found, 3.0, 11.0)
    front, rear = gaining.take(gaining.wheel == 0), gaining.take(gaining.wheel == 2)
    assert np.median(rear.load) > np.median(front.load) + 0.5
    total = sum(np.median(gaining.load[gaining.wheel == w]) for w in range(4))
    assert total == pytest.approx(24.0 * 9.80665, rel=0.01)


def test_reverse_and_stops_add_up() -> None:
    def speed(t: np.ndarray) -> np.ndarray:
        return np.select([t < 3.0, t < 5.0, t < 8.0], [0.3, 0.0, -0.3], 0.0)

    found, _ = _drive(speed=speed)
    assert found.distance[-1] == pytest.approx(1.8, rel=0.05)
    assert _while(found, 3.5, 4.8).stands.all()
    assert _while(found, 1.0, 2.8).onward.all()
    assert not _while(found, 6.0, 7.8).onward.any()


def test_ground_that_is_crossed_again_has_been_rolled_over() -> None:
    """A circle of 1 m, twice: in the second round each wheel meets its own and the other's track."""
    vehicle = rover(imu_topic=None)
    rows = drive(50.0, speed=lambda t: 0.3 + 0.0 * t, turn=lambda t: 0.3 + 0.0 * t, noise=0.0)
    found = readings_of(vehicle, rows)
    once = _while(found, 12.0, 20.0)
    twice = _while(found, 36.0, 45.0)
    for wheel in range(4):
        first = np.median(once.passes[once.wheel == wheel])
        second = np.median(twice.passes[twice.wheel == wheel])
        assert second > first + 0.3
