# SPDX-License-Identifier: Apache-2.0
"""Recorded joints that steer (`steering_joints.py`): of which topic, and called otherwise than described."""

from __future__ import annotations

from smallwheel_ros.init.steering_joints import steering_values

WHEELS = ["front_left", "front_right", "middle_left", "middle_right"]
DRIVE = [f"{wheel}_wheel_joint" for wheel in WHEELS]
STEER = ["front_left_steering_joint", "front_right_steering_joint"]


def test_without_a_description_joints_steer_the_wheels_that_they_are_named_after() -> None:
    found, notes = steering_values({}, WHEELS, {"/joint_states": DRIVE + STEER}, "/joint_states")
    assert found == {
        f"front_{s}.steering_joint": f"front_{s}_steering_joint" for s in ("left", "right")
    }
    assert all("check steering_sign" in note for note in notes)


def test_a_topic_of_their_own_is_steering_topic() -> None:
    joints = {"/drive_state": DRIVE, "/corner_state": ["corner_front_left", "corner_front_right"]}
    found, notes = steering_values({}, WHEELS, joints, "/drive_state")
    assert found["steering_topic"] == "/corner_state"
    assert found["front_left.steering_joint"] == "corner_front_left"
    assert "/corner_state is steering_topic" in notes[-1]


def test_what_the_description_says_stands_where_it_is_recorded() -> None:
    described = {"front_left.steering_joint": "servo_7"}
    assert steering_values(
        described, ["front_left"], {"/joint_states": ["servo_7"]}, "/joint_states"
    ) == (
        {},
        [],
    )
    found, notes = steering_values(
        described, ["front_left"], {"/joint_states": DRIVE}, "/joint_states"
    )
    assert found == {}
    assert "servo_7 steers front_left, and is in no joint states" in notes[0]


def test_vehicles_that_do_not_steer_get_nothing() -> None:
    assert steering_values({}, WHEELS, {"/joint_states": DRIVE}, "/joint_states") == ({}, [])
