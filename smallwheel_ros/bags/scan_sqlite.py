"""The rows of a rosbag2 sqlite3 file, read without its index and whatever its header says."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from smallwheel_ros.bags.scan import ScanChannel, ScanDamage, Scanned


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    try:
        return {kind: (encoding, text) for kind, encoding, text in database.execute(query)}
    except sqlite3.Error:
        return {}  # bags before Iron have none


def _channels(database: sqlite3.Connection) -> dict[int, ScanChannel]:
    known = _definitions(database)
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    rows = database.execute(f"SELECT id, name, type, {qos} FROM topics")
    return {
        key: ScanChannel(name, kind, *known.get(kind, ("", "")), qos)
        for key, name, kind, qos in rows
    }


def scan(path: Path) -> Iterator[Scanned]:
    """Give the messages in the order of their rows, which is that of recording."""
    # What a killed recorder left in the write-ahead log is only seen in a database that may change.
    logged = path.with_name(f"{path.name}-wal").exists()
    address = f"{path.resolve().as_uri()}?{'mode=ro' if logged else 'immutable=1'}"
    count = 0
    database = None
    try:
        database = sqlite3.connect(address, uri=True)
        # A file shorter than its header says is refused at once otherwise.
        database.execute("PRAGMA writable_schema = ON")
        channels = _channels(database)
        rows = database.execute(
            "SELECT topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY id"
        )
        for topic, log_time, data in rows:
            if topic in channels:
                yield Scanned(channels[topic], log_time, data)
            count += 1
    except sqlite3.Error as error:
        raise ScanDamage(f"damaged after row {count} ({error})") from error
    finally:
        if database is not None:
            database.close()
