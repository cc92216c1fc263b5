# SPDX-License-Identifier: Apache-2.0
"""Bags that are made to cost memory or time, or to lie about their types: one message for each."""

from __future__ import annotations

import contextlib
import re
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from smallwheel_ros.bags import (
    BagError,
    BagReader,
    BagTopic,
    BagWriter,
    message_type,
    types,
    typestore,
)
from smallwheel_ros.bags.storage import LARGEST, zstd
from smallwheel_ros.bags.types import DefinitionError, Definitions, message_definitions
from smallwheel_ros.cli import main
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

SINKAGE = "smallwheel_ros/msg/WheelSinkage"
TOPIC = "/left/sinkage"
SEPARATOR = "=" * 80 + "\n"
HEADER = (
    f"{SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
WHEEL = "std_msgs/Header header\nfloat64 sinkage\nfloat64 variance\n" + HEADER


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive"
    write_drive_bag(simulate_drive(DriveSettings(seed=5, distance=3.0)), path)
    return path


@pytest.fixture(scope="module")
def rover(repository) -> Path:
    return repository / "config" / "four_wheels.yaml"


def replayed(bag: Path, rover: Path, folder: Path, code: int) -> str:
    arguments = ["replay", str(bag), "--config", str(rover), "-o", str(folder), "--copy", "none"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == code, (result.output, result.exception)
    return result.stderr


def sinkage_bytes(i: int) -> bytes:
    stamp = message_type("builtin_interfaces/msg/Time")(sec=1000 + i, nanosec=0)
    header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="left")
    message = message_type(SINKAGE)(header=header, sinkage=0.01, variance=1e-6)
    return bytes(typestore().serialize_cdr(message, SINKAGE))


# --- Definitions


def with_definition(path: Path, kind: str, text: str) -> Path:
    """A bag with ten messages of a type that it defines in its own way, and ten as they are here."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        odd = writer.add_connection("/odd", kind, msgdef=text, rihs01="RIHS01_" + "0" * 64)
        good = writer.add_connection("/left/load", "geometry_msgs/msg/Vector3Stamped",
                                     typestore=typestore())  # fmt: skip
        vector = message_type("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=1.0)
        stamp = message_type("builtin_interfaces/msg/Time")(sec=1, nanosec=0)
        header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="left")
        loaded = message_type("geometry_msgs/msg/Vector3Stamped")(header=header, vector=vector)
        for i in range(10):
            writer.write(odd, i, sinkage_bytes(i))
            data = typestore().serialize_cdr(loaded, "geometry_msgs/msg/Vector3Stamped")
            writer.write(good, i, data)
    return path


def doubling(levels: int) -> str:
    """Each message holds two of the next: 2^levels fields in a few lines."""
    text = "a/T0 x\n"
    for i in range(levels):
        text += f"{SEPARATOR}MSG: a/T{i}\na/T{i + 1} x\na/T{i + 1} y\n"
    return text + f"{SEPARATOR}MSG: a/T{levels}\nuint8 x\n"


HOSTILE = {
    "itself": ("a/Odd x\n", "contains itself"),
    "circle": (f"a/B x\n{SEPARATOR}MSG: a/B\na/Odd y\n", "contains itself"),
    "billion": (f"a/E[1000000000] x\n{SEPARATOR}MSG: a/E\nuint8 x\n", "more than 100000 fields"),
    "billion_texts": ("string[1000000000] x\n", "more than 100000 fields"),
    "doubling": (doubling(40), "more than 100000 fields"),
    "nothing": (f"a/E[] x\n{SEPARATOR}MSG: a/E\n", "messages without fields"),
    "deep": (
        "a/T0 x\n"
        + "".join(f"{SEPARATOR}MSG: a/T{i}\na/T{i + 1} x\n" for i in range(900))
        + f"{SEPARATOR}MSG: a/T900\nuint8 x\n",
        "messages deep",
    ),
    "many": (
        "a/T0 x\n" + "".join(f"{SEPARATOR}MSG: a/T{i}\nuint8 x\n" for i in range(20_000)),
        "characters; expected at most",
    ),
    "unknown": ("a/Nobody x\n", "refers to a/msg/Nobody"),
    "no_text": ("what? [\n", "cannot be understood"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_definition_beyond_all_measure_costs_its_topic_alone(tmp_path, name):
    text, expected = HOSTILE[name]
    bag = with_definition(tmp_path / "bag", "a/msg/Odd", text)
    with BagReader(bag) as reader:
        assert reader.as_channel("/odd", "a/msg/Odd") is None
        assert len(list(reader.messages({"/left/load"}))) == 10
        assert len(list(reader.messages())) == 10
        with pytest.raises(BagError, match=re.escape(expected)):
            list(reader.messages({"/odd"}))


def test_a_type_that_only_the_bag_knows_is_not_one_of_here() -> None:
    topic = BagTopic("/x", "other/msg/Kind", encoding="ros2msg", definition="float64 x")
    assert Definitions(ros2=True).decoder(topic)
    with pytest.raises(DefinitionError, match="only the bag knows the type"):
        Definitions(ros2=True).decoder(topic, as_here=True)


def test_many_large_definitions_have_a_limit_together(tmp_path, monkeypatch):
    monkeypatch.setattr(types, "_MOST_IN_BAG", types._MOST_IN_BAG // 10)
    text = "uint8 x\n" + "# a comment without end\n" * 500
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        for i in range(40):
            name = f"a/msg/T{i}"
            connection = writer.add_connection(f"/t{i}", name, msgdef=text, rihs01="RIHS01_0")
            writer.write(connection, i, b"\0\1\0\0\7")
    with BagReader(tmp_path / "bag") as reader:
        known = [reader.as_channel(t.name, t.type) is not None for t in reader.topics]
    assert 10 < sum(known) < 20


def redefined(bag: Path, target: Path, kind: str, text: str) -> Path:
    """The messages of a bag as they are, with another definition of one type."""
    writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
    with BagReader(bag) as reader, writer:
        connections = {}
        for topic in reader.topics:
            options = {"typestore": typestore()}
            if topic.type == kind:
                options = {"msgdef": text, "rihs01": "RIHS01_" + "0" * 64}
            connections[topic.name] = writer.add_connection(topic.name, topic.type, **options)
        for raw in reader.raw_messages():
            writer.write(connections[raw.topic], raw.log_time, raw.data)
    return target


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (WHEEL.replace("float64 sinkage", "string sinkage"), "sinkage is string, expected float64"),
        (WHEEL.replace("string frame_id", "float64 frame_id"),
         "header.frame_id is float64, expected string"),
        (WHEEL.replace("int32 sec", "string sec"), "Time' is already present with"),
        (WHEEL.replace("int32 sec\nuint32 nanosec", "float64 t"), "Time' is already present with"),
        (WHEEL.replace("float64 sinkage", "float64[3] sinkage"),
         "sinkage is float64[3], expected float64"),
        (WHEEL.replace("float64 sinkage", "float64[] sinkage"),
         "sinkage is float64[], expected float64"),
    ],
)  # fmt: skip
def test_an_input_of_another_definition_is_named(drive, rover, tmp_path, text, expected):
    bag = redefined(drive, tmp_path / "bag", SINKAGE, text)
    stderr = replayed(bag, rover, tmp_path / "out", 2)
    assert "nothing can be estimated" in stderr
    assert f"/front_left/sinkage ({SINKAGE}): " in stderr
    assert expected in stderr


def test_without_the_input_of_another_definition_the_rest_goes_on(drive, rover, tmp_path):
    kind = "sensor_msgs/msg/JointState"
    text = "std_msgs/Header header\nstring[] name\nstring velocity\n" + HEADER
    stderr = replayed(redefined(drive, tmp_path / "bag", kind, text), rover, tmp_path / "out", 1)
    assert f"type {kind}: the bag defines it otherwise than here: position is missing" in stderr
    assert (tmp_path / "out" / "estimates.csv").read_text().count("\n") > 100


def test_a_definition_with_more_fields_is_read(drive, rover, tmp_path):
    """A sensor's own version of the message, with a temperature behind it."""
    text = WHEEL.replace("float64 variance\n", "float64 variance\nfloat64 temperature\n")
    target = tmp_path / "bag"
    writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
    with BagReader(drive) as reader, writer:
        connections = {}
        for topic in reader.topics:
            options = {"typestore": typestore()}
            if topic.type == SINKAGE:
                options = {"msgdef": text, "rihs01": "RIHS01_" + "0" * 64}
            connections[topic.name] = writer.add_connection(topic.name, topic.type, **options)
        for raw in reader.raw_messages():
            more = bytes(8) if raw.type == SINKAGE else b""
            writer.write(connections[raw.topic], raw.log_time, raw.data + more)
    replayed(target, rover, tmp_path / "out", 0)


# --- Compression


def zeros(size: int) -> bytes:
    """A zstd frame of so many zeros that does not say its size."""
    compressor = zstd.ZstdCompressor()
    parts = [compressor.compress(bytes(1 << 20)) for _ in range(size >> 20)]
    return b"".join([*parts, compressor.flush()])


@pytest.fixture(scope="module")
def bomb() -> bytes:
    packed = zeros(3300 << 20)
    assert len(packed) < 400_000
    return packed


@contextlib.contextmanager
def bounded_memory() -> Iterator[Callable[[], int]]:
    """Give what says how much more memory (bytes) Python has held than before at the most."""
    import tracemalloc

    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    try:
        yield lambda: tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()


def test_a_message_that_unpacks_to_gigabytes_is_left_out(tmp_path, bomb):
    path = tmp_path / "bag"
    with BagWriter(path, storage="sqlite3") as writer:
        for i in range(20):
            writer.write_raw(TOPIC, SINKAGE, i, bomb if i == 7 else sinkage_bytes(i))
    good = []
    with bounded_memory() as used, BagReader(path, salvage=True) as reader:
        with pytest.raises(BagError, match=f"unpacks to more than {LARGEST >> 20} MiB"):
            good.extend(m.log_time for m in kept(reader.messages(), good))
        assert used() < 4 * LARGEST
    assert good == [i for i in range(20) if i != 7]


def kept(messages, into):
    for message in messages:
        into.append(message.log_time)
    return []


def test_a_file_that_unpacks_to_gigabytes_stops_at_the_limit(tmp_path, bomb):
    packed = tmp_path / "drive.mcap.zstd"
    packed.write_bytes(bomb)
    with pytest.raises(BagError, match=r"drive\.mcap\.zstd cannot be .*the limit here"):
        BagReader(packed, salvage=True).__enter__()


def chunked(path: Path, bomb: bytes | None) -> Path:
    """An mcap file with three compressed chunks; bomb: instead of the content of the second."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=1000, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        text = message_definitions()[SINKAGE] + "\n" + HEADER
        schema = writer.register_schema(SINKAGE, "ros2msg", text.encode())
        channel = writer.register_channel(TOPIC, "cdr", schema)
        for i in range(45):
            writer.add_message(channel, i, sinkage_bytes(i), i)
        writer.finish()
    if bomb is not None:
        content = path.read_bytes()
        frames = [m.start() for m in re.finditer(re.escape(b"\x28\xb5\x2f\xfd"), content)]
        start = frames[1]
        size = int.from_bytes(content[start - 8 : start], "little")
        # Cut off behind it: what follows has moved, and the index with it.
        record = start - 8 - len("zstd") - 4 - 28 - 8
        length = int.from_bytes(content[record : record + 8], "little") + len(bomb) - size
        path.write_bytes(
            content[:record] + length.to_bytes(8, "little") + content[record + 8 : start - 8]
            + len(bomb).to_bytes(8, "little") + bomb + content[start + size :]
        )  # fmt: skip
    return path


def test_a_chunk_that_unpacks_to_gigabytes_is_left_out(tmp_path, bomb):
    with BagReader(chunked(tmp_path / "whole.mcap", None)) as reader:
        whole = [m.log_time for m in reader.messages()]
    assert whole == list(range(45))
    good = []
    with bounded_memory() as used:
        with (
            pytest.raises(BagError, match="unpacks to more than"),
            BagReader(chunked(tmp_path / "bomb.mcap", bomb), salvage=True) as reader,
        ):
            kept(reader.messages(), good)
        assert used() < 4 * LARGEST
    assert good
    assert set(good) < set(whole)


def test_a_chunk_of_ros1_that_unpacks_to_gigabytes_stops_at_the_limit(tmp_path):
    path = tmp_path / "old.bag"
    store = get_typestore(Stores.ROS1_NOETIC)
    text = store.types["std_msgs/msg/String"](data="x" * (LARGEST + (1 << 20)))
    old = Writer1(path)
    old.set_compression(Writer1.CompressionFormat.BZ2)
    with old as writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 1, store.serialize_ros1(text, "std_msgs/msg/String"))
    assert path.stat().st_size < 100_000
    with (
        pytest.raises(BagError, match="unpacks to more than"),
        BagReader(path, salvage=True) as reader,
    ):
        list(reader.messages())


# --- sqlite3


def database(bag: Path) -> sqlite3.Connection:
    return sqlite3.connect(next(bag.glob("*.db3")))


@pytest.fixture
def in_sqlite(drive, tmp_path) -> Path:
    with BagReader(drive) as reader, BagWriter(tmp_path / "drive", storage="sqlite3") as writer:
        for raw in reader.raw_messages():
            writer.write_raw(*raw)
    return tmp_path / "drive"


@pytest.mark.parametrize("cell", ["12345", "'text'", "1.5"])
def test_a_cell_that_is_no_message_costs_that_message_alone(in_sqlite, rover, tmp_path, cell):
    with BagReader(in_sqlite) as reader:
        count = sum(topic.message_count for topic in reader.topics if topic.name != "/imu")
    with contextlib.closing(database(in_sqlite)) as changed:
        changed.execute(f"UPDATE messages SET data = {cell} WHERE id = 40")
        changed.commit()
    stderr = replayed(in_sqlite, rover, tmp_path / "out", 1)
    assert f"{count - 1} messages could be read" in stderr
    assert "row 40 of topic" in stderr
    assert "expected an integer and a blob" in stderr


@pytest.mark.parametrize(
    "trick",
    [
        "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        " SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n",
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
        " data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
        "CREATE VIRTUAL TABLE messages USING fts3(id, topic_id, timestamp, data)",
    ],
)
def test_what_sqlite_works_out_by_itself_is_no_bag(in_sqlite, rover, tmp_path, trick):
    with contextlib.closing(database(in_sqlite)) as changed:
        changed.execute("ALTER TABLE messages RENAME TO kept")
        changed.execute(trick)
        if "GENERATED" in trick:
            changed.execute(
                "INSERT INTO messages (id, topic_id, timestamp) SELECT id, topic_id, timestamp"
                " FROM kept"
            )
        changed.commit()
    assert "no plain table 'messages'" in replayed(in_sqlite, rover, tmp_path / "out", 2)


# --- The folder's own file


def test_metadata_that_never_ends_is_left_alone(drive, rover, tmp_path):
    bomb = "a0: &a0 {x: 1}\n" + "".join(
        f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 30)
    )
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "drive.mcap").write_bytes((drive / "drive.mcap").read_bytes())
    (bag / "metadata.yaml").write_text(bomb)
    stderr = replayed(bag, rover, tmp_path / "out", 1)
    assert "metadata.yaml cannot be read" in stderr
