"""Where a reader's messages come from: rosbags, or a scan of what is left of a damaged bag."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

from smallwheel_ros.bag_files import RawMessage
from smallwheel_ros.bags.library import AnyReader, Codec, Connection, connection_qos, typestore

Key = tuple[str, str]  # topic and type


class SourceTopic(NamedTuple):
    """Messages of one topic and type, and the QoS (of rosbags) that they were recorded with."""

    messages: int
    qos: tuple[object, ...]


class Source(Protocol):
    """Serialised messages of one bag.

    Attributes
    ----------
    topics
        By topic and type.
    start_time, end_time
        Log times of the first and the last message (ns), None when there is none.
    damage
        What is wrong with the bag as far as known before reading, empty where nothing is.
    """

    codec: Codec
    topics: dict[Key, SourceTopic]
    start_time: int | None
    end_time: int | None
    damage: str

    def stream(self, wanted: set[Key], start: int | None, stop: int | None) -> Iterator[RawMessage]:
        """Give the messages of the wanted topics and types."""

    def close(self) -> None:
        """Let go of files."""


class RosbagsSource:
    """A bag as rosbags reads it. Raises whatever rosbags raises."""

    damage = ""

    def __init__(self, path: Path) -> None:
        self._reader = AnyReader([path], default_typestore=typestore())
        self._reader.open()
        self.codec = Codec(self._reader.typestore, self._reader.is2)
        self._connections: dict[Key, list[Connection]] = {}
        for connection in self._reader.connections:
            key = (connection.topic, connection.msgtype)
            self._connections.setdefault(key, []).append(connection)
        self.topics = {
            key: SourceTopic(sum(c.msgcount for c in same), tuple(connection_qos(same[0])))
            for key, same in sorted(self._connections.items())
        }
        filled = self._reader.message_count > 0
        self.start_time = self._reader.start_time if filled else None
        # rosbags gives the first instant after the last message.
        self.end_time = self._reader.end_time - 1 if filled else None

    def stream(self, wanted: set[Key], start: int | None, stop: int | None) -> Iterator[RawMessage]:
        """Give the messages of the wanted topics and types, in the order of log times."""
        chosen = [c for key in wanted for c in self._connections.get(key, [])]
        if not chosen:  # to rosbags an empty list means all of them
            return
        for connection, time, data in self._reader.messages(chosen, start=start, stop=stop):
            yield RawMessage(connection.topic, connection.msgtype, time, data)

    def close(self) -> None:
        """Close the files."""
        self._reader.close()
