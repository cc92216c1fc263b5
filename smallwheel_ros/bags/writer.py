"""Write rosbag2 bags: whole or not at all."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from smallwheel_ros.bag_files import STORAGES, BagError, Storage, check_new_bag, reason
from smallwheel_ros.bags.codec import Channel
from smallwheel_ros.bags.library import Connection, StoragePlugin, Writer, latched, typestore


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
            raise self._failed(error) from error
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
        if kind not in typestore().fielddefs:
            raise BagError(self.path, f"topic {topic}: the definition of {kind} is not known here")
        self.write_bytes(Channel(topic, kind, typestore()), log_time, data)

    def write_bytes(self, channel: Channel, log_time: int, data: bytes | memoryview) -> None:
        """Write a serialised message of any type; a channel is `BagReader.as_channel`'s."""
        assert self._target is not None, "use BagWriter in a with statement"
        writer = self._target.writer
        try:
            connection = self._connections.get((channel.topic, channel.type))
            if connection is None:
                connection = self._add(writer, channel)
            writer.write(connection, log_time, data)
        except (OSError, sqlite3.Error) as error:
            raise self._failed(error) from error
        self.message_count += 1

    def add(self, topic: str, kind: str, *, keeps_last: bool = False) -> Channel:
        """Make a topic of a type that `message_type` knows before its first message comes.

        keeps_last: whoever plays the bag gives its last message to those who listen later.
        """
        assert self._target is not None, "use BagWriter in a with statement"
        qos = (latched(),) if keeps_last else ()
        channel = Channel(topic, kind, typestore(), qos)
        try:
            self._add(self._target.writer, channel)
        except (OSError, sqlite3.Error) as error:
            raise self._failed(error) from error
        return channel

    def _add(self, writer: Writer, channel: Channel) -> Connection:
        connection = writer.add_connection(
            channel.topic,
            channel.type,
            typestore=channel.store,
            offered_qos_profiles=channel.qos,
        )
        self._connections[channel.topic, channel.type] = connection
        return connection

    def _failed(self, error: Exception) -> BagError:
        return BagError(self.path, f"cannot be written ({reason(error)})")

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
        except (OSError, sqlite3.Error) as failure:
            raise self._failed(failure) from failure
        finally:
            shutil.rmtree(target.workplace, ignore_errors=True)
