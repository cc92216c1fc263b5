# SPDX-License-Identifier: Apache-2.0
"""Slip tests that are proposed: they tell what was said, in a truth of other numerics, and the bands hold."""

from __future__ import annotations

import math

import pytest

from benchmarks.slip_tests import driven
from benchmarks.traction_rates import settings_of
from smallwheel_ros.estimator.path_steps import RollingContact
from smallwheel_ros.estimator.slip_tests import slip_tests
from smallwheel_ros.estimator.strength_filter import TractionFilter, WheelStep
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

WORLD, SEED, KIND = "cruise, equal", 101, "pull sensor"
PLACES = {"friction angle": (1, math.degrees(1.0)), "shear displacement": (2, 100.0)}


def test_a_slip_test_tells_what_was_said_and_the_truth_is_in_its_band() -> None:
    rover, on = driven(WORLD, SEED, KIND, None)
    assert on.slip_tests
    best = min(on.slip_tests, key=lambda one: one.after / one.driving_on)
    front = "front" in best.what
    axle = [j for j, w in enumerate(rover.wheels) if (w.longitudinal_position > 0.0) == front]
    _, tested = driven(WORLD, SEED, KIND, axle)
    truth = {"friction angle": rover.strength[1], "shear displacement": math.log(rover.strength[2])}
    for one in on.slip_tests:
        place, by = PLACES[one.quantity]
        plain = math.sqrt(on.traction.reserve.strength[1][place, place])
        mean, covariance = tested.traction.reserve.strength
        deviation = math.sqrt(covariance[place, place])
        assert by * deviation == pytest.approx(one.after, rel=0.2)
        assert deviation < 0.95 * plain
        assert abs(mean[place] - truth[one.quantity]) < 2.5 * deviation
        assert "braked" in one.text
        assert "driving on" in one.text


def test_nobody_is_told_to_slip_where_the_vehicle_may_get_stuck() -> None:
    _, on = driven(WORLD, SEED, KIND, None)
    assert on.slip_tests
    on.stuck.warning = "may get stuck"
    on.find_slip_tests()
    assert on.slip_tests == ()


def test_nothing_is_proposed_before_anything_has_told_of_strength() -> None:
    fresh = Onboard(settings_of("equal", 23.6))
    assert fresh.look_for_slip_tests()
    assert fresh.look_for_slip_tests()
    assert fresh.slip_tests == ()


def test_one_axle_has_no_other_to_brake() -> None:
    wheels = [Wheel("a", 0.25, 0.1), Wheel("b", 0.25, 0.1, lateral_position=0.5)]
    prior = Strength(Quantity(0.0, 400.0), Quantity(0.5, 0.1), Quantity(0.012, 0.005))
    steps = [WheelStep(i, RollingContact(59.0, 0.012, 0.25, 0.1, 1.0), 0.1) for i in range(2)]
    made = TractionFilter(prior, wheels, 24.0)
    assert list(slip_tests(made, wheels, steps, with_balance=True, reference_slip=0.4)) == []
