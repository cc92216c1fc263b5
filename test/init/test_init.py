# SPDX-License-Identifier: Apache-2.0
"""`smallwheel init`: what it finds in a bag or a robot description, and what it leaves to people.

Tests `from_bag.py`, `joint_topics.py`, `recorded.py` and `rover.py`.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner, Result

import smallwheel_ros as sw
from smallwheel_ros.bags import BagReader, BagWriter, message_type
from smallwheel_ros.cli import main
from smallwheel_ros.init.rover import FILL_IN, usual_names, wheels_named_by
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    for_each_wheel,
    read_parameters,
    settings_from,
)
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

PLACES = {"front_left": (0.35, 0.28), "front_right": (0.35, -0.28),
          "rear_left": (-0.35, 0.28), "rear_right": (-0.35, -0.28)}  # fmt: skip


def description(joint: str = "{}_joint", body: str = "cylinder radius='0.125' length='0.1'") -> str:
    """A URDF of four wheels, and an arm that turns and is none."""
    parts = ["<link name='base_link'/>", "<link name='arm'/>",
             "<joint name='elbow' type='continuous'><parent link='base_link'/>"
             "<child link='arm'/></joint>"]  # fmt: skip
    for name, (x, y) in PLACES.items():
        parts.append(
            f"<link name='{name}'><collision><origin rpy='1.5707963 0 0'/><geometry><{body}/></geometry>"
            f"</collision></link><joint name='{joint.format(name)}' type='continuous'>"
            f"<origin xyz='{x} {y} 0'/><axis xyz='0 1 0'/><parent link='base_link'/>"
            f"<child link='{name}'/></joint>"
        )
    return f"<robot name='rover'>{''.join(parts)}</robot>"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive"
    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=2.0)), path)
    return path


def standing() -> object:
    """A message of a radar on a vehicle that stands."""
    stamp = message_type("builtin_interfaces/msg/Time")(sec=1, nanosec=0)
    header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="radar")
    still = message_type("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
    twist = message_type("geometry_msgs/msg/Twist")(linear=still, angular=still)
    return message_type("geometry_msgs/msg/TwistStamped")(header=header, twist=twist)


def rewritten(
    bag: Path,
    target: Path,
    names: Mapping[str, str | None],
    urdf: str | None = None,
    radar: bool = False,
) -> Path:
    """A copy with topics of other names (None: without them), a robot description, a radar."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        if urdf is not None:
            kind = "std_msgs/msg/String"
            text = message_type(kind)(data=urdf)
            writer.write("/robot_description", kind, reader.start_time or 0, text)
        if radar:
            kind = "geometry_msgs/msg/TwistStamped"
            writer.write("/radar", kind, reader.start_time or 0, standing())
        for name, kind, time, message in reader.messages():
            new = names.get(name, name)
            if new is not None:
                writer.write(new, kind, time, message)
    return target


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(main, [str(a) for a in arguments])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def found(path: Path) -> dict[str, object]:
    return for_each_wheel(read_parameters(path))


def found_in(text: str) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rover.yaml"
        path.write_text(text)
        return found(path)


def test_a_bag_with_a_description_needs_nothing_more(bag: Path, tmp_path: Path) -> None:
    other = rewritten(bag, tmp_path / "drive", {}, description())
    run("init", other, "-o", tmp_path / "rover.yaml")
    values = found(tmp_path / "rover.yaml")
    assert values["wheels"] == list(PLACES)
    assert values["front_right.diameter"] == 0.25
    assert values["front_right.width"] == 0.1
    assert values["front_right.lateral_position"] == -0.28
    assert "front_left.load_topic" not in values  # as the node expects it
    settings_from(values)  # the node takes it
    assert FILL_IN not in (tmp_path / "rover.yaml").read_text()


def test_replay_goes_by_what_the_bag_tells_and_says_so(bag: Path, tmp_path: Path) -> None:
    names = {"/odom": "/rover/odometry", "/front_left/load": "/ft/fl/wrench"}
    other = rewritten(bag, tmp_path / "drive", names, description())
    text = run("replay", other, "-o", tmp_path / "out").stdout
    assert f"no parameter file was given: {tmp_path / 'out' / 'rover.yaml'}" in text
    assert "assumed: /rover/odometry is odom" in text
    summary = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert summary["missing"] == []
    assert summary["estimates"] > 0
    assert found(tmp_path / "out" / "rover.yaml")["front_left.load_topic"] == "/ft/fl/wrench"
    (tmp_path / "out" / "rover.yaml").write_text("mine")
    refused = run("replay", other, "-o", tmp_path / "out", code=2)
    assert "differs from what the bag gives" in refused.stderr


def test_what_the_bag_does_not_tell_is_marked_and_stops_a_replay(bag: Path, tmp_path: Path) -> None:
    said = run("init", bag, "-o", tmp_path / "rover.yaml", "--json", tmp_path / "found.json").stdout
    assert "to be filled in: all_wheels.diameter, all_wheels.width, vehicle.track" in said
    text = (tmp_path / "rover.yaml").read_text()
    assert text.count(FILL_IN) == 4 + 1  # and where it is explained
    assert json.loads((tmp_path / "found.json").read_text())["missing"][0] == "all_wheels.diameter"
    refused = run("replay", bag, "-o", tmp_path / "out", code=2).stderr
    assert "does not give all_wheels.diameter" in refused
    assert f"smallwheel init {bag} -o rover.yaml" in refused
    assert not (tmp_path / "out").exists()
    half = run("replay", bag, "--config", tmp_path / "rover.yaml", "-o", tmp_path / "out", code=2)
    assert "all_wheels.diameter is string 'FILL_IN'" in half.stderr
    assert "front_left.diameter" not in half.stderr  # said once, not of each wheel
    assert "from 0.005 to 5 m: write the number in its place" in half.stderr
    sizes = text.replace(f"diameter: {FILL_IN}", "diameter: 0.25").replace(f": {FILL_IN}", ": 1")
    (tmp_path / "rover.yaml").write_text(sizes)
    sw.replay(bag, tmp_path / "rover.yaml", tmp_path / "out")


def test_other_names_of_topics_and_joints_are_found(bag: Path, tmp_path: Path) -> None:
    names = {f"/{w}/load": f"/ft/{w[0]}{w.split('_')[1][0]}/wrench" for w in PLACES}
    names |= {"/joint_states": "/drive/joints", "/front_left/sinkage": None}
    other = rewritten(bag, tmp_path / "drive", names, description("wheel_{}_drive"))
    said = run("init", other, "-o", tmp_path / "rover.yaml").stdout
    values = found(tmp_path / "rover.yaml")
    assert values["wheels"] == list(PLACES)
    assert values["rear_right.load_topic"] == "/ft/rr/wrench"
    assert "rear_right.joint" not in values  # as the joint states have it, not the description
    assert "rear_right_joint turns rear_right, by its name; there is no wheel_rear_right" in said
    assert values["rear_right.diameter"] == 0.25
    assert values["front_left.sinkage_topic"] == ""
    assert "joint_states_topic: /drive/joints" in said
    assert values["joint_states_topic"] == "/drive/joints"
    text = (tmp_path / "rover.yaml").read_text()
    assert "    all_wheels:\n" in text  # what is equal stands there once
    assert text.count("diameter: 0.25") == 1


def test_a_robot_description_alone(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(description("{}_wheel"))
    run("init", tmp_path / "robot.urdf", "-o", tmp_path / "a.yaml")
    run("init", "--urdf", tmp_path / "robot.urdf", "-o", tmp_path / "b.yaml")
    values = found(tmp_path / "a.yaml")
    assert values == found(tmp_path / "b.yaml")
    assert values["wheels"] == list(PLACES)  # the arm that turns is none
    assert values["rear_left.joint"] == "rear_left_wheel"
    settings_from(values)
    (tmp_path / "mesh.urdf").write_text(description(body="mesh filename='a.stl'"))
    run("init", tmp_path / "mesh.urdf", "-o", tmp_path / "c.yaml")
    text = (tmp_path / "c.yaml").read_text()
    assert text.count(f"diameter: {FILL_IN}") == text.count(f"width: {FILL_IN}") == 1
    assert f"lateral_position: {FILL_IN}" not in text


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 20])
def test_so_many_wheels(count: int, tmp_path: Path) -> None:
    run("init", "--wheels", count, "-o", tmp_path / "rover.yaml")
    (section,) = yaml.safe_load((tmp_path / "rover.yaml").read_text()).values()
    values = section["ros__parameters"]
    assert values["wheels"] == usual_names(count)
    assert len({*values["wheels"]}) == count
    assert values["all_wheels"] == {"diameter": FILL_IN, "width": FILL_IN}
    sizes = {
        2: {"track"},
        3: {"track", "wheelbase"},
        4: {"track", "wheelbase"},
        6: {"track", "wheelbase"},
    }
    assert set(values.get("vehicle", {})) == sizes.get(count, set())
    places = dict.fromkeys(("lateral_position", "longitudinal_position"), FILL_IN)
    for wheel in values["wheels"]:  # names that say nothing of a place
        assert values.get(wheel, {}) == (places if count in (5, 20) else {})
    settings = settings_from(found_in(filled_in((tmp_path / "rover.yaml").read_text())))
    assert count == 1 or count in (5, 20) or not settings.onboard.unknown_positions


@pytest.mark.parametrize(
    ("names", "wheels"),
    [
        (["/fl/load", "/fr/load", "/rl/load"], ["front_left", "front_right", "rear_left"]),
        (["/rear/ft", "/front/ft"], ["front", "rear"]),
        (["/cell_1/force", "/cell_2/force"], ["wheel_1", "wheel_2"]),
        (["/scale/alpha", "/scale/beta"], ["alpha", "beta"]),
        (["/force"], ["wheel"]),
    ],
)
def test_wheels_are_called_by_what_tells_them_apart(names: list[str], wheels: list[str]) -> None:
    assert list(wheels_named_by(names)) == wheels
    assert sorted(wheels_named_by(names).values()) == sorted(names)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give a BAG, a URDF (--urdf FILE), both, or --wheels N"),
        (["--wheels", "4", "drive"], "both, or --wheels N alone"),
        (["--wheels", "0"], "0 wheels, expected 1 to 20"),
        (["--wheels", "99"], "99 wheels, expected 1 to 20"),
        (["nowhere"], "nowhere"),
        (["nowhere.urdf"], "nowhere.urdf: cannot be read: No such file"),
        (["text.urdf"], "text.urdf: it is no XML"),
        (["binary.urdf"], "binary.urdf: cannot be read: it is not text in UTF-8"),
        (["--wheels", "4", "-o", "taken.yaml"], "taken.yaml: exists already: give another name"),
    ],
)
def test_a_bad_question_is_answered_in_words(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.urdf").write_text("hello")
    Path("binary.urdf").write_bytes(b"\xff\xfe\x00")
    Path("taken.yaml").write_text("mine")
    result = run("init", "-o", "rover.yaml", *arguments, code=2)
    assert words in result.stderr
    assert not Path("rover.yaml").exists()
    assert Path("taken.yaml").read_text() == "mine"
    run("init", "--wheels", 4, "-o", "taken.yaml", "--force")
    assert FILL_IN in Path("taken.yaml").read_text()


# --- What real robots record: no load, no sinkage


SIGNS = {"left_front": -1.0, "left_rear": -1.0, "right_front": 1.0, "right_rear": 1.0}


def plain_drive(
    target: Path, odometries: Mapping[str, float], up: float = 1.0, side: float = 0.0
) -> Path:
    """Joint states, an imu and odometries of 30 s: by topic, the share of slip that it sees.

    The left axes are mirrored, the wheels have a radius of 0.15 m, and one joint steers.
    """
    time_type = message_type("builtin_interfaces/msg/Time")
    header, vector = message_type("std_msgs/msg/Header"), message_type("geometry_msgs/msg/Vector3")
    joints, imu, odometry = (
        message_type(kind)
        for kind in ("sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry")
    )
    kinds = ("Pose", "PoseWithCovariance", "Twist", "TwistWithCovariance", "Point", "Quaternion")
    pose, with_pose, twist, with_twist, point, turned = (
        message_type(f"geometry_msgs/msg/{kind}") for kind in kinds
    )
    still, nothing, upright = (
        vector(x=0.0, y=0.0, z=0.0),
        np.zeros(36),
        turned(x=0.0, y=0.0, z=0.0, w=1.0),
    )
    with BagWriter(target) as writer:
        x = dict.fromkeys(odometries, 0.0)
        for i in range(600):
            at = (1_700_000_000 * 20 + i) * 50_000_000
            head = header(stamp=time_type(sec=at // 10**9, nanosec=at % 10**9), frame_id="odom")
            rim = 0.6 + 0.3 * np.sin(0.1 * i)
            names = ["steering_joint", *(f"{name}_wheel" for name in SIGNS)]
            rates = np.array([0.1, *(sign * rim / 0.15 for sign in SIGNS.values())])
            states = joints(head, names, np.empty(0), rates, np.empty(0))
            writer.write("/joint_states", "sensor_msgs/msg/JointState", at, states)
            felt = vector(x=0.0, y=9.81 * side, z=9.81 * up)
            none = np.array([-1.0, *np.zeros(8)])
            message = imu(head, upright, none, still, none, felt, none)
            writer.write("/imu/data", "sensor_msgs/msg/Imu", at, message)
            for topic, slip in odometries.items():
                speed = rim * (1.0 - slip * (1.0 + np.sin(0.37 * i)))
                x[topic] += 0.05 * speed
                place = with_pose(pose(point(x=x[topic], y=0.0, z=0.0), upright), nothing)
                moves = with_twist(twist(vector(x=speed, y=0.0, z=0.0), still), nothing)
                told = odometry(head, "base_link", place, moves)
                writer.write(topic, "nav_msgs/msg/Odometry", at, told)
    return target


def filled_in(text: str) -> str:
    """The file with a number in each place that has to be filled in."""
    for name, number in (("diameter", 0.3), ("width", 0.1), ("mass", 40.0)):
        text = text.replace(f"{name}: {FILL_IN}", f"{name}: {number}")
    return text.replace(f": {FILL_IN}", ": 0.2")


def filled_in_from(text: str, vehicle: Path) -> str:
    """The file with what the parameters of the vehicle say in each place that has to be filled in."""
    true = yaml.safe_load(vehicle.read_text())["/**"]["ros__parameters"]
    wheel = true["front_left"]
    numbers = {name: wheel[name] for name in ("diameter", "width")} | true["vehicle"]
    numbers |= {
        "track": 2.0 * wheel["lateral_position"],
        "wheelbase": 2.0 * wheel["longitudinal_position"],
    }
    for name, number in numbers.items():
        text = text.replace(f" {name}: {FILL_IN}", f" {name}: {number:g}")  # 280, too
    assert f": {FILL_IN}" not in text
    return text


def test_a_bag_without_soil_sensors_gives_a_file_that_works(tmp_path: Path) -> None:
    bag = plain_drive(tmp_path / "drive", {"/wheel/odom": 0.0, "/lidar/pose": 0.1})
    config = tmp_path / "rover.yaml"
    said = run("init", bag, "-o", config).stdout
    assert "assumed: /lidar/pose is odom; /wheel/odom is computed from the wheels" in said
    assert "joint_sign of front_left, rear_left by the drive" in said
    assert f"then: smallwheel replay {bag} --config {config} -o out" in said
    text = config.read_text()
    assert text.count(f"mass: {FILL_IN}") == 1
    assert text.count(f": {FILL_IN}") == 5
    config.write_text(filled_in(text))
    values = found(config)
    assert values["wheels"] == list(PLACES)
    assert values["front_left.joint"] == "left_front_wheel"
    assert values["front_left.joint_sign"] == -1
    assert "front_right.joint_sign" not in values
    assert values["imu_topic"] == "/imu/data"
    sw.replay(bag, config, tmp_path / "out", copy="none")
    rows = pd.read_csv(tmp_path / "out" / "estimates.csv")
    assert rows["slip"].notna().mean() > 0.9
    assert rows["slip"].mean() == pytest.approx(0.1, abs=0.03)


def test_an_imu_that_looks_down_is_used_and_said(tmp_path: Path) -> None:
    bag, config = plain_drive(tmp_path / "drive", {"/odom": 0.1}, up=-1.0), tmp_path / "rover.yaml"
    said = run("init", bag, "-o", config).stdout
    assert "/imu/data is the imu, z down as gravity shows: it is turned over" in said
    config.write_text(filled_in(config.read_text()))
    assert found_in(config.read_text())["imu_topic"] == "/imu/data"
    sw.replay(bag, config, tmp_path / "out", copy="none")
    rows = pd.read_csv(tmp_path / "out" / "estimates.csv")
    assert rows["slip"].notna().mean() > 0.9
    assert rows["slip"].mean() == pytest.approx(0.1, abs=0.03)


def test_an_imu_that_lies_on_its_side_is_not_used(tmp_path: Path) -> None:
    bag = plain_drive(tmp_path / "drive", {"/odom": 0.1}, up=0.0, side=1.0)
    said = run("init", bag, "-o", tmp_path / "rover.yaml").stdout
    assert "/imu/data is not used: gravity is not along its z axis" in said
    assert "imu_topic" not in found_in(filled_in((tmp_path / "rover.yaml").read_text()))


def test_a_description_beside_the_bag(tmp_path: Path) -> None:
    bag = plain_drive(tmp_path / "drive", {"/odom": 0.0})
    names = {"front_left": "left_front", "front_right": "right_front",
             "rear_left": "left_rear", "rear_right": "right_rear"}  # fmt: skip
    text = description("{}_wheel")
    for ours, theirs in names.items():
        text = text.replace(f"'{ours}_wheel'", f"'{theirs}_wheel'")
    (tmp_path / "rover.urdf").write_text(text)
    said = run("init", bag, "--urdf", tmp_path / "rover.urdf", "-o", tmp_path / "r.yaml").stdout
    assert "to be filled in: vehicle.mass\n" in said
    assert "/odom is computed from the wheels" in said
    values = found_in(filled_in((tmp_path / "r.yaml").read_text()))
    assert values["rear_right.lateral_position"] == -0.28
    assert values["rear_left.joint_sign"] == -1  # by the drive, whatever the description says


def test_a_wrong_joint_is_answered_with_those_that_are_there(tmp_path: Path) -> None:
    bag = plain_drive(tmp_path / "drive", {"/odom": 0.1})
    config = tmp_path / "rover.yaml"
    run("init", bag, "-o", config)
    config.write_text(filled_in(config.read_text()).replace("joint: left_rear_wheel", "joint: rl"))
    said = run("replay", bag, "--config", config, "-o", tmp_path / "out").stdout
    has = "has no value of its joint; it has steering_joint, left_front_wheel"
    assert f"joint rl): topic /joint_states {has}" in said


FAST = ("husky_snow", "pathfinder_flat", "warthog_grass_pose_only")
SLOW = ("husky_wetgrass", "warthog_grass", "warthog_gravel", "warthog_ice", "warthog_sand1")


@pytest.mark.parametrize("name", [*FAST, *(pytest.param(n, marks=pytest.mark.slow) for n in SLOW)])
def test_a_real_drive_needs_five_numbers(name: str, shared_data: Path, tmp_path: Path) -> None:
    bag, config = shared_data / "real_drives" / name, tmp_path / "rover.yaml"
    if not bag.exists():
        pytest.skip(f"no recorded drive {bag}")
    said = run("init", bag, "-o", config).stdout
    # With made-up sizes rims are off by half, and every joint may well be doubted.
    vehicle = bag.with_name(f"{name.split('_')[0]}.yaml")
    assert config.read_text().count(f": {FILL_IN}") == 5
    config.write_text(filled_in_from(config.read_text(), vehicle))
    assert "--remap" not in said
    result = run("replay", bag, "--config", config, "--copy", "none", "-o", tmp_path / "out")
    assert "never in a message" not in result.stdout
    table = pd.read_csv(tmp_path / "out" / "estimates.csv", usecols=["time", "slip"])
    known = table["slip"].notna()
    assert known.sum() > 100
    if name == "husky_snow":  # slip ends where its odometry is found to be made of the wheels
        found_out = table["time"] > 30.0
        assert not known[found_out].any()
        known = known[~found_out]
    assert known.mean() > 1.0 / 3.0  # of warthogs 0.65 and 0.94 when this was written
    signs = [value for key, value in found(config).items() if key.endswith("joint_sign")]
    assert signs == ([-1, -1] if name == "pathfinder_flat" else [])


def test_a_bag_without_wheels_says_what_it_looked_for(bag: Path, tmp_path: Path) -> None:
    gone = dict.fromkeys(f"/{wheel}/{what}" for wheel in PLACES for what in ("load", "sinkage"))
    other = rewritten(bag, tmp_path / "drive", gone | {"/joint_states": None})
    refused = run("init", other, "-o", tmp_path / "r.yaml", code=2)
    assert "no topic of a wheel's load (geometry_msgs/msg/WrenchStamped)" in refused.stderr
    assert (
        "no joint that turns like a wheel (no topic of type sensor_msgs/msg/JointState)"
        in refused.stderr
    )
    assert "smallwheel init BAG --urdf FILE" in refused.stderr


# --- What is left out


def with_all_that_is_left_out(text: str) -> str:
    """The file with each such line taken in, and the mass written."""
    lines = text.replace("# vehicle.mass: 0.0", "vehicle.mass: 24.0")
    return re.sub(r"^    # (\w+: \S+)$", r"    \1", lines, flags=re.MULTILINE)


def left_out(text: str) -> dict[str, tuple[str, str]]:
    """By parameter that is left out: the words on it, and the line below them."""
    found = {}
    for block in re.findall(r"(?:^ +## .*\n)+(?: +# .*\n)+", text, re.MULTILINE):
        words = " ".join(line.strip(" #") for line in block.splitlines() if "##" in line)
        name = words.split(" is left out: ")[0]
        found[name] = (words, block.splitlines()[-1].strip(" #"))
    return found


@pytest.mark.parametrize(
    ("origin", "names"),
    [
        ("bag", {"vehicle.mass", "robot_description_topic"}),
        ("bag with a description", {"vehicle.mass"}),
        ("bag without imu", {"imu_topic", "vehicle.mass", "robot_description_topic"}),
        ("bag with radar", {"velocity_topic", "vehicle.mass", "robot_description_topic"}),
        ("urdf", {"imu_topic", "vehicle.mass"}),
        ("wheels", {"imu_topic", "vehicle.mass", "robot_description_topic"}),
    ],
)  # fmt: skip
def test_each_line_that_is_left_out_says_why_and_what_it_brings(
    origin: str, names: set[str], bag: Path, tmp_path: Path
) -> None:
    sources: dict[str, list[object]] = {"wheels": ["--wheels", 3], "urdf": [tmp_path / "r.urdf"]}
    (tmp_path / "r.urdf").write_text(description())
    other: dict[str, str | None] = {"/imu": None if "without" in origin else "/imu"}
    if origin.startswith("bag"):
        urdf = description() if "description" in origin else None
        drive = rewritten(bag, tmp_path / "drive", other, urdf, radar="radar" in origin)
        sources[origin] = [drive]
    run("init", *sources[origin], "-o", tmp_path / "rover.yaml")
    text = (tmp_path / "rover.yaml").read_text()
    found = left_out(text)
    assert set(found) == names
    for name, (words, line) in found.items():
        assert re.fullmatch(rf"{name} is left out: \S.+\. Brings\b.+\.", words)
        assert line.startswith(f"{name}: ")
    if "imu_topic" in names:
        assert found["imu_topic"][1] == "imu_topic: imu"
    else:  # the bag has it, with gravity along its z axis
        assert found_in(text)["imu_topic"] == "/imu"

    # Nothing of it counts as it is; taken in, the node and replay understand it.
    assert not names & set(found_in(text))
    whole = with_all_that_is_left_out(text).replace(FILL_IN, "0.2")
    values = found_in(whole)
    assert names <= set(values)
    settings = settings_from(values)
    assert settings.onboard.mass == 24.0
    assert settings.onboard.with_imu
    assert (settings.onboard.velocity == "topic") == ("velocity_topic" in names)


def test_a_mass_that_nobody_wrote_is_refused(tmp_path: Path) -> None:
    run("init", "--wheels", 2, "-o", tmp_path / "rover.yaml")
    text = (tmp_path / "rover.yaml").read_text().replace(FILL_IN, "0.2")
    taken = text.replace("# vehicle.mass: 0.0", "vehicle.mass: 0.0")
    with pytest.raises(
        ParametersError, match=r"vehicle\.mass is 0\.0, expected a double from 0\.01"
    ):
        settings_from(found_in(taken))


# --- Which imu, which topics, which robot


@pytest.mark.parametrize(
    ("up", "words"),
    [
        (1.0 / 9.80665, "gravity in g? expected 9.81 m/s^2"),
        (0.0, "its accelerations are all 0"),
        (0.01, "gravity has been taken out"),
        (float("nan"), "none of its 600 accelerations is a number"),
    ],
)
def test_an_imu_is_left_out_for_its_own_reason(up: float, words: str, tmp_path: Path) -> None:
    bag = plain_drive(tmp_path / "drive", {"/odom": 0.1}, up=up)
    said = run("init", bag, "-o", tmp_path / "rover.yaml").stdout
    assert "/imu/data is not used: " in said
    assert words in said
    assert "gravity is not along its z axis" not in said


def test_of_two_imus_the_one_that_stands_upright_is_taken_and_both_are_named(
    tmp_path: Path,
) -> None:
    """The other is of a camera that looks down."""
    plain = plain_drive(tmp_path / "plain", {"/odom": 0.1})
    with BagReader(plain) as reader, BagWriter(tmp_path / "two") as writer:
        for name, kind, time, message in reader.messages():
            writer.write(name, kind, time, message)
            if name == "/imu/data":
                a = message.linear_acceleration
                felt = type(a)(x=a.z, y=a.y, z=a.x)
                writer.write("/camera/imu", kind, time, replace(message, linear_acceleration=felt))
    said = run("init", tmp_path / "two", "-o", tmp_path / "rover.yaml").stdout
    assert found_in(filled_in((tmp_path / "rover.yaml").read_text()))["imu_topic"] == "/imu/data"
    assert "in place of /camera/imu" in said


def joined(bag: Path, target: Path, *copies: Mapping[str, str]) -> Path:
    """The messages of a bag several times, under other names; without those that have none."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for name, kind, time, message in reader.messages():
            for names in copies:
                if name in names:
                    writer.write(names[name], kind, time, message)
    return target


def steering_states(bag: Path, target: Path) -> Path:
    """A copy with the joints of the corners on a topic of their own, as rovers with two drivers have."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for i, (name, kind, time, message) in enumerate(reader.messages()):
            if name == "/joint_states":
                corners = [f"corner_{wheel}" for wheel in SIGNS]
                rates, none = np.full(4, 0.3 * np.cos(0.1 * i)), np.empty(0)
                states = message_type(kind)(message.header, corners, none, rates, none)
                writer.write("/corner_state", kind, time, states)
                name = "/drive_state"
            writer.write(name, kind, time, message)
    return target


def test_of_two_topics_of_joint_states_that_of_the_wheels_is_taken(tmp_path: Path) -> None:
    bag = steering_states(plain_drive(tmp_path / "drive", {"/odom": 0.1}), tmp_path / "two")
    said = run("init", bag, "-o", tmp_path / "rover.yaml").stdout
    assert "/drive_state is joint_states, with the joints of the wheels; /corner_state has" in said
    assert "front_left.joint: left_front_wheel" in said
    asked = ("--joint-states", "/corner_state", "-o", tmp_path / "a.yaml")
    assert "(its joints are corner_left_front," in run("init", bag, *asked, code=2).stderr
    run("init", bag, "--joint-states", "drive_state", "-o", tmp_path / "b.yaml")
    assert found(tmp_path / "b.yaml") == found(tmp_path / "rover.yaml")
    refused = run("init", bag, "--joint-states", "/x", "-o", tmp_path / "a.yaml", code=2).stderr
    assert "no topic /x of joint states, expected one of /corner_state, /drive_state" in refused


def test_of_two_robots_one_has_to_be_named(tmp_path: Path) -> None:
    topics = ("/joint_states", "/odom", "/imu/data")
    copies = [{topic: f"/{robot}{topic}" for topic in topics} for robot in ("one", "two")]
    bag = joined(plain_drive(tmp_path / "drive", {"/odom": 0.1}), tmp_path / "both", *copies)
    config = tmp_path / "rover.yaml"
    refused = run("init", bag, "-o", config, code=2).stderr
    assert (
        "joint states of 2 robots, /one/joint_states, /two/joint_states: --namespace one" in refused
    )
    said = run("init", bag, "--namespace", "two", "-o", config).stdout
    assert "/two/odom is odom" in said
    assert "/one/" not in config.read_text()
    refused = run("init", bag, "--namespace", "three", "-o", tmp_path / "a.yaml", code=2).stderr
    assert "no topic is in the namespace 'three', expected one of one, two" in refused


def test_an_odometry_that_looks_back_is_named_and_turns_no_joint(tmp_path: Path) -> None:
    """The left axes are mirrored in the drive: a description that has the right ones so is against all."""
    bag = plain_drive(tmp_path / "drive", {"/odom": 0.1})
    text = description("{}_wheel")
    for ours, theirs in {"front_left": "left_front", "rear_left": "left_rear",
                         "front_right": "right_front", "rear_right": "right_rear"}.items():  # fmt: skip
        text = text.replace(f"'{ours}_wheel'", f"'{theirs}_wheel'")
    head, *joints = text.split("<joint ")
    joints = [j.replace("0 1 0", "0 -1 0") if "name='right_" in j else j for j in joints]
    (tmp_path / "rover.urdf").write_text("<joint ".join([head, *joints]))
    said = run("init", bag, "--urdf", tmp_path / "rover.urdf", "-o", tmp_path / "r.yaml").stdout
    assert "the odometry looks backward" in said
    values = found_in(filled_in((tmp_path / "r.yaml").read_text()))
    assert [values[f"{wheel}.joint_sign"] for wheel in PLACES] == [1, -1, 1, -1]


def test_a_description_that_cannot_be_used_does_not_stop_a_bag(bag: Path, tmp_path: Path) -> None:
    other = rewritten(bag, tmp_path / "drive", {}, "<robot name='nothing'/>")
    said = run("init", other, "-o", tmp_path / "rover.yaml").stdout
    assert "the robot description is not used: it has no joint" in said
    assert found_in(filled_in((tmp_path / "rover.yaml").read_text()))["wheels"] == list(PLACES)
