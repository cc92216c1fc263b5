# SPDX-License-Identifier: Apache-2.0
"""Which joints of a robot description turn wheels, what steers these, and which way the base looks.

Tests `urdf.py`.
"""

from __future__ import annotations

import re

import pytest
import robots
from robots import CORNERS, SIX, joint, robot, wheel

from smallwheel_ros.init.rover import InitError, Rover, rover_of_description
from smallwheel_ros.onboard.running_gear import running_gear, steering_of
from smallwheel_ros.onboard.urdf import RobotDescriptionError, Urdf


def rover(text: str, tmp_path) -> Rover:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return rover_of_description(path)


def steering(text: str) -> dict[str, tuple[str, int, float]]:
    urdf = Urdf(text)
    found = {j.name: steering_of(urdf, j, "base_link") for j in running_gear(urdf).wheels}
    return {name: (s.joint, s.sign, round(s.arm, 6)) for name, s in found.items() if s is not None}


@pytest.mark.parametrize(
    ("text", "wheels", "steered"),
    [
        pytest.param(robots.four(), CORNERS, 0, id="four"),
        pytest.param(robots.four(body=robots.MESH), CORNERS, 0, id="four of meshes"),
        pytest.param(robots.CURIOSITY, SIX, 4, id="curiosity"),
        pytest.param(robots.OSR, SIX, 4, id="osr"),
        pytest.param(robots.EXOTER, SIX, 4, id="exoter"),
        pytest.param(robots.MARTA, SIX, 6, id="marta"),
        pytest.param(robots.hunter("0 0 1"), CORNERS, 2, id="hunter"),
        pytest.param(robots.ranger(), CORNERS, 4, id="ranger"),
        pytest.param(robots.limo(), CORNERS, 2, id="limo"),
        pytest.param(robots.casters(), {"left": 0, "right": 0}, 0, id="casters"),
        pytest.param(robots.one_caster("continuous"), {"left": 0, "right": 0}, 0, id="caster"),
        pytest.param(robots.mobile_manipulator(), {"left": 0, "right": 0}, 0, id="with an arm"),
    ],
)
def test_wheels_are_found_named_and_steered(text, wheels, steered, tmp_path) -> None:
    assert {*rover(text, tmp_path).wheels} == {*wheels}
    assert len(steering(text)) == steered


def test_steering_has_its_joint_sign_and_arm() -> None:
    assert steering(robots.ranger())["rl_wheel"] == ("rl_steering_joint", -1, 0.0)
    assert steering(robots.limo()) == {
        f"front_{side}_wheel": (f"{side}_steering_hinge_wheel", 1, arm)
        for side, arm in (("left", 0.0225), ("right", -0.0225))
    }
    assert steering(robots.OSR)["front_wheel_joint_left"] == ("front_wheel_joint_L", 1, 0.02)


def test_a_steering_joint_that_lies_is_named_and_does_not_steer() -> None:
    gear = running_gear(Urdf(robots.hunter("0 -1 0")))
    assert len(gear.wheels) == 4
    words = "fr_steer_left_joint is called a steering joint, but turns about (0 -1 0)"
    assert words in "; ".join(gear.notes)
    assert steering(robots.hunter("0 -1 0")) == {}


def test_joints_that_turn_and_are_not_taken_are_named_with_the_reason() -> None:
    notes = "; ".join(running_gear(Urdf(robots.CURIOSITY)).notes)
    for words in ("mast_pan (about (0 0 1))", "(limited to less than a turn)",
                  "wrist (about (1 0 0))", "rocker_left (above bogie_left)"):  # fmt: skip
        assert words in notes
    high = robot(*(wheel(n, "base_link", f"{x} {y} 0") for n, (x, y) in CORNERS.items()),
                 joint("reel", "base_link", "reel", "0 0 1.5"))  # fmt: skip
    assert "reel (1.5 m above the lowest wheel)" in "; ".join(running_gear(Urdf(high)).notes)
    assert "roll_l, roll_r (a caster)" in "; ".join(running_gear(Urdf(robots.casters())).notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (robots.mobile_manipulator("fixed"), "left_wheel_joint, right_wheel_joint (fixed)"),
        (robots.one_caster(), "hubcap_joint (a caster)"),
        (robots.one_caster(), "caster_swivel (about (1 0 0))"),
        (
            robot(*robots.arm("0 0.3 0.7", "_l", 7), *robots.arm("0 -0.3 0.7", "_r", 7)),
            "arm_l_5, arm_r_5 (at the end of 5 others: an arm)",
        ),
    ],
)
def test_what_turns_but_is_no_wheel_is_refused_with_the_reason(text: str, words: str) -> None:
    with pytest.raises(RobotDescriptionError, match="no joint turns like a wheel") as refused:
        running_gear(Urdf(text))
    assert words in str(refused.value)


@pytest.mark.parametrize(
    "shank",
    [
        "<inertial><origin xyz='0 0 -0.08'/><mass value='1'/></inertial>",
        "<inertial><mass value='1'/></inertial>"
        "<collision><origin xyz='0.1 0 0'/><geometry><box size='.2 .01 .01'/></geometry></collision>",
    ],
)
def test_knees_are_no_wheels_what_they_turn_hangs_to_one_side(shank: str) -> None:
    """Quadrupeds' knees turn without end in their descriptions, about a horizontal axis, lowest of all."""
    words = "knee_rear_right (its link is not balanced about the axis, a leg)"
    with pytest.raises(RobotDescriptionError, match=re.escape(words)):
        running_gear(Urdf(robots.legged(shank)))
    assert len(running_gear(Urdf(robots.legged(shank, "wheel"))).wheels) == 4


@pytest.mark.parametrize(
    "hub",
    [
        "<inertial><origin xyz='0 0.09 0.001'/><mass value='1'/></inertial>",
        "<visual><origin xyz='0 0 -0.1'/><geometry><mesh filename='package://a/b.dae'/></geometry></visual>",
        "",
    ],
)
def test_wheels_at_the_end_of_a_rocker_are_balanced_or_tell_nothing(hub: str) -> None:
    assert len(running_gear(Urdf(robots.legged(hub))).wheels) == 4


def test_wheels_on_the_base_are_wheels_whatever_their_centre_of_mass_is_said_to_be() -> None:
    text = robots.four(names="drive_{}", body="").replace(
        "_link'></link>",
        "_link'><inertial><origin xyz='0.1 0.2 0.1'/><mass value='1'/></inertial></link>",
    )
    assert "inertial" in text
    assert len(running_gear(Urdf(text)).wheels) == 4


def test_wheels_at_the_end_of_a_leg_are_wheels() -> None:
    """A leg has as many joints as an arm: its wheel is called so."""
    legs = []
    for side, y in (("left", 0.2), ("right", -0.2)):
        parts = robots.arm(f"0 {y} 0.9", f"_{side}", 6)
        legs += [*parts, wheel(f"{side}_wheel", f"arm_{side}_link_5", "0 0 -0.8", axis="1 0 0")]
    assert len(running_gear(Urdf(robot(*legs))).wheels) == 2


def test_wheels_of_two_sizes_and_with_rollers_are_all_wheels() -> None:
    radius = {name: 0.1 if x > 0 else 0.2 for name, (x, _) in CORNERS.items()}
    sizes = robot(*(wheel(n, "base_link", f"{0.5 * x} {0.4 * y} {radius[n]}", radius[n])
                    for n, (x, y) in CORNERS.items()))  # fmt: skip
    assert len(running_gear(Urdf(sizes)).wheels) == 4
    rollers = "".join(
        joint(f"roller_{n}", f"{n}_joint_link", f"roller_{n}", "0 0 0.1", "0.7 0.7 0")
        for n in CORNERS
    )
    mecanum = robots.four().replace("</robot>", f"{rollers}</robot>")
    assert len(running_gear(Urdf(mecanum)).wheels) == 4


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_turned_base_is_turned(quarters, tmp_path) -> None:
    found = rover(robots.turned(quarters), tmp_path)
    assert found.wheels == list(CORNERS)
    for name, (x, y) in CORNERS.items():
        assert found.values[f"{name}.longitudinal_position"] == pytest.approx(0.23 * x)
        assert found.values[f"{name}.lateral_position"] == pytest.approx(0.16 * y)
        assert found.values[f"{name}.joint_sign"] == 1
    assert ("is turned" in "; ".join(found.notes)) == (quarters != 0)


def test_a_turned_base_without_names_leaves_places_and_signs_to_people(tmp_path) -> None:
    text = robots.turned(1, "{}_wheel")
    for i, name in enumerate(CORNERS):
        text = text.replace(f"{name}_wheel", f"drive_{i}")
    found = rover(text, tmp_path)
    assert len(found.wheels) == 4
    assert not [name for name in found.values if name.endswith(("position", "joint_sign"))]
    assert sum(name.endswith("_position") for name in found.missing) == 8
    assert "wheels turn about the x axis of base_link" in "; ".join(found.notes)


def test_an_axis_that_is_not_there_is_said(tmp_path) -> None:
    text = robots.four().replace("<axis xyz='0 1 0'/>", "")
    notes = "; ".join(rover(text, tmp_path).notes)
    assert "has no axis, and then turns about x" in notes


def test_a_wheel_that_is_not_where_its_name_says_is_said(tmp_path) -> None:
    text = robots.four().replace("front_left", "swap").replace("front_right", "front_left")
    found = rover(text.replace("swap", "front_right"), tmp_path)
    assert "front_left is not where its name says" in "; ".join(found.notes)
    assert "rear_left is not" not in "; ".join(found.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (robots.articulated(), "'bend' turns about the vertical and carries the wheels of front_left_joint,"),
        (robot(), "it has no joint, 1 links: is it one part of a description?"),
        (robots.four(kind="fixed"), "none of its 4 joints turns, they are fixed: a wheel's is continuous"),
        (robots.four(axis="0 0 1"), "no joint turns like a wheel, about a horizontal axis and without end"),
        (robots.four(kind="revolute", limit=robots.HALF_TURN), "(limited to less than a turn)"),
        (
            robots.four().replace("<robot", "<robot xmlns:xacro='http://ros.org/wiki/xacro'").replace(
                "</robot>", "<xacro:wheel side='left'/></robot>"
            ),
            "it is xacro that has not been expanded (it has <xacro:wheel>)",
        ),
        (robots.tracked(), "8 joints turn like wheels, in two rows, and higher ones in line with them (spr"),
        (
            robot(robots.joint("arm_1", "base_link", "arm")),
            "one joint alone turns about a horizontal axis and without end, 'arm_1'",
        ),
        ("<robot name='a'><xacro:wheel/></robot>", "it is xacro that has not been expanded"),
        (robots.four("${{side}}{}"), "it is xacro that has not been expanded (name of a link is '${side}"),
    ],
)  # fmt: skip
def test_what_is_refused_says_why(text, words, tmp_path) -> None:
    with pytest.raises(InitError) as refused:
        rover(text, tmp_path)
    assert words in str(refused.value)


def test_eight_wheels_are_no_track_and_a_wheel_alone_is_one(tmp_path) -> None:
    eight = robots.tracked(sprockets=False)
    assert len(rover(eight, tmp_path).wheels) == 8
    assert rover(robot(robots.wheel("wheel", "base_link", "0 0 0")), tmp_path).wheels == ["wheel"]


def test_rockers_above_six_wheels_make_no_track(tmp_path) -> None:
    text = robots.rocker_bogie("{along}_{across}_drive", "{along}_{across}_steer", ())
    assert len(rover(text, tmp_path).wheels) == 6


def test_a_swivel_above_the_base_is_no_articulation() -> None:
    text = robots.four().replace(
        "</robot>",
        "<link name='world'/><joint name='turn' type='continuous'><parent link='world'/>"
        "<child link='base_link'/><axis xyz='0 0 1'/></joint></robot>",
    )
    assert steering(text) == {}
    assert len(running_gear(Urdf(text)).wheels) == 4


def test_a_description_without_wheels_is_an_error_of_its_own() -> None:
    with pytest.raises(RobotDescriptionError):
        running_gear(Urdf(robot()))


def test_a_wheel_of_a_rocker_that_is_drawn_tilted_is_one_by_its_name_and_its_mate() -> None:
    """Some rovers are drawn with a rocker up; what is as high and has no mate below is no wheel."""
    at = {name: (0.4 * x, 0.3 * y, 0.0) for name, (x, y) in SIX.items()}
    at["front_right"] = (0.4, -0.3, 0.35)
    parts = [
        wheel(f"wheel_{n}_joint", "base_link", f"{x} {y} {z}", body=robots.MESH)
        for n, (x, y, z) in at.items()
    ]
    spare = wheel("spare_wheel", "base_link", "-0.5 0 0.5", body=robots.MESH)
    arm = joint("arm", "base_link", "arm_link", "0.5 0 0.6", "0 0 1")
    gear = running_gear(Urdf(robot(*parts, spare, arm)))
    assert {one.name for one in gear.wheels} == {f"wheel_{n}_joint" for n in SIX}
    assert "spare_wheel (0.5 m above the lowest wheel)" in "; ".join(gear.notes)
