# SPDX-License-Identifier: Apache-2.0
"""Write rosbag2 bags, whole or not at all."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from smallwheel_ros.bags.reader import BagError, CopiedTopic, Storage
from smallwheel_ros.bags.types import typestore
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stamps import SECOND

STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")
Message = SimpleNamespace  # a message: rosbags needs an object with the fields of the type
_NEVER = QosTime(2147483647, 4294967295)
# Quality of service of a topic whose last message is given to late subscribers.
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _NEVER,
    _NEVER,
    QosLiveliness.AUTOMATIC,
    _NEVER,
    False,
)


def header(stamp: int, frame: str) -> Message:
    """Make a std_msgs/Header.

    Parameters
    ----------
    stamp
        Stamp, ns since the epoch.
    frame
        Name of the frame: frame_id.
    """
    time = Message(sec=stamp // SECOND, nanosec=stamp % SECOND)
    return Message(stamp=time, frame_id=frame)


class BagWriter:
    """A new rosbag2 bag to write; use it in a `with` statement.

    The bag appears at `path` only when the `with` block ends without an error; until then it is
    in a hidden folder beside it, which is removed if something goes wrong.

    Parameters
    ----------
    path
        Folder of the bag; it must not exist.
    storage
        Storage format, ``"mcap"`` or ``"sqlite3"``.

    Attributes
    ----------
    path, storage
        As given.
    message_count
        Number of messages written so far.

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
        with self._failing():
            # The file in the bag is named after its folder: the folder has its final name already.
            prefix = f".{self.path.name}-"
            self._workplace = Path(tempfile.mkdtemp(prefix=prefix, dir=self.path.parent))
            plugin = StoragePlugin[self.storage.upper()]
            made = self._workplace / self.path.name
            self._writer = RosbagsWriter(made, version=9, storage_plugin=plugin)
            self._writer.open()
        return self

    @contextlib.contextmanager
    def _failing(self) -> Any:
        """Raise BagError where the bag cannot be written."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            raise BagError(self.path, f"cannot be written ({reason(error)})") from error

    def write(self, topic: str, kind: str, log_time: int, message: Any) -> None:
        """Write a message of ROS 2 Jazzy or of this package.

        Parameters
        ----------
        topic, kind
            Name and type of the topic, such as ``"/odom"`` and ``"nav_msgs/msg/Odometry"``.
        log_time
            Time of recording, ns since the epoch.
        message
            A message of a class from `message_type`, or any object with the type's fields as attributes.

        Raises
        ------
        BagError
            If the type is not known here, or the bag cannot be written.
        """
        connection = self._connections.get((topic, kind)) or self.add(topic, kind)
        self._write(connection, log_time, typestore().serialize_cdr(message, kind))

    def write_raw(self, topic: str, kind: str, log_time: int, data: bytes | memoryview) -> None:
        """Write a message that is already serialised.

        Parameters
        ----------
        topic, kind
            Name and type of the topic; a type that `message_type` knows.
        log_time
            Time of recording, ns since the epoch.
        data
            CDR, with its four bytes of encapsulation.

        Raises
        ------
        BagError
            If the type is not known here, or the bag cannot be written.
        """
        connection = self._connections.get((topic, kind)) or self.add(topic, kind)
        self._write(connection, log_time, data)

    def copy(self, topic: CopiedTopic, log_time: int, data: bytes) -> None:
        """Write a message of another bag, converted to CDR if it is of ROS 1.

        Parameters
        ----------
        topic
            Its topic, as returned by `BagReader.channel`.
        log_time
            Time of recording, ns since the epoch.
        data
            The message as it is serialised in that bag.

        Raises
        ------
        BagError
            If the bag cannot be written.
        """
        converted = topic.convert(data)
        connection = self._connections.get(topic[:2]) or self._add(topic)
        self._write(connection, log_time, converted)

    def add(self, topic: str, kind: str, *, keeps_last: bool = False) -> Connection:
        """Add a topic before its first message is written, so that it is in the bag in any case.

        Parameters
        ----------
        topic, kind
            Name and type of the topic; a type that `message_type` knows.
        keeps_last
            Whether late subscribers get the last message when the bag is played.

        Returns
        -------
        Connection
            The topic as rosbags has it.

        Raises
        ------
        BagError
            If the type is not known here, or the bag cannot be written.
        """
        if kind not in typestore().fielddefs:
            raise BagError(self.path, f"topic {topic}: the definition of {kind} is not known here")
        qos = (_LATCHED,) if keeps_last else ()
        return self._add(CopiedTopic(topic, kind, typestore(), qos, bytes))

    def _add(self, topic: CopiedTopic) -> Connection:
        with self._failing():
            connection = self._writer.add_connection(
                *topic[:2], typestore=topic.store, offered_qos_profiles=topic.qos
            )
        self._connections[topic[:2]] = connection
        return connection

    def _write(self, connection: Connection, log_time: int, data: bytes | memoryview) -> None:
        try:
            self._writer.write(connection, log_time, data)
        except (OSError, sqlite3.Error) as error:
            raise BagError(self.path, f"cannot be written ({reason(error)})") from error
        self.message_count += 1

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            with self._failing():
                if kind is None:
                    self._writer.close()
                    check_new_bag(self.path)
                    (self._workplace / self.path.name).rename(self.path)
                else:
                    with contextlib.suppress(Exception):
                        self._writer.abort()
        finally:
            shutil.rmtree(self._workplace, ignore_errors=True)


def check_new_bag(path: Path) -> None:
    """Raise BagError if `path` exists already, or its parent folder does not exist."""
    if path.exists():
        raise BagError(path, "exists already; nothing was changed: remove it or give another name")
    if not path.parent.is_dir():
        raise BagError(path, f"the folder {path.parent} does not exist: create it first")
