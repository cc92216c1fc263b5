# SPDX-License-Identifier: Apache-2.0
"""What each watch of the sensors says, and keeps to itself, on drives made by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.estimator.path_steps import PathStep, WheelMean
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.onboard.load_watch import Level, LoadWatch
from smallwheel_ros.onboard.motion_watch import MotionWatch
from smallwheel_ros.onboard.problems import ProblemLog, unit_of
from smallwheel_ros.physics.wheel import Quantity, Wheel

GRAVITY = 9.80665
MASS = 24.0
PLACES = {"fl": (0.3, 0.25), "fr": (0.3, -0.25), "rl": (-0.3, 0.25), "rr": (-0.3, -0.25)}
WHEELS = tuple(
    Wheel(name, 0.25, 0.1, longitudinal_position=x, lateral_position=y)
    for name, (x, y) in PLACES.items()
)
Change = Callable[[str, Reading], Reading]


def drive(
    metres: float, change: Change = lambda _, one: one, heading: float = 0.0, begin: float = 0.0
) -> Iterator[Reading]:
    """At 0.3 m/s and 20 Hz over hills: loads of a rigid frame, sinkage that follows each load."""
    rng = np.random.default_rng(1)
    for i in range(round(metres / 0.015)):
        path = begin + 0.015 * i
        time = path / 0.3
        slope, across = 0.12 * math.sin(1.7 * path), 0.1 * math.sin(1.1 * path + 1.0)
        twist = 0.1 * math.sin(5.0 * path)
        speed = 0.3 + 0.05 * math.sin(0.8 * time)
        for wheel in WHEELS:
            x, y = wheel.longitudinal_position, wheel.lateral_position
            share = 1.0 - 0.3 * (slope * x / 0.09 + across * y / 0.0625) + twist * np.sign(x * y)
            load = MASS * GRAVITY / 4.0 * share
            one = Reading(
                wheel,
                int(1e9 * time) + 1_000_000_000,
                Quantity(load + rng.normal(0.0, 0.6), 1.0),
                Quantity(0.1, 0.05),
                Quantity(0.012 * (load / 60.0) ** 0.8 * math.exp(rng.normal(0.0, 0.03)), 1e-3),
                speed,
                path,
                path,
                rim_speed=speed / 0.9 * (1.0 + rng.normal(0.0, 0.01)),
                slope_force=GRAVITY * slope,
                gained_force=0.0,
                across_force=GRAVITY * across,
                heading=heading,
            )
            yield change(wheel.name, one)


def weighed(change: Change = lambda _, one: one, wheels: tuple[Wheel, ...] = WHEELS) -> LoadWatch:
    watch = LoadWatch(wheels, MASS)
    for one in drive(8.0, change):
        watch.add(one)
    return watch


def scaled(factor: float) -> Change:
    return lambda _, one: one._replace(load=Quantity(factor * one.load.value, 1.0))


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0, ""),
        (0.95, ""),
        (1.07, ""),
        (1.15, "times vehicle.mass and gravity (235.4 N): check the load cells, and"),
        (0.8, "whether a wheel that is not listed carries the rest"),
        (1.0 / GRAVITY, "loads in kg? Check the drivers"),
        (1e-3, "loads in kN?"),
    ],
)
def test_the_sum_of_loads_is_compared_with_the_mass(factor: float, words: str) -> None:
    found = weighed(scaled(factor)).findings
    assert len(found) == bool(words)
    assert not words or words in found[0]


def test_a_weighing_says_what_the_loads_should_add_up_to() -> None:
    watch = weighed(scaled(1.05))
    assert watch.weighing is not None
    _, weight = watch.weighing
    assert weight.value == pytest.approx(MASS * GRAVITY, rel=0.02)


def exchanged(a: str, b: str) -> Change:
    """The load that belongs to one wheel is shown for the other."""
    loads = {(one.wheel.name, one.stamp): one.load for one in drive(8.0)}
    other = {a: b, b: a}
    return lambda name, one: one._replace(load=loads[other.get(name, name), one.stamp])


@pytest.mark.parametrize(("a", "b"), [("fl", "rl"), ("fl", "fr"), ("fr", "rl")])
def test_loads_that_are_interchanged_are_named(a: str, b: str) -> None:
    (found,) = weighed(exchanged(a, b)).findings
    assert f"loads of '{a}' and '{b}' look interchanged (swapped)" in found


def test_loads_that_are_where_they_belong_are_not() -> None:
    assert weighed().interchanged == ""


def test_places_that_are_mirrored_are_named() -> None:
    mirrored = tuple(
        replace(wheel, longitudinal_position=-wheel.longitudinal_position) for wheel in WHEELS
    )
    assert "front and rear look interchanged" in weighed(wheels=mirrored).interchanged


# -- the imu's zero


def tilted(zero: float) -> Change:
    return lambda _, one: one._replace(slope_force=(one.slope_force or 0.0) + GRAVITY * zero)


def test_turns_tell_the_zero_of_the_imu_from_the_slope() -> None:
    level = Level()
    for i in range(10):
        heading = 0.5 * math.pi * i
        slope = 0.06 * math.cos(heading), -0.06 * math.sin(heading)
        for one in drive(0.6, heading=heading, begin=0.6 * i):
            shown = one._replace(
                slope_force=GRAVITY * (slope[0] + 0.05), across_force=GRAVITY * slope[1]
            )
            level.add(shown)
    assert level.zero.value / GRAVITY == pytest.approx(0.05, abs=0.015)
    assert "too much slope, nose up" in level.findings[0]
    assert level.slope == pytest.approx(0.06, abs=0.02)


def test_on_the_straight_a_zero_is_not_told() -> None:
    level = Level()
    for one in drive(20.0, tilted(0.05)):
        level.add(one)
    assert level.findings == ()
    assert level.zero.standard_deviation / GRAVITY > 0.02


def test_without_an_imu_there_is_no_slope() -> None:
    level = Level()
    for one in drive(1.0):
        assert not level.add(one._replace(slope_force=None))
    assert level.slope == 0.0


# -- joints


def joints(change: Change, metres: float = 6.0) -> tuple[MotionWatch, list[Reading]]:
    watch = MotionWatch(WHEELS)
    return watch, [watch.add(one) for one in drive(metres, change)]


def first(change: Callable[[Reading], Reading]) -> Change:
    return lambda name, one: change(one) if name == "fl" else one


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one: one._replace(rim_speed=0.0), "shows 0 while the vehicle moves"),
        (lambda one: one._replace(rim_speed=-one.rim_speed), "joint has turned against the travel"),
        (lambda one: one._replace(rim_speed=0.33, rim_held=2.0), "without change while the others"),
    ],
)
def test_a_joint_that_lies_is_named_and_its_slip_not_used(
    change: Callable[[Reading], Reading], words: str
) -> None:
    watch, seen = joints(first(change))
    (found,) = watch.findings
    assert found.startswith("wheel 'fl': ")
    assert words in found
    said = next(one for one in seen if one.wheel.name == "fl" and one.slip is None)
    assert said.path < 2.0
    assert all(one.slip is not None for one in seen if one.wheel.name != "fl")


def test_joints_that_turn_are_not_named() -> None:
    watch, seen = joints(lambda _, one: one)
    assert watch.findings == ()
    assert all(one.slip is not None for one in seen)


def compared(watch: MotionWatch, slips: dict[str, float], i: int) -> PathStep:
    means = {n: WheelMean(Quantity(slip, 0.02), None, None, None) for n, slip in slips.items()}
    return watch.compared(PathStep(i, 0.1 * i, 0.1, True, True, means, 0.0, 0.0, 0.07))


def test_a_slip_far_from_the_others_is_theirs_until_it_agrees_again() -> None:
    watch = MotionWatch(WHEELS)
    usual = {"fl": 0.1, "fr": 0.12, "rl": 0.08, "rr": 0.1}
    for i in range(8):
        step = compared(watch, usual | {"fl": 0.6}, i)
        assert step.wheels["fl"].slip.value == pytest.approx(0.1)
        assert step.wheels["fl"].doubt > 0.1
        assert step.wheels["fr"].doubt == 0.0
    assert "shows a slip of 0.60 where the others have 0.10" in watch.findings[0]
    for i in range(8, 16):
        step = compared(watch, usual, i)
    assert watch.findings == ()
    assert step.wheels["fl"].doubt == 0.0


def test_an_axle_that_is_braked_is_no_broken_encoder() -> None:
    """Both of its wheels slip alike: so it is, and nothing is doubted or changed."""
    watch = MotionWatch(WHEELS)
    front = {w.name for w in WHEELS if w.longitudinal_position > 0.0}
    slips = {w.name: -0.2 if w.name in front else 0.4 for w in WHEELS}
    for i in range(12):
        found = compared(watch, slips, i)
        assert {name: mean.slip.value for name, mean in found.wheels.items()} == slips
        assert all(mean.doubt == 0.0 for mean in found.wheels.values())
    assert watch.findings == ()
    alone = {**slips, min(front): 0.4 - 0.6}
    alone[max(front)] = 0.4
    for i in range(12, 24):
        found = compared(watch, alone, i)
    assert min(front) in "".join(watch.findings)


def test_odometry_that_repeats_is_said_until_it_changes() -> None:
    watch = MotionWatch(WHEELS)
    for one in drive(1.0):
        watch.add(one._replace(speed_repeats=True))
    assert "odometry repeats one and the same message" in watch.findings[0]
    watch.add(next(drive(0.1)))
    assert watch.findings == ()


# -- refused streams


def test_a_stream_of_which_much_is_refused_is_said_with_the_unit() -> None:
    log = ProblemLog()
    for i in range(40):
        log.add("a/sinkage", "too_deep", "sinkage is 11 m", ratio=900.0 + i)
        log.good("b/sinkage")
    (found,) = log.findings
    assert found.startswith("a/sinkage: 100% of the newest messages are refused")
    assert "1000 times too large: in mm?" in found
    for _ in range(200):
        log.good("a/sinkage")
    assert log.findings == ()


@given(st.integers(0, 7))
def test_few_refused_messages_and_outliers_are_not_said(refused: int) -> None:
    log = ProblemLog()
    for i in range(50):
        if i % 7 < refused / 7:
            log.add("a/load", "negative", "load is -1 N")
        else:
            log.add("a/load", "gate", "does not fit", outlier=True)
            log.good("a/load")
    assert log.findings == ()


@given(st.sampled_from(["load", "sinkage", "speed", "wheel_speed", "odom"]), st.floats(1e-9, 1e9))
def test_a_unit_is_named_only_near_its_ratio(quantity: str, ratio: float) -> None:
    found = unit_of(ratio, quantity)
    if found is not None:
        assert abs(math.log(ratio / found[0])) <= math.log(1.05) + 1e-12
    assert unit_of(1.0, quantity) is None
    assert unit_of(-ratio, quantity) is None
