# SPDX-License-Identifier: Apache-2.0
"""From messages to the estimate: each way of input, with real messages (those of bags)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from smallwheel_ros.bags import message_type
from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.onboard.feed import Feed, Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil

START = 1_700_000_000 * SECOND
ONE_WHEEL = {
    "wheels": ["front"],
    "front.diameter": 0.25,
    "front.width": 0.1,
    "timing.reorder_time": 0.05,
    "timing.silent_after": 0.1,
    "mobility.rate": 0.0,
}
QUARTER = math.sqrt(0.5)


def make(**changes: object) -> Feed:
    settings = settings_from({**ONE_WHEEL, **changes})
    return Feed(Onboard(settings.onboard), settings)


def topic(feed: Feed, name: str) -> Topic:
    (found,) = [item for item in feed.topics if item.name == name]
    return found


def header(stamp: int, frame: str = "odom") -> Any:
    time = message_type("builtin_interfaces/msg/Time")(sec=stamp // SECOND, nanosec=stamp % SECOND)
    return message_type("std_msgs/msg/Header")(stamp=time, frame_id=frame)


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return message_type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)


def wrench(stamp: int, force: float) -> Any:
    forces = message_type("geometry_msgs/msg/Wrench")(force=vector(z=force), torque=vector())
    return message_type("geometry_msgs/msg/WrenchStamped")(header=header(stamp), wrench=forces)


def twist(speed: float, turn: float = 0.0) -> Any:
    return message_type("geometry_msgs/msg/Twist")(linear=vector(x=speed), angular=vector(z=turn))


def velocity(stamp: int, speed: float) -> Any:
    return message_type("geometry_msgs/msg/TwistStamped")(header=header(stamp), twist=twist(speed))


def odometry(
    stamp: int,
    x: float,
    speed: float,
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    turn: float = 0.0,
) -> Any:
    names = dict(zip("xyzw", orientation, strict=True))
    quaternion = message_type("geometry_msgs/msg/Quaternion")(**names)
    place = message_type("geometry_msgs/msg/Point")(x=x, y=2.0, z=0.0)
    pose = message_type("geometry_msgs/msg/Pose")(position=place, orientation=quaternion)
    nothing = np.zeros(36)
    return message_type("nav_msgs/msg/Odometry")(
        header=header(stamp),
        child_frame_id="base_link",
        pose=message_type("geometry_msgs/msg/PoseWithCovariance")(pose=pose, covariance=nothing),
        twist=message_type("geometry_msgs/msg/TwistWithCovariance")(
            twist=twist(speed, turn), covariance=np.zeros(36)
        ),
    )


def joints(stamp: int, velocity: list[float], effort: list[float], names: list[str]) -> Any:
    return message_type("sensor_msgs/msg/JointState")(
        header=header(stamp),
        name=names,
        position=np.zeros(len(names)),
        velocity=np.array(velocity),
        effort=np.array(effort),
    )


def sinkage(stamp: int, value: float, variance: float = 1e-6) -> Any:
    return message_type("smallwheel_ros/msg/WheelSinkage")(
        header=header(stamp), sinkage=value, variance=variance
    )


def distance(stamp: int, value: float, low: float = 0.05, high: float = 2.0) -> Any:
    return message_type("sensor_msgs/msg/Range")(
        header=header(stamp),
        radiation_type=0,
        field_of_view=0.1,
        min_range=low,
        max_range=high,
        range=value,
        variance=4e-6,
    )


def step(i: int) -> int:
    return START + i * SECOND // 50


class TestUsual:
    def test_topics(self) -> None:
        feed = make()
        assert {(t.name, t.type) for t in feed.topics} == {
            ("front/load", "geometry_msgs/msg/WrenchStamped"),
            ("front/sinkage", "smallwheel_ros/msg/WheelSinkage"),
            ("odom", "nav_msgs/msg/Odometry"),
            ("joint_states", "sensor_msgs/msg/JointState"),
        }
        streams = {name for t in feed.topics for name in t.streams}
        assert streams == set(feed.onboard.streams)

    def run(self, feed: Feed, **how: Any) -> list[Result]:
        results: list[Result] = []
        for i in range(30):
            turned = how.get("orientation", (0.0, 0.0, 0.0, 1.0))
            results += topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5, turned), None)
            state = joints(step(i), [0.5 / 0.9 / 0.125], [], ["front_joint"])
            results += topic(feed, "joint_states").handle(state, None)
            results += topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
            results += topic(feed, "front/sinkage").handle(sinkage(step(i), 0.008), None)
        return results + feed.onboard.flush()

    def test_everything_arrives(self) -> None:
        feed = make(**{"front.lateral_position": 0.3, "front.longitudinal_position": 0.2})
        results = self.run(feed)
        assert len(results) == 30
        last = results[-1]
        assert last.reading.load.value == 60.0
        assert last.reading.slip.value == pytest.approx(0.1)
        assert last.reading.sinkage.value == 0.008
        assert last.reading.place == pytest.approx((0.29 + 0.2, 2.0 + 0.3))
        assert feed.odometry_frame == "odom"

    def test_the_wheel_is_where_the_robot_is_turned_to(self) -> None:
        feed = make(**{"front.lateral_position": 0.3, "front.longitudinal_position": 0.2})
        last = self.run(feed, orientation=(0.0, 0.0, QUARTER, QUARTER))[-1]
        assert last.reading.place == pytest.approx((0.29 - 0.3, 2.0 + 0.2))

    def test_without_an_orientation_there_is_no_place_and_that_is_said(self) -> None:
        feed = make()
        last = self.run(feed, orientation=(0.0, 0.0, 0.0, 0.0))[-1]
        assert last.reading.place is None
        assert last.reading.slip is not None
        assert feed.onboard.counts["odom", "no_orientation"] == 30

    def test_joints_without_velocities_are_counted(self) -> None:
        feed = make()
        state = joints(START, [], [], ["front_joint"])
        assert topic(feed, "joint_states").handle(state, None) == []
        assert feed.onboard.counts["front/wheel_speed", "no_velocities"] == 1
        assert feed.onboard.received["front/wheel_speed"] == 1
        # Joints of others are none of our business.
        topic(feed, "joint_states").handle(joints(START, [], [], ["arm"]), None)
        assert feed.onboard.received["front/wheel_speed"] == 1

    @pytest.mark.parametrize("changes", [{"load_sign": -1}, {"front.load_sign": -1}])
    def test_load_sign(self, changes: dict[str, int]) -> None:
        feed = make(**changes)
        topic(feed, "front/load").handle(wrench(START, -60.0), None)
        assert feed.onboard.counts == {}

    def test_a_mirrored_joint_is_said_and_its_slip_is_not_used(self) -> None:
        """An axis that points the other way shows slip of 1 (R7)."""
        feed = make()
        results = self.drive_mirrored(feed)
        assert results[5].reading.slip.value == pytest.approx(1.0, abs=0.01)
        assert results[-1].reading.slip is None
        (words,) = feed.onboard.findings
        assert "wheel 'front': its joint has turned against the travel" in words
        assert "front.joint_sign" in words

    def test_the_sign_of_the_joint_mends_it(self) -> None:
        feed = make(**{"front.joint_sign": -1})
        assert self.drive_mirrored(feed)[-1].reading.slip.value == pytest.approx(0.1, abs=0.01)
        assert feed.onboard.findings == ()

    def drive_mirrored(self, feed: Feed) -> list[Result]:
        results: list[Result] = []
        for i in range(100):
            topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5), None)
            state = joints(step(i), [-0.5 / 0.9 / 0.125], [], ["front_joint"])
            topic(feed, "joint_states").handle(state, None)
            topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
            shown = 0.008 + 1e-4 * (i % 3)
            results += topic(feed, "front/sinkage").handle(sinkage(step(i), shown), None)
        return results + feed.onboard.flush()

    def test_pitch_and_covariance_of_odometry_are_used(self) -> None:
        feed = make()
        nose_down = (0.0, math.sin(0.05), 0.0, math.cos(0.05))
        message = odometry(START, 0.0, 0.5, nose_down)
        message.twist.covariance[0], message.twist.covariance[35] = 0.04, 0.01
        ((stream, motion),) = topic(feed, "odom").read(message)
        assert stream == "odom"
        assert motion.pitch == pytest.approx(0.1)
        assert (motion.speed_variance, motion.yaw_rate_variance) == (0.04, 0.01)

    def test_a_sure_odometry_makes_a_sure_slip(self) -> None:
        def slip(variance: float) -> float:
            feed = make()
            message = odometry(START, 0.0, 0.5)
            message.twist.covariance[0] = variance
            topic(feed, "odom").handle(message, None)
            state = joints(START, [4.0], [], ["front_joint"])
            topic(feed, "joint_states").handle(state, None)
            topic(feed, "front/load").handle(wrench(START, 60.0), None)
            found = topic(feed, "front/sinkage").handle(sinkage(START, 0.008), None)
            (result,) = found + feed.onboard.flush()
            return result.reading.slip.standard_deviation

        assert slip(0.01) > 5.0 * slip(0.0)


class TestRange:
    def feed(self) -> Feed:
        return make(**{"front.sinkage_source": "Range", "front.range_height": 0.3})

    def test_nearer_ground_is_a_deeper_wheel(self) -> None:
        feed = self.feed()
        assert topic(feed, "front/sinkage").type == "sensor_msgs/msg/Range"
        topic(feed, "front/load").handle(wrench(START, 60.0), None)
        topic(feed, "front/sinkage").handle(distance(START, 0.288), None)
        (result,) = feed.onboard.flush()
        measured = result.reading.sinkage
        assert measured.value == pytest.approx(0.012)
        assert measured.standard_deviation == pytest.approx(0.002)

    @pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 0.01, 3.0])
    def test_outside_of_its_limits_is_counted(self, value: float) -> None:
        feed = self.feed()
        assert topic(feed, "front/sinkage").handle(distance(START, value), None) == []
        assert feed.onboard.counts["front/sinkage", "range_out_of_limits"] == 1
        assert feed.onboard.problems.rejected == 1
        (problem,) = feed.onboard.take_problems()
        assert "expected a number from 0.05 to 2 m" in problem.text

    def test_limits_that_nobody_filled_in_do_not_count(self) -> None:
        feed = self.feed()
        topic(feed, "front/sinkage").handle(distance(START, 0.29, 0.0, 0.0), None)
        assert feed.onboard.counts == {}

    def test_a_little_higher_is_noise_and_much_higher_a_wrong_height(self) -> None:
        feed = self.feed()
        for i, value in enumerate((0.301, 0.6)):
            topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
            topic(feed, "front/sinkage").handle(distance(step(i), value), None)
        first, _ = feed.onboard.flush()
        assert first.reading.sinkage.value == pytest.approx(-0.001)
        assert feed.onboard.counts == {("front/sinkage", "sinkage_negative"): 1}


class TestLoads:
    def test_efforts_of_joints(self) -> None:
        feed = make(
            **{
                "load.source": "joint_states",
                "load.per_effort": 2.0,
                "load_sign": -1,
                "front.load_joint": "leg",
            }
        )
        assert not [t for t in feed.topics if t.name == "front/load"]
        names = ["arm", "leg", "front_joint"]
        handle = topic(feed, "joint_states").handle
        handle(joints(START, [0.0, 0.0, 4.0], [9.0, -30.0, 0.0], names), None)
        topic(feed, "front/sinkage").handle(sinkage(START, 0.008), None)
        (result,) = feed.onboard.flush()
        assert result.reading.load.value == pytest.approx(60.0)
        handle(joints(step(1), [0.0, 0.0, 4.0], [], names), None)
        assert feed.onboard.counts["front/load", "no_efforts"] == 1

    def test_a_static_load_is_used_and_said(self) -> None:
        feed = make(**{"load.source": "static", "load.mass": 6.0})
        assert "front/load" not in feed.onboard.streams
        results = topic(feed, "front/sinkage").handle(sinkage(START, 0.008), None)
        results += feed.onboard.flush()
        (result,) = results
        load = result.reading.load
        assert load.value == pytest.approx(58.8399)
        assert load.standard_deviation == pytest.approx(0.3 * 58.8399)
        assert "load not measured: 58.8 N as configured" in result.status_text
        assert result.forces is not None

    def test_a_guessed_load_makes_everything_less_sure(self) -> None:
        def spread(**changes: object) -> float:
            feed = make(**changes)
            for i in range(40):
                if "load.source" not in changes:
                    topic(feed, "front/load").handle(wrench(step(i), 58.86), None)
                topic(feed, "odom").handle(odometry(step(i), 0.1 * i, 0.5), None)
                shown = 0.008 + 1e-4 * (i % 3)
                topic(feed, "front/sinkage").handle(sinkage(step(i), shown), None)
            feed.onboard.flush()
            return float(feed.onboard.soil.log_covariance[0, 0])

        guessed = spread(**{"load.source": "static", "load.mass": 6.0})
        assert guessed > 1.4 * spread()

    def test_without_sinkage_and_load_sensors_odometry_gives_the_times(self) -> None:
        without = {"load.source": "static", "load.mass": 6.0, "front.sinkage_topic": ""}
        for told in ({}, {"soil.name": "dry_sand"}):
            feed = make(**without, **told)
            results: list[Result] = []
            for i in range(100):
                results += topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5), None)
            assert len(results) == pytest.approx(20, abs=3)
            assert all(r.forces is not None for r in results)
            # How deep it sinks into a soil that nobody has named nobody knows.
            assert all((r.sinkage_predicted is not None) == bool(told) for r in results)


class TestVelocity:
    def slip(self, feed: Feed) -> Result:
        results: list[Result] = []
        for i in range(10):
            state = joints(step(i), [0.5 / 0.125], [], ["front_joint"])
            topic(feed, "joint_states").handle(state, None)
            # Odometry made from the wheels: as fast as they turn.
            topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5), None)
            if "radar" in {t.name for t in feed.topics}:
                topic(feed, "radar").handle(velocity(step(i), 0.3), None)
            topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
            results += topic(feed, "front/sinkage").handle(sinkage(step(i), 0.008), None)
        return (results + feed.onboard.flush())[-1]

    def test_a_velocity_of_its_own_shows_the_slip_that_the_wheels_hide(self) -> None:
        feed = make(velocity_topic="radar", odometry_from_wheels=True)
        assert "velocity" in feed.onboard.streams
        assert topic(feed, "radar").type == "geometry_msgs/msg/TwistStamped"
        assert self.slip(feed).reading.slip.value == pytest.approx(0.4)

    def test_odometry_from_the_wheels_alone_shows_none_and_says_so(self) -> None:
        last = self.slip(make(odometry_from_wheels=True))
        assert last.reading.slip is None
        assert last.status is Status.SLIP_UNKNOWN
        assert "odometry comes from the wheels, and there is no velocity_topic" in last.status_text
        assert last.forces.margin is not None

    def driven(self, speed: float, turn: float = 0.0, **changes: object) -> Feed:
        """Five seconds on wheels that turn as for 0.5 m/s, with odometry made from them."""
        made = {"velocity_topic": "radar", "odometry_from_wheels": True, **changes}
        feed = make(**made)
        for i in range(250):
            topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5, turn=turn), None)
            state = joints(step(i), [0.5 / 0.125], [], ["front_joint"])
            topic(feed, "joint_states").handle(state, None)
            topic(feed, "radar").handle(velocity(step(i), speed), None)
            topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
            shown = 0.008 + 1e-4 * (i % 3)
            self.results += topic(feed, "front/sinkage").handle(sinkage(step(i), shown), None)
        self.results += feed.onboard.flush()
        return feed

    @pytest.fixture(autouse=True)
    def no_results(self) -> None:
        self.results: list[Result] = []

    def test_stuck_with_spinning_wheels_is_no_travel(self) -> None:
        """Path comes from the same source as slip (R3): one hole is one place."""
        feed = self.driven(0.0)
        assert feed.onboard.soil.distance == 0.0
        assert feed.onboard.soil.accepted == 0
        assert self.results[-1].reading.slip.value == pytest.approx(1.0)

    def test_half_as_fast_is_half_the_travel(self) -> None:
        assert self.driven(0.25).onboard.soil.distance == pytest.approx(1.25, rel=0.02)

    @pytest.mark.parametrize("left", [0.3, -0.3])
    def test_a_velocity_without_yaw_rate_leaves_turns_to_odometry(self, left: float) -> None:
        """Speed of the middle 0.5 m/s in a turn of 0.6 rad/s (R4): no wheel slips."""
        feed = make(velocity_topic="radar", **{"front.lateral_position": left})
        for i in range(50):
            topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5, turn=0.6), None)
            rim = (0.5 - 0.6 * left) / 0.125
            topic(feed, "joint_states").handle(joints(step(i), [rim], [], ["front_joint"]), None)
            topic(feed, "radar").handle(velocity(step(i), 0.5), None)
            topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
            self.results += topic(feed, "front/sinkage").handle(sinkage(step(i), 0.008), None)
        assert self.results[-1].reading.slip.value == pytest.approx(0.0, abs=1e-6)

    def test_a_sensor_beside_the_middle_or_turned_is_told_so(self) -> None:
        """0.2 m left of the middle it is slower in a left turn: 0.5 - 0.6 x 0.2 m/s."""
        beside = self.driven(
            0.38, turn=0.6, velocity_lateral_position=0.2, odometry_from_wheels=False
        )
        assert self.results[-1].reading.slip.value == pytest.approx(0.0, abs=1e-6)
        assert beside.onboard.soil.distance == pytest.approx(0.5 * 249 / 50, rel=0.01)
        self.results = []
        self.driven(0.5 / math.cos(0.3), velocity_yaw=0.3)
        assert self.results[-1].reading.slip.value == pytest.approx(0.0, abs=1e-6)

    def test_a_bad_velocity_is_counted(self) -> None:
        feed = make(velocity_topic="radar")
        topic(feed, "radar").handle(velocity(START, math.nan), None)
        assert feed.onboard.counts["velocity", "not_finite"] == 1


# ---- Drawbar pull


def pulled(stamp: int, load: float, pull: float) -> Any:
    forces = message_type("geometry_msgs/msg/Wrench")(force=vector(x=pull, z=load), torque=vector())
    return message_type("geometry_msgs/msg/WrenchStamped")(header=header(stamp), wrench=forces)


@pytest.mark.parametrize("name", ["front/load", "front/pull"])
def test_drawbar_pull_tells_the_strength(name: str) -> None:
    """From a topic of its own or from the load's; off where no topic is named."""
    rng = np.random.default_rng(4)
    kind = Soil("kind", 1.6e6, 0.8, 0.39, 0.0, 0.42, 0.012)
    feed = make(**{"front.drawbar_pull_topic": name})
    assert "front/drawbar_pull" in feed.onboard.streams
    assert "front/drawbar_pull" not in make().onboard.streams
    inputs = [topic(feed, n) for n in ("odom", "joint_states", "front/sinkage")]
    results: list[Result] = []
    for i in range(200):
        stamp, slip = START + i * SECOND // 10, 0.25 + 0.2 * math.sin(0.2 * i)
        made = predict(Model(kind), Conditions.of(60.0, 0.25, 0.1, slip=slip))
        pull = float(made.drawbar_pull[0]) + 0.3 * rng.standard_normal()
        message = pulled(stamp, 60.0, pull)
        for loaded in {"front/load", name}:
            results += topic(feed, loaded).handle(message, None)
        messages = (
            odometry(stamp, 0.03 * i, 0.3),
            joints(stamp, [0.3 / (1.0 - slip) / 0.125], [], ["front_joint"]),
            sinkage(stamp, float(made.sinkage[0])),
        )
        for item, message in zip(inputs, messages, strict=True):
            results += item.handle(message, None)
    results += feed.onboard.flush()
    told = feed.onboard.strength
    assert told.sources == {"pull"}
    assert told.steps > 40
    angle = told.strength.friction_angle
    assert abs(angle.value - 0.42) < 3.0 * angle.standard_deviation
    assert results[-1].forces.drawbar_pull.value == pytest.approx(
        float(made.drawbar_pull[0]), abs=1.0
    )
    wild = pulled(START + 20 * SECOND, 60.0, math.nan)
    topic(feed, name).handle(wild, None)
    assert feed.onboard.counts["front/drawbar_pull", "not_finite"] == 1


# ---- Acceleration


@pytest.mark.parametrize(
    ("felt", "reason"), [(math.inf, "not_finite"), (math.nan, "not_finite"), (1e9, "not_plausible")]
)
def test_an_acceleration_that_no_vehicle_has_is_counted_and_changes_nothing(
    felt: float, reason: str
) -> None:
    feed = make(imu_topic="imu", **{"vehicle.mass": 6.0})

    def give(i: int, ahead: float) -> None:
        message = message_type("sensor_msgs/msg/Imu")(
            header=header(step(i)),
            orientation=message_type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=0.0),
            orientation_covariance=np.full(9, -1.0),
            angular_velocity=vector(),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=ahead, z=9.81),
            linear_acceleration_covariance=np.zeros(9),
        )
        topic(feed, "imu").handle(message, None)

    results: list[Result] = []
    for i in range(20):
        topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5), None)
        state = joints(step(i), [0.5 / 0.9 / 0.125], [], ["front_joint"])
        topic(feed, "joint_states").handle(state, None)
        topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
        give(i, felt if i == 10 else 0.5)
        results += topic(feed, "front/sinkage").handle(sinkage(step(i), 0.008), None)
    results += feed.onboard.flush()
    assert {r.reading.slope_force + r.reading.gained_force for r in results} == {0.5}
    assert feed.onboard.counts == {("imu", reason): 1}


def test_an_imu_that_loses_its_orientation_leaves_no_nan() -> None:
    """Between a message with orientation and one without it the slope is not known."""
    feed = make(imu_topic="imu", **{"vehicle.mass": 6.0})
    readings: list[Any] = []
    feed.onboard.on_reading = readings.append
    for i in range(200):
        told = i % 3 > 0
        message = message_type("sensor_msgs/msg/Imu")(
            header=header(step(i)),
            orientation=message_type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.full(9, 0.0 if told else -1.0),
            angular_velocity=vector(),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=0.5, z=9.81),
            linear_acceleration_covariance=np.zeros(9),
        )
        topic(feed, "imu").handle(message, None)
        topic(feed, "odom").handle(odometry(step(i), 0.01 * i, 0.5), None)
        state = joints(step(i), [0.5 / 0.9 / 0.125], [], ["front_joint"])
        topic(feed, "joint_states").handle(state, None)
        topic(feed, "front/load").handle(wrench(step(i), 60.0), None)
        between = step(i) - SECOND // 100
        topic(feed, "front/sinkage").handle(sinkage(between, 0.008), None)
    feed.onboard.flush()
    slopes = [one.slope_force for one in readings[3:]]
    assert None in slopes
    assert all(slope is None or math.isfinite(slope) for slope in slopes)
    assert math.isfinite(feed.onboard.strength.strength.friction_angle.value)
