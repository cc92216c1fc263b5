# SPDX-License-Identifier: Apache-2.0
"""Read bags: rosbag2 (mcap, sqlite3) and ROS 1, whole or, where asked, damaged."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from smallwheel_ros.bags.definitions import DefinitionError, Definitions
from smallwheel_ros.bags.files import (
    REPAIR,
    BagError,
    BagMessage,
    BagTopic,
    RawMessage,
    reason,
    storage_files,
    storage_kind,
)
from smallwheel_ros.bags.storage import FORMATS, Key, StorageFile, unpack_file
from smallwheel_ros.bags.writer import Channel

_LAST = (1 << 63) - 1  # ns, of the times that there are


class BagReader:
    """An open bag; use it in a `with` statement.

    Parameters
    ----------
    path
        A rosbag2 folder, one ``.mcap`` or ``.db3`` file (or one of these with ``.zstd`` behind it),
        or a ROS 1 ``.bag`` file.
    salvage
        Read what is left of a bag that is damaged, was not closed, or lacks metadata or a file.
        Without it a bag that is seen to be damaged when it is opened is an error at once.

    Attributes
    ----------
    topics
        What is in the bag, by name; a topic with two types is there twice.
    message_count
        Number of messages in the bag.
    start_time, end_time
        Log times of the first and the last message (ns), None when the bag is empty.
    is_ros2
        False for a bag of ROS 1.

    Raises
    ------
    BagError
        If there is no bag at `path`, or it is damaged so that nothing can be read.
    """

    def __init__(self, path: Path | str, *, salvage: bool = False) -> None:
        self.path = Path(path)
        self._salvage = salvage
        self._paths, self._problems = storage_files(self.path, salvage=salvage)
        self.is_ros2 = all(storage_kind(file) != ".bag" for file in self._paths)
        self._definitions = Definitions(self.is_ros2)
        self._stack = ExitStack()
        self._files: dict[str, StorageFile] = {}  # by name
        self._topics: dict[Key, BagTopic] = {}

    def __enter__(self) -> BagReader:
        try:
            for file in self._paths:
                self._open(file)
            found = sorted(self._topics.values(), key=lambda topic: topic[:2])
            self.topics = tuple(t._replace(readable=self._definitions.is_known(t)) for t in found)
            self.message_count = sum(topic.message_count for topic in found)
            times = [time for file in self._files.values() for time in file.times]
            self.start_time, self.end_time = min(times, default=None), max(times, default=None)
            if not self._files or (self.damage and not (self._salvage and self.message_count)):
                text = self.damage or "it has no storage file"
                raise BagError(self.path, f"cannot be read ({text}); {REPAIR}")
        except BaseException:
            self._stack.close()
            raise
        return self

    def _open(self, file: Path) -> None:
        plain = file
        try:
            if file.name.endswith(".zstd"):
                folder = tempfile.TemporaryDirectory(prefix="smallwheel-")
                plain = Path(self._stack.enter_context(folder)) / file.stem
                if damage := unpack_file(file, plain):
                    self._problems.append(f"{file.name} cannot be decompressed ({damage})")
            opened = FORMATS[storage_kind(file) or ""](plain, self._stack)
        except Exception as error:  # a damaged file makes the libraries raise almost anything
            self._problems.append(f"{file.name} cannot be read: {reason(error)}")
            return
        self._files[file.name] = opened
        for key, topic in opened.topics.items():
            known = self._topics.get(key, topic._replace(message_count=0))
            if not known.definition:
                known = known._replace(encoding=topic.encoding, definition=topic.definition)
            count = known.message_count + topic.message_count
            self._topics[key] = known._replace(message_count=count)

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def damage(self) -> str:
        """What is wrong with the bag as far as it has been read, empty where nothing is."""
        found = [f"{name}: {text}" for name, f in self._files.items() for text in f.problems]
        return "; ".join([*self._problems, *found])

    def decoder(self, topic: str, kind: str) -> Callable[[bytes], Any]:
        """Return what makes a message of bytes, with the fields that its type has here.

        Raises DefinitionError where the bag defines the type otherwise, or beyond all measure; it
        is then part of the bag's `damage`.
        """
        try:
            return self._definitions.decoder(self._topics[topic, kind], as_here=True)
        except DefinitionError as error:
            text = f"type {kind}: {error}"
            if text not in self._problems:
                self._problems.append(text)
            raise

    def as_channel(
        self, topic: str, kind: str
    ) -> tuple[Channel, Callable[[bytes], bytes | memoryview]] | None:
        """Return a topic as `BagWriter.write_bytes` takes it, and what its bytes become there.

        None for a type whose definition is neither in the bag nor known here, or not to be used.
        """
        found = self._topics[topic, kind]
        try:
            name, store, convert = self._definitions.in_ros2(found)
        except DefinitionError:
            return None
        return Channel(topic, name, store, found.qos), convert

    def messages(
        self,
        topics: Collection[str] | None = None,
        *,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[BagMessage]:
        """Give messages in the order of their log times.

        Header stamps may come in another order. Arrays in a message are read-only.

        Parameters
        ----------
        topics
            Only these; None means all whose definition is known.
        start, stop
            Only log times from `start` on and before `stop` (ns).

        Raises
        ------
        BagError
            If a wanted topic's definition is unknown, or, after the readable messages have been
            given, where the bag is damaged.
        """
        decoders: dict[Key, Callable[[bytes], Any]] = {}
        for key in self._keys(topics):
            try:
                decoders[key] = self._definitions.decoder(self._topics[key])
            except DefinitionError as error:
                if topics is not None:
                    text = f"topic {key[0]} has type {key[1]}: {error}"
                    raise BagError(self.path, text) from error
        for read, (topic, kind, time, data) in enumerate(self._stream(set(decoders), start, stop)):
            try:
                message = decoders[topic, kind](data)
            except Exception as error:  # damaged bytes make rosbags raise as it likes
                raise self._damaged(reason(error), read, time, topic) from error
            yield BagMessage(topic, kind, time, message)

    def raw_messages(
        self,
        topics: Collection[str] | None = None,
        *,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[RawMessage]:
        """Give messages without deserialising them; otherwise like `messages`."""
        return self._stream(self._keys(topics), start, stop)

    def _keys(self, topics: Collection[str] | None) -> set[Key]:
        return {key for key in self._topics if topics is None or key[0] in topics}

    def _stream(
        self, wanted: set[Key], start: int | None, stop: int | None
    ) -> Iterator[RawMessage]:
        read, last = 0, None
        first, end = start or 0, _LAST if stop is None else stop - 1
        for file in self._files.values():
            seen = 0
            for raw in file.messages(wanted):
                seen, time = seen + 1, raw.log_time
                if first <= time <= end:
                    read, last = read + 1, time
                    yield raw
                elif not 0 <= time <= _LAST:
                    file.note(f"a message on topic {raw.topic} has log time {time} ns")
            lost = sum(file.topics[k].message_count for k in wanted & file.topics.keys()) - seen
            if lost > 0 and not file.problems:
                file.note(f"{lost} of its messages are lost")
        if self.damage:
            raise self._damaged(self.damage, read, last)

    def _damaged(self, why: str, read: int, last: int | None, topic: str = "") -> BagError:
        """Return the error of a bag that is damaged, after so many messages."""
        where = f" on topic {topic}" if topic else ""
        until = f", the last at {last / 1e9:.3f} s" if last is not None else ""
        return BagError(
            self.path,
            f"damaged{where}: {read} messages could be read{until} ({why})",
            messages_read=read,
            last_log_time=last,
        )
