"""An sqlite3 file of rosbag2, whole or damaged."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from smallwheel_ros.bag_files import RawMessage, reason
from smallwheel_ros.bags.library import parsed_qos
from smallwheel_ros.bags.storage import Channel, Contents, Key
from smallwheel_ros.bags.unpack import Unpacker, UnpackError
from smallwheel_ros.errors import SmallwheelError

_ALL = "SELECT id, topic_id, timestamp, data FROM messages "
# rosbag2 has an index of times; a damaged file is read row by row instead.
_BY_TIME, _BY_ROW = _ALL + "ORDER BY timestamp, id", _ALL + "NOT INDEXED ORDER BY id"
_COUNTS = (
    "SELECT topic_id, MIN(timestamp), MAX(timestamp), COUNT(*) FROM messages NOT INDEXED"
    " WHERE typeof(timestamp) = 'integer' GROUP BY topic_id"
)


class SqliteError(SmallwheelError):
    """A database that is no bag."""


class SqliteFile:
    """One file; see `storage.Storage`.

    Raises
    ------
    SqliteError, sqlite3.Error
        If it is no database, or not that of a bag.
    """

    def __init__(self, path: Path) -> None:
        self.contents = Contents()
        self._size = path.stat().st_size
        # What a killed recorder left in the write-ahead log is only seen in a database that may
        # change.
        logged = path.with_name(f"{path.name}-wal").exists()
        address = f"{path.resolve().as_uri()}?{'mode=ro' if logged else 'immutable=1'}"
        self._database = sqlite3.connect(address, uri=True)
        self._database.text_factory = _text
        self._query = _BY_TIME
        try:
            # A file shorter than its header says is refused at once otherwise.
            self._database.execute("PRAGMA writable_schema = ON")
            for table in ("topics", "messages"):
                self._check_table(table)
            self._keys = self._topics()
            self._count()
        except BaseException:
            self.close()
            raise

    def _check_table(self, name: str) -> None:
        """Refuse what is computed when it is read: views, virtual tables, generated columns."""
        query = "SELECT type, sql FROM sqlite_master WHERE name = ?"
        rows = self._database.execute(query, (name,)).fetchall()
        plain = [sql for kind, sql in rows if kind == "table" and "VIRTUAL" not in sql.upper()]
        hidden = any(row[6] for row in self._database.execute(f"PRAGMA table_xinfo({name})"))
        if not plain or hidden:
            raise SqliteError(f"it has no plain table {name!r}, as every bag has")

    def _topics(self) -> dict[int, Key]:
        known: dict[str, tuple[str, str]] = {}
        try:
            self._check_table("message_definitions")
            query = (
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            known = {kind: (encoding, text) for kind, encoding, text in self._select(query)}
        except (sqlite3.Error, SqliteError):
            pass  # bags before Iron have none
        columns = {row[1] for row in self._database.execute("PRAGMA table_info(topics)")}
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        keys: dict[int, Key] = {}
        for number, name, kind, offered in self._select(
            f"SELECT id, name, type, {qos} FROM topics"
        ):
            keys[int(number)] = key = (str(name), str(kind))
            encoding, text = known.get(str(kind), ("", ""))
            self.contents.channels[key] = Channel(
                str(encoding), str(text), parsed_qos(str(offered))
            )
        return keys

    def _select(self, query: str) -> list[tuple[Any, ...]]:
        return self._database.execute(query).fetchall()

    def _count(self) -> None:
        try:
            for number, first, last, count in self._database.execute(_COUNTS):
                if number in self._keys:
                    self.contents.add(self._keys[number], first, last, count)
        except sqlite3.Error:
            self._query = _BY_ROW
            for topic, kind, time, _ in self.messages(self._keys.values()):
                self.contents.add((topic, kind), time, time, 1)

    def messages(self, wanted: Collection[Key]) -> Iterator[RawMessage]:
        """Give messages by log time; of a damaged file in the order of their rows."""
        unpack, count = Unpacker(self._size), 0
        numbers = {number: key for number, key in self._keys.items() if key in wanted}
        try:
            for row, number, log_time, data in self._database.execute(self._query):
                count += 1
                if number not in numbers:
                    continue
                if isinstance(log_time, int) and isinstance(data, bytes):
                    try:
                        yield RawMessage(*numbers[number], log_time, unpack(data))
                    except UnpackError as error:
                        self.contents.note(f"row {row}: {error}")
                else:
                    self.contents.note(
                        f"row {row} of topic {numbers[number][0]} has time {_kind(log_time)} and"
                        f" data {_kind(data)}, expected an integer and a blob"
                    )
        except sqlite3.Error as error:
            self.contents.note(f"it is damaged after row {count} ({reason(error)})")

    def close(self) -> None:
        """Close the database."""
        self._database.close()


def _kind(value: object) -> str:
    return {int: "an integer", float: "a real", str: "text", bytes: "a blob"}.get(
        type(value), "null"
    )


def _text(content: bytes) -> str:
    return content.decode(errors="replace")
