"""An mcap file, whole or damaged.

By the package `mcap` chunk by chunk, in the order of the index where there is one, else as they follow
each other.
"""

from __future__ import annotations

import contextlib
import heapq
import zlib
from collections.abc import Collection, Iterator
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from mcap.summary import Summary

from smallwheel_ros.bag_files import RawMessage, reason
from smallwheel_ros.bags.library import Ros2Reader, parsed_qos, plain_qos
from smallwheel_ros.bags.rosbags_file import RosbagsFile
from smallwheel_ros.bags.storage import Channel, Contents, Key, Storage
from smallwheel_ros.bags.unpack import Unpacker, UnpackError

_LARGEST_RECORD = 1 << 30  # bytes that are read at once
_QOS = "offered_qos_profiles"
_PREFIX = 9  # bytes of a record's code and length


def open_mcap(path: Path) -> Storage:
    """Open a file: with rosbags, which is faster, or with mcap what it would not read, or for ever.

    Raises an Exception of any kind, where it does not begin like an mcap file.
    """
    summary = None
    with path.open("rb") as file:
        reader = SeekingReader(file, record_size_limit=_LARGEST_RECORD)
        with contextlib.suppress(Exception):  # the end of the file is missing or damaged
            summary = reader.get_summary()
    if summary is not None and _is_plain(summary):
        with contextlib.suppress(Exception):
            return RosbagsFile(path, Ros2Reader(path), lambda: McapFile(path, summary))
    return McapFile(path, summary)


def _is_plain(summary: Summary) -> bool:
    """Whether a file has an index of all its chunks, nothing compressed, and no tricks."""
    chunks, statistics = summary.chunk_indexes, summary.statistics
    return (
        statistics is not None
        and statistics.chunk_count == len(chunks) > 0
        and bool(summary.schemas)
        and not any(chunk.compression for chunk in chunks)
        and all(plain_qos(c.metadata.get(_QOS, "")) for c in summary.channels.values())
        and {c.message_encoding for c in summary.channels.values()} <= {"cdr"}
    )


class McapFile:
    """One file, by the package mcap; see `storage.Storage`. summary: the file's own, if it is there."""

    def __init__(self, path: Path, summary: Summary | None) -> None:
        self.contents = Contents()
        self._size = path.stat().st_size
        self._schemas: dict[int, Schema] = {}
        self._keys: dict[int, Key] = {}
        self._summary = summary
        self._file: BinaryIO = path.open("rb")
        try:
            self._count()
        except BaseException:
            self.close()
            raise

    def _count(self) -> None:
        """Say what there is: by the file's own summary, or by reading all of it."""
        summary = self._summary
        if summary is None or summary.statistics is None:
            for topic, kind, time, _ in self.messages(None):
                self.contents.add((topic, kind), time, time, 1)
            return
        for schema in summary.schemas.values():
            self._take(schema)
        for channel in summary.channels.values():
            self._take(channel)
        statistics = summary.statistics
        for number, count in statistics.channel_message_counts.items():
            if number in self._keys and count:
                times = (statistics.message_start_time, statistics.message_end_time)
                self.contents.add(self._keys[number], *times, count)

    def _take(self, record: McapRecord) -> None:
        """Note a type, or a topic."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, ChannelRecord) and record.id not in self._keys:
            schema = self._schemas.get(record.schema_id)
            name = "" if schema is None else schema.name
            key = self._keys[record.id] = (record.topic, name)
            found = self.contents.channels.setdefault(key, Channel())
            found.qos = parsed_qos(record.metadata.get(_QOS, ""))
            if schema is not None:
                cdr = record.message_encoding == "cdr"
                found.encoding = schema.encoding if cdr else record.message_encoding
                found.definition = schema.data.decode(errors="replace")

    def messages(self, wanted: Collection[Key] | None) -> Iterator[RawMessage]:
        """Give messages by log time; where there is no index, as far as chunks follow in time."""
        # The number keeps messages of one time in their order.
        waiting: list[tuple[int, int, RawMessage]] = []
        number = 0
        for messages in self._batches():
            begin = min((raw.log_time for raw in messages), default=0)
            while waiting and waiting[0][0] < begin:
                yield heapq.heappop(waiting)[2]
            for raw in messages:
                if wanted is None or (raw.topic, raw.type) in wanted:
                    number += 1
                    heapq.heappush(waiting, (raw.log_time, number, raw))
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _batches(self) -> Iterator[list[RawMessage]]:
        """Give the messages of a chunk, or one without chunk."""
        unpack = Unpacker(self._size)
        for at, record in self._records():
            if isinstance(record, Chunk):
                yield self._of_chunk(record, at, unpack)
            elif isinstance(record, Message) and record.channel_id in self._keys:
                yield self._of_message(record, at, unpack)
            else:
                self._take(record)

    def _records(self) -> Iterator[tuple[int, McapRecord]]:
        """Give records and their places in the file."""
        summary, file = self._summary, self._file
        if summary is not None and summary.statistics is not None and summary.chunk_indexes:
            for index in sorted(summary.chunk_indexes, key=attrgetter("message_start_time")):
                at = index.chunk_start_offset
                file.seek(at)
                try:
                    yield at, next(_reader(file))
                except Exception as error:  # damaged bytes can mean anything
                    self._problem(at, error)
            return
        at = MAGIC_SIZE
        file.seek(at)
        try:
            for record in _reader(file):
                yield at, record
                at = file.tell()
        except Exception as error:
            self._problem(at, error)
            yield from self._cut_off(at)

    def _cut_off(self, at: int) -> Iterator[tuple[int, McapRecord]]:
        """Give the chunk with which the file ends too early, as far as it is there."""
        self._file.seek(at)
        head = self._file.read(_PREFIX)
        length = int.from_bytes(head[1:], "little")
        if head[:1] == bytes([Opcode.CHUNK]) and at + _PREFIX + length > self._size:
            with contextlib.suppress(Exception):  # not even its head is there
                chunk = Chunk.read(ReadDataStream(self._file))
                chunk.uncompressed_crc = chunk.uncompressed_size = 0  # those of the whole chunk
                yield at, chunk

    def _problem(self, at: int, error: Exception) -> None:
        if self._file.tell() >= self._size and not isinstance(error, UnpackError):
            text = f"it ends at byte {self._size}, inside of the record at byte {at}"
        else:
            text = f"it is damaged at byte {at} ({reason(error)})"
        self.contents.note(text)

    def _of_chunk(self, chunk: Chunk, at: int, unpack: Unpacker) -> list[RawMessage]:
        found: list[RawMessage] = []
        try:
            content = unpack(chunk.data) if chunk.compression else chunk.data
            if chunk.uncompressed_size and len(content) != chunk.uncompressed_size:
                raise UnpackError("a chunk has another size than it says")
            if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
                raise UnpackError("the checksum of a chunk is not that of its content")
        except UnpackError as error:
            self._problem(at, error)
            return found
        try:
            for record in _reader(BytesIO(content)):
                if isinstance(record, Message) and record.channel_id in self._keys:
                    found += self._of_message(record, at, unpack)
                else:
                    self._take(record)
        except EndOfFile:
            pass  # every chunk ends like this
        except Exception as error:
            self._problem(at, error)
        return found

    def _of_message(self, message: Message, at: int, unpack: Unpacker) -> list[RawMessage]:
        try:
            data = unpack(message.data)
        except UnpackError as error:
            self._problem(at, error)
            return []
        return [RawMessage(*self._keys[message.channel_id], message.log_time, data)]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _reader(file: BinaryIO) -> Iterator[McapRecord]:
    limit = _LARGEST_RECORD
    return StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=limit).records
