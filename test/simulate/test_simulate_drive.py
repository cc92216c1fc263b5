# SPDX-License-Identifier: Apache-2.0
"""Tests `drive.py`, `drive_bag.py`, `sensors.py`, `vehicle.py`, `world.py` and `world_ground.py`."""

from __future__ import annotations

import json

import numpy as np
import pytest

from smallwheel_ros.bags import BagError, BagReader
from smallwheel_ros.simulate import (
    DriveSettings,
    SimulationError,
    simulate_drive,
    write_drive_bag,
)
from smallwheel_ros.simulate.settings import Stretch
from smallwheel_ros.simulate.truth import soil_of_pressure
from smallwheel_ros.simulate.vehicle import EPOCH, STUCK, TICK
from smallwheel_ros.simulate.world import GRAVITY, ROVERS, RoverWheel, SimulatedRover
from smallwheel_ros.simulate.world_ground import Frame

WHEELS = ["front_left", "front_right", "rear_left", "rear_right"]


@pytest.fixture(scope="module")
def drive():
    return simulate_drive(DriveSettings(seed=0))


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "drive"
    count = write_drive_bag(drive, path)
    with BagReader(path) as reader:
        assert count == sum(1 for _ in reader.messages())
    return path


@pytest.fixture(scope="module")
def messages(bag):
    by_topic = {}
    with BagReader(bag) as reader:
        for message in reader.messages():
            by_topic.setdefault(message.topic, []).append(message)
    return by_topic


def stamps(messages):
    return np.array(
        [m.message.header.stamp.sec * 10**9 + m.message.header.stamp.nanosec for m in messages]
    )


def test_topics_and_types_are_those_of_the_interface(bag):
    with BagReader(bag) as reader:
        found = {topic.name: topic.type for topic in reader.topics}
    expected = {"/odom": "nav_msgs/msg/Odometry", "/joint_states": "sensor_msgs/msg/JointState"}
    expected["/imu"] = "sensor_msgs/msg/Imu"
    for wheel in WHEELS:
        expected[f"/{wheel}/load"] = "geometry_msgs/msg/WrenchStamped"
        expected[f"/{wheel}/sinkage"] = "smallwheel_ros/msg/WheelSinkage"
    assert found == expected


def test_default_drive_is_about_a_minute_and_30_metres(drive):
    assert 50 < drive.truth.time[-1] < 80
    assert drive.truth.path[-1] == pytest.approx(30.0, abs=0.01)


def test_rates_stamps_and_delays(messages):
    rates = {"load": 50, "sinkage": 10, "odom": 30, "joint_states": 50, "imu": 50}
    first = set()
    for topic, recorded in messages.items():
        stamp = stamps(recorded)
        log_time = np.array([m.log_time for m in recorded])
        assert np.all(np.diff(stamp) > 0), topic
        assert np.all(log_time > stamp), topic
        assert np.max(log_time - stamp) < 0.3e9, topic
        rate = 1e9 / np.median(np.diff(stamp))
        assert rate == pytest.approx(rates[topic.rpartition("/")[2]], rel=0.03)
        assert EPOCH <= stamp[0] < EPOCH + 0.2e9
        first.add(int(stamp[0]))
    assert len(first) == len(messages)  # no two sensors start at the same instant


def test_frames_names_and_quaternions(messages):
    for wheel in WHEELS:
        for kind in ("load", "sinkage"):
            assert {m.message.header.frame_id for m in messages[f"/{wheel}/{kind}"]} == {wheel}
    odometry = [m.message for m in messages["/odom"]]
    assert {m.header.frame_id for m in odometry} == {"odom"}
    assert {m.child_frame_id for m in odometry} == {"base_link"}
    turned = [m.pose.pose.orientation for m in odometry]
    norm = np.array([q.x**2 + q.y**2 + q.z**2 + q.w**2 for q in turned])
    assert norm == pytest.approx(np.ones(norm.size), abs=1e-12)
    joints = [m.message for m in messages["/joint_states"]]
    assert {tuple(m.name) for m in joints} == {tuple(f"{w}_joint" for w in WHEELS)}
    assert {m.velocity.size for m in joints} == {4}


def test_orientation_says_the_slope_that_the_rover_climbs(drive, messages):
    odometry = [m.message for m in messages["/odom"]]
    time = (stamps(messages["/odom"]) - EPOCH) / 1e9
    q = [m.pose.pose.orientation for m in odometry]
    nose_down = np.arcsin([2 * (p.w * p.y - p.z * p.x) for p in q])
    climb = np.interp(time, drive.truth.time, drive.truth.climb)
    assert np.max(np.abs(-nose_down - climb)) < 0.015
    height = np.array([m.pose.pose.position.z for m in odometry])
    way = np.interp(time, drive.truth.time, drive.truth.path)
    slope = np.diff(height[::30]) / np.maximum(np.diff(way[::30]), 1e-6)
    moving = np.diff(way[::30]) > 0.2
    assert np.corrcoef(slope[moving], climb[::30][1:][moving])[0, 1] > 0.95


def test_odometry_pose_is_the_integral_of_its_twist(messages):
    odometry = [m.message for m in messages["/odom"]]
    time = stamps(messages["/odom"]) / 1e9
    speed = np.array([m.twist.twist.linear.x for m in odometry])
    rate = np.array([m.twist.twist.angular.z for m in odometry])
    way = np.sum(speed[1:] * np.diff(time))
    place = np.array([[m.pose.pose.position.x, m.pose.pose.position.y] for m in odometry])
    height = np.array([m.pose.pose.position.z for m in odometry])
    steps = np.hypot(*np.diff(place[::30], axis=0).T)
    assert np.sum(np.hypot(steps, np.diff(height[::30]))) == pytest.approx(way, rel=0.02)
    q = [m.pose.pose.orientation for m in odometry]
    yaw = np.arctan2(
        [2 * (p.w * p.z + p.x * p.y) for p in q], [1 - 2 * (p.y**2 + p.z**2) for p in q]
    )
    assert np.max(np.abs(yaw - np.cumsum(rate * np.gradient(time)))) < 0.05


def test_slip_from_the_bag_is_the_true_slip(drive, messages):
    answer = drive.answer()
    time = (stamps(messages["/odom"]) - EPOCH) / 1e9
    speed = np.array([m.message.twist.twist.linear.x for m in messages["/odom"]])
    joint_time = (stamps(messages["/joint_states"]) - EPOCH) / 1e9
    joints = np.array([m.message.velocity for m in messages["/joint_states"]])
    for j, wheel in enumerate(WHEELS):
        truth = answer["wheels"][wheel]
        at, moving = np.array(truth["time"]), np.array(truth["moving"])
        rim = np.interp(at, joint_time, joints[:, j]) * 0.125
        v = np.interp(at, time, speed)
        fast = moving & (v > 0.2)
        slip = np.where(rim >= v, 1 - v / np.maximum(rim, 1e-3), rim / np.maximum(v, 1e-3) - 1)
        error = slip[fast] - np.array(truth["slip"])[fast]
        assert abs(np.median(error)) < 0.03  # in turns a wheel is faster or slower than the rover
        assert np.quantile(np.abs(error), 0.95) < 0.08


def test_readings_scatter_about_the_truth_as_declared(drive, messages):
    answer = drive.answer()
    for wheel in WHEELS:
        recorded = [m.message for m in messages[f"/{wheel}/sinkage"]]
        truth = answer["wheels"][wheel]
        assert len(recorded) == len(truth["time"])
        read = np.array([m.sinkage for m in recorded])
        variance = np.array([m.variance for m in recorded])
        normed = (read - np.array(truth["sinkage"])) / np.sqrt(variance)
        assert np.all(read > 0)
        assert abs(np.mean(normed)) < 0.15
        assert 0.85 < np.std(normed) < 1.15
        load = np.array([m.message.wrench.force.z for m in messages[f"/{wheel}/load"]])
        at = (stamps(messages[f"/{wheel}/load"]) - EPOCH) / 1e9
        true = np.interp(at, truth["time"], truth["load"])
        assert np.std(load - true) < 2.0


def test_the_drive_is_varied(drive):
    """What an estimator needs: other loads, other slips, other soils, standing still, skidding."""
    truth = drive.truth
    assert np.quantile(truth.load, 0.95) > 1.6 * np.quantile(truth.load, 0.05)
    slip = truth.slip[np.isfinite(truth.slip)]
    assert np.quantile(slip, 0.95) - np.quantile(slip, 0.05) > 0.15
    assert np.max(slip) > 0.4
    soils = [np.median(truth.sinkage[drive.stretch == i]) for i in range(len(drive.stretches))]
    assert max(soils) > 2 * min(soils)
    assert np.sum(truth.speed < 1e-6) * TICK > 4.0
    assert np.all(truth.sinkage < 0.3 * 0.25)


def test_loads_carry_the_rover_and_balance_on_slopes():
    rover = ROVERS["four"]
    climb, roll = np.radians([0.0, 8.0, 0.0]), np.radians([0.0, 0.0, -6.0])
    still, twist = np.zeros(3), np.array([0.2, 0.0, 0.0])
    loads = Frame(rover, spare=0.0).loads(climb, roll, still, twist)
    weight = rover.mass * GRAVITY
    assert loads.sum(axis=1) == pytest.approx(weight * np.cos(climb) * np.cos(roll), rel=1e-9)
    x = np.array([w.x for w in rover.wheels])
    y = np.array([w.y for w in rover.wheels])
    assert loads[1, x < 0].sum() > loads[1, x > 0].sum()  # uphill: onto the rear wheels
    assert loads[2, y > 0].sum() > loads[2, y < 0].sum()  # left side lower: onto it
    # Moments about the axes through the ground, level: the resultant is under the centre.
    assert loads[0] @ x / weight == pytest.approx(rover.gravity_x, abs=1e-9)
    assert loads[0] @ y / weight == pytest.approx(rover.gravity_y, abs=1e-9)


@pytest.mark.parametrize("finish", ["none", "slope", "slippery"])
def test_wheels_together_pull_what_the_rover_needs(finish):
    made = simulate_drive(DriveSettings(seed=2, distance=8.0, finish=finish))
    truth = made.truth
    gained = np.diff(truth.speed, prepend=0.0) / TICK
    needed = made.rover.mass * (GRAVITY * np.sin(truth.climb) + gained)
    moves = truth.speed > 0.1
    off = np.abs(truth.pull.sum(axis=1) - needed)[moves]
    # Speed is found between steps of 2 cm/s, over which pulls are not quite straight.
    assert np.quantile(off, 0.95) < 1.0
    assert off.max() < 0.015 * made.rover.mass * GRAVITY


@pytest.mark.parametrize("finish", ["slope", "slippery"])
@pytest.mark.parametrize("wheels", ["four", "two_sizes"])
def test_a_drive_ends_where_the_soil_does_not_give_what_it_takes(finish, wheels):
    settings = DriveSettings(seed=1, distance=4.0, finish=finish, wheels=wheels)
    made = simulate_drive(settings)
    truth, stuck = made.truth, made.answer()["stuck"]
    assert stuck is not None
    assert 4.0 < stuck["way"] <= truth.path[-1] < 20.0
    # The wheels turn on, and slip tells how little comes of it.
    over = (truth.time > stuck["time"]) & (truth.rim.min(axis=1) > 0.1)
    assert np.all(truth.slip[over].mean(axis=1) > STUCK)
    assert truth.path[-1] - stuck["way"] < 0.2
    assert 3.0 < np.sum(over) * TICK < 5.0  # then the driver gives up
    if finish == "slope":
        assert truth.climb[-1] > np.interp(4.0, truth.path, truth.climb) + np.radians(5.0)
    # Everything before is the same drive.
    plain = simulate_drive(DriveSettings(seed=1, distance=4.0, wheels=wheels))
    early = truth.time < 4.0
    assert np.array_equal(truth.load[early], plain.truth.load[: early.sum()])
    assert plain.answer()["stuck"] is None


def test_imu_and_motors_tell_of_the_forces(drive, messages):
    truth, mass = drive.truth, drive.rover.mass
    at = (stamps(messages["/imu"]) - EPOCH) / 1e9
    felt = np.array([m.message.linear_acceleration.x for m in messages["/imu"]])
    pull = np.interp(at, truth.time, truth.pull.sum(axis=1))
    moves = np.interp(at, truth.time, truth.speed) > 0.05
    off = mass * felt[moves] - pull[moves]
    # Mounted 0.3 degrees (1 sigma) off the level, it feels that share of the weight.
    assert abs(np.mean(off)) < 3.0 * mass * GRAVITY * np.radians(0.3)
    assert np.std(off) == pytest.approx(mass * 0.1, rel=0.25)
    turned = [m.message.orientation for m in messages["/imu"]]
    pitch = np.arcsin([2.0 * (q.w * q.y - q.z * q.x) for q in turned])
    climb = np.interp(at, truth.time, truth.climb)
    assert np.abs(pitch + climb).max() < np.radians(2.5)
    joint = (stamps(messages["/joint_states"]) - EPOCH) / 1e9
    effort = np.array([m.message.effort for m in messages["/joint_states"]])
    assert effort.shape == (joint.size, 4)
    for j, wheel in enumerate(drive.rover.wheels):
        true = np.interp(joint, truth.time, truth.torque[:, j])
        assert np.std(effort[:, j] - true) < 0.05 + 0.1 * np.std(true)
        # What is left of the thrust after motion resistance pulls.
        turning = truth.speed > 0.05
        by_motor = truth.torque[turning, j] / (wheel.diameter / 2)
        assert np.all(by_motor > truth.pull[turning, j])


def test_same_seed_same_bytes_other_seed_other_bytes(tmp_path):
    settings = DriveSettings(seed=5, distance=3.0, outliers=0.05)
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        made = simulate_drive(settings)
        write_drive_bag(made, folder / "bag")
        (folder / "answer").write_text(json.dumps(made.answer()))
    for file in ("bag/bag.mcap", "bag/metadata.yaml", "answer"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    other = simulate_drive(DriveSettings(seed=6, distance=3.0))
    assert other.answer()["stretches"] != made.answer()["stretches"]


def test_outliers_and_their_marks_change_nothing_else():
    plain = simulate_drive(DriveSettings(seed=2, distance=8.0, dropouts=0.0))
    wild = simulate_drive(DriveSettings(seed=2, distance=8.0, dropouts=0.0, outliers=0.1))
    for stream in (f"{wheel}/sinkage" for wheel in WHEELS):
        calm, odd = (made.rows[stream][1][:, 0] for made in (plain, wild))
        gross = wild.outliers[stream]
        assert not plain.outliers[stream].any()
        assert 0.03 < gross.mean() < 0.2
        assert np.array_equal(calm[~gross], odd[~gross])
        assert np.all(odd[gross] > 1.5 * calm[gross])
    for stream in {*plain.rows} - {f"{wheel}/sinkage" for wheel in WHEELS}:
        assert np.array_equal(plain.rows[stream][1], wild.rows[stream][1]), stream


def test_dropouts():
    full = simulate_drive(DriveSettings(seed=2, distance=8.0, dropouts=0.0))
    gaps = simulate_drive(DriveSettings(seed=2, distance=8.0, dropouts=0.3))
    before, after = (
        {name: stamps for name, (stamps, _) in made.rows.items()} for made in (full, gaps)
    )
    assert 0.6 < after["rear_left/load"].size / before["rear_left/load"].size < 0.8
    assert np.max(np.diff(before["front_right/sinkage"])) < 0.3e9
    assert np.max(np.diff(after["front_right/sinkage"])) > 1.4e9
    assert set(after["rear_left/sinkage"]) <= set(before["rear_left/sinkage"])


def test_no_noise_is_the_truth():
    made = simulate_drive(DriveSettings(seed=1, distance=4.0, noise=0.0))
    truth = made.answer()["wheels"]["rear_right"]
    sinkage, variance = made.rows["rear_right/sinkage"][1].T
    assert sinkage == pytest.approx(truth["sinkage"], abs=1e-7)
    assert np.all(variance > 0)


def test_two_wheel_sizes_in_one_soil():
    made = simulate_drive(DriveSettings(seed=3, distance=6.0, wheels="two_sizes", terrain="single"))
    assert len(made.stretches) == 1
    assert {(w.diameter, w.width) for w in made.rover.wheels} == {(0.25, 0.10), (0.40, 0.12)}
    # Rear wheels are larger: they sink less under the same load.
    ratio = made.truth.sinkage / made.truth.load
    assert np.median(ratio[:, 2:]) < 0.8 * np.median(ratio[:, :2])


def test_own_rover_and_own_soils():
    rover = SimulatedRover(
        (RoverWheel("probe", 0.2, 0.05, 0.2, 0.0), RoverWheel("main", 0.3, 0.1, -0.2, 0.1))
    )
    soils = tuple(
        Stretch(start, soil_of_pressure(f"s{start}", pressure, 0.8, 0.3))
        for start, pressure in ((0.0, 60e3), (3.0, 25e3))
    )
    made = simulate_drive(DriveSettings(distance=6.0, wheels=rover, stretches=soils))
    assert {name for name in made.rows if name.endswith("/load")} == {"probe/load", "main/load"}
    assert [s["name"] for s in made.answer()["stretches"]] == ["s0.0", "s3.0"]
    truth = made.truth
    assert np.median(truth.sinkage[made.stretch == 1]) > 1.4 * np.median(
        truth.sinkage[made.stretch == 0]
    )


@pytest.mark.parametrize(
    "name", ["slip_sinkage", "multipass", "penetration_rate", "sinkage_offset"]
)
def test_hidden_effects_are_in_the_truth_and_in_the_answer_only(name, tmp_path):
    plain = simulate_drive(DriveSettings(seed=4, distance=6.0))
    hidden = simulate_drive(DriveSettings(seed=4, distance=6.0, hidden=(name,)))
    # At the same places: a rover that finds more resistance is there later.
    places = np.arange(0.3, 5.7, 0.01)
    there, before = (
        np.stack([np.interp(places, of.truth.path, z) for z in of.truth.sinkage.T], axis=1)
        for of in (hidden, plain)
    )
    ratio = there / before
    assert np.max(np.abs(ratio - 1.0)) > 0.05
    if name == "multipass":  # the front wheels make the rut in which the rear ones roll
        assert np.median(np.abs(ratio[:, :2] - 1.0)) < 0.005
        assert np.quantile(ratio[:, 2:], 0.02) > 1.1
    assert hidden.answer()["hidden"][0]["effect"] == name
    write_drive_bag(hidden, tmp_path / "drive")
    recorded = b"".join(f.read_bytes() for f in (tmp_path / "drive").iterdir())
    assert name.encode() not in recorded
    for secret in (b"dry_sand", b"loose_sand", b"hidden", b"answer"):
        assert secret not in recorded


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"distance": -1.0}, "distance is -1.0"),
        ({"distance": float("nan")}, "distance is nan"),
        ({"speed": 0.0}, "speed is 0.0: expected a number from 0.01 to 3 m/s"),
        ({"outliers": 1.5}, "outliers is 1.5"),
        ({"noise": -0.1}, "noise is -0.1"),
        ({"seed": -1}, "seed is -1"),
        ({"wheels": "six"}, "one of four, two_sizes"),
        ({"terrain": "moon"}, "one of mixed, single"),
        ({"finish": None}, "finish None is unknown: expected one of none, slope, slippery"),
        ({"hidden": ("moisture",)}, "simulate rig"),
        ({"hidden": ("slip_angle_sinkage",)}, "simulate rig"),
        ({"hidden": ("hardpam",)}, "did you mean 'hardpan'"),
    ],
)
def test_bad_settings_are_named(settings, match):
    with pytest.raises(SimulationError, match=match):
        simulate_drive(DriveSettings(**settings))


def test_a_rover_that_sinks_to_its_axle_is_named():
    mud = (Stretch(0.0, soil_of_pressure("mud", 300.0, 0.8, 0.0)),)
    with pytest.raises(
        SimulationError, match=r"wheel front_left sinks to its axle at 0\.0 m in mud"
    ):
        simulate_drive(DriveSettings(distance=3.0, stretches=mud))


def test_an_existing_bag_is_left_alone(drive, bag):
    before = sorted((f.name, f.stat().st_mtime_ns) for f in bag.iterdir())
    with pytest.raises(BagError, match="exists already"):
        write_drive_bag(drive, bag)
    assert sorted((f.name, f.stat().st_mtime_ns) for f in bag.iterdir()) == before
