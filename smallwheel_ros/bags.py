"""Read and write bags: rosbag2 (mcap, sqlite3) and ROS 1. The only module that imports rosbags.

No ROS installation is needed. A bag brings its own message definitions; where it does not,
those of ROS 2 Jazzy and of this package are used.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.bag_files import (
    REPAIR,
    STORAGES,
    BagError,
    BagMessage,
    BagTopic,
    RawMessage,
    Storage,
    check_is_bag,
    check_new_bag,
    reason,
)
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.interfaces import message_definitions

__all__ = [
    "BagError",
    "BagMessage",
    "BagReader",
    "BagTopic",
    "BagWriter",
    "RawMessage",
    "message_type",
    "typestore",
]
T = TypeVar("T")


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy together with this package's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own = {}
    for name, text in message_definitions().items():
        own.update(get_types_from_msg(text, name))
    store.register(own)
    return store


def message_type(name: str) -> Callable[..., Any]:
    """Return the class of a message, such as ``geometry_msgs/msg/WrenchStamped``.

    Its fields are keyword arguments, all of them required.

    Raises
    ------
    SmallwheelError
        If neither ROS 2 Jazzy nor this package has a message of that name.
    """
    try:
        return typestore().types[name]
    except KeyError:
        raise SmallwheelError(
            f"message type {name!r} is unknown: expected one of ROS 2 Jazzy's common interfaces"
            " or of smallwheel_ros, written like 'nav_msgs/msg/Odometry'"
        ) from None


class BagReader:
    """An open bag; use it in a `with` statement.

    Parameters
    ----------
    path
        A rosbag2 folder, one ``.mcap`` or ``.db3`` file, or a ROS 1 ``.bag`` file.

    Raises
    ------
    BagError
        If there is no bag at `path`, or it is damaged so that nothing can be read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        check_is_bag(self.path)
        self._reader = self._guarded(lambda: AnyReader([self.path], default_typestore=typestore()))

    def __enter__(self) -> BagReader:
        self._guarded(self._reader.open)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """What is in the bag, by name; a topic with two types is there twice."""
        counts: dict[tuple[str, str], int] = {}
        for connection in self._reader.connections:
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
        return tuple(
            BagTopic(name, kind, count, self._store(kind) is not None)
            for (name, kind), count in sorted(counts.items())
        )

    @property
    def message_count(self) -> int:
        """Number of messages in the bag."""
        return self._reader.message_count

    @property
    def start_time(self) -> int | None:
        """Log time of the first message (ns), None when the bag is empty."""
        return self._reader.start_time if self.message_count else None

    @property
    def end_time(self) -> int | None:
        """Log time of the last message (ns), None when the bag is empty."""
        # rosbags gives the first instant after the last message.
        return self._reader.end_time - 1 if self.message_count else None

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
        connections = self._connections(topics)
        decoders: dict[str, Callable[[bytes], Any]] = {}
        for connection in connections:
            decoder = self._decoder(connection.msgtype)
            if decoder is not None:
                decoders[connection.msgtype] = decoder
            elif topics is not None:
                raise BagError(
                    self.path,
                    f"topic {connection.topic} has type {connection.msgtype}, whose definition is"
                    " neither in the bag nor known here; record the bag with its definitions"
                    " (mcap does)",
                )
        readable = [c for c in connections if c.msgtype in decoders]
        for connection, time, data, read in self._stream(readable, start, stop):
            try:
                message = decoders[connection.msgtype](data)
            except Exception as error:
                raise self._damaged(error, read, time, connection.topic) from error
            yield BagMessage(connection.topic, connection.msgtype, time, message)

    def raw_messages(
        self,
        topics: Collection[str] | None = None,
        *,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[RawMessage]:
        """Give messages without deserialising them; otherwise like `messages`."""
        for connection, time, data, _ in self._stream(self._connections(topics), start, stop):
            yield RawMessage(connection.topic, connection.msgtype, time, data)

    def _connections(self, topics: Collection[str] | None) -> list[Connection]:
        if topics is None:
            return list(self._reader.connections)
        wanted = set(topics)
        return [c for c in self._reader.connections if c.topic in wanted]

    def _stream(
        self, connections: list[Connection], start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, int, bytes, int]]:
        if not connections:  # to rosbags an empty list means all of them
            return
        source = self._reader.messages(connections, start=start, stop=stop)
        read, time = 0, None
        while True:
            # Only the step of the reader is guarded: an error of whoever consumes the messages
            # is not an error of the bag.
            try:
                connection, time, data = next(source)
            except StopIteration:
                break
            except Exception as error:
                raise self._damaged(error, read, time) from error
            yield connection, time, data, read
            read += 1
        # Damage inside a chunk can make rosbags skip messages without a word: count them.
        expected = sum(connection.msgcount for connection in connections)
        if start is None and stop is None and read < expected:
            raise self._damaged(EOFError(f"{expected - read} of {expected} are lost"), read, time)

    def _store(self, kind: str) -> Typestore | None:
        for store in (self._reader.typestore, typestore()):
            if kind in store.fielddefs:
                return store
        return None

    def _decoder(self, kind: str) -> Callable[[bytes], Any] | None:
        store = self._store(kind)
        if store is None:
            return None
        decode = store.deserialize_cdr if self._reader.is2 else store.deserialize_ros1
        return lambda data: decode(data, kind)

    def _damaged(
        self, error: Exception, read: int, last: int | None, topic: str | None = None
    ) -> BagError:
        where = f" on topic {topic}" if topic else ""
        until = f", the last at {last / 1e9:.3f} s" if last is not None else ""
        return BagError(
            self.path,
            f"damaged{where} after {read} messages{until} ({reason(error)}); what came before is"
            " good",
            messages_read=read,
            last_log_time=last,
        )

    def _guarded(self, action: Callable[[], T]) -> T:
        # A damaged file makes rosbags raise almost anything (struct.error, IndexError, KeyError,
        # AssertionError, database errors), so everything that is an Exception is meant here.
        try:
            return action()
        except Exception as error:
            raise BagError(self.path, f"cannot be read ({reason(error)}); {REPAIR}") from error


@dataclass
class _Target:
    workplace: Path
    writer: Writer


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
        self._target: _Target | None = None
        self._connections: dict[tuple[str, str], Connection] = {}

    def __enter__(self) -> BagWriter:
        try:
            workplace = Path(tempfile.mkdtemp(prefix=f".{self.path.name}-", dir=self.path.parent))
        except OSError as error:
            raise BagError(self.path, f"cannot be written ({error.strerror})") from error
        # The file in the bag is named after its folder: the folder has its final name already.
        writer = Writer(
            workplace / self.path.name,
            version=9,
            storage_plugin=StoragePlugin[self.storage.upper()],
        )
        writer.open()
        self._target = _Target(workplace, writer)
        return self

    def write(self, topic: str, kind: str, log_time: int, message: Any) -> None:
        """Write a message of ROS 2 Jazzy or of this package.

        Parameters
        ----------
        topic, kind
            Such as ``"/odom"`` and ``"nav_msgs/msg/Odometry"``.
        log_time
            Time of recording, ns since the epoch.
        message
            Made with `message_type`.
        """
        self.write_raw(topic, kind, log_time, typestore().serialize_cdr(message, kind))

    def write_raw(self, topic: str, kind: str, log_time: int, data: bytes | memoryview) -> None:
        """Write a message that is serialised (CDR) already, of a type that `message_type` knows."""
        assert self._target is not None, "use BagWriter in a with statement"
        if kind not in typestore().fielddefs:
            raise BagError(self.path, f"topic {topic}: the definition of {kind} is not known here")
        writer = self._target.writer
        try:
            connection = self._connections.get((topic, kind))
            if connection is None:
                connection = writer.add_connection(topic, kind, typestore=typestore())
                self._connections[topic, kind] = connection
            writer.write(connection, log_time, data)
        except OSError as error:
            raise BagError(self.path, f"cannot be written ({error.strerror})") from error
        self.message_count += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._target is not None
        target, self._target = self._target, None
        try:
            if kind is None:
                target.writer.close()
                check_new_bag(self.path)
                (target.workplace / self.path.name).rename(self.path)
            else:
                with contextlib.suppress(Exception):
                    target.writer.abort()
        except OSError as failure:
            raise BagError(self.path, f"cannot be written ({failure.strerror})") from failure
        finally:
            shutil.rmtree(target.workplace, ignore_errors=True)
