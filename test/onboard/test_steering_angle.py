# SPDX-License-Identifier: Apache-2.0
"""Angles of steered wheels (`steering_angle.py`), and vehicles whose steering is refused in words."""

from __future__ import annotations

import math

import numpy as np
import pytest
from steered_drives import CAR

from smallwheel_ros.onboard.parameters import ParametersError, settings_from
from smallwheel_ros.onboard.steering_angle import SteeringAngle, SteeringReader

SECOND = 10**9


def test_a_linkage_has_its_wheels_square_to_one_point() -> None:
    length, half, central = 0.36, 0.2, 0.3
    radius = length / math.tan(central)
    left, right = (
        SteeringReader(1, 0.0, length, y).angle(np.array([central])) for y in (half, -half)
    )
    assert left[0] == pytest.approx(math.atan2(length, radius - half))
    assert right[0] == pytest.approx(math.atan2(length, radius + half))
    behind = SteeringReader(1, 0.0, -length, half).angle(np.array([-central]))
    assert behind[0] == pytest.approx(-math.atan2(length, radius - half))
    assert SteeringReader(-1, 0.1).angle(np.array([0.4]))[0] == pytest.approx(-0.3)


def test_degrees_are_recognised_and_steps_counted() -> None:
    stamps = np.arange(100) * (SECOND // 10)
    degrees = SteeringAngle()
    usable = degrees.usable(stamps, 20.0 * np.sin(0.1 * np.arange(100)))
    assert not usable[-50:].any()
    assert "in degrees?" in degrees.wrong
    steps = SteeringAngle()
    assert steps.usable(stamps, 0.3 * (np.arange(100) // 10 % 2)).all()
    assert steps.new_steps == 9
    smooth = SteeringAngle()
    assert smooth.usable(stamps, 0.3 * np.sin(0.2 * np.arange(100))).all()
    assert smooth.new_steps == 0
    assert not smooth.wrong


def test_an_articulated_vehicle_is_refused_in_words() -> None:
    values = {"wheels": list(CAR), "all_wheels.diameter": 0.2, "all_wheels.width": 0.1}
    values |= {f"{n}.longitudinal_position": x for n, (x, _, _) in CAR.items()}
    values |= {f"{n}.lateral_position": y for n, (_, y, _) in CAR.items()}
    with pytest.raises(ParametersError, match="articulated"):
        settings_from(values | {"all_wheels.steering_joint": "middle"})
    linked = {f"front_{side}.steering_joint": "servo" for side in ("left", "right")}
    steered = settings_from(values | linked).onboard.steered
    assert {name: one.linkage for name, one in steered.items()} == {
        "front_left": 0.36,
        "front_right": 0.36,
    }
    with pytest.raises(ParametersError, match="turns wheel rear_left"):
        settings_from(values | {"front_left.steering_joint": "rear_left_joint"})
