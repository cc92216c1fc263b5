"""The records of a ROS 1 bag (wiki.ros.org/Bags/Format/2.0), read from beginning to end."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from smallwheel_ros.bags.library import decompressed
from smallwheel_ros.bags.scan import ScanChannel, ScanDamage, Scanned, by_log_time

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_LENGTH = struct.Struct("<I")
_LARGEST_HEADER = 1 << 20


def _fields(header: bytes) -> dict[str, bytes]:
    found, at = {}, 0
    while at + _LENGTH.size <= len(header):
        (size,) = _LENGTH.unpack_from(header, at)
        at += _LENGTH.size
        name, _, value = header[at : at + size].partition(b"=")
        found[name.decode(errors="replace")] = value
        at += size
    return found


def _number(value: bytes) -> int:
    return int.from_bytes(value, "little")


class _Scanner:
    def __init__(self) -> None:
        self.channels: dict[int, ScanChannel] = {}

    def run(self, file: BinaryIO, size: int) -> Iterator[Scanned]:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ScanDamage("it does not begin like a bag of ROS 1 (version 2.0)")
        indexed = False
        while file.tell() < size:
            start = file.tell()
            header = self._part(file, size, start, _LARGEST_HEADER)
            fields = _fields(header)
            code = _number(fields.get("op", b""))
            if code == _CHUNK:
                data, whole = self._chunk_data(file, size, start)
                method = fields.get("compression", b"none").decode()
                content = decompressed(data, method)
                yield from by_log_time(self._chunk(content))
                if whole and len(content) < _number(fields.get("size", b"")):
                    raise ScanDamage(f"the chunk at byte {start} is damaged")
                if not whole:
                    raise ScanDamage(f"it ends at byte {size}, inside the chunk at byte {start}")
                continue
            data = self._part(file, size, start, size)
            indexed = indexed or code == _CHUNK_INFO
            if code == _CONNECTION:
                self._connection(fields, data)
        if not indexed and self.channels:
            raise ScanDamage(f"it ends at byte {size} without its index: not closed")

    def _part(self, file: BinaryIO, size: int, start: int, largest: int) -> bytes:
        raw = file.read(_LENGTH.size)
        (length,) = _LENGTH.unpack(raw) if len(raw) == _LENGTH.size else (size,)
        if length > min(size - file.tell(), largest):
            raise ScanDamage(f"it ends or is damaged inside the record at byte {start}")
        return file.read(length)

    def _chunk_data(self, file: BinaryIO, size: int, start: int) -> tuple[bytes, bool]:
        raw = file.read(_LENGTH.size)
        if len(raw) < _LENGTH.size:
            raise ScanDamage(f"it ends at byte {size}, inside the record at byte {start}")
        (length,) = _LENGTH.unpack(raw)
        data = file.read(length)
        return data, len(data) == length

    def _chunk(self, content: bytes) -> Iterator[Scanned]:
        at = 0
        while True:
            parts = []
            for _ in range(2):
                if at + _LENGTH.size > len(content):
                    return
                (length,) = _LENGTH.unpack_from(content, at)
                at += _LENGTH.size
                if at + length > len(content):
                    return
                parts.append(content[at : at + length])
                at += length
            fields, data = _fields(parts[0]), parts[1]
            code = _number(fields.get("op", b""))
            if code == _CONNECTION:
                self._connection(fields, data)
            elif code == _MESSAGE:
                channel = self.channels.get(_number(fields.get("conn", b"")))
                seconds, rest = struct.unpack("<II", fields["time"])
                if channel is not None:
                    yield Scanned(channel, seconds * 10**9 + rest, data)

    def _connection(self, fields: dict[str, bytes], data: bytes) -> None:
        said = _fields(data)
        package, _, name = said.get("type", b"").decode().partition("/")
        topic = fields.get("topic", b"").decode()
        text = said.get("message_definition", b"").decode(errors="replace")
        channel = ScanChannel(topic, f"{package}/msg/{name}", "ros1", text)
        self.channels.setdefault(_number(fields.get("conn", b"")), channel)


def scan(path: Path) -> Iterator[Scanned]:
    """Give the messages of a ROS 1 bag; in a chunk by log time."""
    with path.open("rb") as file:
        yield from _Scanner().run(file, path.stat().st_size)
