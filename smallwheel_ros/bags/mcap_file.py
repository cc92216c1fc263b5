# SPDX-License-Identifier: Apache-2.0
"""An mcap file, whole or damaged, by the package mcap.

Chunk by chunk, in the order of the index where there is one, else as they follow each other.
"""

from __future__ import annotations

import contextlib
from bisect import bisect_left
from collections.abc import Collection, Iterator
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk

from smallwheel_ros.bags.files import RawMessage, reason
from smallwheel_ros.bags.storage import Key, StorageFile, StoredTopic
from smallwheel_ros.bags.types import qos_of
from smallwheel_ros.bags.unpack import Unpacker, UnpackError

_LARGEST_RECORD = 1 << 30  # bytes that are read at once
_TIME = attrgetter("log_time")
_PREFIX = 9  # bytes of a record's code and length


class McapFile(StorageFile):
    """See `StorageFile`. Raises an Exception where it does not begin like an mcap file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, Schema] = {}
        self._keys: dict[int, Key] = {}
        self._index: list[ChunkIndex] = []
        self._file: BinaryIO = path.open("rb")
        try:
            if not self._read_summary():
                for topic, kind, time, _ in self.messages(None):
                    self.count((topic, kind), time, time, 1)
        except BaseException:
            self.close()
            raise

    def _read_summary(self) -> bool:
        """Say what there is by the file's own summary; return whether it has one that says it."""
        reader, summary = SeekingReader(self._file, record_size_limit=_LARGEST_RECORD), None
        with contextlib.suppress(Exception):  # the end of the file is missing or damaged
            summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return False
        for record in (*summary.schemas.values(), *summary.channels.values()):
            self._take(record)
        statistics = summary.statistics
        for number, count in statistics.channel_message_counts.items():
            if number in self._keys and count:
                times = (statistics.message_start_time, statistics.message_end_time)
                self.count(self._keys[number], *times, count)
        self._index = sorted(summary.chunk_indexes, key=attrgetter("message_start_time"))
        return True

    def _take(self, record: McapRecord) -> None:
        """Note a type, or a topic."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in self._keys:
            schema = self._schemas.get(record.schema_id)
            key = self._keys[record.id] = (record.topic, schema.name if schema else "")
            found = self.topics.setdefault(key, StoredTopic())
            found.qos = qos_of(record.metadata.get("offered_qos_profiles", ""))
            if schema is not None:
                cdr = record.message_encoding == "cdr"
                found.encoding = schema.encoding if cdr else record.message_encoding
                found.definition = schema.data.decode(errors="replace")

    def messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give messages by log time; where there is no index, as far as chunks follow in time."""
        self._unpack = Unpacker(self._size)
        waiting: list[RawMessage] = []
        for at, record in self._records():
            if isinstance(record, Chunk):
                begin, content = record.message_start_time, self._in_chunk(record, at)
            elif isinstance(record, Message):
                begin, content = record.log_time, iter((record,))
            else:
                self._take(record)
                continue
            waiting.sort(key=_TIME)  # messages of one time stay in their order
            ready = bisect_left(waiting, begin, key=_TIME)
            yield from waiting[:ready]
            del waiting[:ready]
            for message in content:
                key = self._keys.get(message.channel_id)
                if key is not None and (wanted is None or key in wanted):
                    raw = self.raw(key, message.log_time, message.data, f"at byte {at}")
                    if raw is not None:
                        waiting.append(raw)
        yield from sorted(waiting, key=_TIME)

    def _records(self) -> Iterator[tuple[int, McapRecord]]:
        """Give records and their places in the file."""
        file = self._file
        for index in self._index:
            at = index.chunk_start_offset
            file.seek(at)
            try:
                yield at, next(_reader(file))
            except Exception as error:  # damaged bytes can mean anything
                self._note_damage(at, error)
        if self._index:
            return
        at = MAGIC_SIZE
        file.seek(at)
        try:
            for record in _reader(file):
                yield at, record
                at = file.tell()
        except Exception as error:
            self._note_damage(at, error)
            yield from self._cut_off(at)

    def _cut_off(self, at: int) -> Iterator[tuple[int, McapRecord]]:
        """Give what is there of the chunk with which the file ends too early."""
        self._file.seek(at)
        head = self._file.read(_PREFIX)
        length = int.from_bytes(head[1:], "little")
        if head[:1] == bytes([Opcode.CHUNK]) and at + _PREFIX + length > self._size:
            with contextlib.suppress(Exception):  # the last record in it is cut off, too
                chunk = Chunk.read(ReadDataStream(self._file))
                content = self._unpack(chunk.data) if chunk.compression else chunk.data
                for record in _reader(BytesIO(content)):
                    yield at, record

    def _in_chunk(self, chunk: Chunk, at: int) -> Iterator[Message]:
        """Give the messages in a chunk, and note the types and topics in it."""
        try:
            if chunk.compression:
                chunk.data, chunk.compression = self._unpack(chunk.data), ""
            for record in breakup_chunk(chunk, validate_crc=True):
                if isinstance(record, Message):
                    yield record
                else:
                    self._take(record)
        except Exception as error:
            self._note_damage(at, error)

    def _note_damage(self, at: int, error: Exception) -> None:
        if self._file.tell() >= self._size and not isinstance(error, UnpackError):
            self.note(f"it ends at byte {self._size}, inside of the record at byte {at}")
        else:
            self.note(f"it is damaged at byte {at} ({reason(error)})")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _reader(file: BinaryIO) -> Iterator[McapRecord]:
    limit = _LARGEST_RECORD
    return StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=limit).records
