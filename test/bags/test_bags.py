# SPDX-License-Identifier: Apache-2.0
"""Tests `reader.py`, `types.py` and `writer.py`."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.bags import BagError, BagReader, BagWriter, message_type
from smallwheel_ros.common.errors import SmallwheelError

_kinds = importlib.util.spec_from_file_location(
    "bag_kinds", Path(__file__).parents[1] / "bag_kinds.py"
)
bag_kinds = importlib.util.module_from_spec(_kinds)
_kinds.loader.exec_module(bag_kinds)
compressed_copy, split_copy = bag_kinds.compressed_copy, bag_kinds.split_copy
ros1_copy, write_foreign = bag_kinds.ros1_copy, bag_kinds.write_foreign

SECOND = 10**9
EPOCH = 1_749_720_600 * SECOND
SINKAGE = "smallwheel_ros/msg/WheelSinkage"
LOAD = "geometry_msgs/msg/WrenchStamped"


def header(nanoseconds, frame="wheel"):
    stamp = message_type("builtin_interfaces/msg/Time")(
        sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND
    )
    return message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)


def sinkage_message(nanoseconds: int, sinkage: float):
    return message_type(SINKAGE)(header=header(nanoseconds), sinkage=sinkage, variance=1e-6)


def load_message(nanoseconds: int, load: float):
    vector = message_type("geometry_msgs/msg/Vector3")
    wrench = message_type("geometry_msgs/msg/Wrench")(
        force=vector(x=0.0, y=0.0, z=load), torque=vector(x=0.0, y=0.0, z=0.0)
    )
    return message_type(LOAD)(header=header(nanoseconds), wrench=wrench)


def write_example(path: Path, storage: str = "mcap", count: int = 50) -> Path:
    with BagWriter(path, storage=storage) as writer:
        for i in range(count):
            time = EPOCH + i * SECOND // 10
            writer.write("/left/sinkage", SINKAGE, time + 5, sinkage_message(time, 0.001 * i))
            writer.write("/left/load", LOAD, time + 7, load_message(time, 50.0 + i))
    return path


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_is_written_is_read(tmp_path, storage):
    bag = write_example(tmp_path / "drive", storage)
    with BagReader(bag) as reader:
        assert [(t.name, t.type, t.message_count, t.readable) for t in reader.topics] == [
            ("/left/load", LOAD, 50, True),
            ("/left/sinkage", SINKAGE, 50, True),
        ]
        assert reader.message_count == 100
        assert (reader.start_time, reader.end_time) == (EPOCH + 5, EPOCH + 49 * SECOND // 10 + 7)
        messages = list(reader.messages())
        raw = list(reader.raw_messages())
    assert [m.log_time for m in messages] == sorted(m.log_time for m in messages)
    assert [(m.topic, m.log_time) for m in raw] == [(m.topic, m.log_time) for m in messages]
    sinkages = [m for m in messages if m.topic == "/left/sinkage"]
    assert np.allclose([m.message.sinkage for m in sinkages], 0.001 * np.arange(50))
    assert {m.message.header.frame_id for m in sinkages} == {"wheel"}
    assert sinkages[13].message.header.stamp.sec == EPOCH // SECOND + 1
    assert sinkages[13].message.header.stamp.nanosec == 3 * SECOND // 10


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_foreign_tool_reads_the_bag_by_its_own_definitions(tmp_path, storage):
    # Plain rosbags without any type store of ours stands for the foreign tool; on opening it also
    # compares the definition with the type hash in the bag.
    from rosbags.highlevel import AnyReader

    bag = write_example(tmp_path / "drive", storage)
    with AnyReader([bag]) as reader:
        connection = next(c for c in reader.connections if c.topic == "/left/sinkage")
        assert connection.msgdef.data.strip()
        _, _, data = list(reader.messages([connection]))[7]
        assert reader.deserialize(data, SINKAGE).sinkage == pytest.approx(0.007)


def test_only_wanted_topics(tmp_path):
    bag = write_example(tmp_path / "drive")
    with BagReader(bag) as reader:
        some = list(reader.messages({"/left/load"}))
        assert [m.message.wrench.force.z for m in some] == [50.0 + i for i in range(50)]
        assert list(reader.messages({"/no/such/topic"})) == []
        assert list(reader.messages(set())) == []


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_single_storage_file_and_folder_without_metadata(tmp_path, storage):
    bag = write_example(tmp_path / "drive", storage)
    inside = next(f for f in bag.iterdir() if f.suffix in (".mcap", ".db3"))
    with BagReader(inside) as reader:
        assert len(list(reader.messages())) == 100
    (bag / "metadata.yaml").unlink()
    assert len(salvaged(bag)[0]) == 100


def test_what_is_no_bag_is_named(tmp_path):
    with pytest.raises(BagError, match="does not exist"):
        BagReader(tmp_path / "nothing")
    with pytest.raises(BagError, match="this is not a bag"):
        BagReader(tmp_path)
    text = tmp_path / "notes.txt"
    text.write_text("no bag")
    with pytest.raises(BagError, match=r"\.txt"):
        BagReader(text)
    for suffix in (".mcap", ".db3", ".bag"):
        for content in (b"", b"garbage " * 30):
            wrong = tmp_path / f"wrong{suffix}"
            wrong.write_bytes(content)
            with pytest.raises(BagError, match=f"wrong{suffix}.*cannot be read"), BagReader(wrong):
                pass


@pytest.mark.parametrize("share", [0.03, 0.3, 0.6, 0.9, 0.999])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_truncated_bag_gives_a_bag_error_never_another(tmp_path, storage, share):
    bag = write_example(tmp_path / "drive", storage, count=400)
    inside = next(f for f in bag.iterdir() if f.suffix in (".mcap", ".db3"))
    os.truncate(inside, int(inside.stat().st_size * share))
    with pytest.raises(BagError, match="drive"), BagReader(bag) as reader:
        list(reader.messages())


def collect(reader, into):
    for message in reader.messages():
        into.append(message)


def test_damage_inside_says_how_far_it_was_good(tmp_path):
    bag = write_example(tmp_path / "drive", count=12_000)  # several chunks
    whole = names_and_times(bag)
    inside = next(bag.glob("*.mcap"))
    content = bytearray(inside.read_bytes())
    half = len(content) // 2
    content[half : half + 200_000] = np.random.default_rng(0).bytes(200_000)
    inside.write_bytes(content)
    good = []
    with BagReader(bag) as reader, pytest.raises(BagError, match="damaged") as caught:
        collect(reader, good)
    assert 10_000 < len(good) < 24_000
    assert caught.value.messages_read == len(good)
    assert [(message.topic, message.log_time) for message in good] == whole[: len(good)]


class Refusing:
    def append(self, message):
        raise TypeError("not a BagMessage")


def test_error_of_the_consumer_is_not_an_error_of_the_bag(tmp_path):
    bag = write_example(tmp_path / "drive")
    with pytest.raises(TypeError, match="not a BagMessage"), BagReader(bag) as reader:
        collect(reader, Refusing())


def write_half_a_bag(target):
    with BagWriter(target) as writer:
        writer.write("/left/load", LOAD, EPOCH, load_message(EPOCH, 1.0))
        Refusing().append(None)


def test_a_bag_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "drive"
    with pytest.raises(TypeError, match="not a BagMessage"):
        write_half_a_bag(target)
    assert list(tmp_path.iterdir()) == []
    write_example(target)
    before = {f.name: f.read_bytes() for f in target.iterdir()}
    with pytest.raises(BagError, match="exists already"):
        BagWriter(target)
    assert {f.name: f.read_bytes() for f in target.iterdir()} == before
    with pytest.raises(BagError, match="does not exist"):
        BagWriter(tmp_path / "no" / "drive")
    with pytest.raises(BagError, match="storage 'csv'"):
        BagWriter(tmp_path / "other", storage="csv")


def test_an_empty_bag_has_no_times(tmp_path):
    with BagWriter(tmp_path / "empty"):
        pass
    with BagReader(tmp_path / "empty") as reader:
        assert reader.topics == ()
        assert reader.start_time is None
        assert reader.end_time is None
        assert list(reader.messages()) == []


def test_unknown_message_type_is_named():
    with pytest.raises(SmallwheelError, match="no_msgs/msg/Such"):
        message_type("no_msgs/msg/Such")


def test_a_message_of_an_unknown_type_is_a_bag_error(tmp_path):
    with (
        pytest.raises(BagError, match="/x: the definition of vendor_msgs/msg/Odd"),
        BagWriter(tmp_path / "odd") as writer,
    ):
        writer.write("/x", "vendor_msgs/msg/Odd", 0, object())
    assert list(tmp_path.iterdir()) == []


def test_a_type_without_definition_is_not_written(tmp_path):
    with pytest.raises(BagError, match="/x: the definition of vendor_msgs/msg/Odd"):
        write_odd(tmp_path / "odd")
    assert list(tmp_path.iterdir()) == []


def write_odd(path):
    with BagWriter(path) as writer:
        writer.write_raw("/x", "vendor_msgs/msg/Odd", EPOCH, b"")


def test_ros1_bag_with_a_vendor_message(shared_data):
    bag = shared_data / "cmu_wheel_rig" / "raw" / "force-displacement_6.bag"
    with BagReader(bag) as reader:
        topic = next(t for t in reader.topics if t.name.endswith("/forcetorque_readings"))
        assert topic.readable
        messages = list(reader.messages({topic.name}))
        assert len(messages) == topic.message_count
        assert reader.end_time == messages[-1].log_time
    force = np.array([m.message.wrench.wrench.force.z for m in messages])
    assert np.all(np.isfinite(force))
    rate = (len(messages) - 1) / (messages[-1].log_time - messages[0].log_time) * 1e9
    assert 80 < rate < 120


def test_ros_itself_reads_what_is_written(tmp_path):
    """The generated message classes make the same of the bytes."""
    serialization = pytest.importorskip("rclpy.serialization", reason="needs ROS 2 (rclpy)")
    messages = pytest.importorskip("smallwheel_ros.msg", reason="needs the generated messages")
    bag = write_example(tmp_path / "drive", count=3)
    with BagReader(bag) as reader:
        raw = [m.data for m in reader.raw_messages({"/left/sinkage"})]
    read = [serialization.deserialize_message(data, messages.WheelSinkage) for data in raw]
    assert [m.sinkage for m in read] == [0.0, 0.001, 0.002]
    assert [m.header.frame_id for m in read] == ["wheel"] * 3
    assert read[1].header.stamp.nanosec == SECOND // 10


# --- Bags of every kind, whole and damaged


def names_and_times(bag: Path, **options) -> list[tuple[str, int]]:
    with BagReader(bag, **options) as reader:
        return [(m.topic, m.log_time) for m in reader.messages()]


@pytest.mark.parametrize(
    ("storage", "how"),
    [("mcap", "message"), ("mcap", "file"), ("mcap", "storage"), ("sqlite3", "message"),
     ("sqlite3", "file")],
)  # fmt: skip
def test_compressed_bags_are_read(tmp_path, storage, how):
    bag = write_example(tmp_path / "drive")
    packed = compressed_copy(bag, tmp_path / "packed", storage, how)
    assert names_and_times(packed) == names_and_times(bag)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_split_bags_are_read(tmp_path, storage):
    bag = write_example(tmp_path / "drive")
    split = split_copy(bag, tmp_path / "split", storage)
    assert len(list(split.iterdir())) == 4
    assert names_and_times(split) == names_and_times(bag)
    (split / "metadata.yaml").unlink()
    assert salvaged(split)[0] == names_and_times(bag)


def test_a_bag_of_ros1_becomes_one_of_ros2(tmp_path):
    bag = write_example(tmp_path / "drive")
    old = ros1_copy(bag, tmp_path / "old.bag")
    with BagReader(old) as reader, BagWriter(tmp_path / "new") as writer:
        for raw in reader.raw_messages():
            channel = reader.channel(raw.topic, raw.type)
            writer.copy(channel, raw.log_time, raw.data)
    with BagReader(bag) as one, BagReader(tmp_path / "new") as other:
        for a, b in zip(one.raw_messages(), other.raw_messages(), strict=True):
            assert (a.topic, a.type, a.log_time, bytes(a.data)) == (*b[:3], bytes(b.data))


def salvaged(bag: Path) -> tuple[list[tuple[str, int]], str]:
    """What a damaged bag gives, and how it says that it is damaged."""
    good = []
    with BagReader(bag) as reader, pytest.raises(BagError) as caught:
        good.extend((m.topic, m.log_time) for m in Collected(reader.messages(), good))
    assert caught.value.messages_read == len(good)
    return good, str(caught.value)


class Collected:
    """Iterates, and keeps what came before an error in a list."""

    def __init__(self, source, into):
        self.source, self.into = source, into

    def __iter__(self):
        for message in self.source:
            self.into.append((message.topic, message.log_time))
        return iter(())


@pytest.mark.parametrize("how", ["", "storage", "message"])
def test_truncated_mcap_gives_what_it_holds(tmp_path, how):
    count = 40_000 if how == "storage" else 4000  # several chunks
    bag = write_example(tmp_path / "drive", count=count)
    if how:
        bag = compressed_copy(bag, tmp_path / "packed", "mcap", how)
    whole = names_and_times(bag)
    file = next(f for f in bag.iterdir() if f.suffix != ".yaml")
    size = file.stat().st_size
    counts = []
    for share in (0.98, 0.6, 0.2):
        os.truncate(file, int(size * share))
        good, text = salvaged(bag)
        assert good == whole[: len(good)]
        assert re.search(r"\d+ messages could be read, the last at .*\.mcap", text) or not good
        counts.append(len(good))
    # A compressed chunk is lost as a whole where its end is missing, at worst.
    assert counts[0] > (0.9 if how != "storage" else 0.5) * len(whole)
    assert counts[0] > counts[1] > counts[2] >= 0
    if how != "storage":
        assert counts[1] > 0.55 * len(whole)


@pytest.mark.parametrize("share", [0.98, 0.6, 0.2])
def test_truncated_sqlite3_names_what_saves_its_messages(tmp_path, share):
    bag = write_example(tmp_path / "drive", "sqlite3", count=4000)
    file = next(bag.glob("*.db3"))
    os.truncate(file, int(file.stat().st_size * share))
    with (
        pytest.raises(BagError, match=r"malformed.*; `sqlite3 drive\.db3 \.recover"),
        BagReader(bag),
    ):
        pass


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_a_bag_of_ros1_is_read_whole_or_says_how_to_mend_it(tmp_path, compression):
    bag = write_example(tmp_path / "drive", count=6000)  # more than one chunk
    old = ros1_copy(bag, tmp_path / "old.bag", compression)
    assert names_and_times(old) == names_and_times(bag)
    os.truncate(old, int(old.stat().st_size * 0.9))
    with (
        pytest.raises(BagError, match=r"old\.bag: cannot be read .*rosbag reindex"),
        BagReader(old),
    ):
        pass


def test_a_split_bag_lacks_a_file(tmp_path):
    bag = write_example(tmp_path / "drive")
    split = split_copy(bag, tmp_path / "split", "mcap")
    (split / "split_1.mcap").unlink()
    good, text = salvaged(split)
    assert 60 <= len(good) <= 70
    assert "files are missing: ['split_1.mcap']" in text


def test_garbage_is_refused_with_salvage_too(tmp_path):
    for suffix in (".mcap", ".db3", ".bag"):
        for content in (b"", b"garbage " * 30):
            wrong = tmp_path / f"wrong{suffix}"
            wrong.write_bytes(content)
            with (
                pytest.raises(BagError, match=f"wrong{suffix}.*cannot be read"),
                BagReader(wrong),
            ):
                pass


def test_a_topic_of_a_foreign_type_is_copied_with_its_definition(tmp_path):
    bag = write_foreign(tmp_path / "foreign", write_example(tmp_path / "drive"))
    with BagReader(bag) as reader, BagWriter(tmp_path / "copy") as writer:
        assert reader.channel("/vendor/nobody", "vendor_msgs/msg/Nobody") is None
        for raw in reader.raw_messages({"/vendor/odd"}):
            channel = reader.channel(raw.topic, raw.type)
            writer.copy(channel, raw.log_time, raw.data)
    with BagReader(tmp_path / "copy") as reader:
        assert [m.message.x for m in reader.messages()] == [10.0 * i for i in range(10)]


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1", "storage", "file", "message"])
def test_damage_anywhere_is_a_bag_error_and_never_another(tmp_path, kind):
    rng = np.random.default_rng(0)
    example = write_example(tmp_path / "drive", "sqlite3" if kind == "sqlite3" else "mcap", 200)
    if kind == "ros1":
        bag = file = ros1_copy(example, tmp_path / "old.bag")
    else:
        packed = kind in ("storage", "file", "message")
        bag = compressed_copy(example, tmp_path / "packed", "mcap", kind) if packed else example
        file = next(f for f in bag.iterdir() if f.suffix != ".yaml")
    whole = file.read_bytes()
    for _ in range(25):
        content = bytearray(whole)
        at = int(rng.integers(len(content)))
        if rng.random() < 0.5:
            for place in rng.integers(len(content), size=int(rng.choice([1, 5, 30]))):
                content[place] = int(rng.integers(256))
        elif rng.random() < 0.5:
            content[at : at + 2000] = bytes(len(content[at : at + 2000]))
        else:
            content[at:at] = rng.bytes(9)
        file.write_bytes(content)
        read, errors = [], []
        try:
            with BagReader(bag) as reader:
                read.extend(reader.messages())
        except BagError as error:
            errors.append(error)
        assert all(e.messages_read == len(read) and e.path == bag for e in errors)


def test_what_a_killed_recorder_left_in_its_log_is_said(tmp_path):
    import sqlite3

    bag = write_example(tmp_path / "drive", "sqlite3")
    whole = names_and_times(bag)
    file = next(bag.glob("*.db3"))
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    last = database.execute("SELECT MAX(id) FROM messages").fetchone()[0]
    rows = "SELECT topic_id, timestamp + 10000000000, data FROM messages WHERE id > ?"
    database.execute(f"INSERT INTO messages (topic_id, timestamp, data) {rows}", (last - 10,))
    database.commit()
    killed = tmp_path / "killed"
    shutil.copytree(bag, killed)  # as it is on the disk, with its log, while the recorder runs
    database.close()
    (killed / "metadata.yaml").unlink()
    good, text = salvaged(killed)
    assert good == whole
    assert "a write-ahead log next to it, whose messages are not read" in text


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("odd", ["first", "last"])
def test_a_hole_of_years_in_the_times_of_recording_is_bridged(tmp_path, storage, odd) -> None:
    second, begin = 10**9, 1_700_000_000 * 10**9
    times = [begin + i * second // 10 for i in range(100)]
    others = [0] * 5 if odd == "first" else [begin + 30 * 10**16 + i for i in range(5)]
    kind = "std_msgs/msg/String"
    with BagWriter(tmp_path / "bag", storage=storage) as writer:
        for i, time in enumerate(sorted(times + others)):
            writer.write("/text", kind, time, message_type(kind)(data=str(i)))
    with BagReader(tmp_path / "bag") as reader:
        assert "5 of 105 messages were recorded" in reader.hole
        logged = [message.log_time for message in reader.messages()]
        assert logged == sorted(logged)
        # Of a clock that stood at 0 they are spread at the pace of the others.
        assert logged[0] == (begin - second // 2 if odd == "first" else begin)
        assert logged[-1] <= begin + 10 * second + 4
        assert (reader.start_time, reader.end_time) == (logged[0], logged[-1])


def test_a_night_between_two_drives_is_no_hole(tmp_path) -> None:
    kind, night = "std_msgs/msg/String", 12 * 3600 * 10**9
    with BagWriter(tmp_path / "bag") as writer:
        for time in (1, night):
            writer.write("/text", kind, time, message_type(kind)(data=""))
    with BagReader(tmp_path / "bag") as reader:
        assert reader.hole == ""
        assert [message.log_time for message in reader.messages()] == [1, night]
