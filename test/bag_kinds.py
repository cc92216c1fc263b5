# SPDX-License-Identifier: Apache-2.0
"""Bags of every kind for tests: compressed, split, of ROS 1, with types that nobody knows."""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.bags.types import message_definitions

COMPRESSIONS = {"message": CompressionMode.MESSAGE, "file": CompressionMode.FILE,
                "storage": CompressionMode.STORAGE}  # fmt: skip


def beginning(bag: Path, target: Path, seconds: float) -> Path:
    """The first seconds of a bag: most of what a test looks at is there by then."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        assert reader.start_time is not None
        end = reader.start_time + round(seconds * 1e9)
        for raw in reader.raw_messages():
            if raw.log_time < end:
                writer.write_raw(*raw)
    return target


def compressed_copy(bag: Path, target: Path, storage: str, how: str) -> Path:
    """The same messages, compressed by message, file, or in the storage (mcap's chunks)."""
    writer = Writer(target, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(COMPRESSIONS[how], CompressionFormat.ZSTD)
    with BagReader(bag) as reader, writer:
        connections = {}
        for topic in reader.topics:
            channel = reader.channel(topic.name, topic.type)
            connections[topic.name] = writer.add_connection(
                topic.name, topic.type, typestore=channel.store
            )
        for raw in reader.raw_messages():
            writer.write(connections[raw.topic], raw.log_time, raw.data)
    return target


def split_copy(bag: Path, target: Path, storage: str, parts: int = 3) -> Path:
    """The same messages in several files of one bag, as a recorder splits them."""
    target.mkdir()
    with BagReader(bag) as reader:
        start, end = reader.start_time, reader.end_time
        edges = [start + (end + 1 - start) * i // parts for i in range(parts + 1)]
        infos = []
        for i in range(parts):
            part = target.parent / f"{target.name}_{i}"
            with BagWriter(part, storage=storage) as writer:
                for raw in reader.raw_messages():
                    if edges[i] <= raw.log_time < edges[i + 1]:
                        writer.write_raw(*raw)
            information = yaml.safe_load((part / "metadata.yaml").read_text())
            infos.append(information["rosbag2_bagfile_information"])
            shutil.move(next(part.glob(f"{part.name}.*")), target)
            shutil.rmtree(part)
    whole = dict(infos[0])
    counts: dict[str, dict] = {}
    for info in infos:
        for entry in info["topics_with_message_count"]:
            name = entry["topic_metadata"]["name"]
            if name in counts:
                counts[name]["message_count"] += entry["message_count"]
            else:
                counts[name] = entry
    whole.update(
        relative_file_paths=[info["relative_file_paths"][0] for info in infos],
        files=[info["files"][0] for info in infos],
        message_count=sum(info["message_count"] for info in infos),
        duration={"nanoseconds": end - start},
        topics_with_message_count=list(counts.values()),
    )
    (target / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole}))
    return target


def ros1_copy(bag: Path, target: Path, compression: str = "") -> Path:
    """The same messages in a bag of ROS 1; compression: BZ2 or LZ4, of its chunks."""
    store = get_typestore(Stores.ROS1_NOETIC)
    own = {}
    for name, text in message_definitions().items():
        own.update(get_types_from_msg(text, name))
    own.pop("std_msgs/msg/Header", None)
    store.register(own)

    def converted(message):
        """The same fields; a header of ROS 1 also has a number."""
        kind = message.__msgtype__
        values = {
            name: converted(value) if hasattr(value, "__msgtype__") else value
            for name, value in vars(message).items()
        }
        if kind == "std_msgs/msg/Header":
            values["seq"] = 7
        return store.types[kind](**values)

    old = Writer1(target)
    if compression:
        old.set_compression(Writer1.CompressionFormat[compression])
    with BagReader(bag) as reader, old as writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.type, typestore=store)
            for topic in reader.topics
        }
        for topic, kind, time, message in reader.messages():
            data = store.serialize_ros1(converted(message), kind)
            writer.write(connections[topic], time, data)
    return target


def write_foreign(path: Path, like: Path, storage: str = "mcap") -> Path:
    """The messages of a bag, with topics of types between them that this package does not know."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("float64 x\nstring name\n", "vendor_msgs/msg/Odd"))
    odd = store.types["vendor_msgs/msg/Odd"]
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    with BagReader(like) as reader, writer:
        connections = {}
        for topic in reader.topics:
            channel = reader.channel(topic.name, topic.type)
            connections[topic.name] = writer.add_connection(
                topic.name, topic.type, typestore=channel.store
            )
        known = writer.add_connection("/vendor/odd", "vendor_msgs/msg/Odd", typestore=store)
        # A recorder without the definition writes the type's name alone.
        unknown = writer.add_connection(
            "/vendor/nobody", "vendor_msgs/msg/Nobody", msgdef="", rihs01="RIHS01_" + "0" * 64
        )
        for i, raw in enumerate(reader.raw_messages()):
            writer.write(connections[raw.topic], raw.log_time, raw.data)
            if i % 10 == 0:
                data = store.serialize_cdr(odd(x=float(i), name="odd"), "vendor_msgs/msg/Odd")
                writer.write(known, raw.log_time, data)
                writer.write(unknown, raw.log_time, b"\x00\x01\x00\x00\x07\x00\x00\x00")
    return path
