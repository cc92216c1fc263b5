# SPDX-License-Identifier: Apache-2.0
"""Read bags: rosbag2 (mcap, sqlite3) and ROS 1, including what is left of a truncated mcap.

rosbags reads bags that are whole. An mcap that it refuses (without an end, as the power failed; or
with topics that are not of ROS beside others) is read by the package mcap, record by record, up to
where it breaks.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys.store import Typestore

from smallwheel_ros.bags.types import DefinitionError, Definitions
from smallwheel_ros.common.errors import SmallwheelError, reason
from smallwheel_ros.common.stamps import SECOND

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Storage = Literal["mcap", "sqlite3"]
Key = tuple[str, str]  # topic and type
# How a message begins that was compressed by itself; CDR begins otherwise.
_ZSTD = b"\x28\xb5\x2f\xfd"
_HOLE = 30 * 86_400 * SECOND  # ns: no vehicle's recording goes on over a month without a message
_KINDS = (".mcap", ".db3", ".bag")
_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_MEND = {
    ".mcap": "try `mcap recover`, or record it again",
    ".db3": "`sqlite3 {name} .recover | sqlite3 saved.db3` saves the messages that are left",
    ".bag": "try `rosbag reindex`, or record it again",
}


class BagError(SmallwheelError):
    """A bag cannot be read or written; the message names the bag and what to do.

    Parameters
    ----------
    path
        The bag.
    text
        The problem and its remedy, in words.
    messages_read
        Number of messages read before the error.

    Attributes
    ----------
    path, messages_read
        As given.
    """

    def __init__(self, path: Path, text: str, *, messages_read: int = 0) -> None:
        super().__init__(f"bag {path}: {text}")
        self.path = path
        self.messages_read = messages_read


class RawMessage(NamedTuple):
    """One message, still serialised.

    Attributes
    ----------
    topic, type
        Name and type of the topic, such as ``/odom`` and ``nav_msgs/msg/Odometry``.
    log_time
        Time of recording, ns since the epoch.
    data
        The message: CDR in rosbag2, the format of ROS 1 in a ``.bag``.
    """

    topic: str
    type: str
    log_time: int
    data: bytes


class BagMessage(NamedTuple):
    """One message.

    Attributes
    ----------
    topic, type
        Name and type of the topic, such as ``/odom`` and ``nav_msgs/msg/Odometry``.
    log_time
        Time of recording, ns since the epoch; not the stamp in the header.
    message
        The message, with the fields of its type as attributes.
    """

    topic: str
    type: str
    log_time: int
    message: Any


class BagTopic(NamedTuple):
    """One topic of a bag.

    Attributes
    ----------
    name, type
        Name and type of the topic, such as ``/odom`` and ``nav_msgs/msg/Odometry``.
    message_count
        Number of its messages in the bag.
    readable
        Whether the definition of its type is in the bag, or known to this package.
    """

    name: str
    type: str
    message_count: int
    readable: bool


class BagReader:
    """An open bag; use it in a `with` statement.

    A bag that is damaged, was not closed, or lacks metadata or a file is read as far as possible.

    Parameters
    ----------
    path
        A rosbag2 folder, one ``.mcap`` or ``.db3`` file, or a ROS 1 ``.bag`` file.

    Attributes
    ----------
    topics
        The topics in the bag, sorted by name; one with two types is listed twice.
    message_count
        Number of messages in the bag.
    start_time, end_time
        Log times of the first and the last message (ns), None when the bag is empty.
    storage
        Storage format for a new bag that the same programs can read.
    hole
        How a gap of years in the times of recording was bridged, in words; empty if there is none. All
        log times are given after bridging.
    damage
        Damage in the part of the bag read so far, in words; empty if none.

    Raises
    ------
    BagError
        If there is no bag at `path`, or nothing in it can be read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._files = _storage_files(self.path)
        kinds = {file.suffix for file in self._files}
        self.storage: Storage = "sqlite3" if ".db3" in kinds else "mcap"
        self._definitions = Definitions(ros2=".bag" not in kinds)
        self._problems: list[str] = []

    def __enter__(self) -> BagReader:
        with ExitStack() as stack:
            self._parts = list(self._opened(stack))
            self._stack = stack.pop_all()
        self._connections: dict[Key, Connection] = {}
        counts: Counter[Key] = Counter()
        for connection in (c for part in self._parts for c in part.connections):
            key = connection.topic, connection.msgtype
            self._connections.setdefault(key, connection)
            counts[key] += connection.msgcount
        self.message_count = counts.total()
        if not self._parts or (self._problems and not self.message_count):
            self._stack.close()
            why = self.damage or "it has no storage file"
            mend = "; ".join(dict.fromkeys(_mend(file) for file in self._files))
            raise BagError(self.path, f"cannot be read ({why}); {mend}")
        self.topics = tuple(
            BagTopic(*key, counts[key], self._definitions.is_known(self._connections[key]))
            for key in sorted(self._connections)
        )
        filled = [part for part in self._parts if any(c.msgcount for c in part.connections)]
        self.start_time = min((part.start_time for part in filled), default=None)
        # rosbags gives the first instant after the last message.
        self.end_time = max((part.end_time - 1 for part in filled), default=None)
        self.hole = ""
        self._shifts: list[
            tuple[int, int]
        ] = []  # log times (ns), and the shift (ns) of messages up to each
        if self.start_time is not None and (self.end_time or 0) - self.start_time > _HOLE:
            self._bridge()
        return self

    def _bridge(self) -> None:
        """Shift log times that are years before or after those of most messages next to the latter.

        Before /clock ticks, recorders with use_sim_time write 0 (ros2/rosbag2#1276).
        """
        times = []
        for part in self._parts:
            with suppress(Exception):  # where it breaks is said when it is read
                times += [time for _, time, _ in part.messages()]
        times.sort()
        ends = [i for i in range(1, len(times)) if times[i] - times[i - 1] > _HOLE]
        parts = [times[i:k] for i, k in pairwise([0, *ends, len(times)])]
        if not ends:
            return
        most = max(range(len(parts)), key=lambda i: len(parts[i]))
        pace = (parts[most][-1] - parts[most][0]) // max(len(parts[most]) - 1, 1)
        # Messages with one and the same time, as the clock stood, are given the usual time of so many.
        apart = [pace * (len(part) if part[0] == part[-1] else 1) for part in parts]
        shifts = [0] * len(parts)
        for i in range(most - 1, -1, -1):
            shifts[i] = shifts[i + 1] + parts[i + 1][0] - parts[i][-1] - apart[i]
        for i in range(most + 1, len(parts)):
            shifts[i] = shifts[i - 1] - (parts[i][0] - parts[i - 1][-1]) + pace
        self._shifts = [(part[-1], shift) for part, shift in zip(parts, shifts, strict=True)]
        self.start_time, self.end_time = (
            time + self._shift(time) for time in (times[0], times[-1])
        )
        others = len(times) - len(parts[most])
        years = max(abs(shift) for shift in shifts) / 3.156e16
        self.hole = (
            f"{others} of {len(times)} messages were recorded {years:.1f} years from the others: their"
            " times are moved to those of the others (use_sim_time before the clock ticked?)"
        )

    def _shift(self, time: int) -> int:
        """The shift (ns) of a log time (ns)."""
        return next((shift for until, shift in self._shifts if time <= until), 0)

    def _opened(self, stack: ExitStack) -> Iterator[Any]:
        """Open all of the bag, or each of its files that can be opened."""
        if self.path.is_dir():
            try:
                yield stack.enter_context(Ros2Reader(self.path))
                return
            except Exception as error:  # damaged files make rosbags raise almost anything
                self._problems.append(reason(error).replace(f"{self.path}/", ""))
        for file in self._files:
            if file.with_name(f"{file.name}-wal").exists():
                words = f"{file.name} has a write-ahead log next to it, whose messages are not read: `sqlite3"
                self._problems.append(f"{words} {file.name} 'PRAGMA wal_checkpoint'` puts them in")
            try:
                if file.suffix == ".bag":
                    yield stack.enter_context(Ros1Reader(file))
                    continue
                yield stack.enter_context(Ros2Reader(file))
            except Exception as error:
                try:
                    if file.suffix != ".mcap":
                        raise
                    part = _Mcap(file)
                    yield part
                    self._problems += filter(None, [part.problem])
                except Exception:
                    self._problems.append(f"{file.name} is not readable: {reason(error)}")

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def damage(self) -> str:
        """Damage in the part of the bag read so far, in words; empty if none."""
        return "; ".join(self._problems)

    def decoder(self, topic: str, kind: str) -> Callable[[bytes], Any]:
        """Return a function that decodes a topic's messages, which have all fields that the type has here.

        Parameters
        ----------
        topic, kind
            Name and type of the topic, such as ``"/odom"`` and ``"nav_msgs/msg/Odometry"``.

        Returns
        -------
        callable
            From the bytes of a message to the message.

        Raises
        ------
        KeyError
            If the bag has no such topic.
        DefinitionError
            If the type is not known to this package, or the bag defines it differently; the text is then
            added to the bag's `damage`.
        """
        try:
            return self._definitions.decoder(self._connections[topic, kind], as_here=True)
        except DefinitionError as error:
            text = f"type {kind}: {error}"
            if text not in self._problems:
                self._problems.append(text)
            raise

    def channel(self, topic: str, kind: str) -> CopiedTopic | None:
        """Describe how a bag of ROS 2 would store a topic, for `BagWriter.copy`.

        Parameters
        ----------
        topic, kind
            Name and type of the topic, such as ``"/odom"`` and ``"nav_msgs/msg/Odometry"``.

        Returns
        -------
        CopiedTopic or None
            None if the definition of the topic's type is not known.

        Raises
        ------
        KeyError
            If the bag has no such topic.
        """
        connection = self._connections[topic, kind]
        try:
            name, store, convert = self._definitions.in_ros2(connection)
        except DefinitionError:
            return None
        qos = getattr(connection.ext, "offered_qos_profiles", ())
        return CopiedTopic(topic, name, store, tuple(qos), convert)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Yield messages in the order of their log times; arrays in them are read-only.

        Parameters
        ----------
        topics
            Names of the topics to read; None means all whose definition is known.

        Raises
        ------
        BagError
            If the definition of a requested topic is unknown, or, after the readable messages, if the bag is
            damaged.
        """
        decoders: dict[Key, Callable[[bytes], Any]] = {}
        for key, connection in self._wanted(topics).items():
            try:
                decoders[key] = self._definitions.decoder(connection)
            except DefinitionError as error:
                if topics is not None:
                    text = f"topic {key[0]} has type {key[1]}: {error}"
                    raise BagError(self.path, text) from error
        for read, (topic, kind, time, data) in enumerate(self._stream(decoders)):
            try:
                message = decoders[topic, kind](data)
            except Exception as error:  # damaged bytes make rosbags raise as it likes
                raise self._damaged(reason(error), read, time) from error
            yield BagMessage(topic, kind, time, message)

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages as serialised bytes; otherwise as `messages` yields them."""
        return self._stream(self._wanted(topics))

    def _wanted(self, topics: Collection[str] | None) -> dict[Key, Connection]:
        return {k: c for k, c in self._connections.items() if topics is None or k[0] in topics}

    def _stream(self, wanted: Collection[Key]) -> Iterator[RawMessage]:
        read, last = 0, None
        for part in self._parts:
            chosen = [c for c in part.connections if (c.topic, c.msgtype) in wanted]
            try:
                # To rosbags none are all.
                for connection, time, data in part.messages(chosen) if chosen else ():
                    if data[:4] == _ZSTD:
                        data = zstd.decompress(data)
                    time += self._shift(time) if self._shifts else 0
                    read, last = read + 1, time
                    yield RawMessage(connection.topic, connection.msgtype, time, bytes(data))
            except Exception as error:  # damaged bytes make rosbags raise as it likes
                self._problems.append(f"damaged after {read} messages: {reason(error)}")
        if self.damage:
            raise self._damaged(self.damage, read, last)

    def _damaged(self, why: str, read: int, last: int | None) -> BagError:
        until = f", the last at {last / 1e9:.3f} s" if last is not None else ""
        text = f"damaged: {read} messages could be read{until} ({why})"
        return BagError(self.path, text, messages_read=read)


class CopiedTopic(NamedTuple):
    """A topic of a bag as a bag of ROS 2 stores it.

    Attributes
    ----------
    topic, type
        Name of the topic, and its type in ROS 2.
    store
        Type store of rosbags that knows the type.
    qos
        Offered quality-of-service profiles as rosbags has them; empty if the bag states none.
    convert
        Function that converts the bytes of its messages from the format in the old bag to CDR.
    """

    topic: str
    type: str
    store: Typestore
    qos: tuple[Any, ...]
    convert: Callable[[bytes], bytes | memoryview]


class _Mcap:
    """An mcap file that rosbags refuses, read in the order of recording up to where it breaks.

    problem: where and why it breaks, in words; empty if the file is whole.
    """

    def __init__(self, path: Path) -> None:
        self._path, self.problem = path, ""
        self._found: dict[int, Connection] = {}  # by mcap's number of a channel
        counts: Counter[int] = Counter()
        self.start_time, self.end_time = 1 << 63, 0
        for number, time, _ in self._read():
            counts[number] += 1
            self.start_time = min(self.start_time, time)
            self.end_time = max(self.end_time, time + 1)
        self._found = {n: c._replace(msgcount=counts[n]) for n, c in self._found.items()}

    @property
    def connections(self) -> list[Connection]:
        return list(self._found.values())

    def messages(
        self, connections: Collection[Connection] = ()
    ) -> Iterator[tuple[Connection, int, bytes]]:
        wanted = {connection.id for connection in connections}
        for number, time, data in self._read():
            if number in wanted:
                yield self._found[number], time, data

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, log time (ns) and data of each message; channels are noted as they come."""
        schemas: dict[int, Schema] = {}
        with self._path.open("rb") as file:
            try:
                for record in _records(file):
                    if isinstance(record, Message):
                        yield record.channel_id, record.log_time, record.data
                    elif isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel):
                        schema = schemas.get(record.schema_id)
                        self._found.setdefault(record.id, _connection(record, schema, self))
            except Exception as error:  # where it breaks bytes can mean anything
                at = f"it ends, or is damaged, at byte {file.tell()}"
                self.problem = f"{self._path.name}: {at} ({reason(error)})"


def _records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of an mcap file, including those of an incomplete last chunk without compression."""
    place = 0
    try:
        for record in StreamReader(file).records:
            yield record
            place = file.tell()
    except EndOfFile:
        file.seek(place)
        if file.read(9)[:1] != bytes([Opcode.CHUNK]):
            raise
        file.read(28)  # times, size, checksum
        compression = file.read(int.from_bytes(file.read(4), "little"))
        file.read(8)
        if compression:
            raise
        yield from StreamReader(file, skip_magic=True).records


def _connection(channel: Channel, schema: Schema | None, owner: object) -> Connection:
    """A topic of an mcap file as rosbags has it."""
    name, encoding, text = ("", "", b"")
    if schema is not None:
        name, encoding, text = schema.name, schema.encoding, schema.data
    of_ros = channel.message_encoding == "cdr" and encoding in _FORMATS
    definition = MessageDefinition(
        _FORMATS.get(encoding, MessageDefinitionFormat.NONE), text.decode() if of_ros else ""
    )
    try:
        qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    except Exception:  # the messages are worth having without it
        qos = []
    extension = ConnectionExtRosbag2(channel.message_encoding, qos)
    return Connection(channel.id, channel.topic, name, definition, "", 0, extension, owner)


def storage_kind(path: Path) -> str | None:
    """Format of a storage file by its name: .mcap, .db3 or .bag; None for anything else."""
    return path.suffix if path.suffix in _KINDS else None


def _storage_files(path: Path) -> list[Path]:
    """Return a bag's storage files in order. Raises BagError unless there can be a bag at `path`."""
    if not path.exists():
        raise BagError(path, "does not exist; give a rosbag2 folder, or a .mcap, .db3 or .bag file")
    if not path.is_dir():
        if storage_kind(path) is None:
            text = f"the suffix {path.suffix!r} is not that of a bag (.mcap, .db3 or .bag)"
            raise BagError(path, text)
        return [path]
    found = [file for file in path.iterdir() if storage_kind(file)]
    if not found and not (path / "metadata.yaml").exists():
        text = "the folder has no metadata.yaml and no .mcap, .db3 or .bag file: this is not a bag"
        raise BagError(path, text)
    return sorted(found, key=_natural)


def _natural(path: Path) -> list[tuple[str, int]]:
    """Order of names in which drive_10 comes after drive_9."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D*)(\d*)", path.name)]


def _mend(file: Path) -> str:
    """Advice on a file that cannot be read."""
    return _MEND[file.suffix].format(name=file.name)
