# SPDX-License-Identifier: Apache-2.0
"""Write rosbag2 bags: whole or not at all."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys.store import Typestore

from smallwheel_ros.bags.files import STORAGES, BagError, Storage, check_new_bag, reason
from smallwheel_ros.bags.types import LATCHED, typestore

SECOND = 10**9  # ns
Message = SimpleNamespace  # has a type's fields, as rosbags needs it


def header(stamp: int, frame: str) -> Message:
    """Return the header of a message. stamp: ns since the epoch."""
    time = Message(sec=stamp // SECOND, nanosec=stamp % SECOND)
    return Message(stamp=time, frame_id=frame)


class Channel(NamedTuple):
    """A topic as a bag is to hold it: its type with the store that knows it, and QoS."""

    topic: str
    type: str
    store: Typestore
    qos: tuple[Qos, ...] = ()


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
