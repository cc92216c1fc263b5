"""What rosbags reads: mcap files with an index and nothing compressed, and bags of ROS 1.

A bag of ROS 1 that is cut off has no index, and nothing of it can be read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from smallwheel_ros.bag_files import RawMessage, reason
from smallwheel_ros.bags.library import Ros1Reader, Ros2Reader, offered_qos
from smallwheel_ros.bags.storage import Channel, Contents, Key
from smallwheel_ros.bags.unpack import Unpacker


class RosbagsFile:
    """One file; see `storage.Storage`. Raises whatever rosbags raises for a damaged one."""

    def __init__(self, path: Path, reader: Ros1Reader | Ros2Reader) -> None:
        self.contents = Contents()
        self._reader, self._size = reader, path.stat().st_size
        reader.open()
        for connection in reader.connections:
            key = (connection.topic, connection.msgtype)
            encoding = "ros2idl" if connection.msgdef.format.name == "IDL" else "ros2msg"
            channel = Channel(encoding, connection.msgdef.data, offered_qos(connection))
            self.contents.channels.setdefault(key, channel)
            if connection.msgcount:
                # rosbags gives the first instant after the last message.
                span = (reader.start_time, reader.end_time - 1)
                self.contents.add(key, *span, connection.msgcount)

    def messages(self, wanted: Collection[Key]) -> Iterator[RawMessage]:
        """Give messages by log time."""
        reader, unpack = self._reader, Unpacker(self._size)
        if isinstance(reader, Ros1Reader):
            for place, chunk in reader.chunks.items():
                reader.chunks[place] = chunk._replace(decompressor=unpack)
        chosen = [c for c in reader.connections if (c.topic, c.msgtype) in wanted]
        if not chosen:  # to rosbags an empty list means all of them
            return
        messages, count = reader.messages(chosen), 0
        while True:
            try:
                connection, log_time, data = next(messages)
                data = unpack(data)
            except StopIteration:
                return
            except Exception as error:  # damaged bytes can mean anything
                self.contents.note(f"it is damaged after {count} messages ({reason(error)})")
                return
            yield RawMessage(connection.topic, connection.msgtype, log_time, data)
            count += 1

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
