# SPDX-License-Identifier: Apache-2.0
"""What one storage file of a bag gives, whatever its format."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from rosbags.interfaces import Qos

from smallwheel_ros.bags.files import RawMessage
from smallwheel_ros.bags.unpack import Unpacker, UnpackError

Key = tuple[str, str]  # topic and type
_MOST_PROBLEMS = 5


@dataclass
class StoredTopic:
    """A topic as a file describes it.

    Attributes
    ----------
    encoding, definition
        ``ros2msg``, ``ros2idl``, or another that nobody here can read, and the text of the type's
        definition; empty where the file has none.
    qos
        How it was offered.
    """

    encoding: str = ""
    definition: str = ""
    qos: tuple[Qos, ...] = ()
    messages: int = 0


class StorageFile:
    """An open file: its topics, the log times (ns) of its first and last message, what is wrong.

    While it is read, more may be added to `problems`.
    """

    def __init__(self, path: Path) -> None:
        self.topics: dict[Key, StoredTopic] = {}
        self.times: list[int] = []
        self.problems: list[str] = []
        self._size = path.stat().st_size
        self._unpack = Unpacker(self._size)

    def count(self, key: Key, first: int, last: int, count: int) -> None:
        """Count messages of a topic between two log times."""
        self.topics.setdefault(key, StoredTopic()).messages += count
        self.times = [min(first, *self.times, last), max(first, *self.times, last)]

    def note(self, problem: str) -> None:
        """Note what is wrong, in words; of many such things the first ones."""
        if problem not in self.problems and len(self.problems) < _MOST_PROBLEMS:
            self.problems.append(problem)

    def raw(self, key: Key, log_time: int, data: bytes, where: str) -> RawMessage | None:
        """Return a message, decompressed; where that fails, note it. where: in the file."""
        try:
            return RawMessage(*key, log_time, self._unpack(data))
        except UnpackError as error:
            self.note(f"{where}: {error}")
            return None

    def messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give the messages of these topics (None: of all) by log time, all that can be read."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the file."""
