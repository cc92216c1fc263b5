# SPDX-License-Identifier: Apache-2.0
"""The truth of the worlds of `rates`: forces balance, wheels dig, and each law is its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rates.drive_worlds import WorldDrive, make_drive
from rates.random_worlds import PLAIN, VEHICLES, Feature, RandomWorld
from smallwheel_ros.simulate.truth import Circumstances
from smallwheel_ros.simulate.vehicle import EPOCH, REFERENCE_SLIP, STUCK, TICK
from smallwheel_ros.simulate.wheel_laws import (
    DEPTHS,
    SLIPS,
    RimStrength,
    Sand,
    Stresses,
    peaked_curves,
    response_of,
    rim_curves,
)
from smallwheel_ros.simulate.world import GRAVITY, Sensors

SOFT = (
    Feature("modulus", (-2.5, -2.5), (0.5, 0.5), (1.0, 1.0)),
    Feature("grip", (-0.8, -0.8), (0.5, 0.5), (1.0, 1.0)),
)
GIVES_WAY = RandomWorld(
    "gives way", vehicle="80 kg", way="half", speed=0.5, soil="any", digging=(0.03, 0.03), features=SOFT,
    sticks=True, sensors=PLAIN,
)  # fmt: skip


@pytest.fixture(scope="module")
def plain() -> WorldDrive:
    return make_drive(RandomWorld("plain", way="short"), 1)


@pytest.fixture(scope="module")
def stuck() -> WorldDrive:
    return make_drive(GIVES_WAY, 1)


def test_loads_are_the_weight_and_pull_is_what_the_slope_and_gaining_speed_take(
    plain: WorldDrive,
) -> None:
    truth, mass = plain.truth, plain.rover.mass
    weight = mass * GRAVITY * np.cos(truth.climb) * np.cos(truth.roll)
    assert truth.load.sum(axis=1) == pytest.approx(weight, rel=1e-9)
    gained = np.diff(truth.speed, prepend=0.0) / TICK
    needed = mass * (GRAVITY * np.sin(truth.climb) + gained)
    moves = np.abs(truth.speed) > 0.1
    assert truth.pull.sum(axis=1)[moves] == pytest.approx(needed[moves], abs=1.5)


def test_slip_is_of_rim_and_ground_and_the_margin_is_the_pull_at_its_slip(
    plain: WorldDrive,
) -> None:
    truth = plain.truth
    moves = (np.abs(truth.speed) > 0.05) & (truth.slip > 0.0).all(axis=1)
    assert moves.sum() > 100
    ground = truth.rim[moves] * (1.0 - truth.slip[moves])
    assert ground == pytest.approx(np.tile(truth.speed[moves, None], 4), abs=1e-6)
    low = truth.slip[moves] < REFERENCE_SLIP
    assert (truth.pull[moves] < truth.held[moves])[low].all()


def test_a_vehicle_gets_stuck_where_the_soil_gives_way_and_digs_itself_in(
    stuck: WorldDrive,
) -> None:
    truth = stuck.truth
    assert truth.stuck is not None
    before = truth.place < 5.0
    at = int(truth.stuck / TICK)
    assert np.nanmean(truth.slip[at]) > STUCK
    assert truth.reserve[at] < 0.0 < truth.reserve[before].min()
    rest = int((truth.stuck - 0.4) / TICK)
    assert (truth.sinkage[-1] > truth.sinkage[rest]).all()


def test_a_differential_lets_the_lighter_wheel_of_an_axle_spin() -> None:
    world = replace(GIVES_WAY, name="diagonal", differential=True, swing=3.0)
    drives = [make_drive(world, seed).truth for seed in range(3)]
    assert any(one.stuck is not None for one in drives)
    for truth in drives:
        rolls = truth.path > 2.0
        lighter = truth.load[rolls, 0] < 0.8 * truth.load[rolls, 1]
        assert lighter.any()
        assert np.nanmean((truth.slip[rolls, 0] - truth.slip[rolls, 1])[lighter]) > 0.0


def test_the_same_seed_gives_the_same_drive_and_another_one_another(plain: WorldDrive) -> None:
    again, other = make_drive(plain.world, 1), make_drive(plain.world, 2)
    for name, (stamps, values) in plain.rows.items():
        assert np.array_equal(again.rows[name][0], stamps)
        assert np.array_equal(again.rows[name][1], values)
    assert not np.array_equal(other.rows["odom"][1][:50], plain.rows["odom"][1][:50])


def test_sensors_show_the_truth_but_for_their_noise(plain: WorldDrive) -> None:
    truth = plain.truth
    stamps, shown = plain.rows["rear_left/sinkage"]
    true = np.interp((stamps - EPOCH) / 1e9, truth.time, truth.sinkage[:, 2])
    assert np.std((shown[:, 0] - true) / np.hypot(5e-4, 0.03 * true)) == pytest.approx(
        1.0, abs=0.15
    )
    stamps, shown = plain.rows["imu"]
    climb = np.interp((stamps - EPOCH) / 1e9, truth.time, truth.climb)
    assert shown[:, 4] == pytest.approx(np.sin(climb), abs=0.03)
    stamps, shown = plain.rows["front_left/wheel_speed"]
    rim = np.interp((stamps - EPOCH) / 1e9, truth.time, truth.rim[:, 0])
    assert 0.125 * shown[:, 0] == pytest.approx(rim, abs=0.03)


@pytest.mark.parametrize("kind", ["wheels", "pose"])
def test_odometry_of_wheels_shows_no_slip_and_one_of_poses_no_speed(kind: str) -> None:
    world = RandomWorld(
        "odometry", vehicle="80 kg", way="short", soil="any", sensors=replace(PLAIN, odometry=kind)
    )
    made = make_drive(world, 1)
    stamps, shown = made.rows["odom"]
    rim = np.interp((stamps - EPOCH) / 1e9, made.truth.time, made.truth.rim.mean(axis=1))
    if kind == "wheels":
        assert shown[:, 0] == pytest.approx(rim, abs=0.05)
        return
    assert not shown[:, :2].any()
    way = np.hypot(*np.diff(shown[:, 2:4], axis=0).T).sum()
    assert way == pytest.approx(made.truth.path[-1], rel=0.1)


def test_a_current_is_nothing_where_the_motor_stands() -> None:
    sensors = Sensors(torque=True, current=True)
    made = make_drive(RandomWorld("current", way="short", sensors=sensors), 1)
    stamps, shown = made.rows["front_left/torque"]
    stands = np.interp((stamps - EPOCH) / 1e9, made.truth.time, np.abs(made.truth.rim[:, 0])) == 0.0
    assert stands.any()
    assert not shown[stands].any()
    assert (shown[~stands] > 0.0).mean() > 0.95


@pytest.mark.parametrize("curves", [rim_curves, peaked_curves])
def test_curves_rise_with_slip_and_pull_less_where_the_wheel_is_deep(curves: object) -> None:
    found = curves(0.25, 0.1, 60.0, 0.8, RimStrength(300.0, 0.5, 0.012))  # type: ignore[operator]
    assert found.thrust.shape == (DEPTHS.size, SLIPS.size)
    shallow = found.thrust[DEPTHS < 0.1][:, [1, 3, 6, 9, 13]]  # slips -0.7, -0.2, 0, 0.1, 0.4
    assert (np.diff(shallow, axis=1) > 0.0).all()
    assert (np.diff(found.resistance[:, 8]) > 0.0).all()
    torque, thrust = found.torque[10, 8:], found.thrust[10, 8:]
    assert (torque > 0.9 * thrust).all()


def test_stresses_carry_the_load_and_moved_soil_carries_less() -> None:
    sand = Sand(1e6, 1.0, RimStrength(300.0, 0.57, 0.012), 0.8, 0.1, 2.0, 0.4)
    at = Circumstances.of(load=80.0, diameter=0.25, width=0.1, slip=np.array([0.05, 0.5]))
    z, pull, torque = response_of(sand, at, Stresses())
    assert z[1] > z[0]
    assert pull[1] > pull[0]
    assert (torque > 0.125 * pull).all()
    _, moved, _ = response_of(sand, at, Stresses(moved=0.5))
    assert moved[1] != pytest.approx(pull[1], rel=1e-3)
    _, biased, _ = response_of(sand, at, Stresses(bias=0.05))
    assert biased == pytest.approx(pull + 4.0)


def test_every_vehicle_drives_on_its_soil() -> None:
    for name in VEHICLES:
        made = make_drive(
            RandomWorld("drives", vehicle=name, way="short", speed=0.5, soil="any", sensors=PLAIN),
            0,
        )
        assert made.truth.path[-1] == pytest.approx(8.0, abs=0.05), name
