# SPDX-License-Identifier: Apache-2.0
"""What tells of strength, from messages: mass, imu, slope of the odometry, effort of the joints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from test_feed import (
    ONE_WHEEL,
    START,
    header,
    joints,
    make,
    odometry,
    sinkage,
    topic,
    vector,
    wrench,
)

from smallwheel_ros.bags import BagWriter, message_type
from smallwheel_ros.estimator.path_steps import PathStep, WheelMean
from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.parameters import ParametersError
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.stuck_warning import StuckWarning
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.spec import ReplaySpec

MASS = {"vehicle.mass": 6.0}
IMU = {**MASS, "imu_topic": "imu"}


def nose_up(angle: float) -> tuple[float, float, float, float]:
    """Quaternion of a vehicle that climbs by an angle (rad): a turn about y is nose down."""
    return 0.0, math.sin(-angle / 2), 0.0, math.cos(angle / 2)


def imu(stamp: int, climb: float | None, felt: tuple[float, float, float]) -> Any:
    names = dict(zip("xyzw", nose_up(climb or 0.0), strict=True))
    covariance = np.zeros(9)
    if climb is None:
        covariance[0] = -1.0
    return message_type("sensor_msgs/msg/Imu")(
        header=header(stamp, "base_link"),
        orientation=message_type("geometry_msgs/msg/Quaternion")(**names),
        orientation_covariance=covariance,
        angular_velocity=vector(),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*felt),
        linear_acceleration_covariance=np.zeros(9),
    )


def messages_at(
    i: int,
    stamp: int,
    pose: float = 0.0,
    imu_climb: float | None = 0.1,
    felt: tuple[float, float, float] = (0.0, 0.0, GRAVITY),
    effort: float = 2.0,
    speed: float = 0.3,
) -> dict[str, Any]:
    """Everything of one instant, by topic."""
    return {
        "imu": imu(stamp, imu_climb, felt),
        "odom": odometry(stamp, 0.1 * speed * i, speed, nose_up(pose)),
        "joint_states": joints(stamp, [speed / 0.8 / 0.125], [effort], ["front_joint"]),
        "front/load": wrench(stamp, 59.0),
        "front/sinkage": sinkage(stamp, 0.011),
    }


def drive(
    feed: Feed,
    *,
    pose: float = 0.0,
    imu_climb: float | None = 0.1,
    felt: tuple[float, float, float] = (0.0, 0.0, GRAVITY),
    effort: float = 2.0,
    speed: float = 0.3,
    steps: int = 60,
) -> list[Result]:
    """Six metres per second of nothing: straight on at one speed, slip 0.2."""
    results: list[Result] = []
    names = {item.name for item in feed.topics}
    for i in range(steps):
        messages = messages_at(i, START + i * SECOND // 10, pose, imu_climb, felt, effort, speed)
        for name in names & messages.keys():
            results += topic(feed, name).handle(messages[name], None)
    return results + feed.onboard.flush()


def test_replay_takes_the_same_inputs_from_a_bag(tmp_path: Path) -> None:
    rover = {
        **ONE_WHEEL,
        **IMU,
        "front.joint": "front_joint",
        "front.torque_source": "effort",
        "front.gear_ratio": 1.0,
    }
    (tmp_path / "rover.yaml").write_text(yaml.safe_dump({"/**": {"ros__parameters": rover}}))
    with BagWriter(tmp_path / "bag") as writer:
        for i in range(60):
            stamp = START + i * SECOND // 10
            for topic_name, message in messages_at(i, stamp).items():
                writer.write(f"/{topic_name}", message.__msgtype__, stamp, message)
    spec = ReplaySpec(tmp_path / "bag", tmp_path / "rover.yaml", tmp_path / "out", copy="none")
    result = replay(spec)
    assert result.onboard.strength.sources == {"balance", "torque"}
    table = pd.read_csv(tmp_path / "out" / "estimates.csv")
    risk = table["risk_of_getting_stuck"].dropna()  # unknown until the first step has ended
    assert len(risk) > 50
    assert risk.between(0.0, 1.0).all()


def force(results: list[Result]) -> float | None:
    slope, gained = results[-1].reading.slope_force, results[-1].reading.gained_force
    return None if slope is None or gained is None else slope + gained


def test_the_slope_comes_from_the_imu_or_from_odometry() -> None:
    assert force(drive(make(**MASS), pose=0.1)) == pytest.approx(GRAVITY * math.sin(0.1), rel=1e-3)
    # A flat odometry says nothing of slopes.
    assert force(drive(make(**MASS), pose=0.0)) is None
    climbing = force(drive(make(**IMU), imu_climb=0.1))
    assert climbing == pytest.approx(GRAVITY * math.sin(0.1), rel=1e-3)
    # Without orientation the accelerometer feels the same: gravity along x.
    felt = (GRAVITY * math.sin(0.1), 0.0, GRAVITY * math.cos(0.1))
    assert force(drive(make(**IMU), imu_climb=None, felt=felt)) == pytest.approx(climbing, rel=1e-3)
    # Mounted with its x axis to the left.
    sideways = (0.0, -felt[0], felt[2])
    turned = make(**IMU, imu_yaw=math.pi / 2)
    assert force(drive(turned, imu_climb=None, felt=sideways)) == pytest.approx(climbing, rel=1e-3)
    # Backwards up the slope is down it along the travel.
    assert force(drive(make(**IMU), imu_climb=0.1, speed=-0.3)) == pytest.approx(
        -climbing, rel=1e-3
    )


@pytest.mark.parametrize("noise", [-0.004, 0.0, 0.004])
def test_wheels_that_spin_on_one_place_still_hold_the_vehicle_on_the_slope(noise: float) -> None:
    """The sign of what is noise about a standstill is not the way that the wheels pull."""
    feed, results = make(**IMU), []
    for i in range(30):
        messages = messages_at(i, START + i * SECOND // 10)
        messages["odom"] = odometry(START + i * SECOND // 10, 0.0, noise)
        for name in {item.name for item in feed.topics} & messages.keys():
            results += topic(feed, name).handle(messages[name], None)
    assert force(results + feed.onboard.flush()) == pytest.approx(GRAVITY * math.sin(0.1), rel=1e-3)


def test_the_balance_is_used_where_mass_and_slope_are_known() -> None:
    feed = make(**IMU)
    drive(feed)
    assert feed.onboard.strength.sources == {"balance"}
    assert "balance" not in feed.onboard.lacking
    for changes, words in (
        ({"imu_topic": "imu"}, "vehicle.mass is not given"),
        (MASS, "it needs load and slip of all wheels, and a slope"),
    ):
        feed = make(**changes)
        drive(feed)
        assert feed.onboard.strength.sources == set()
        assert words in feed.onboard.lacking["balance"]


@pytest.mark.parametrize(
    ("climb", "felt"),
    [
        (None, (0.0, 0.0, 0.0)),  # neither orientation nor gravity
        (None, (0.0, 0.0, -GRAVITY)),  # upside down
        (None, (0.0, GRAVITY, 0.5)),  # on its side
        (None, (math.nan, math.nan, math.nan)),
        (2.5, (0.0, 0.0, GRAVITY)),
    ],
)
def test_an_imu_in_another_frame_is_refused_and_the_rest_goes_on(
    climb: float | None, felt: tuple[float, float, float]
) -> None:
    feed = make(**IMU)
    results = drive(feed, imu_climb=climb, felt=felt)
    assert feed.onboard.counts["imu", "imu_not_upright"] == 60
    (problem,) = [p for p in feed.onboard.take_problems() if p.stream == "imu"][:1]
    assert "base_link" in problem.text
    assert len(results) == 60
    assert results[-1].forces is not None
    assert force(results) is None


def test_torque_is_the_effort_times_gear_and_sign() -> None:
    feed = make(
        **{
            "front.torque_source": "effort",
            "front.gear_ratio": 20.0,
            "front.gear_efficiency": 0.8,
        }
    )
    results = drive(feed, effort=0.1)
    assert results[-1].reading.torque == pytest.approx(1.6)
    assert feed.onboard.strength.sources == {"torque"}
    mirrored = make(**{"front.torque_source": "effort", "front.joint_sign": -1})
    results = []
    for i in range(60):
        messages = messages_at(i, START + i * SECOND // 10)
        turning = [-0.3 / 0.8 / 0.125]  # its axis points the other way, and so does what drives it
        stamp = START + i * SECOND // 10
        messages["joint_states"] = joints(stamp, turning, [-0.1], ["front_joint"])
        for name in {item.name for item in mirrored.topics} & messages.keys():
            results += topic(mirrored, name).handle(messages[name], None)
    assert (results + mirrored.onboard.flush())[-1].reading.torque == pytest.approx(0.1)
    assert "front/torque" not in make().onboard.streams


def test_effort_of_zeros_is_said_and_the_rest_goes_on() -> None:
    feed = make(**{"front.torque_source": "effort"})
    results = drive(feed, effort=0.0)
    assert feed.onboard.counts["front/torque", "torque_zero"] == 60
    assert results[-1].forces is not None
    assert feed.onboard.strength.sources == set()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("front.gear_ratio", 0.0),
        ("front.gear_efficiency", 0.0),
        ("vehicle.mass", 0.0),
        ("front.torque_source", "motor"),
        ("imu_yaw", math.nan),
    ],
)
def test_parameters_that_cannot_be(name: str, value: object) -> None:
    with pytest.raises(ParametersError, match=name):
        make(**{name: value})


def step(i: int, slip: float, gained: float = 0.0, **changes: Any) -> PathStep:
    """The step of 0.1 m that ends there, on a slope of a tenth."""
    means = {"front": WheelMean(Quantity(slip, 0.02), None, None, None)}
    whole = PathStep(0.3 * i, 0.1 * i, 0.1, True, i > 0, means, 0.1 * GRAVITY, gained, 0.07)
    return whole._replace(**changes)


def test_a_slipping_vehicle_is_warned_of_with_its_risk() -> None:
    feed = make(**MASS)
    reading = drive(feed, pose=0.05)[-1].reading
    watch = StuckWarning()
    assert watch.risk is None
    warnings, margin = [], Quantity(0.2, 0.05)
    for i in range(30):
        watch.know(reading._replace(stamp=START + i * SECOND // 3), margin)
        watch.take(step(i, min(0.1 + 0.03 * i, 1.0)), watch_at(reading, i), 0.4)
        warnings.append(watch.warning)
    first = next(i for i, words in enumerate(warnings) if words)
    # On the way to 0.4 before it is over 0.3, and long before it is there.
    assert 3 <= first < 7
    assert "may get stuck in" in warnings[first]
    assert "m, " in warnings[first]
    over = next(words for words in warnings if words.startswith("the wheels slip by 0.3"))
    assert "more and more: the vehicle may get stuck in 0." in over
    assert warnings[-1].startswith("the wheels slip by 0.9")
    assert warnings[-1].endswith("at any moment")
    assert watch.risk == pytest.approx(1.0 - 0.977, abs=0.01)  # 0.1 is two deviations
    watch.reset()
    assert (watch.risk, watch.warning) == (None, "")


def watch_at(reading: Any, i: int) -> Any:
    return reading._replace(stamp=START + i * SECOND // 3)


def test_a_slip_that_stays_high_is_warned_of_without_a_distance() -> None:
    reading = drive(make(**MASS), pose=0.05)[-1].reading
    watch = StuckWarning()
    for i in range(60):
        watch.take(step(i, 0.448 - 1e-4 * i), reading, 0.4)
    assert watch.warning == "the wheels slip by 0.44: the vehicle may get stuck"


def test_who_starts_off_or_turns_back_is_not_about_to_get_stuck() -> None:
    """Slip of gaining speed is the driver's will, and a line does not go round corners."""
    reading = drive(make(**MASS), pose=0.05)[-1].reading
    watch = StuckWarning()
    watch.know(reading, Quantity(0.25, 0.03))
    for i in range(8):
        watch.take(step(i, 0.05 + 0.04 * i, 0.05 * i), reading, 0.4)
        assert watch.warning == ""
    level = {"slope": -0.05 * GRAVITY}
    for i in range(8, 14):
        watch.take(step(i, 0.05, **level), reading, 0.4)
    for i in range(14, 18):
        watch.take(step(i, 0.22, slope=0.1 * GRAVITY, forward=False, follows=i > 14), reading, 0.4)
        assert watch.warning == ""
    assert watch.risk is not None
    assert watch.risk < 0.1


def test_no_warning_in_ordinary_driving() -> None:
    feed = make(**MASS)
    drive(feed, pose=0.05)
    assert feed.onboard.stuck.warning == ""
    assert feed.onboard.stuck.risk is not None
