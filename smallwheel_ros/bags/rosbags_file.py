"""What rosbags reads: mcap files with an index and nothing compressed, and bags of ROS 1.

A bag of ROS 1 that is cut off has no index, and nothing of it can be read.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path

from smallwheel_ros.bag_files import RawMessage, reason
from smallwheel_ros.bags.library import Ros1Reader, Ros2Reader, offered_qos
from smallwheel_ros.bags.storage import Channel, Contents, Key, Storage
from smallwheel_ros.bags.unpack import Unpacker, UnpackError


class RosbagsFile:
    """One file; see `storage.Storage`. Raises whatever rosbags raises for a damaged one.

    instead: opens the file in another way, to go on where rosbags stops at a damaged place.
    """

    def __init__(
        self,
        path: Path,
        reader: Ros1Reader | Ros2Reader,
        instead: Callable[[], Storage] | None = None,
    ) -> None:
        self.contents = Contents()
        self._reader, self._size, self._instead = reader, path.stat().st_size, instead
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
            except StopIteration:
                return
            except Exception as error:  # damaged bytes can mean anything
                self.contents.note(f"it is damaged after {count} messages ({reason(error)})")
                break
            count += 1
            if isinstance(reader, Ros2Reader):
                try:
                    data = unpack(data)
                except UnpackError as error:
                    self.contents.note(f"message {count}: {error}")
                    continue
            yield RawMessage(connection.topic, connection.msgtype, log_time, data)
        if self._instead is not None:
            with closing(self._instead()) as other:
                yield from islice(other.messages(wanted), count, None)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
