# SPDX-License-Identifier: Apache-2.0
"""Read bags: rosbag2 (mcap, sqlite3) and ROS 1, whole or, where asked, damaged."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml

from smallwheel_ros.bags.definitions import DefinitionError, Definitions
from smallwheel_ros.bags.files import (
    REPAIR,
    BagError,
    BagMessage,
    BagTopic,
    RawMessage,
    check_is_bag,
    reason,
    storage_kind,
)
from smallwheel_ros.bags.mcap_file import McapFile
from smallwheel_ros.bags.ros1_file import Ros1File
from smallwheel_ros.bags.sqlite_file import SqliteFile
from smallwheel_ros.bags.storage import Key, StorageFile, StoredTopic
from smallwheel_ros.bags.unpack import unpack_file
from smallwheel_ros.bags.writer import Channel

_FORMATS: dict[str, type[StorageFile]] = {".mcap": McapFile, ".db3": SqliteFile, ".bag": Ros1File}
_LARGEST_METADATA = 4 << 20  # characters; a name and a quality of service for each topic
_LOADER = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader
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

    Raises
    ------
    BagError
        If there is no bag at `path`, or it is damaged so that nothing can be read.
    """

    def __init__(self, path: Path | str, *, salvage: bool = False) -> None:
        self.path = Path(path)
        self._salvage = salvage
        check_is_bag(self.path, needs_metadata=not salvage)
        self._stack = ExitStack()
        self._files: dict[str, StorageFile] = {}  # by name
        self._problems: list[str] = []
        self._topics: dict[Key, StoredTopic] = {}

    def __enter__(self) -> BagReader:
        try:
            files, self._problems = storage_files(self.path)
            self._definitions = Definitions(all(storage_kind(file) != ".bag" for file in files))
            for file in files:
                self._open(file)
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
            opened = _FORMATS[storage_kind(file) or ""](plain)
        except Exception as error:  # a damaged file makes the libraries raise almost anything
            self._problems.append(f"{file.name} cannot be read: {reason(error)}")
            return
        self._stack.callback(opened.close)
        self._files[file.name] = opened
        for key, topic in opened.topics.items():
            known = self._topics.setdefault(key, StoredTopic(qos=topic.qos))
            known.messages += topic.messages
            if not known.definition:
                known.encoding, known.definition = topic.encoding, topic.definition

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """What is in the bag, by name; a topic with two types is there twice."""
        return tuple(
            BagTopic(*key, topic.messages, self._definitions.is_known(key[1], topic))
            for key, topic in sorted(self._topics.items(), key=lambda item: item[0])
        )

    @property
    def damage(self) -> str:
        """What is wrong with the bag as far as it has been read, empty where nothing is."""
        found = [f"{name}: {text}" for name, f in self._files.items() for text in f.problems]
        return "; ".join([*self._problems, *found])

    @property
    def is_ros2(self) -> bool:
        """False for a bag of ROS 1."""
        return self._definitions.ros2

    @property
    def message_count(self) -> int:
        """Number of messages in the bag."""
        return sum(topic.messages for topic in self._topics.values())

    @property
    def start_time(self) -> int | None:
        """Log time of the first message (ns), None when the bag is empty."""
        return min((time for file in self._files.values() for time in file.times), default=None)

    @property
    def end_time(self) -> int | None:
        """Log time of the last message (ns), None when the bag is empty."""
        return max((time for file in self._files.values() for time in file.times), default=None)

    def decoder(self, topic: str, kind: str) -> Callable[[bytes], Any]:
        """Return what makes a message of bytes, with the fields that its type has here.

        Raises DefinitionError where the bag defines the type otherwise, or beyond all measure; it
        is then part of the bag's `damage`.
        """
        try:
            return self._definitions.decoder(kind, self._topics[topic, kind], as_here=True)
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
        stored = self._topics[topic, kind]
        try:
            name, store, convert = self._definitions.in_ros2(kind, stored)
        except DefinitionError:
            return None
        return Channel(topic, name, store, stored.qos), convert

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
                decoders[key] = self._definitions.decoder(key[1], self._topics[key])
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
            lost = sum(topic.messages for key, topic in file.topics.items() if key in wanted) - seen
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


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    """Order of names in which drive_10 comes after drive_9."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]


def storage_files(path: Path) -> tuple[list[Path], list[str]]:
    """Return a bag's storage files in order, and what is missing of them, in words."""
    if not path.is_dir():
        return [path], []
    inside = sorted((file for file in path.iterdir() if storage_kind(file)), key=_natural)
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        return inside, ["metadata.yaml is missing"]
    try:
        with metadata.open(encoding="utf-8") as file:
            # Nodes, not values: a few lines with references can make any number of values.
            node: Any = yaml.compose(file.read(_LARGEST_METADATA), Loader=_LOADER)
        for name in ("rosbag2_bagfile_information", "relative_file_paths"):
            node = next(value for key, value in node.value if key.value == name)
        files = [path / Path(entry.value).name for entry in node.value]
    except Exception:  # whatever YAML makes of a damaged text
        return inside, ["metadata.yaml cannot be read"]
    missing = [f"file {file.name} is missing" for file in files if not file.exists()]
    return [file for file in files if file.exists()], missing
