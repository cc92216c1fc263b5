# SPDX-License-Identifier: Apache-2.0
"""Read bags, rosbag2 (mcap, sqlite3) and ROS 1, whole or damaged; write rosbag2 bags whole or not at all."""

from __future__ import annotations

import contextlib
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

import yaml
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from smallwheel_ros.bags.storage import (
    FORMATS,
    Key,
    RawMessage,
    StorageFile,
    storage_kind,
    unpack_file,
)
from smallwheel_ros.bags.types import (
    LATCHED,
    BagTopic,
    Channel,
    DefinitionError,
    Definitions,
    typestore,
)
from smallwheel_ros.common.errors import SmallwheelError, reason

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")
Message = SimpleNamespace  # has a type's fields, as rosbags needs it
SECOND = 10**9  # ns
_LAST = (1 << 63) - 1  # ns, of the times that there are
_LARGEST_METADATA = 4 << 20  # characters; a name and a quality of service for each topic
_LOADER = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader
_REPAIR = (
    "it is damaged, was not closed, or is of another kind: try `ros2 bag reindex` (ROS 1:"
    " `rosbag reindex`), or record it again"
)


class BagError(SmallwheelError):
    """A bag cannot be read or written; the message names the file and what to do.

    Attributes
    ----------
    path : Path
        The bag.
    messages_read : int
        How many messages came out before the error.
    """

    def __init__(self, path: Path, text: str, *, messages_read: int = 0) -> None:
        super().__init__(f"bag {path}: {text}")
        self.path = path
        self.messages_read = messages_read


class BagMessage(NamedTuple):
    """One message: `log_time` is when it was recorded (ns since the epoch), not its header."""

    topic: str
    type: str
    log_time: int
    message: Any


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
    storage
        In which a bag is to be written that is read like this one.

    Raises
    ------
    BagError
        If there is no bag at `path`, or it is damaged so that nothing can be read.
    """

    def __init__(self, path: Path | str, *, salvage: bool = False) -> None:
        self.path = Path(path)
        self._salvage = salvage
        self._paths, self._problems = _storage_files(self.path, salvage=salvage)
        kinds = {storage_kind(file) for file in self._paths}
        self.storage: Storage = "sqlite3" if ".db3" in kinds else "mcap"
        self._definitions = Definitions(ros2=".bag" not in kinds)
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
                raise BagError(self.path, f"cannot be read ({text}); {_REPAIR}")
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
        try:
            return self._definitions.in_ros2(self._topics[topic, kind])
        except DefinitionError:
            return None

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Give messages in the order of their log times.

        Header stamps may come in another order. Arrays in a message are read-only.

        topics: only these; None means all whose definition is known.

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
        for read, (topic, kind, time, data) in enumerate(self._stream(set(decoders))):
            try:
                message = decoders[topic, kind](data)
            except Exception as error:  # damaged bytes make rosbags raise as it likes
                raise self._damaged(reason(error), read, time, topic) from error
            yield BagMessage(topic, kind, time, message)

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Give messages without deserialising them; otherwise like `messages`."""
        return self._stream(self._keys(topics))

    def _keys(self, topics: Collection[str] | None) -> set[Key]:
        return {key for key in self._topics if topics is None or key[0] in topics}

    def _stream(self, wanted: set[Key]) -> Iterator[RawMessage]:
        read, last = 0, None
        for file in self._files.values():
            seen = 0
            for raw in file.messages(wanted):
                seen, time = seen + 1, raw.log_time
                if 0 <= time <= _LAST:
                    read, last = read + 1, time
                    yield raw
                else:
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
        text = f"damaged{where}: {read} messages could be read{until} ({why})"
        return BagError(self.path, text, messages_read=read)


def _storage_files(path: Path, *, salvage: bool) -> tuple[list[Path], list[str]]:
    """Return a bag's storage files in order, and what is missing of them, in words.

    Raises BagError unless there is something at `path` that can be a bag. salvage: of a folder without
    metadata.yaml the storage files are enough.
    """
    if not path.exists():
        raise BagError(path, "does not exist; give a rosbag2 folder, or a .mcap, .db3 or .bag file")
    if not path.is_dir():
        if storage_kind(path) is None:
            text = f"the suffix {path.suffix!r} is not that of a bag (.mcap, .db3 or .bag)"
            raise BagError(path, text)
        return [path], []
    inside = sorted((file for file in path.iterdir() if storage_kind(file)), key=_natural)
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        if inside and salvage:
            return inside, ["metadata.yaml is missing"]
        mend = "and no .mcap, .db3 or .bag file in it: this is not a bag"
        if inside:
            mend = f"run `ros2 bag reindex {path}`, or give the file {inside[0]} itself"
        raise BagError(path, f"the folder has no metadata.yaml; {mend}")
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


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    """Order of names in which drive_10 comes after drive_9."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]


def header(stamp: int, frame: str) -> Message:
    """Return the header of a message. stamp: ns since the epoch."""
    time = Message(sec=stamp // SECOND, nanosec=stamp % SECOND)
    return Message(stamp=time, frame_id=frame)


class BagWriter:
    """Write a rosbag2 bag; use it in a `with` statement.

    The bag appears at `path` only when the `with` block ends without an error; until then it is
    in a hidden folder beside it, which is removed when something goes wrong.

    Parameters
    ----------
    path
        Folder to make; it must not exist.
    storage
        ``"mcap"`` or ``"sqlite3"``.

    Raises
    ------
    BagError
        If `path` exists, its parent folder does not, or writing fails.
    """

    def __init__(self, path: Path | str, *, storage: Storage = "mcap") -> None:
        self.path = Path(path)
        self.storage = storage
        if storage not in STORAGES:
            raise BagError(self.path, f"storage {storage!r} is unknown: mcap or sqlite3")
        check_new_bag(self.path)
        self.message_count = 0
        self._connections: dict[tuple[str, str], Connection] = {}

    def __enter__(self) -> BagWriter:
        try:
            # The file in the bag is named after its folder: the folder has its final name already.
            prefix = f".{self.path.name}-"
            self._workplace = Path(tempfile.mkdtemp(prefix=prefix, dir=self.path.parent))
            plugin = StoragePlugin[self.storage.upper()]
            made = self._workplace / self.path.name
            self._writer = RosbagsWriter(made, version=9, storage_plugin=plugin)
            self._writer.open()
        except OSError as error:
            raise self._failed(error) from error
        return self

    def _failed(self, error: Exception) -> BagError:
        return BagError(self.path, f"cannot be written ({reason(error)})")

    def write(self, topic: str, kind: str, log_time: int, message: Any) -> None:
        """Write a message of ROS 2 Jazzy or of this package.

        Parameters
        ----------
        topic, kind
            Such as ``"/odom"`` and ``"nav_msgs/msg/Odometry"``.
        log_time
            Time of recording, ns since the epoch.
        message
            Made with `message_type`, or any object with the type's fields.
        """
        self.write_raw(topic, kind, log_time, typestore().serialize_cdr(message, kind))

    def write_raw(self, topic: str, kind: str, log_time: int, data: bytes | memoryview) -> None:
        """Write a message that is serialised (CDR) already, of a type that `message_type` knows."""
        if kind not in typestore().fielddefs:
            raise BagError(self.path, f"topic {topic}: the definition of {kind} is not known here")
        self.write_bytes(Channel(topic, kind, typestore()), log_time, data)

    def write_bytes(self, channel: Channel, log_time: int, data: bytes | memoryview) -> None:
        """Write a serialised message of any type; a channel is `BagReader.as_channel`'s."""
        connection = self._connections.get(channel[:2]) or self._add(channel)
        try:
            self._writer.write(connection, log_time, data)
        except (OSError, sqlite3.Error) as error:
            raise self._failed(error) from error
        self.message_count += 1

    def add(self, topic: str, kind: str, *, keeps_last: bool = False) -> None:
        """Make a topic of a type that `message_type` knows before its first message comes.

        keeps_last: whoever plays the bag gives its last message to those who listen later.
        """
        self._add(Channel(topic, kind, typestore(), (LATCHED,) if keeps_last else ()))

    def _add(self, channel: Channel) -> Connection:
        try:
            connection = self._writer.add_connection(
                *channel[:2], typestore=channel.store, offered_qos_profiles=channel.qos
            )
        except (OSError, sqlite3.Error) as error:
            raise self._failed(error) from error
        self._connections[channel.topic, channel.type] = connection
        return connection

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._writer.close()
                check_new_bag(self.path)
                (self._workplace / self.path.name).rename(self.path)
            else:
                with contextlib.suppress(Exception):
                    self._writer.abort()
        except (OSError, sqlite3.Error) as failure:
            raise self._failed(failure) from failure
        finally:
            shutil.rmtree(self._workplace, ignore_errors=True)


def check_new_bag(path: Path) -> None:
    """Raise `BagError` unless a bag can be made at `path`."""
    if path.exists():
        raise BagError(path, "exists already; nothing was changed: remove it or give another name")
    if not path.parent.is_dir():
        raise BagError(path, f"the folder {path.parent} does not exist: make it first")
