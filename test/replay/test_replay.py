# SPDX-License-Identifier: Apache-2.0
"""Tests `new_bag.py`, `recording.py`, `report.py`, `result.py`, `spec.py` and `tables.py`."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from drawbar_drives import with_pulls
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from smallwheel_ros.bags import BagReader, BagWriter, message_type, typestore
from smallwheel_ros.cli import main
from smallwheel_ros.costmap.grid import read_map
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.replay.recording import turns_of
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.report import drive_blocks, page, read_courses, with_gaps
from smallwheel_ros.replay.spec import ReplaySpec, read_remaps
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

_kinds = importlib.util.spec_from_file_location(
    "bag_kinds", Path(__file__).parents[1] / "bag_kinds.py"
)
bag_kinds = importlib.util.module_from_spec(_kinds)
_kinds.loader.exec_module(bag_kinds)

SECOND = 10**9
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
MOBILITY = {f"/mobility_estimator/{wheel}/mobility" for wheel in WHEELS}
VEHICLE = "/mobility_estimator/vehicle"
SOIL = "/mobility_estimator/soil"
COST = "/mobility_estimator/cost"
OWN = {
    *MOBILITY,
    VEHICLE,
    SOIL,
    COST,
    f"{COST}_bare",
    "/tf",
}  # what a replay adds to a bag without transforms


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """The first eight seconds of a drive: it stands, sets off, and drives two metres."""
    folder = tmp_path_factory.mktemp("drive")
    write_drive_bag(
        simulate_drive(DriveSettings(seed=5, distance=4.0, wheels="two_sizes")), folder / "whole"
    )
    return bag_kinds.beginning(folder / "whole", folder / "drive", 8.0)


@pytest.fixture(scope="module")
def rover(repository) -> Path:
    return repository / "config" / "two_wheel_sizes.yaml"


def smallwheel(*arguments: object, code: int = 0):
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def table_of(folder: Path) -> pd.DataFrame:
    return pd.read_csv(folder / "estimates.csv", float_precision="round_trip")


def replayed(bag: Path, rover: Path, folder: Path, remaps=(), **options) -> pd.DataFrame:
    """Replay by the library, without the page, which takes longest; return the table."""
    replay(ReplaySpec(bag, rover, folder, read_remaps(remaps), **options))
    return table_of(folder)


@pytest.fixture(scope="module")
def usual(bag, rover, tmp_path_factory) -> tuple[Path, pd.DataFrame]:
    """A replay of the drive as it is: its folder and its table."""
    folder = tmp_path_factory.mktemp("usual") / "out"
    smallwheel("replay", bag, "--config", rover, "-o", folder)
    return folder, table_of(folder)


def directly(bag: Path, rover: Path) -> Estimates:
    """The bag's messages through the pipeline alone, in blocks of another size."""
    turns = turns_of(bag, settings_from(read_parameters(rover)), block=997)
    return Estimates.joined([turn.estimates for turn in turns])


def assert_same_estimates(one: pd.DataFrame, other: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(
        one.drop(columns="time"), other.drop(columns="time"), rtol=1e-9, check_exact=False
    )


# --- What comes out


def test_the_table_is_what_the_library_gives(bag, rover, usual):
    _, table = usual
    expected = directly(bag, rover)
    assert len(table) == len(expected) > 200
    np.testing.assert_array_equal(table["stamp"], expected.stamp)
    columns = {"sinkage_predicted": "sinkage", "slip": "slip", "drawbar_pull": "drawbar_pull"}
    for name, column in columns.items():
        values = getattr(expected, column)
        np.testing.assert_allclose(table[name], values, rtol=1e-9, err_msg=name)
    known = np.isfinite(expected.drawbar_pull)
    assert known.any()
    assert not known.all()  # standing: slip is not known, and the cell is blank, not 0


def test_positions_and_speed_are_those_of_odometry(bag, usual):
    _, table = usual
    with BagReader(bag) as reader:
        rows = [
            (m.message.header.stamp.sec * SECOND + m.message.header.stamp.nanosec,
             m.message.pose.pose.position.x, m.message.twist.twist.linear.x)
            for m in reader.messages({"/odom"})
        ]  # fmt: skip
    stamps, x, speed = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    moving = table[table["speed"].notna()]
    assert len(moving) > 0.95 * len(table)
    np.testing.assert_allclose(moving["x"], np.interp(moving["stamp"], stamps, x), atol=1e-3)
    left = moving[moving["wheel"].str.endswith("left")]["speed"].mean()
    right = moving[moving["wheel"].str.endswith("right")]["speed"].mean()
    assert (left + right) / 2 == pytest.approx(np.mean(speed), abs=0.02)


def test_parquet_says_the_same_as_csv(usual):
    pytest.importorskip("pyarrow", reason="needs pyarrow")
    folder, table = usual
    other = pd.read_parquet(folder / "estimates.parquet")
    assert list(other.columns) == list(table.columns)
    for name in table.columns:
        if table[name].dtype == float:
            np.testing.assert_array_equal(table[name], other[name].astype(float), err_msg=name)
        elif name.endswith("_text"):
            assert list(table[name].fillna("")) == list(other[name])
        else:
            assert list(table[name]) == list(other[name]), name


def test_the_new_bag_has_originals_and_estimates(bag, usual):
    folder, table = usual
    with BagReader(bag) as reader:
        originals = [(*m[:3], bytes(m.data)) for m in reader.raw_messages()]
        names = {topic.name for topic in reader.topics}
    with BagReader(folder / "bag") as reader:
        assert {t.name for t in reader.topics} == names | OWN
        copies = [(*m[:3], bytes(m.data)) for m in reader.raw_messages(names)]
        mobility = [m.message for m in reader.messages(MOBILITY)]
        soils = [m.message for m in reader.messages({SOIL})]
    assert sorted(copies) == sorted(originals)
    assert len(mobility) == len(table)
    stamps = [m.header.stamp.sec * SECOND + m.header.stamp.nanosec for m in mobility]
    assert stamps == list(table["stamp"])
    assert [m.header.frame_id for m in mobility] == list(table["wheel"])
    assert [m.wheel for m in mobility] == list(table["wheel"])
    assert [m.sinkage_predicted for m in mobility] == list(table["sinkage_predicted"])
    assert [m.drawbar_pull for m in mobility] == list(table["drawbar_pull"].fillna(0.0))
    assert soils[-1].k == table["soil_k"].iloc[-1]
    assert soils[-1].header.frame_id == "odom"
    gaps = np.diff([s.header.stamp.sec * SECOND + s.header.stamp.nanosec for s in soils])
    assert np.all(gaps > 0)
    assert np.median(gaps) >= SECOND // 10


def test_originals_stay_in_their_order_and_estimates_have_the_log_time_of_their_stamps(
    bag, rover, tmp_path
):
    picture, picture_type = "/camera", "sensor_msgs/msg/CompressedImage"
    with BagReader(bag) as reader:
        recorded = list(reader.raw_messages())
    header = message_type("std_msgs/msg/Header")(
        stamp=message_type("builtin_interfaces/msg/Time")(sec=1, nanosec=2), frame_id="camera"
    )
    with BagWriter(tmp_path / "drive", storage="sqlite3") as writer:
        for i, (topic, kind, log_time, data) in enumerate(recorded):
            writer.write_raw(topic, kind, log_time, data)
            if i % 100 == 0:
                pixels = np.full(600_000, i % 256, dtype=np.uint8)
                image = message_type(picture_type)(header=header, format="jpeg", data=pixels)
                writer.write(picture, picture_type, log_time, image)
    table = replayed(tmp_path / "drive", rover, tmp_path / "out")
    with BagReader(tmp_path / "drive") as reader:
        originals = [(*m[:3], bytes(m.data)) for m in reader.raw_messages()]
    with contextlib.closing(sqlite3.connect(tmp_path / "out" / "bag" / "bag.db3")) as database:
        written = database.execute(
            "SELECT topics.name, type, timestamp, data FROM messages"
            " JOIN topics ON topics.id = topic_id ORDER BY messages.id"
        ).fetchall()
    assert [m for m in written if m[0] not in OWN] == originals
    times = np.array([time for topic, _, time, _ in written if topic in MOBILITY])
    assert (np.diff(times) >= 0).all()
    # Stamps are of the clock of the recording, and messages come within some hundredths of a second.
    assert times.size == len(table)
    assert np.abs(times - table["stamp"].to_numpy()).max() < 0.1 * SECOND


def test_a_foreign_tool_reads_the_estimates_by_their_own_definitions(usual):
    from rosbags.highlevel import AnyReader

    folder, table = usual
    with AnyReader([folder / "bag"]) as reader:
        own = f"/mobility_estimator/{table['wheel'].iloc[0]}/mobility"
        connection = next(c for c in reader.connections if c.topic == own)
        _, _, data = next(iter(reader.messages([connection])))
        first = reader.deserialize(data, connection.msgtype)
        soil = next(c for c in reader.connections if c.topic == SOIL)
        assert soil.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    assert first.load == table["load"].iloc[0]


def test_the_summary_counts_what_the_table_has(bag, usual):
    folder, table = usual
    summary = json.loads((folder / "replay.json").read_text())
    assert summary["state"] == "complete"
    assert summary["estimates"] == len(table)
    with BagReader(bag) as reader:
        assert summary["messages"] == {"read": reader.message_count, "in_bag": reader.message_count}
    for wheel, rows in table.groupby("wheel"):
        found = summary["wheels"][wheel]
        assert found["estimates"] == len(rows)
        assert found["with_slip"] == rows["slip"].notna().sum()
    assert summary["missing"] == []
    assert summary["soil"]["n"]["value"] == table["soil_n"].iloc[-1]
    for name in summary["files"].values():
        assert (folder / name).exists()
    used = sum(wheel["used_for_soil"] for wheel in summary["wheels"].values())
    # It drives two metres, and a border is found on the last one: stretches about it wait or are of no soil.
    assert 0.3 * used < table["soil_measurements_accepted"].iloc[-1] <= used


def test_json_on_standard_output_is_the_summary(bag, rover, tmp_path):
    result = smallwheel("replay", bag, "--config", rover, "-o", tmp_path / "o", "--json", "-")
    summary = json.loads(result.stdout)
    assert summary == json.loads((tmp_path / "o" / "replay.json").read_text())


def test_the_report_is_one_page_that_needs_nothing_else(usual):
    folder, table = usual
    page = (folder / "report.html").read_text()
    for word in ("In short", "The drive", "The soil", "What was not used", "used for the soil"):
        assert word in page
    assert not re.search(r"(src|href)=\"?https?:", page)
    assert "nan" not in page.partition("<script")[0].lower().split()
    panels = figures(folder)["wheels"].panels
    shown = {p.title.removesuffix(": sinkage"): p for p in panels if p.title.endswith(": sinkage")}
    assert list(shown) == sorted(name.replace("_", " ") for name in table["wheel"].unique())
    for wheel, rows in table.groupby("wheel"):
        every = math.ceil(len(rows) / 500)
        (line,) = (x for x in shown[wheel.replace("_", " ")].layers if x.name == "predicted")
        known = rows["sinkage_predicted"].iloc[::every].dropna()
        assert line.y.dropna().to_numpy() == pytest.approx(1e3 * known.to_numpy(), rel=1e-3)


def figures(folder):
    """The figures of a replay's page by name."""
    blocks = drive_blocks(json.loads((folder / "replay.json").read_text()), folder)
    return {block.name: block for block in blocks}


def test_the_cost_in_the_report_is_that_of_the_map(repository, tmp_path):
    """U7: the report left out the slope: 0 where the rover gets stuck."""
    drive = simulate_drive(DriveSettings(seed=2, distance=6.0, finish="slope"))
    write_drive_bag(drive, tmp_path / "bag")
    out, rover = tmp_path / "out", repository / "config" / "four_wheels.yaml"
    smallwheel("replay", tmp_path / "bag", "--config", rover, "-o", out)
    table, ground = table_of(out), read_map(out / "cost_map.yaml")
    (panel,) = (p for p in figures(out)["path"].panels if p.title.endswith("by cost"))
    costs = np.asarray(panel.layers[0].value, float)
    costs = costs[np.isfinite(costs)]
    under = {ground.cells[ground.cell(x, y)] for x, y in table[["x", "y"]].dropna().to_numpy()}
    assert costs.size > 50
    assert set(costs) <= under
    assert max(costs) == 100  # where it got stuck
    assert min(costs) < 60


def test_a_gap_in_time_stays_a_gap():
    time = [0.0, 0.1, 0.2, 0.3, 4.0, 4.1]
    rows = with_gaps(pd.DataFrame({"time": time, "sinkage_predicted": 0.01}))
    assert list(rows["time"]) == pytest.approx([*time[:4], 2.15, *time[4:]])
    assert list(rows["sinkage_predicted"].isna()) == [False] * 4 + [True] + [False] * 2
    assert len(with_gaps(rows.iloc[:3])) == 3


def test_pictures_are_drawn_from_rows_of_each_wheel(usual):
    """All of them, or of a long drive every so many-th."""
    folder, table = usual
    wheels = json.loads((folder / "replay.json").read_text())["wheels"]
    whole = read_courses(folder / "estimates.csv", 1)
    third = read_courses(folder / "estimates.csv", 3)
    for name, counts in wheels.items():
        assert whole[name]["used"].sum() == counts["used_for_soil"]
        rows = table[table["wheel"] == name]
        assert list(third[name]["sinkage_measured"]) == pytest.approx(
            list(rows["sinkage_measured"][::3]), rel=1e-12
        )


# --- Every kind of bag


@pytest.mark.parametrize("kind", ["sqlite3", "split", "message", "file", "ros1", "foreign"])
def test_every_kind_of_bag_gives_the_same(bag, rover, usual, tmp_path, kind):
    other = tmp_path / ("other.bag" if kind == "ros1" else "other")
    if kind == "ros1":
        bag_kinds.ros1_copy(bag, other)
    elif kind == "foreign":
        bag_kinds.write_foreign(other, bag)
    elif kind == "split":
        bag_kinds.split_copy(bag, other, "sqlite3")
    elif kind == "sqlite3":
        with BagReader(bag) as reader, BagWriter(other, storage="sqlite3") as writer:
            for raw in reader.raw_messages():
                writer.write_raw(*raw)
    else:
        bag_kinds.compressed_copy(bag, other, "mcap", kind)
    table = replayed(other, rover, tmp_path / "out")
    assert_same_estimates(table, usual[1])
    with BagReader(tmp_path / "out" / "bag") as reader:
        counts = {topic.name: topic.message_count for topic in reader.topics}
    summary = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert counts["/odom"] > 100
    if kind == "foreign":
        assert counts["/vendor/odd"] > 100
        assert "/vendor/nobody" not in counts
        assert summary["not_copied"] == ["/vendor/nobody (vendor_msgs/msg/Nobody)"]
    else:
        assert summary["not_copied"] == []


def test_a_bag_with_estimates_in_it_keeps_both(usual, rover, tmp_path):
    folder, table = usual
    again = replayed(folder / "bag", rover, tmp_path / "again")
    assert_same_estimates(again, table)
    with BagReader(tmp_path / "again" / "bag") as reader:
        counts = {topic.name: topic.message_count for topic in reader.topics}
    assert sum(counts[one] for one in MOBILITY) == len(table)
    assert sum(counts[f"/replay{one}"] for one in MOBILITY) == len(table)


def test_the_map_of_the_drive_is_one_of_map_server_and_the_grid_is_in_the_bag(usual, bag):
    folder, _ = usual
    whole = read_map(folder / "cost_map.yaml")
    assert whole.frame == "odom"
    with BagReader(folder / "bag") as reader:
        grids = [m.message for m in reader.messages({COST})]
        poses = [m.message.transforms[0] for m in reader.messages({"/tf"})]
    assert len(grids) > 3
    assert grids[-1].header.frame_id == "odom"
    assert {(p.header.frame_id, p.child_frame_id) for p in poses} == {("odom", "base_link")}
    # Where it went is known, and as dear as the last grid has it.
    last = grids[-1]
    info, cells = last.info, np.asarray(last.data).reshape(last.info.height, last.info.width)
    for pose in poses:
        at = pose.transform.translation
        cost = whole.cells[whole.cell(at.x, at.y)]
        row = int((at.y - info.origin.position.y) / info.resolution)
        column = int((at.x - info.origin.position.x) / info.resolution)
        assert cost == -1 or abs(int(cells[row, column]) - int(cost)) <= 1
    assert np.mean(whole.cells >= 0) > 0.1


@pytest.mark.parametrize(("copy", "originals"), [("none", 0), ("used", 10), ("all", 13)])
def test_what_is_copied_can_be_chosen(bag, rover, tmp_path, copy, originals):
    foreign = bag_kinds.write_foreign(tmp_path / "foreign", bag)
    replayed(foreign, rover, tmp_path / "out", copy=copy)
    with BagReader(tmp_path / "out" / "bag") as reader:
        topics = {topic.name for topic in reader.topics}
    unknown = copy == "all"  # its type is not known: it cannot be copied
    assert len(topics - OWN) == originals - unknown


# --- Topics


def renamed(bag: Path, target: Path, names: dict[str, str], joint: str = "") -> Path:
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for topic, kind, time, message in reader.messages():
            if joint and kind.endswith("JointState"):
                message.name[:] = [
                    joint.format(name.removesuffix("_joint")) for name in message.name
                ]
            writer.write(names.get(topic, topic), kind, time, message)
    return target


RENAMED = {
    "/odom": "/rover/visual_odometry",
    "/joint_states": "/rover/joints",
    "/front_left/load": "/ft/fl/wrench",
    "/front_right/load": "/ft/fr/wrench",
    "/rear_left/load": "/ft/rl/wrench",
    "/rear_right/load": "/ft/rr/wrench",
    "/rear_left/sinkage": "/sinkage/RearLeft",
}


def test_topics_are_listed_and_remaps_find_them(bag, rover, usual, tmp_path):
    other = renamed(bag, tmp_path / "other", RENAMED)
    text = smallwheel("replay", other, "--topics").stdout
    assert "/ft/fl/wrench" in text
    content = json.loads(smallwheel("replay", other, "--topics", "--json", "-").stdout)
    assert {topic["name"] for topic in content["topics"]} >= set(RENAMED.values())
    remaps = [word for a, b in RENAMED.items() for word in ("--remap", f"{a}:={b}")]
    smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out", *remaps)
    assert_same_estimates(table_of(tmp_path / "out"), usual[1])


def test_joints_of_other_names_are_said(bag, rover, tmp_path):
    other = renamed(bag, tmp_path / "other", {}, joint="wheel_{}_drive")
    replayed(other, rover, tmp_path / "out")
    missing = json.loads((tmp_path / "out" / "replay.json").read_text())["missing"]
    assert len(missing) == 4
    has = "has no value of its joint; it has wheel_front_left_drive"
    assert f"joint front_left_joint): topic /joint_states {has}" in missing[0]


def test_a_bag_without_what_is_needed_says_what_it_lacks(bag, rover, tmp_path):
    names = {name: f"/x{i}" for i, name in enumerate(RENAMED)}
    other = renamed(bag, tmp_path / "other", names)
    text = smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out", code=2).stderr
    assert "nothing can be estimated" in text
    assert "/front_left/load (geometry_msgs/msg/WrenchStamped): not in the bag" in text
    assert "Of these types the bag has " in text
    assert "/x2 (geometry_msgs/msg/WrenchStamped)" in text
    assert not (tmp_path / "out").exists()


def test_one_missing_topic_is_named_and_the_rest_goes_on(bag, rover, tmp_path):
    other = renamed(bag, tmp_path / "other", {"/odom": "/elsewhere"})
    result = smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out")
    assert "/odom (nav_msgs/msg/Odometry): not in the bag" in result.stdout
    table = table_of(tmp_path / "out")
    assert table["slip"].isna().all()
    assert table["x"].isna().all()
    assert "Inputs that the bag lacks" in (tmp_path / "out" / "report.html").read_text()


def test_a_topic_of_another_type_is_named(bag, rover, tmp_path):
    with BagReader(bag) as reader, BagWriter(tmp_path / "other") as writer:
        for topic, kind, time, message in reader.messages():
            if topic == "/odom":
                continue
            writer.write(topic, kind, time, message)
        writer.write("/odom", kind, time, message)
    result = smallwheel("replay", tmp_path / "other", "--config", rover, "-o", tmp_path / "out")
    assert re.search(r"/odom \(nav_msgs/msg/Odometry\): the bag has it as \w+", result.stdout)


def test_remaps_are_checked(bag, rover, tmp_path):
    rest = ("replay", bag, "--config", rover, "-o", tmp_path / "out", "--remap")
    assert "expected NAME:=TOPIC" in smallwheel(*rest, "odom=/x", code=2).stderr
    assert "has no such input" in smallwheel(*rest, "odometry:=/x", code=2).stderr
    assert read_remaps(["odom:=x/y", "~/a:=/b"]) == {"/odom": "/x/y", "/mobility_estimator/a": "/b"}


# --- Bags as robots make them


def rewritten(bag: Path, target: Path, change) -> Path:
    """The messages after `change(topic, kind, time, message)` gave them back, or None."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        found = [change(*m) for m in reader.messages()]
        for topic, kind, time, message in sorted(
            (entry for entry in found if entry is not None), key=lambda entry: entry[2]
        ):
            writer.write(topic, kind, time, message)
    return target


def shift(message, nanoseconds: int):
    stamp = message.header.stamp
    total = stamp.sec * SECOND + stamp.nanosec + nanoseconds
    message.header.stamp = message_type("builtin_interfaces/msg/Time")(
        sec=total // SECOND, nanosec=total % SECOND
    )
    return message


def test_messages_that_come_out_of_order_change_nothing(bag, rover, usual, tmp_path):
    rng = np.random.default_rng(0)
    delays: dict[str, int] = {}

    def later(topic, kind, time, message):
        """Up to 80 ms, each topic its own: many messages change places, in no topic two."""
        return topic, kind, time + delays.setdefault(topic, int(rng.uniform(0, 80e6))), message

    other = rewritten(bag, tmp_path / "other", later)
    table = replayed(other, rover, tmp_path / "out")
    assert_same_estimates(table, usual[1])


def test_late_and_wrong_stamps_are_counted_by_reason(bag, rover, tmp_path):
    count = {"/front_left/load": 0}

    def change(topic, kind, time, message):
        if topic == "/front_left/load":
            count[topic] += 1
            if count[topic] % 10 == 0:
                shift(message, -3 * SECOND)  # late
            elif count[topic] % 10 == 1:
                shift(message, 60 * SECOND)  # ahead of the clock
        return topic, kind, time, message

    other = rewritten(bag, tmp_path / "other", change)
    smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "replay.json").read_text())
    dropped = {(d["topic"], d["reason"]): d for d in summary["not_used"]}
    tenth = count["/front_left/load"] // 10
    assert dropped["/front_left/load", "out_of_order"]["count"] == pytest.approx(tenth, abs=2)
    assert dropped["/front_left/load", "stamp_in_future"]["count"] == pytest.approx(tenth, abs=2)
    assert "ahead of the clock" in dropped["/front_left/load", "stamp_in_future"]["example"]


def test_a_looping_bag_begins_anew(bag, rover, usual, tmp_path):
    """Recorded while another bag was played twice: the stamps jump back, /clock with them."""
    clock, time_of = (
        message_type("rosgraph_msgs/msg/Clock"),
        message_type("builtin_interfaces/msg/Time"),
    )
    with BagReader(bag) as reader, BagWriter(tmp_path / "loop") as writer:
        length = reader.end_time - reader.start_time + SECOND
        for turn in range(2):
            for i, (topic, kind, time, message) in enumerate(reader.messages()):
                log_time = time + turn * length
                if i % 20 == 0:
                    now = clock(clock=time_of(sec=time // SECOND, nanosec=time % SECOND))
                    writer.write("/clock", "rosgraph_msgs/msg/Clock", log_time, now)
                writer.write(topic, kind, log_time, message)
    table = replayed(tmp_path / "loop", rover, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert [e["kind"] for e in summary["events"]].count("time_jump") == 1
    once = usual[1]
    second = table[len(once) - 5 :].reset_index(drop=True)
    assert 0 <= 2 * len(once) - len(table) <= 8  # what waited when time went back is dropped
    last = second.iloc[-1]
    assert last["soil_n"] == pytest.approx(once["soil_n"].iloc[-1], rel=1e-6)
    assert last["soil_measurements_accepted"] == once["soil_measurements_accepted"].iloc[-1]


def test_stamps_of_another_clock_need_no_clock(bag, rover, usual, tmp_path):
    def change(topic, kind, time, message):
        return topic, kind, time, shift(message, -1000 * SECOND)

    other = rewritten(bag, tmp_path / "other", change)
    # Each reading is refused for its stamp, so that nothing is estimated: that is exit code 2.
    result = smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out", code=2)
    assert "nothing could be estimated" in result.stderr
    assert "--no-clock" in result.stdout
    assert len(table_of(tmp_path / "out")) == 0
    table = replayed(other, rover, tmp_path / "free", clock=False)
    assert_same_estimates(table.assign(stamp=table["stamp"] + 1000 * SECOND), usual[1])


def test_numbers_that_are_none_are_counted_and_never_come_out(bag, rover, tmp_path):
    rng = np.random.default_rng(1)

    def change(topic, kind, time, message):
        if rng.random() < 0.05:
            bad = rng.choice([np.nan, np.inf, -1.0])
            if topic.endswith("/load"):
                message.wrench.force.z = float(bad)
            elif topic.endswith("/sinkage"):
                message.sinkage = float(bad)
            elif topic == "/odom":
                message.twist.twist.linear.x = float(rng.choice([np.nan, np.inf]))
        return topic, kind, time, message

    other = rewritten(bag, tmp_path / "other", change)
    table = replayed(other, rover, tmp_path / "out")
    text = (tmp_path / "out" / "estimates.csv").read_text().lower()
    assert not re.search(r"(^|,)-?(nan|inf)(,|$)", text, re.MULTILINE)
    assert len(table) > 200
    reasons = {
        d["reason"] for d in json.loads((tmp_path / "out" / "replay.json").read_text())["not_used"]
    }
    assert {"not_finite", "load_not_positive"} <= reasons


def test_an_empty_bag_and_no_bag(rover, tmp_path):
    with BagWriter(tmp_path / "empty"):
        pass
    rest = ("--config", rover, "-o", tmp_path / "out")
    assert "has no messages" in smallwheel("replay", tmp_path / "empty", *rest, code=2).stderr
    assert "does not exist" in smallwheel("replay", tmp_path / "no", *rest, code=2).stderr
    (tmp_path / "text.mcap").write_text("no bag")
    assert "cannot be read" in smallwheel("replay", tmp_path / "text.mcap", *rest, code=2).stderr
    assert not (tmp_path / "out").exists()


def test_what_is_wrong_with_the_parameters_is_said(bag, rover, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text(rover.read_text().replace("0.25", "-1.0"))
    rest = ("-o", tmp_path / "out")
    text = smallwheel("replay", bag, "--config", bad, *rest, code=2).stderr
    assert "front_left.diameter is -1.0" in text
    assert (
        "no.yaml"
        in smallwheel("replay", bag, "--config", tmp_path / "no.yaml", *rest, code=2).stderr
    )
    assert "smallwheel init" in smallwheel("replay", bag, *rest, code=2).stderr


def test_a_folder_of_somebody_else_is_left_alone(bag, rover, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "estimates.csv").write_text("mine")
    text = smallwheel("replay", bag, "--config", rover, "-o", tmp_path / "out", code=2).stderr
    assert "which no replay wrote" in text
    assert (tmp_path / "out" / "estimates.csv").read_text() == "mine"
    text = smallwheel("replay", bag, "--config", rover, "-o", bag, code=2).stderr
    assert "is the bag itself" in text


@pytest.mark.parametrize("name", ["bag", "bag/bag.mcap"])
def test_the_bag_of_an_earlier_replay_is_not_cleared_to_read_it(bag, rover, tmp_path, name):
    folder = tmp_path / "out"
    replayed(bag, rover, folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    text = smallwheel("replay", folder / name, "--config", rover, "-o", folder, code=2).stderr
    assert "what an earlier replay has written" in text
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


# --- Messages that are none


def raw_copy(bag: Path, target: Path, change) -> Path:
    """The same bag with other bytes; change: gives those of a message by topic and number."""
    counts: dict[str, int] = {}
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for topic, kind, time, data in reader.raw_messages():
            counts[topic] = counts.get(topic, 0) + 1
            writer.write_raw(topic, kind, time, change(topic, counts[topic], data))
    return target


def test_messages_that_end_too_early_are_counted(bag, rover, usual, tmp_path):
    broken = ("/front_left/load", "/odom", "/joint_states", "/rear_right/sinkage")

    def change(topic, number, data):
        return data[:-5] if topic in broken and number in (1, 30) else data

    other = raw_copy(bag, tmp_path / "other", change)
    table = replayed(other, rover, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "replay.json").read_text())
    found = {d["topic"]: d for d in summary["not_used"] if d["reason"] == "not_readable"}
    assert {topic: drop["count"] for topic, drop in found.items()} == dict.fromkeys(broken, 2)
    assert "bytes, expected at least" in found["/odom"]["example"]
    assert len(table) == len(usual[1]) - 2


def test_a_clock_that_is_damaged_is_counted(bag, rover, usual, tmp_path):
    clock = message_type("rosgraph_msgs/msg/Clock")
    time_of = message_type("builtin_interfaces/msg/Time")
    with BagReader(bag) as reader, BagWriter(tmp_path / "whole") as writer:
        for i, (topic, kind, time, data) in enumerate(reader.raw_messages()):
            if i % 20 == 0:
                now = clock(clock=time_of(sec=time // SECOND, nanosec=time % SECOND))
                writer.write("/clock", "rosgraph_msgs/msg/Clock", time, now)
            writer.write_raw(topic, kind, time, data)

    def change(topic, number, data):
        return data[:7] if topic == "/clock" and number in (1, 5) else data

    other = raw_copy(tmp_path / "whole", tmp_path / "other", change)
    assert_same_estimates(replayed(other, rover, tmp_path / "out"), usual[1])
    summary = json.loads((tmp_path / "out" / "replay.json").read_text())
    found = [d for d in summary["not_used"] if d["topic"] == "/clock"]
    assert [(d["reason"], d["count"]) for d in found] == [("not_readable", 2)]


def test_a_type_that_the_bag_defines_otherwise_is_named(bag, rover, tmp_path):
    kind = "smallwheel_ros/msg/WheelSinkage"
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(
        {kind: get_types_from_msg("std_msgs/Header header\nfloat64 depth\n", kind)[kind]}
    )
    writer = Writer(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP)
    with BagReader(bag) as reader, writer:
        connections = {
            topic.name: writer.add_connection(
                topic.name, topic.type, typestore=store if topic.type == kind else typestore()
            )
            for topic in reader.topics
        }
        for topic, _, time, message in reader.messages():
            if message.__msgtype__ == kind:
                odd = store.types[kind](header=message.header, depth=message.sinkage)
                data = store.serialize_cdr(odd, kind)
            else:
                data = typestore().serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], time, data)
    smallwheel("replay", tmp_path / "other", "--topics")
    rest = ("--config", rover, "-o", tmp_path / "out")
    text = smallwheel("replay", tmp_path / "other", *rest, code=2).stderr
    assert "nothing can be estimated" in text
    assert "the bag defines it otherwise than here: sinkage is missing" in text


# --- Damaged bags


def truncated(bag: Path, target: Path, storage: str) -> Path:
    with BagReader(bag) as reader, BagWriter(target, storage=storage) as writer:
        for raw in reader.raw_messages():
            writer.write_raw(*raw)
    file = next(f for f in target.iterdir() if f.suffix != ".yaml")
    os.truncate(file, int(0.6 * file.stat().st_size))
    return target


def test_a_truncated_sqlite3_bag_names_what_saves_its_messages(bag, rover, tmp_path):
    other = truncated(bag, tmp_path / "other", "sqlite3")
    result = smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out", code=2)
    assert "`sqlite3 other.db3 .recover | sqlite3 saved.db3` saves" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_truncated_bag_gives_what_could_be_read(bag, rover, usual, tmp_path):
    other = truncated(bag, tmp_path / "other", "mcap")
    result = smallwheel("replay", other, "--config", rover, "-o", tmp_path / "out", code=1)
    assert re.search(r"ended early: .*\d+ messages could be read, the last at \d+", result.stderr)
    table = table_of(tmp_path / "out")
    assert 0.3 * len(usual[1]) < len(table) < len(usual[1])
    # The last ones did not get all that belonged to them.
    whole = len(table) - 8
    assert_same_estimates(table[:whole], usual[1][:whole])
    with BagReader(tmp_path / "out" / "bag") as reader:
        assert sum(1 for _ in reader.messages(MOBILITY)) == len(table)
    assert "The bag is damaged" in (tmp_path / "out" / "report.html").read_text()


def test_a_bag_that_was_not_closed_is_read_from_its_folder(bag, rover, usual, tmp_path):
    shutil.copytree(bag, tmp_path / "drive")
    (tmp_path / "drive" / "metadata.yaml").unlink()
    result = smallwheel(
        "replay", tmp_path / "drive", "--config", rover, "-o", tmp_path / "out", code=1
    )
    assert "metadata" in result.stderr
    assert_same_estimates(table_of(tmp_path / "out"), usual[1])


# --- On from a drive


@pytest.fixture(scope="module")
def three_soils(rover, tmp_path_factory):
    """A drive over three soils, the folder of its replay, and what that found."""
    folder = tmp_path_factory.mktemp("three_soils")
    drive = simulate_drive(DriveSettings(seed=2, distance=25.0, speed=1.0, wheels="two_sizes"))
    write_drive_bag(drive, folder / "drive")
    out = folder / "out"
    return drive, out, replay(ReplaySpec(folder / "drive", rover, out, copy="none"))


def test_changes_of_soil_are_told_where_they_are(three_soils, tmp_path):
    drive, folder, found = three_soils
    summary = json.loads((folder / "replay.json").read_text())
    places = [e["travel"] for e in summary["events"] if e["kind"] == "soil_change"]
    true = [stretch.start for stretch in drive.stretches[1:]]
    assert len(true) == 2
    assert summary["soil"]["changes"] == len(places) == 2
    # Within the rover's length and some turns of its wheels.
    np.testing.assert_allclose(places, true, atol=2.5)
    assert "The soil changed twice" in page(found).text()


def test_the_measurements_are_a_table_for_the_bench(three_soils):
    _, folder, _ = three_soils
    estimates = table_of(folder)
    data = read_measurements(folder / "measurements.csv")
    assert 20 < len(data.line) < 100
    assert data.warnings == ()
    assert set(data.conditions.diameter) == {0.25, 0.4}
    rows = pd.read_csv(folder / "measurements.csv")
    assert rows.groupby(["run", "wheel"]).size().max() == 1
    # A row lies within what it is the median of.
    for _, row in rows.iterrows():
        of_wheel = estimates[estimates["wheel"] == row["wheel"]]
        assert of_wheel["sinkage_measured"].min() <= row["sinkage [m]"]
        assert row["sinkage [m]"] <= of_wheel["sinkage_measured"].max()
    # A soil for each stretch between the changes that the summary counts, numbered like them.
    changes = json.loads((folder / "replay.json").read_text())["soil"]["changes"]
    assert changes == 2
    assert sorted(rows["soil"].unique()) == [f"soil {i + 1}" for i in range(changes + 1)]
    smallwheel("compare", folder / "measurements.csv")


def test_drawbar_pull_is_used_and_put_into_the_measurements(rover, tmp_path):
    """Rows of the law stay as they are; predicted pull comes nearer to the true one."""
    bag, folder = tmp_path / "drive", tmp_path / "out"
    settings = DriveSettings(seed=5, distance=10.0, speed=1.0, wheels="two_sizes", terrain="single")
    drive = simulate_drive(settings)
    write_drive_bag(drive, bag)
    before = replayed(bag, rover, tmp_path / "without", copy="none")
    after = replayed(bag, with_pulls(rover, tmp_path), folder, copy="none")
    law = [name for name in before if name.startswith(("sinkage", "soil_"))]
    pd.testing.assert_frame_equal(after[law], before[law])
    assert (after["drawbar_pull"] != before["drawbar_pull"]).sum() > 100
    data = read_measurements(folder / "measurements.csv")
    assert set(data.channels) == {"sinkage", "drawbar_pull"}
    assert set(data.declared_std) == {"sinkage", "drawbar_pull"}
    true = drive.answer()

    def off(table: pd.DataFrame) -> np.ndarray:
        known = table[table["drawbar_pull"].notna()]
        time = (known["stamp"] - true["epoch_ns"]) / 1e9
        return np.concatenate(
            [
                known["drawbar_pull"][known["wheel"] == name]
                - np.interp(time[known["wheel"] == name], wheel["time"], wheel["drawbar_pull"])
                for name, wheel in true["wheels"].items()
            ]
        )

    rms_after, rms_before = (np.sqrt(np.mean(off(table) ** 2)) for table in (after, before))
    assert rms_after < 0.95 * rms_before


@pytest.mark.slow
def test_a_missing_effect_is_found_on_from_a_drive(rover, tmp_path):
    """The truth simulator hides slip sinkage in one drive, and nothing in the other."""
    verdicts = {}
    for hidden in ((), ("slip_sinkage",)):
        name = hidden[0] if hidden else "none"
        drive = DriveSettings(seed=3, distance=120.0, wheels="two_sizes", hidden=hidden)
        write_drive_bag(simulate_drive(drive), tmp_path / name)
        replayed(tmp_path / name, rover, tmp_path / f"{name}_out", copy="none")
        result = smallwheel(
            "diagnose", tmp_path / f"{name}_out" / "measurements.csv", "--json", "-"
        )
        found = json.loads(result.stdout)
        verdicts[name] = (found["verdict"], found["missing_effects"])
    assert verdicts == {
        "none": ("adequate", []),
        "slip_sinkage": ("missing_effect", ["slip_sinkage"]),
    }


@pytest.mark.slow
def test_a_rut_that_deepens_is_found_on_from_a_drive(repository, tmp_path):
    """Rear wheels run in the front wheels' ruts; the replay's pass numbers let diagnose name it."""
    drive = DriveSettings(seed=3, distance=120.0, terrain="single", hidden=("multipass",))
    write_drive_bag(simulate_drive(drive), tmp_path / "drive")
    rover = repository / "config" / "four_wheels.yaml"
    replayed(tmp_path / "drive", rover, tmp_path / "out", copy="none")
    result = smallwheel("diagnose", tmp_path / "out" / "measurements.csv", "--json", "-")
    found = json.loads(result.stdout)
    assert (found["verdict"], found["missing_effects"]) == ("missing_effect", ["multipass"])


# --- A real rig


def test_the_rigs_own_bag_of_ros1_lists_its_topics(shared_data, rover, tmp_path):
    raw = shared_data / "cmu_wheel_rig" / "raw" / "force-displacement_6.bag"
    text = smallwheel("replay", raw, "--topics").stdout
    assert re.search(r"forcetorque_readings +rokubimini_msgs/msg/Reading +\d+ +\d\d", text)
    error = smallwheel("replay", raw, "--config", rover, "-o", tmp_path / "out", code=2).stderr
    assert "nothing can be estimated" in error


def test_where_a_rover_stands_nothing_is_lethal(shared_data, tmp_path):
    """It stands for 60 s with encoders that shake, then drives off over firm ground: nothing got stuck."""
    made = shared_data.parent / "cases" / "robots" / "standstill_lethal.py"
    if not made.exists():
        pytest.skip(f"{made} is not there")
    subprocess.run([sys.executable, str(made), str(tmp_path / "case")], check=True)
    case, out = tmp_path / "case", tmp_path / "out"
    smallwheel("replay", case / "bag", "--config", case / "rover.yaml", "-o", out)
    ground = read_map(out / "cost_map.yaml")
    assert (ground.cells >= 0).sum() > 500
    assert ground.cells.max() < 100
