# SPDX-License-Identifier: Apache-2.0
"""One storage file of a bag: an mcap file by the package mcap, sqlite3 by SQLite, ROS 1 by rosbags.

rosbags reads mcap and sqlite3 too, but whole ones alone: it refuses all of a file for one topic of an
encoding that it does not know, unpacks without a limit, and does not see what a killed recorder left
in the log beside a database. Decompression here knows when to stop: a few kilobytes can be made to
unpack to gigabytes.
"""

from __future__ import annotations

import bz2
import contextlib
import sqlite3
import sys
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk
from rosbags.rosbag1 import Reader as Ros1Reader

from smallwheel_ros.bags.types import LATCHED, BagTopic, qos_of
from smallwheel_ros.common.errors import SmallwheelError, reason

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Key = tuple[str, str]  # topic and type
_MOST_PROBLEMS = 5
_LARGEST_RECORD = 1 << 30  # bytes of an mcap file that are read at once
_PREFIX = 9  # bytes of such a record's code and length
_TIME = attrgetter("log_time")
_COUNTS = (
    "SELECT topic_id, MIN(timestamp), MAX(timestamp), COUNT(*) FROM messages NOT INDEXED"
    " WHERE typeof(timestamp) = 'integer' GROUP BY topic_id"
)
_MESSAGES = "SELECT id, topic_id, timestamp, data FROM messages ORDER BY timestamp, id"
_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_KINDS = {int: "an integer", float: "a real", str: "text", bytes: "a blob"}
# What one chunk or message may unpack to: the largest that robots record, raw pictures and clouds
# of points, are some tens of megabytes.
LARGEST = 64 << 20
# What a file may unpack to, as a multiple of its size. Pictures of depth, mostly zeros, reach 30.
_MOST_TIMES = 100
_PIECE = 1 << 20
_DECOMPRESSORS: dict[bytes, Callable[[], Any]] = {
    b"\x28\xb5\x2f\xfd": zstd.ZstdDecompressor,
    b"\x04\x22\x4d\x18": LZ4FrameDecompressor,
    b"BZh": bz2.BZ2Decompressor,
}
_MAGICS = tuple(_DECOMPRESSORS)


class RawMessage(NamedTuple):
    """One message still serialised, CDR in rosbag2, ROS 1 format in a ``.bag``."""

    topic: str
    type: str
    log_time: int
    data: bytes


class _StorageError(SmallwheelError):
    """A file holds no bag, or only by SQLite's own means; or what is compressed is damaged or too large."""


def _check(size: int, limit: int) -> None:
    if size > limit:
        raise _StorageError(
            f"it unpacks to more than {limit >> 20} MiB, the limit here: a chunk or message may"
            f" unpack to {LARGEST >> 20} MiB, a file to {_MOST_TIMES} times its size; if the bag is"
            " sound, decompress it with the tool that made it"
        )


def _most(path: Path) -> int:
    """Bytes that a file may unpack to."""
    return max(LARGEST, _MOST_TIMES * path.stat().st_size)


def unpack_file(source: Path, target: Path) -> str:
    """Decompress a file (zstd) to wherever it ends; return what is wrong with it, or nothing."""
    limit = _most(source)
    try:
        with zstd.open(source, "rb") as packed, target.open("wb") as plain:
            while piece := packed.read1(_PIECE):
                plain.write(piece)
                _check(plain.tell(), limit)
    except (zstd.ZstdError, EOFError, _StorageError) as error:
        return str(error)
    return ""


class StorageFile:
    """An open file: its topics, the log times (ns) of its first and last message, what is wrong.

    While it is read, more may be added to `problems`. stack: closes what is opened.
    """

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.topics: dict[Key, BagTopic] = {}
        self.times: list[int] = []
        self.problems: list[str] = []
        self._path = path
        self._left = _most(path)  # bytes that may still be unpacked
        self._open(path, stack)

    def _open(self, path: Path, stack: ExitStack) -> None:
        """Open the file and find what is in it; any Exception where that is no bag."""
        raise NotImplementedError

    def _messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give messages by log time, up to an Exception where the file is damaged."""
        raise NotImplementedError

    def messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give the messages of these topics (None: of all) by log time, to where the file breaks."""
        self._left, count = _most(self._path), 0
        try:
            for message in self._messages(wanted):
                count += 1
                yield message
        except Exception as error:  # damaged bytes make each library raise as it likes
            self.note(f"it is damaged after {count} messages ({self._reason(error)})")

    def _reason(self, error: Exception) -> str:
        """Say what an error means, and what to do where that is special."""
        return reason(error)

    def note(self, problem: str) -> None:
        """Note what is wrong, in words; of many such things the first ones."""
        if problem not in self.problems and len(self.problems) < _MOST_PROBLEMS:
            self.problems.append(problem)

    def _count(self, key: Key, first: int, last: int, count: int) -> None:
        """Count messages of a topic between two log times."""
        topic = self.topics.setdefault(key, BagTopic(*key))
        self.topics[key] = topic._replace(message_count=topic.message_count + count)
        self.times = [min(first, *self.times, last), max(first, *self.times, last)]

    def _unpack(self, data: bytes) -> bytes:
        """Return the data unpacked; as it is where it is not compressed (zstd, lz4, bz2).

        What ends too early gives what it holds. Raises _StorageError.
        """
        if not data.startswith(_MAGICS):
            return data
        make = next(make for magic, make in _DECOMPRESSORS.items() if data.startswith(magic))
        limit = min(LARGEST, self._left)
        try:
            found: bytes = make().decompress(data, limit + 1)
        except Exception as error:  # each library has errors of its own
            raise _StorageError(f"compressed data is damaged ({error})") from error
        _check(len(found), limit)
        self._left -= len(found)
        return found

    def _raw(self, key: Key, log_time: int, data: bytes, where: str) -> RawMessage | None:
        """Return a message, decompressed; where that fails, note it. where: in the file."""
        try:
            return RawMessage(*key, log_time, self._unpack(data))
        except _StorageError as error:
            self.note(f"{where}: {error}")
            return None


class _McapFile(StorageFile):
    """An mcap file: by its index where it has one, else as its chunks follow each other."""

    _file: BinaryIO

    def _open(self, path: Path, stack: ExitStack) -> None:
        self._schemas: dict[int, Schema] = {}
        self._keys: dict[int, Key] = {}
        self._chunks: list[int] = []  # where they begin, by time
        self._file = stack.enter_context(path.open("rb"))
        reader, summary = SeekingReader(self._file, record_size_limit=_LARGEST_RECORD), None
        with contextlib.suppress(Exception):  # the end of the file is missing or damaged
            summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            for topic, kind, time, _ in self.messages(None):
                self._count((topic, kind), time, time, 1)
            return
        for record in (*summary.schemas.values(), *summary.channels.values()):
            self._take(record)
        statistics = summary.statistics
        times = (statistics.message_start_time, statistics.message_end_time)
        for number, count in statistics.channel_message_counts.items():
            if number in self._keys and count:
                self._count(self._keys[number], *times, count)
        indexes = sorted(summary.chunk_indexes, key=attrgetter("message_start_time"))
        self._chunks = [index.chunk_start_offset for index in indexes]

    def _take(self, record: McapRecord) -> None:
        """Note a type, or a topic."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in self._keys:
            schema = self._schemas.get(record.schema_id)
            key = self._keys[record.id] = (record.topic, schema.name if schema else "")
            topic = self.topics.get(key, BagTopic(*key))
            topic = topic._replace(qos=qos_of(record.metadata.get("offered_qos_profiles", "")))
            if schema is not None:
                cdr = record.message_encoding == "cdr"
                topic = topic._replace(
                    encoding=schema.encoding if cdr else record.message_encoding,
                    definition=schema.data.decode(errors="replace"),
                )
            self.topics[key] = topic

    def _messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give messages by log time; where there is no index, as far as chunks follow in time."""
        waiting: list[RawMessage] = []
        for begin, messages in self._parts():
            waiting.sort(key=_TIME)  # messages of one time stay in their order
            ready = bisect_left(waiting, begin, key=_TIME)
            yield from waiting[:ready]
            del waiting[:ready]
            where = f"at byte {self._place}"
            for message in messages:
                key = self._keys.get(message.channel_id)
                if key is not None and (wanted is None or key in wanted):
                    raw = self._raw(key, message.log_time, message.data, where)
                    if raw is not None:
                        waiting.append(raw)
        yield from sorted(waiting, key=_TIME)

    def _parts(self) -> Iterator[tuple[int, Sequence[Message]]]:
        """Give messages that stand together, and the first one's time, to where the file breaks."""
        file = self._file
        try:
            for record in self._records():
                if isinstance(record, Chunk):
                    yield record.message_start_time, self._in_chunk(record)
                elif isinstance(record, Message):
                    yield record.log_time, (record,)
                else:
                    self._take(record)
        except Exception as error:  # damaged bytes can mean anything
            at = self._place
            size = self._path.stat().st_size
            if file.tell() < size or isinstance(error, _StorageError):
                self.note(f"it is damaged at byte {at} ({reason(error)})")
                return
            self.note(f"it ends at byte {size}, inside of the record at byte {at}")
            file.seek(at)
            if file.read(_PREFIX)[:1] == bytes([Opcode.CHUNK]):
                with contextlib.suppress(Exception):
                    chunk = Chunk.read(ReadDataStream(file))
                    yield chunk.message_start_time, self._in_chunk(chunk, cut_off=True)

    def _records(self) -> Iterator[McapRecord]:
        """Give records, and keep their place: chunks alone where there is an index."""
        for place in self._chunks:
            self._place = place
            self._file.seek(place)
            yield next(_reader(self._file))
        if not self._chunks:
            self._place = MAGIC_SIZE
            self._file.seek(self._place)
            for record in _reader(self._file):
                yield record
                self._place = self._file.tell()

    def _in_chunk(self, chunk: Chunk, *, cut_off: bool = False) -> list[Message]:
        """Return the messages in a chunk, and note the types and topics in it.

        cut_off: the file ends within it; what is there counts.
        """
        if chunk.compression:
            chunk.data, chunk.compression = self._unpack(chunk.data), ""
        records = _reader(BytesIO(chunk.data)) if cut_off else breakup_chunk(chunk, True)
        messages = []
        with contextlib.suppress(*[Exception] if cut_off else []):
            for record in records:
                if isinstance(record, Message):
                    messages.append(record)
                else:
                    self._take(record)
        return messages


def _reader(file: BinaryIO) -> Iterator[McapRecord]:
    limit = _LARGEST_RECORD
    return StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=limit).records


class _SqliteFile(StorageFile):
    """An sqlite3 file of rosbag2."""

    def _open(self, path: Path, stack: ExitStack) -> None:
        # What a killed recorder left in the write-ahead log is only seen in a database that may
        # change.
        logged = path.with_name(f"{path.name}-wal").exists()
        address = f"{path.resolve().as_uri()}?{'mode=ro' if logged else 'immutable=1'}"
        self._database = database = sqlite3.connect(address, uri=True)
        stack.callback(database.close)
        database.text_factory = lambda content: content.decode(errors="replace")
        try:
            self._check_table("topics")
            self._check_table("messages")
            self._keys = self._read_topics()
            for number, first, last, count in database.execute(_COUNTS):
                if number in self._keys:
                    self._count(self._keys[number], first, last, count)
        except sqlite3.Error as error:
            raise _StorageError(self._reason(error)) from error

    def _reason(self, error: Exception) -> str:
        mend = "; `sqlite3 {0} .recover | sqlite3 saved.db3` saves the messages that are left"
        return reason(error) + (mend.format(self._path.name) if "malformed" in str(error) else "")

    def _check_table(self, name: str) -> None:
        """Refuse what is computed when it is read: views, virtual tables, generated columns."""
        query = "SELECT type, sql FROM sqlite_master WHERE name = ?"
        rows = self._database.execute(query, (name,)).fetchall()
        plain = [sql for kind, sql in rows if kind == "table" and "VIRTUAL" not in sql.upper()]
        hidden = any(row[6] for row in self._database.execute(f"PRAGMA table_xinfo({name})"))
        if not plain or hidden:
            raise _StorageError(f"it has no plain table {name!r}, as every bag has")

    def _read_topics(self) -> dict[int, Key]:
        """Note the topics; return topic and type by their numbers."""
        known: dict[str, tuple[str, str]] = {}
        with contextlib.suppress(sqlite3.Error, _StorageError):  # bags before Iron have none
            self._check_table("message_definitions")
            known = {str(kind): (e, t) for kind, e, t in self._database.execute(_DEFINITIONS)}
        columns = {row[1] for row in self._database.execute("PRAGMA table_info(topics)")}
        offers = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        keys: dict[int, Key] = {}
        query = f"SELECT id, name, type, {offers} FROM topics"
        for number, name, kind, offered in self._database.execute(query):
            keys[int(number)] = key = (str(name), str(kind))
            encoding, text = known.get(str(kind), ("", ""))
            qos = qos_of(str(offered))
            self.topics[key] = BagTopic(*key, encoding=str(encoding), definition=str(text), qos=qos)
        return keys

    def _messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        keys = {n: key for n, key in self._keys.items() if wanted is None or key in wanted}
        for row, number, log_time, data in self._database.execute(_MESSAGES):
            key = keys.get(number)
            if key is None:
                continue
            if isinstance(log_time, int) and isinstance(data, bytes):
                raw = self._raw(key, log_time, data, f"row {row}")
                if raw is not None:
                    yield raw
            else:
                there, found = (_KINDS.get(type(cell), "null") for cell in (log_time, data))
                self.note(
                    f"row {row} of topic {key[0]} has time {there} and data {found}, expected"
                    " an integer and a blob"
                )


class _Ros1File(StorageFile):
    """A bag of ROS 1. One that is cut off has no index, and nothing of it can be read."""

    def _open(self, path: Path, stack: ExitStack) -> None:
        self._reader = reader = stack.enter_context(Ros1Reader(path))
        for connection in reader.connections:
            key = (connection.topic, connection.msgtype)
            qos = (LATCHED,) if getattr(connection.ext, "latching", False) else ()
            text = connection.msgdef.data
            self.topics.setdefault(
                key, BagTopic(*key, encoding="ros2msg", definition=text, qos=qos)
            )
            if connection.msgcount:
                # rosbags gives the first instant after the last message.
                self._count(key, reader.start_time, reader.end_time - 1, connection.msgcount)

    def _messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        reader = self._reader
        for place, chunk in reader.chunks.items():
            reader.chunks[place] = chunk._replace(decompressor=self._unpack)
        chosen = [c for c in reader.connections if wanted is None or (c.topic, c.msgtype) in wanted]
        # To rosbags an empty list means all of them.
        for connection, log_time, data in reader.messages(chosen) if chosen else ():
            yield RawMessage(connection.topic, connection.msgtype, log_time, data)


FORMATS: dict[str, type[StorageFile]] = {".mcap": _McapFile, ".db3": _SqliteFile, ".bag": _Ros1File}


def storage_kind(path: Path) -> str | None:
    """Format of a storage file by its name: .mcap, .db3 or .bag; None for anything else.

    A rosbag2 file that is compressed as a whole has .zstd behind that.
    """
    name = path.name.removesuffix(".zstd")
    kind = next((kind for kind in FORMATS if name.endswith(kind)), None)
    return None if kind == ".bag" and name != path.name else kind
