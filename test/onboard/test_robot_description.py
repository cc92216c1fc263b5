# SPDX-License-Identifier: Apache-2.0
"""What a robot description fills, and what is said of what it cannot; `urdf.py` reads it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from smallwheel_ros.bags import BagReader, BagWriter, message_type
from smallwheel_ros.cli import main
from smallwheel_ros.onboard.robot_description import (
    Filled,
    RobotDescriptionError,
    Urdf,
    fill_silent,
    needs_description,
    silent_parameters,
)
from smallwheel_ros.replay.replay import replay as replay_bag
from smallwheel_ros.replay.spec import ReplaySpec, read_remaps
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

QUARTER = math.pi / 2
CYLINDER = '<geometry><cylinder radius="0.125" length="0.1"/></geometry>'
LYING = f'<origin rpy="{QUARTER} 0 0"/>{CYLINDER}'  # about y


def joint(
    name: str,
    parent: str,
    child: str,
    *,
    xyz: str = "0 0 0",
    rpy: str = "0 0 0",
    axis: str = "0 1 0",
    kind: str = "continuous",
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/></joint>'
    )


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def robot(*parts: str) -> str:
    return f'<robot name="rover">{"".join(parts)}</robot>'


def one_wheel(body: str = f"<collision>{LYING}</collision>", **options: str) -> str:
    """A robot with one wheel, 0.3 m ahead and 0.2 m to the left."""
    options = {"xyz": "0.3 0.2 0.1"} | options
    return robot(
        link("base_link"), link("tyre", body), joint("front_joint", "base_link", "tyre", **options)
    )


def filled(text: str, **given: object) -> Filled:
    """What is filled besides the frame, which is given."""
    return fill_silent(
        text,
        {"wheels": ["front"], "front.frame": "rim"}
        | {k.replace("__", "."): given[k] for k in given},
    )


ALL = {
    "front.diameter": 0.25,
    "front.width": 0.1,
    "front.lateral_position": 0.2,
    "front.longitudinal_position": 0.3,
    "front.joint_sign": 1,
}
SILENT = {name.replace(".", "__"): value for name, value in ALL.items()}


# --- What is filled


@pytest.mark.parametrize(
    ("text", "differs"),
    [
        pytest.param(one_wheel(), {}, id="plain"),
        pytest.param(one_wheel(axis="0 -3 0"), {"front.joint_sign": -1}, id="mirrored axis"),
        pytest.param(
            # As is usual: z of the joint outward, on the right side turned by half a circle.
            one_wheel(
                f"<collision>{CYLINDER}</collision>",
                xyz="0.3 -0.2 0",
                rpy=f"{QUARTER} 0 0",
                axis="0 0 1",
            ),
            {"front.lateral_position": -0.2, "front.joint_sign": -1},
            id="axis turned by the origin to -y",
        ),
        pytest.param(
            one_wheel(f"<collision>{CYLINDER}</collision>", rpy=f"-{QUARTER} 0 0", axis="0 0 1"),
            {},
            id="axis turned by the origin to +y",
        ),
        pytest.param(
            robot(
                link("base_footprint"),
                link("base_link"),
                link("rocker"),
                link("leg"),
                link("tyre", f"<collision>{LYING}</collision>"),
                joint("stand", "base_footprint", "base_link", xyz="5 5 5", kind="fixed"),
                joint("rock", "base_link", "rocker", xyz="0.1 0.2 0", kind="revolute"),
                # The rocker's x looks to the left: what is ahead of it is to the left of the base.
                joint("turn", "rocker", "leg", xyz="0.2 0 0", rpy=f"0 0 {QUARTER}", kind="fixed"),
                joint("front_joint", "leg", "tyre", xyz="0.05 0 0", axis="1 0 0"),
            ).replace(f'rpy="{QUARTER} 0 0"', f'rpy="0 {QUARTER} 0"'),
            {"front.lateral_position": 0.25},
            id="nested chain above which base_link is not the root",
        ),
        pytest.param(
            one_wheel(f"<visual>{LYING}</visual>"), {}, id="cylinder of the visual, no collision"
        ),
        pytest.param(
            one_wheel(
                f'<collision><origin xyz="0 0.04 0" rpy="{QUARTER} 0 0"/>{CYLINDER}</collision>'
            ),
            {"front.lateral_position": 0.24},
            id="cylinder beside its link",
        ),
        pytest.param(
            one_wheel(
                f"<collision>{LYING.replace('0.125', '0.02').replace('0.1', '0.3')}</collision>"
                f"<collision>{LYING}</collision>"
            ),
            {},
            id="hub and tyre: the larger one",
        ),
        pytest.param(
            one_wheel().replace("base_link", "chassis"), {}, id="no base_link: from the root link"
        ),
        pytest.param(
            one_wheel().replace(
                "</robot>", '<transmission><joint name="front_joint"/></transmission></robot>'
            ),
            {},
            id="joints within other elements are none",
        ),
    ],
)
def test_silent_parameters_are_filled(text: str, differs: dict[str, object]) -> None:
    found = filled(text)
    assert found.values == pytest.approx(ALL | differs)
    assert found.lacking == []


def test_the_frame_is_the_link_that_the_joint_moves() -> None:
    assert filled(one_wheel(), front__frame=None).values["front.frame"] == "tyre"
    no_joint = filled(one_wheel(), front__frame=None, front__joint="x", **SILENT)
    assert no_joint == Filled()  # nothing else was asked for


def test_what_all_wheels_have_is_given_and_a_track_that_contradicts_is_said() -> None:
    found = filled(one_wheel(), **{"all_wheels.diameter": 0.3, "vehicle.track": 0.9})
    assert "front.diameter" not in found.values
    assert found.values["front.lateral_position"] == 0.2
    found = fill_silent(
        one_wheel().replace("front_joint", "left_joint"),
        {"wheels": ["left"], "left.frame": "rim", "vehicle.track": 0.9},
    )
    (said,) = found.lacking
    assert "left.lateral_position is 0.2, but vehicle.track (0.9) says 0.45: the desc" in said


def test_given_parameters_win_and_are_not_spoken_of() -> None:
    mesh = one_wheel('<collision><geometry><mesh filename="a.stl"/></geometry></collision>')
    found = filled(mesh, front__diameter=0.3, front__width=0.2, front__joint_sign=-1)
    assert found.values == {"front.lateral_position": 0.2, "front.longitudinal_position": 0.3}
    assert found.lacking == []
    assert filled("<robot/>", **{k.replace(".", "__"): v for k, v in ALL.items()}) == Filled()


def test_the_joint_and_the_base_frame_are_those_of_parameters() -> None:
    text = one_wheel().replace("front_joint", "drive_1")
    assert filled(text, front__joint="drive_1").values == pytest.approx(ALL)
    from_tyre = filled(text, front__joint="drive_1", base_frame="tyre").values
    assert from_tyre["front.lateral_position"] == 0.0


# --- What is not, and what is said of it


@pytest.mark.parametrize(
    ("text", "missing", "words"),
    [
        (
            one_wheel('<collision><geometry><mesh filename="a.stl"/></geometry></collision>'),
            {"diameter", "width"},
            "front.diameter, front.width: link 'tyre' has 'mesh', expected a cylinder in its",
        ),
        (one_wheel(""), {"diameter", "width"}, "link 'tyre' has no geometry, expected a cylinder"),
        (
            one_wheel(f"<collision>{CYLINDER}</collision>"),
            {"diameter", "width"},
            "the cylinder of link 'tyre' is not about the axis of joint 'front_joint'",
        ),
        (
            one_wheel().replace("0.125", "30"),
            {"diameter"},
            "parameter front.diameter is 60.0, expected a double from 0.005 to 5 m",
        ),
        (
            one_wheel().replace('length="0.1"', 'length="nan"'),
            {"diameter", "width"},
            "link 'tyre': length of its cylinder is 'nan', expected 1 number",
        ),
        (
            one_wheel(kind="fixed"),
            {"joint_sign"},
            "joint 'front_joint' is 'fixed', expected continuous or revolute",
        ),
        (
            one_wheel(
                "<collision><origin rpy='0 1.5708 0'/>" + CYLINDER + "</collision>", axis="1 0 0"
            ),
            # Wheels turn about x: it is not ahead, and one wheel's name does not tell what is.
            {"lateral_position", "longitudinal_position", "joint_sign"},
            "wheels turn about the x axis of base_link, which is then not ahead (REP 103)",
        ),
        (
            one_wheel(f"<collision>{CYLINDER}</collision>", axis="0 0 1"),
            {"joint_sign"},
            "axis of joint 'front_joint' is (0.00 0.00 1.00) in 'base_link', expected (0 1 0) or",
        ),
        (
            one_wheel(axis="0 0 0"),
            {"diameter", "width", "joint_sign"},
            "joint 'front_joint' has an axis without direction",
        ),
        (
            one_wheel(xyz="left 0 0"),
            {"lateral_position", "longitudinal_position", "joint_sign"},
            "joint 'front_joint': xyz of its origin is 'left 0 0', expected 3 numbers",
        ),
        (
            one_wheel(xyz="1e400 0 0"),
            {"lateral_position", "longitudinal_position", "joint_sign"},
            "xyz of its origin is '1e400 0 0'",
        ),
        (
            one_wheel().replace("front_joint", "drive_1"),
            {"diameter", "width", "lateral_position", "longitudinal_position", "joint_sign"},
            "there is no joint 'front_joint', expected parameter front.joint to be one that turns:"
            " 'drive_1'",
        ),
        (
            robot(
                link("base_link"),
                link("tyre", f"<collision>{LYING}</collision>"),
                joint("front_joint", "a", "tyre"),
                joint("back", "tyre", "a"),
            ),
            {"lateral_position", "longitudinal_position", "joint_sign"},
            "the joints above link 'a' are a circle",
        ),
        (
            robot(
                link("base_link"),
                link("tyre", f"<collision>{LYING}</collision>"),
                joint("front_joint", "elsewhere", "tyre"),
            ),
            {"lateral_position", "longitudinal_position", "joint_sign"},
            "no joints connect link 'tyre' with link 'base_link'",
        ),
    ],
)
def test_what_cannot_be_filled_is_said(text: str, missing: set[str], words: str) -> None:
    found = filled(text)
    assert ALL.keys() - found.values.keys() == {f"front.{name}" for name in missing}
    assert words in "; ".join(found.lacking)
    for name in missing:
        assert f"front.{name}" in "; ".join(found.lacking)


def test_a_base_frame_that_is_not_there_is_said() -> None:
    found = filled(one_wheel(), base_frame="chassis")
    assert found.values == {}
    assert "no link 'chassis', expected parameter base_frame" in found.lacking[0]


def test_what_steers_a_wheel_comes_from_the_description() -> None:
    text = robot(
        link("base_link"),
        link("fork"),
        link("tyre", f"<collision>{LYING}</collision>"),
        joint("steering", "base_link", "fork", xyz="0.3 0.2 0", axis="0 0 1", kind="revolute"),
        joint("front_joint", "fork", "tyre"),
    )
    steering = {"front.steering_joint": "steering", "front.steering_arm": 0.0}
    found = filled(text)
    assert found.values == pytest.approx(ALL | steering)
    assert found.lacking == []
    assert filled(text, front__contact="pressed").values == pytest.approx(ALL)
    own = filled(text, front__steering_joint="")
    assert own.values == pytest.approx(ALL)
    other = filled(text, front__steering_joint="a_servo")
    assert other.values == pytest.approx(ALL)
    turned = filled(text.replace("0 0 1", "0 0 -1"))
    assert turned.values["front.steering_sign"] == -1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty"),
        ("\n", "it is empty"),
        ("<?xml version='1.0'?>", "it is no XML: no element found"),
        ("<robot><xacro:a/></robot>", "it is xacro that has not been expanded (it has <xacro:a>)"),
        ("<sdf><a:b/></sdf>", "it is no XML: unbound prefix"),
        ("<robot>", "it is no XML"),
        ("<robot>\x00</robot>", "it is no XML"),
        ("<robot>\ud800</robot>", "it is no XML"),
        ("<sdf/>", "its outermost element is 'sdf', expected 'robot'"),
        ("<robot>&b;</robot>", "it is no XML: undefined entity"),
        (
            one_wheel(xyz="${track/2} 0 0"),
            "xacro that has not been expanded (xyz of a origin is '${track/2} 0 0')",
        ),
        (
            one_wheel().replace("</robot>", joint("front_joint", "a", "b") + "</robot>"),
            "two joints",
        ),
        (
            one_wheel().replace("</robot>", joint("other", "a", "tyre") + "</robot>"),
            "link 'tyre' is the child of two joints, 'front_joint' and 'other'",
        ),
    ],
)
def test_what_is_no_description_is_refused_in_words(text: str, words: str) -> None:
    with pytest.raises(RobotDescriptionError) as refused:
        Urdf(text)
    assert words in str(refused.value)
    assert len(str(refused.value)) < 300


def test_prefixes_that_nobody_declared_are_read() -> None:
    """As the descriptions of robots with older sensors of Gazebo have them."""
    sensor = "<gazebo><sensor:camera name='a' body:b='1'><x/></sensor:camera></gazebo>"
    text = one_wheel().replace("</robot>", f"{sensor}</robot>")
    assert {*Urdf(text).joints} == {*Urdf(one_wheel()).joints}


def test_a_description_is_needed_only_where_nothing_else_is_wrong() -> None:
    wheels: dict[str, object] = {"wheels": ["front"]}
    assert needs_description(wheels) == ["front.diameter", "front.width"]
    assert needs_description(wheels | {"front.width": 0.1}) == ["front.diameter"]
    assert needs_description(wheels | {"front.width": 0.1, "front.diameter": 0.2}) == []
    assert needs_description(wheels | {"front.load_sign": 3}) == []
    assert needs_description({}) == silent_parameters({}) == []


# --- Replay


WHEELS = {"front_left": (0.35, 0.28), "front_right": (0.35, -0.28)}
REAR = {"rear_left": (-0.35, 0.42), "rear_right": (-0.35, -0.42)}


def rover_of_two_sizes() -> str:
    parts = [link("base_link")]
    for name, (x, y) in (WHEELS | REAR).items():
        body = f"<collision>{LYING}</collision>"
        if name in REAR:
            body = body.replace("0.125", "0.2").replace('length="0.1"', 'length="0.12"')
        parts += [link(name, body), joint(f"{name}_joint", "base_link", name, xyz=f"{x} {y} 0")]
    return robot(*parts)


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive"
    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=2.0, wheels="two_sizes")), path)
    return path


def with_description(bag: Path, target: Path, text: str, topic: str = "/robot_description") -> Path:
    kind = "std_msgs/msg/String"
    with BagReader(bag) as reader, BagWriter(target) as writer:
        writer.write(topic, kind, reader.start_time or 0, message_type(kind)(data=text))
        for name, its_kind, time, message in reader.messages():
            writer.write(name, its_kind, time, message)
    return target


def replay(bag: Path, config: Path, folder: Path, *options: str, code: int = 0):
    arguments = ["replay", str(bag), "--config", str(config), "-o", str(folder), *options]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == code, (result.output, result.exception)
    return result


@pytest.fixture
def given(repository, tmp_path) -> dict[str, Path]:
    """The rover's parameter file, and the same without what a robot description fills."""
    content = yaml.safe_load((repository / "config" / "two_wheel_sizes.yaml").read_text())
    (section,) = content.values()
    for name in WHEELS | REAR:
        for parameter in ("diameter", "width", "lateral_position", "longitudinal_position"):
            del section["ros__parameters"][name][parameter]
    silent = tmp_path / "silent.yaml"
    silent.write_text(yaml.safe_dump(content))
    return {"full": repository / "config" / "two_wheel_sizes.yaml", "silent": silent}


def test_replay_takes_what_is_silent_from_the_bag(bag, given, tmp_path) -> None:
    full = yaml.safe_load(given["full"].read_text())["/**"]["ros__parameters"]
    text = rover_of_two_sizes()
    expected = {
        f"{wheel}.{name}": value
        for wheel in WHEELS | REAR
        for name, value in full[wheel].items()
        if name in ("diameter", "width", "lateral_position", "longitudinal_position")
    }
    found = fill_silent(text, {"wheels": list(WHEELS | REAR)}).values
    assert expected == {name: found[name] for name in expected}
    described = with_description(bag, tmp_path / "described", text)
    replay_bag(ReplaySpec(bag, given["full"], tmp_path / "full"))
    result = replay(described, given["silent"], tmp_path / "silent", "--copy", "used")
    assert "from the bag's /robot_description: front_left.diameter=0.25" in result.output
    estimates = [(tmp_path / name / "estimates.csv").read_text() for name in ("full", "silent")]
    assert estimates[0] == estimates[1]
    notes = json.loads((tmp_path / "silent" / "replay.json").read_text())["notes"]
    assert any("rear_right.joint_sign=1" in note for note in notes)
    # What was used is in the new bag, so that it can be replayed in turn.
    with BagReader(tmp_path / "silent" / "bag") as reader:
        assert "/robot_description" in {topic.name for topic in reader.topics}


def test_replay_follows_a_remap_of_the_description(bag, given, tmp_path) -> None:
    described = with_description(bag, tmp_path / "described", rover_of_two_sizes(), "/rover/urdf")
    remaps = read_remaps(["robot_description:=/rover/urdf"])
    result = replay_bag(ReplaySpec(described, given["silent"], tmp_path / "out", remaps))
    assert "from the bag's /rover/urdf: front_left.diameter=0.25" in result.notes[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "no robot description: /robot_description is not in the bag"),
        ("<robot/>", "there is no joint 'front_left_joint'"),
    ],
)
def test_replay_without_a_usable_description_says_so(bag, given, tmp_path, text, words) -> None:
    source = bag if text is None else with_description(bag, tmp_path / "described", text)
    result = replay(source, given["silent"], tmp_path / "out", code=2)
    assert "parameter front_left.diameter is missing, expected a double" in result.output
    assert words in result.output
    assert not (tmp_path / "out").exists()
