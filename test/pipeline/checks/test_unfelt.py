# SPDX-License-Identifier: Apache-2.0
"""Changes of the ground speed that the imu does not feel. Tests `unfelt.py`, and what follows from it."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raw_drives import GRAVITY, real_folder, settings

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.pipeline.checks.believed import MOVES, BelievedRows, RawRows
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.checks.unfelt import InertialSpeed, Unfelt
from smallwheel_ros.pipeline.intake.buffer import Samples
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Flags, Integers
from smallwheel_ros.simulate.sensors import Rows

START, END, STOPS, DIAMETER = 1_000 * SECOND, 30.0, 20.0, 0.25
VEHICLE = settings()


def speed(t: Array) -> Array:
    """A vehicle that starts, drives with 0.8 m/s, and from 20 s on brakes to 0 within 0.8 s, m/s."""
    return np.interp(t, [1.0, 2.0, STOPS, STOPS + 0.8], [0.0, 0.8, 0.8, 0.0])


def nose_up(t: Array, digs: bool) -> Array:
    """Bumps of 2 degrees while it drives; where it digs in, a vehicle's tail sinks meanwhile by 6, rad."""
    bumps = 0.035 * np.sin(5.0 * t) * np.minimum(speed(t), 0.5)
    return bumps + digs * np.interp(t, [STOPS, STOPS + 0.8], [0.0, 0.1])


def rows_of(shows: str, *, early: float = 0.0, late: float = 0.0, digs: bool = False) -> Rows:
    """Streams of that vehicle. early, late: s, of the odometry. digs: its wheels turn on as it stops.

    shows: how its imu tells where up is: "up", by an orientation; "pitch rate"; "neither".
    """
    random = np.random.default_rng(7)
    rows: Rows = {}
    t = np.arange(0.0, END, 0.02)
    stamps = START + np.round(t * 1e9).astype(np.int64)
    rim = np.interp(t, [1.0, 2.0], [0.0, 0.8]) if digs else speed(t)
    for wheel in VEHICLE.wheels:
        rows[f"{wheel.name}/wheel_speed"] = stamps, (rim / (0.5 * wheel.diameter))[:, None]
    angle, unknown = nose_up(t, digs), np.full(t.size, np.nan)
    gains, turns = np.gradient(speed(t), t), np.gradient(angle, t)
    ahead = gains + GRAVITY * np.sin(angle) + 0.3 * random.standard_normal(t.size)
    zero = np.zeros(t.size)
    up = [np.sin(angle), zero, np.cos(angle)] if shows == "up" else [unknown] * 3
    pitch_rate = zero if shows == "neither" else -turns
    rows[IMU] = (
        stamps,
        np.column_stack([zero, ahead, zero, GRAVITY * np.cos(angle), *up, pitch_rate]),
    )
    t = np.arange(0.01, END, 0.1)
    shown = speed(t + early - late) + 0.02 * random.standard_normal(t.size)
    zero, one = np.zeros(t.size), np.ones(t.size)
    columns = [shown, zero, np.cumsum(shown) * 0.1, zero, one, *[zero] * 5]
    rows[ODOMETRY] = START + np.round(t * 1e9).astype(np.int64), np.column_stack(columns)
    return rows


def believed(rows: Rows, vehicle: OnboardSettings = VEHICLE) -> BelievedRows:
    until = max(int(stamps[-1]) for stamps, _ in rows.values())
    raw = RawRows({name: Samples(*of) for name, of in rows.items()}, until)
    return SensorChecks(vehicle).take(raw, last=True)


def doubted(rows: Rows, vehicle: OnboardSettings = VEHICLE) -> Array:
    """Times (s) of the odometry's messages whose speed is not believed."""
    stamps, _ = rows[ODOMETRY]
    unknown = np.isnan(believed(rows, vehicle).at(MOVES, stamps)[:, 0])
    return (stamps[unknown] - START) / 1e9


@pytest.mark.parametrize("shows", ["up", "pitch rate"])
def test_a_stop_that_is_shown_before_it_is_felt_is_not_believed(shows: str) -> None:
    """The odometry is 1 s early: until the imu feels the stop, too, nothing is known of slip."""
    found = doubted(rows_of(shows, early=1.0))
    stop = found[found > 5.0]
    # From half of the false loss on, at the latest; over when the true one is.
    assert STOPS - 1.0 < stop.min() < STOPS - 0.5
    assert stop.max() < STOPS + 0.8
    assert stop.size >= 5


@pytest.mark.parametrize("shows", ["up", "pitch rate"])
@pytest.mark.parametrize("digs", [False, True])
def test_a_stop_that_is_felt_is_believed(shows: str, digs: bool) -> None:
    assert not doubted(rows_of(shows, digs=digs)).size


def test_an_imu_without_pitch_doubts_no_speed() -> None:
    """Gravity that turns as the tail sinks would look like a loss that is not felt."""
    assert not doubted(rows_of("neither", digs=True)).size
    assert not doubted(rows_of("neither", early=1.0)).size


def test_a_loss_that_a_late_odometry_shows_is_no_doubt() -> None:
    """What was felt half a second before is the change that it shows."""
    assert not doubted(rows_of("up", late=0.3, digs=True)).size


def test_what_depends_on_a_doubted_speed_is_unknown_and_nothing_before_is() -> None:
    rows = rows_of("pitch rate", early=1.0)
    found = believed(rows)
    stamps, values = found.new(ODOMETRY)
    unknown = np.isnan(values[:, 0])
    assert unknown.any()
    assert np.array_equal(values[~unknown], rows[ODOMETRY][1][~unknown])
    assert np.isnan(found.speeds(stamps[unknown])).all()


def test_why_slip_is_unknown_is_said() -> None:
    """At the end of what has come, half a second after the odometry has begun to stop."""
    said = []
    for early in (1.0, 0.0):
        rows = rows_of("pitch rate", early=early)
        pipeline, until = Pipeline(VEHICLE), START + round((STOPS - 0.2) * SECOND)
        for name in VEHICLE.streams:
            stamps, values = rows.get(name, (np.empty(0, dtype=np.int64), None))
            if stamps.size and values is not None:
                come = stamps <= until
                pipeline.streams.all[name].extend(stamps[come], values[come])
        pipeline.streams.latest = until
        list(pipeline.turns(last=True))
        said.append(pipeline.doubt_of_slip(VEHICLE.wheels[0].name))
    assert said == ["the imu does not feel how the speed of odom changes", ""]


def observed(edges: list[int]) -> tuple[Array, Flags]:
    """Speed by the imu alone, and doubts, of a drive in parts."""
    rows = rows_of("pitch rate", early=1.0)
    inertial, unfelt = InertialSpeed(GRAVITY), Unfelt(GRAVITY)
    stamps, felt = rows[IMU]
    parts = np.split(np.arange(stamps.size), sorted(edges))
    carried = np.concatenate([inertial.take(stamps[i], felt[i]) for i in parts if i.size])
    at, shown = rows[ODOMETRY]
    told = np.interp(at / 1e9, stamps / 1e9, carried)
    moved = shown[:, 0]
    before = np.interp(at / 1e9 - 1.0, at / 1e9, moved)
    parts = np.split(np.arange(at.size), sorted(each // 5 for each in edges))
    flags = [unfelt.take(at[i], moved[i], before[i], told[i]) for i in parts if i.size]
    return carried, np.concatenate(flags)


@given(st.lists(st.integers(0, 1500), max_size=6))
def test_cuts_do_not_matter(edges: list[int]) -> None:
    whole, cut = observed([]), observed(edges)
    assert np.array_equal(whole[0], cut[0], equal_nan=True)
    assert np.array_equal(whole[1], cut[1])


def stamps_of(t: Array) -> Integers:
    return START + np.round(t * 1e9).astype(np.int64)


def test_gravity_that_turns_gains_no_speed() -> None:
    """Nose up by 0.1 rad within a second, at an even speed: felt is gravity alone."""
    t = np.arange(0.0, 10.0, 0.01)
    angle = np.interp(t, [4.0, 5.0], [0.0, 0.1])
    felt = np.full((t.size, 8), np.nan)
    felt[:, 1] = GRAVITY * angle
    felt[:, 7] = -np.gradient(angle, t)
    found = InertialSpeed(GRAVITY).take(stamps_of(t), felt)
    assert np.isnan(found[t < 3.9]).all(), "no pitch rate has come yet"
    assert np.abs(found[t > 4.1]).max() < 0.01
    felt[:, 7] = 0.0  # a driver that measures none
    assert np.isnan(InertialSpeed(GRAVITY).take(stamps_of(t), felt)).all()


def test_at_a_constant_push_the_speed_is_its_integral() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    felt = np.zeros((t.size, 8))
    felt[:, 1], felt[:, 4] = 0.5 + GRAVITY * 0.2, 0.2
    assert InertialSpeed(GRAVITY).take(stamps_of(t), felt) == pytest.approx(0.5 * t)


def test_on_a_real_robot_only_its_early_stop_is_doubted() -> None:
    """Pathfinder's satellite positions have guessed stamps: 54 s after its first, it stops a second early."""
    drive = import_module("rates.real_drives").real_drive(real_folder(), "pathfinder_flat")
    rows = {name: of for name, of in drive.rows.items() if of[0].size}
    stamps, _ = rows[ODOMETRY]
    unknown = np.isnan(believed(rows, drive.settings).at(MOVES, stamps)[:, 0])
    times = (stamps[unknown] - stamps[0]) / 1e9
    assert 5 <= times.size <= 25
    assert times.min() > 52.5
    assert times.max() < 55.0
