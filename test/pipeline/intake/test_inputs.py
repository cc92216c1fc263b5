# SPDX-License-Identifier: Apache-2.0
"""Each way of input, with real messages (those of bags): which numbers come of them, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from topic_messages import (
    START,
    Fed,
    distance,
    imu,
    joints,
    nose_up,
    odometry,
    sinkage,
    step,
    velocity,
    wrench,
)

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.onboard.parameters import ParametersError
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.tables import Estimates, Readings

QUARTER = math.sqrt(0.5)
MASS: dict[str, object] = {"vehicle.mass": 6.0}
IMU: dict[str, object] = {**MASS, "imu_topic": "imu"}
BESIDE: dict[str, object] = {"front.lateral_position": 0.3, "front.longitudinal_position": 0.2}


def drive(
    fed: Fed, steps: int = 60, *, speed: float = 0.5, slip: float = 0.1, turn: float = 0.0,
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0), climb: float | None = 0.0,
    felt: tuple[float, float, float] = (0.0, 0.0, GRAVITY), effort: tuple[float, ...] = (),
    rim: float | None = None, radar: float | None = None,
    variances: tuple[float, float] = (0.0, 0.0),
) -> tuple[Readings, Estimates]:  # fmt: skip
    """Everything at 50 Hz, as far as there are topics for it. rim: m/s; radar: speed that it shows, m/s."""
    rim = speed / (1.0 - slip) if rim is None else rim
    for i in range(steps):
        at = step(i)
        messages = {
            "imu": imu(at, climb, felt),
            "odom": odometry(at, 0.02 * speed * i, speed, orientation, turn, variances),
            "joint_states": joints(at, [rim / 0.125], list(effort), ["front_joint"]),
            "radar": velocity(at, (speed if radar is None else radar) + 1e-4 * math.sin(i)),
            "front/load": wrench(at, 60.0),
            "front/sinkage": sinkage(at, 0.008 + 1e-4 * (i % 3)),
        }
        for name in messages.keys() & fed.topics.keys():
            fed.give(name, messages[name])
    return fed.rest()


def test_the_topics_are_those_of_the_parameters() -> None:
    fed = Fed()
    assert {(t.name, t.type) for t in fed.topics.values()} == {
        ("front/load", "geometry_msgs/msg/WrenchStamped"),
        ("front/sinkage", "smallwheel_ros/msg/WheelSinkage"),
        ("odom", "nav_msgs/msg/Odometry"),
        ("joint_states", "sensor_msgs/msg/JointState"),
    }
    streams = {name for topic in fed.topics.values() for name in topic.streams}
    assert streams == set(fed.pipeline.streams.all)


def test_everything_arrives() -> None:
    rows, estimates = drive(Fed(**BESIDE))
    assert len(rows) == len(estimates) == 60
    last = rows.take(-1 + np.zeros(1, dtype=int))
    assert (last.load[0], last.sinkage[0]) == pytest.approx((60.0, 0.0082))
    assert last.slip[0] == pytest.approx(0.1, abs=0.01)
    assert (last.x[0], last.y[0], last.heading[0]) == pytest.approx((0.59, 2.0, 0.0))


def test_the_heading_is_that_of_the_pose() -> None:
    rows, _ = drive(Fed(), orientation=(0.0, 0.0, QUARTER, QUARTER))
    assert rows.heading == pytest.approx(0.5 * math.pi)


def test_without_an_orientation_there_is_no_place_and_that_is_said() -> None:
    fed = Fed()
    rows, _ = drive(fed, orientation=(0.0, 0.0, 0.0, 0.0))
    assert np.isnan(rows.heading).all()
    assert np.isfinite(rows.slip[5:]).all()
    assert fed.counts == {("odom", "no_orientation"): 60}


def test_joints_without_a_velocity_are_said_with_what_there_is() -> None:
    fed = Fed()
    nothing = joints(START, [], [], ["front_joint"])
    nothing.position = np.empty(0)
    fed.give("joint_states", nothing)
    (problem,) = fed.pipeline.take_problems()
    fed.give("joint_states", joints(step(1), [1.0], [], ["arm"]))
    assert fed.counts == {("front/wheel_speed", "no_value"): 2}
    assert "names joint front_joint without velocity or position" in problem.text
    fed.give("joint_states", joints(step(2), [], [], ["front_joint"]))  # of a position
    assert fed.counts[("front/wheel_speed", "by_positions")] == 1


def test_load_sign() -> None:
    fed = Fed(**{"front.load_sign": -1})
    for i in range(10):
        fed.give("front/load", wrench(step(i), -60.0))
        fed.give("front/sinkage", sinkage(step(i), 0.008))
    assert fed.rest()[0].load.tolist() == [60.0] * 10
    assert fed.counts == {}


def test_the_sign_of_the_joint_mends_a_mirrored_one() -> None:
    wrong, _ = drive(Fed(), rim=-0.5 / 0.9)
    right, _ = drive(Fed(**{"front.joint_sign": -1}), rim=-0.5 / 0.9)
    assert np.isnan(wrong.slip[-1])  # the joint or the odometry looks back, and which is not known
    assert right.slip[-1] == pytest.approx(0.1, abs=0.01)


def test_pitch_and_covariance_of_odometry_are_used() -> None:
    rows, _ = drive(Fed(), orientation=nose_up(-0.1))
    assert rows.pitch == pytest.approx(0.1)
    sure, unsure = (drive(Fed(), variances=(v, 0.0))[0] for v in (1e-6, 0.01))
    assert unsure.speed_std[-1] > 5.0 * sure.speed_std[-1]


# ---- Distance to the ground


def by_range() -> Fed:
    return Fed(**{"front.range_height": 0.3})


def test_nearer_ground_is_a_deeper_wheel() -> None:
    fed = by_range()
    assert fed.topics["front/sinkage"].type == "sensor_msgs/msg/Range"
    fed.give("front/load", wrench(START, 60.0))
    fed.give("front/sinkage", distance(START, 0.288))
    rows, _ = fed.rest()
    assert rows.sinkage == pytest.approx(0.012, rel=1e-5)  # a Range has numbers of 32 bits
    assert rows.sinkage_std == pytest.approx(0.002, rel=1e-5)


# The last two are its limits: so drivers write that nothing is in view, where REP 117 asks for infinity.
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 0.01, 3.0, 0.05, 2.0])
def test_a_distance_outside_of_its_limits_is_counted(value: float) -> None:
    fed = by_range()
    fed.give("front/sinkage", distance(START, value))
    assert sum(fed.counts.values()) == 1
    (problem,) = fed.pipeline.take_problems()
    assert problem.stream == "front/sinkage"
    assert "no reading" in problem.text
    assert fed.pipeline.rejected == 1


def test_limits_of_a_range_that_are_not_filled_in_do_not_count() -> None:
    fed = by_range()
    fed.give("front/sinkage", distance(START, 0.29, 0.0, 0.0))
    assert fed.counts == {}


# ---- Loads


def test_efforts_of_joints_are_loads() -> None:
    leg = {"load.source": "joint_states", "load.per_effort": 2.0, "front.load_sign": -1}
    fed = Fed(**leg, **{"front.load_joint": "leg"})
    assert "front/load" not in fed.topics
    names = ["arm", "leg", "front_joint"]
    fed.give("joint_states", joints(START, [0.0, 0.0, 4.0], [9.0, -30.0, 0.0], names))
    fed.give("front/sinkage", sinkage(START, 0.008))
    assert fed.rest()[0].load == pytest.approx(60.0)
    fed.give("joint_states", joints(step(1), [0.0, 0.0, 4.0], [], names))
    assert [stream for stream, _ in fed.counts] == ["front/load"]


def test_a_static_load_is_used_and_said() -> None:
    fed = Fed(**{"load.source": "static", "vehicle.mass": 6.0})
    assert "front/load" not in fed.pipeline.streams.all
    rows, estimates = drive(fed)
    assert rows.load == pytest.approx(58.8399)
    assert rows.load_std == pytest.approx(0.3 * 58.8399)
    assert np.isfinite(estimates.sinkage).all()


def test_a_guessed_load_makes_the_soil_less_sure() -> None:
    """Until the readings themselves have told how they scatter."""

    def spread(**changes: object) -> float:
        fed = Fed(**changes, sinkage_zero_std=0.001)  # else that is the limit
        drive(fed, 40)
        return float(fed.pipeline.soil.log_covariance[0, 0])

    assert spread(**{"load.source": "static", "vehicle.mass": 6.0}) > 1.4 * spread()


@pytest.mark.parametrize("told", [{}, {"soil.name": "dry_sand"}])
def test_without_sinkage_and_load_sensors_odometry_gives_the_times(told: dict[str, object]) -> None:
    without = {"load.source": "static", "vehicle.mass": 6.0, "front.sinkage_topic": ""}
    rows, estimates = drive(Fed(**without, **told), 100)
    assert len(rows) == pytest.approx(20, abs=3)
    assert np.isfinite(estimates.margin).all()


# ---- Velocity of its own


RADAR: dict[str, object] = {"velocity_topic": "radar", "odometry_from_wheels": True}


def test_a_velocity_of_its_own_shows_the_slip_that_the_wheels_hide() -> None:
    fed = Fed(**RADAR)
    assert fed.topics["radar"].type == "geometry_msgs/msg/TwistStamped"
    assert drive(fed, rim=0.5, radar=0.3)[0].slip[-1] == pytest.approx(0.4, abs=0.01)


def test_odometry_from_the_wheels_alone_shows_none() -> None:
    rows, estimates = drive(Fed(odometry_from_wheels=True), rim=0.5)
    assert np.isnan(rows.slip).all()
    assert np.isnan(estimates.drawbar_pull).all()
    assert np.isfinite(estimates.margin).all()


def test_stuck_with_spinning_wheels_is_no_travel() -> None:
    """Path comes from the same source as slip (R3): one hole is one place."""
    fed = Fed(**RADAR)
    rows, _ = drive(fed, 250, rim=0.5, radar=0.0)
    assert rows.distance[-1] == 0.0
    assert fed.pipeline.soil.accepted == 0
    assert rows.slip[-1] == pytest.approx(1.0, abs=0.01)
    half, _ = drive(Fed(**RADAR), 250, rim=0.5, radar=0.25)
    assert half.distance[-1] == pytest.approx(1.25, rel=0.03)


@pytest.mark.parametrize("left", [0.3, -0.3])
def test_a_velocity_without_yaw_rate_leaves_turns_to_odometry(left: float) -> None:
    """Speed of the middle 0.5 m/s in a turn of 0.6 rad/s (R4): no wheel slips."""
    fed = Fed(velocity_topic="radar", **{"front.lateral_position": left})
    rows, _ = drive(fed, turn=0.6, rim=0.5 - 0.6 * left)
    assert rows.slip[-1] == pytest.approx(0.0, abs=0.01)


# ---- Slope, torque, drawbar pull


def force(rows: Readings) -> float:
    """Specific force along x at the end, m/s^2."""
    return float(rows.slope[-1] + rows.gained[-1])


@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_the_slope_comes_from_the_imu_or_from_odometry(speed: float) -> None:
    climb = GRAVITY * math.sin(0.1)
    by_pose, _ = drive(Fed(**MASS), orientation=nose_up(0.1), speed=speed)
    assert force(by_pose) == pytest.approx(climb, rel=1e-3)
    assert math.isnan(force(drive(Fed(**MASS), speed=speed)[0]))  # a flat odometry says nothing
    by_imu, _ = drive(Fed(**IMU), climb=0.1, speed=speed)
    assert force(by_imu) == pytest.approx(climb, rel=1e-3)
    # Without orientation the accelerometer feels the same: gravity along x.
    felt = (climb, 0.0, GRAVITY * math.cos(0.1))
    assert force(drive(Fed(**IMU), climb=None, felt=felt, speed=speed)[0]) == pytest.approx(climb)
    sideways = (0.0, -felt[0], felt[2])  # mounted with its x axis to the left
    turned = Fed(**IMU, imu_yaw=math.pi / 2)
    assert force(drive(turned, climb=None, felt=sideways, speed=speed)[0]) == pytest.approx(climb)


@pytest.mark.parametrize("felt", [(0.0, GRAVITY, 0.5), (9.0, 0.0, 3.0)])
def test_an_imu_on_its_side_tells_no_slope_and_the_rest_goes_on(
    felt: tuple[float, float, float],
) -> None:
    rows, estimates = drive(Fed(**IMU), climb=None, felt=felt)
    assert np.isnan(rows.slope[5:]).all()
    assert len(rows) == 60
    assert np.isfinite(estimates.drawbar_pull[5:]).all()


@pytest.mark.parametrize(
    ("wild", "reason"), [(math.inf, "not_finite"), (math.nan, "not_finite"), (1e9, "not_plausible")]
)
def test_an_acceleration_that_no_vehicle_has_is_counted_and_changes_nothing(
    wild: float, reason: str
) -> None:
    fed = Fed(**IMU)
    for i in range(60):
        felt = (wild if i == 10 else 0.5, 0.0, 9.81)
        fed.give("imu", imu(step(i), None, felt))
        fed.give("odom", odometry(step(i), 0.01 * i, 0.5))
        fed.give("joint_states", joints(step(i), [0.5 / 0.9 / 0.125], [], ["front_joint"]))
        fed.give("front/load", wrench(step(i), 60.0))
        fed.give("front/sinkage", sinkage(step(i), 0.008))
    rows, _ = fed.rest()
    np.testing.assert_allclose(rows.pushed[5:], 0.5)
    assert fed.counts == {("imu", reason): 1}


def test_an_imu_that_loses_its_orientation_leaves_no_infinity() -> None:
    """Between a message with orientation and one without it the slope is not known."""
    fed = Fed(**IMU)
    for i in range(200):
        fed.give("imu", imu(step(i), 0.0 if i % 3 else None, (0.5, 0.0, 9.81)))
        fed.give("odom", odometry(step(i), 0.01 * i, 0.5))
        fed.give("joint_states", joints(step(i), [0.5 / 0.9 / 0.125], [], ["front_joint"]))
        fed.give("front/load", wrench(step(i), 60.0))
        fed.give("front/sinkage", sinkage(step(i) - SECOND // 100, 0.008))
    fed.rest()
    assert math.isfinite(fed.pipeline.strength.friction_angle.value)


def test_torque_is_the_effort_times_gear_and_sign() -> None:
    fed = Fed(**{"front.torque_per_effort": 16.0})
    assert drive(fed, effort=(0.1,))[0].torque[-1] == pytest.approx(1.6)
    assert fed.pipeline.strength.sources == {"torque"}
    mirrored = Fed(**{"front.torque_per_effort": 1.0, "front.joint_sign": -1})
    rows, _ = drive(mirrored, effort=(-0.1,), rim=-0.5 / 0.9)
    assert rows.torque[-1] == pytest.approx(0.1)
    assert "front/torque" not in Fed().pipeline.streams.all


def test_the_balance_is_used_where_mass_and_slope_are_known() -> None:
    known = Fed(**IMU)
    drive(known, 200, climb=0.1)
    assert known.pipeline.strength.sources == {"balance"}
    assert "balance" not in known.pipeline.lacking
    for changes in ({"imu_topic": "imu"}, MASS):
        fed = Fed(**changes)
        drive(fed, 200)
        assert fed.pipeline.strength.sources == set()
        assert "balance" in fed.pipeline.lacking


@pytest.mark.parametrize("name", ["front/load", "front/pull"])
def test_drawbar_pull_tells_the_strength(name: str) -> None:
    """From a topic of its own or from the load's; off where no topic is named."""
    rng = np.random.default_rng(4)
    kind = Soil("kind", 1.6e6, 0.8, 0.39, 0.0, 0.42, 0.012)
    fed = Fed(**{"front.drawbar_pull_topic": name})
    assert "front/drawbar_pull" not in Fed().pipeline.streams.all
    for i in range(200):
        stamp, slip = START + i * SECOND // 10, 0.25 + 0.2 * math.sin(0.2 * i)
        made = predict(Model(kind), Conditions.of(60.0, 0.25, 0.1, slip=slip))
        assert made.drawbar_pull is not None
        pull = float(made.drawbar_pull[0]) + 0.3 * rng.standard_normal()
        for loaded in {"front/load", name}:
            fed.give(loaded, wrench(stamp, 60.0, pull))
        fed.give("odom", odometry(stamp, 0.03 * i, 0.3))
        turning = [0.3 / (1.0 - slip) / 0.125]
        fed.give("joint_states", joints(stamp, turning, [], ["front_joint"]))
        fed.give("front/sinkage", sinkage(stamp, float(made.sinkage[0])))
    _, estimates = fed.rest()
    told = fed.pipeline.strength
    assert told.sources == {"pull"}
    assert told.steps > 40
    angle = told.friction_angle
    assert abs(angle.value - 0.42) < 3.0 * angle.standard_deviation
    off = estimates.drawbar_pull[-1] - float(made.drawbar_pull[0])
    assert abs(off) < max(1.0, 2.0 * estimates.drawbar_pull_std[-1])
    fed.give(name, wrench(START + 20 * SECOND, 60.0, math.nan))
    assert fed.counts["front/drawbar_pull", "not_finite"] == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("front.torque_per_effort", -1.0),
        ("vehicle.mass", 0.0),
        ("imu_yaw", math.nan),
    ],
)
def test_parameters_that_cannot_be(name: str, value: object) -> None:
    with pytest.raises(ParametersError, match=name):
        Fed(**{name: value})
