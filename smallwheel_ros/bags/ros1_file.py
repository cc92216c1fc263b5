# SPDX-License-Identifier: Apache-2.0
"""A bag of ROS 1, by rosbags. One that is cut off has no index, and nothing of it can be read."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from rosbags.interfaces import ConnectionExtRosbag1
from rosbags.rosbag1 import Reader

from smallwheel_ros.bags.files import RawMessage, reason
from smallwheel_ros.bags.storage import Key, StorageFile, StoredTopic
from smallwheel_ros.bags.types import LATCHED
from smallwheel_ros.bags.unpack import Unpacker


class Ros1File(StorageFile):
    """See `StorageFile`. Raises whatever rosbags raises for a damaged one."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._reader = reader = Reader(path)
        reader.open()
        for connection in reader.connections:
            key = (connection.topic, connection.msgtype)
            ext = connection.ext
            latching = isinstance(ext, ConnectionExtRosbag1) and ext.latching
            topic = StoredTopic("ros2msg", connection.msgdef.data, (LATCHED,) if latching else ())
            self.topics.setdefault(key, topic)
            if connection.msgcount:
                # rosbags gives the first instant after the last message.
                self.count(key, reader.start_time, reader.end_time - 1, connection.msgcount)

    def messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give messages by log time, up to the first damage."""
        reader, unpack, count = self._reader, Unpacker(self._size), 0
        for place, chunk in reader.chunks.items():
            reader.chunks[place] = chunk._replace(decompressor=unpack)
        chosen = [c for c in reader.connections if wanted is None or (c.topic, c.msgtype) in wanted]
        # To rosbags an empty list means all of them.
        messages = reader.messages(chosen) if chosen else iter(())
        while True:
            try:
                connection, log_time, data = next(messages)
            except StopIteration:
                return
            except Exception as error:  # damaged bytes can mean anything
                self.note(f"it is damaged after {count} messages ({reason(error)})")
                return
            count += 1
            yield RawMessage(connection.topic, connection.msgtype, log_time, data)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
