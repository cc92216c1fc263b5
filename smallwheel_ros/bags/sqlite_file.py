# SPDX-License-Identifier: Apache-2.0
"""An sqlite3 file of rosbag2, whole or damaged, by SQLite itself: rosbags opens only whole ones."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from smallwheel_ros.bags.files import RawMessage, reason
from smallwheel_ros.bags.storage import Key, StorageFile, StoredTopic
from smallwheel_ros.bags.types import qos_of
from smallwheel_ros.bags.unpack import Unpacker
from smallwheel_ros.common.errors import SmallwheelError

_ALL = "SELECT id, topic_id, timestamp, data FROM messages "
# rosbag2 has an index of times; a damaged file is read row by row instead.
_BY_TIME, _BY_ROW = _ALL + "ORDER BY timestamp, id", _ALL + "NOT INDEXED ORDER BY id"
_COUNTS = (
    "SELECT topic_id, MIN(timestamp), MAX(timestamp), COUNT(*) FROM messages NOT INDEXED"
    " WHERE typeof(timestamp) = 'integer' GROUP BY topic_id"
)
_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_KINDS = {int: "an integer", float: "a real", str: "text", bytes: "a blob"}


class SqliteError(SmallwheelError):
    """A database that is no bag."""


class SqliteFile(StorageFile):
    """See `StorageFile`. Raises SqliteError or sqlite3.Error for what is no database of a bag."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        # What a killed recorder left in the write-ahead log is only seen in a database that may
        # change.
        logged = path.with_name(f"{path.name}-wal").exists()
        address = f"{path.resolve().as_uri()}?{'mode=ro' if logged else 'immutable=1'}"
        self._database = sqlite3.connect(address, uri=True)
        self._database.text_factory = lambda content: content.decode(errors="replace")
        self._query = _BY_TIME
        try:
            # A file shorter than its header says is refused at once otherwise.
            self._database.execute("PRAGMA writable_schema = ON")
            self._check_table("topics")
            self._check_table("messages")
            self._keys = self._read_topics()
            self._count_messages()
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

    def _read_topics(self) -> dict[int, Key]:
        known: dict[str, tuple[str, str]] = {}
        try:
            self._check_table("message_definitions")
            known = {str(kind): (e, t) for kind, e, t in self._database.execute(_DEFINITIONS)}
        except (sqlite3.Error, SqliteError):
            pass  # bags before Iron have none
        columns = {row[1] for row in self._database.execute("PRAGMA table_info(topics)")}
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        keys: dict[int, Key] = {}
        query = f"SELECT id, name, type, {qos} FROM topics"
        for number, name, kind, offered in self._database.execute(query):
            keys[int(number)] = key = (str(name), str(kind))
            encoding, text = known.get(str(kind), ("", ""))
            self.topics[key] = StoredTopic(str(encoding), str(text), qos_of(str(offered)))
        return keys

    def _count_messages(self) -> None:
        try:
            for number, first, last, count in self._database.execute(_COUNTS):
                if number in self._keys:
                    self.count(self._keys[number], first, last, count)
        except sqlite3.Error:
            self._query = _BY_ROW
            for topic, kind, time, _ in self.messages(None):
                self.count((topic, kind), time, time, 1)

    def messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give messages by log time; of a damaged file in the order of their rows."""
        self._unpack, count = Unpacker(self._size), 0
        keys = {n: key for n, key in self._keys.items() if wanted is None or key in wanted}
        try:
            for row, number, log_time, data in self._database.execute(self._query):
                count += 1
                key = keys.get(number)
                if key is None:
                    continue
                if isinstance(log_time, int) and isinstance(data, bytes):
                    raw = self.raw(key, log_time, data, f"row {row}")
                    if raw is not None:
                        yield raw
                else:
                    there, found = (_KINDS.get(type(cell), "null") for cell in (log_time, data))
                    self.note(
                        f"row {row} of topic {key[0]} has time {there} and data {found}, expected"
                        " an integer and a blob"
                    )
        except sqlite3.Error as error:
            self.note(f"it is damaged after row {count} ({reason(error)})")

    def close(self) -> None:
        """Close the database."""
        self._database.close()
