"""The records of an mcap file (mcap.dev/spec), read from its beginning to wherever it ends."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from smallwheel_ros.bags.library import decompressed
from smallwheel_ros.bags.scan import ScanChannel, ScanDamage, Scanned, by_log_time

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_PREFIX = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_QOS_KEY = "offered_qos_profiles"


class _Record:
    """A cursor over the fields of one record."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def number(self, form: str) -> int:
        (value,) = struct.unpack_from(form, self.data, self.at)
        self.at += struct.calcsize(form)
        return int(value)

    def text(self) -> str:
        return self.bytes("<I").decode()

    def bytes(self, form: str) -> bytes:
        size = self.number(form)
        self.at += size
        return self.data[self.at - size : self.at]


class _Scanner:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.schemas: dict[int, tuple[str, str, str]] = {0: ("", "", "")}
        self.channels: dict[int, ScanChannel] = {}

    def run(self, file: BinaryIO, size: int) -> Iterator[Scanned]:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ScanDamage("it does not begin like an mcap file")
        while True:
            start = file.tell()
            prefix = file.read(_PREFIX.size)
            if len(prefix) < _PREFIX.size:
                raise ScanDamage(f"it ends at byte {start} without its index: not closed")
            code, length = _PREFIX.unpack(prefix)
            if code in (_DATA_END, _FOOTER):
                # The messages are all there; the index behind them is checked by its own magic.
                file.seek(max(size - len(_MAGIC), 0))
                if file.read() != _MAGIC:
                    raise ScanDamage(f"it ends at byte {size} inside its index; no message is lost")
                return
            whole = length <= size - file.tell()
            if code == _CHUNK:
                yield from by_log_time(self._chunk(file.read(length), whole, start))
            elif whole:
                yield from self._record(code, file.read(length))
            if not whole:
                raise ScanDamage(f"it ends at byte {size}, inside a record that begins at {start}")

    def _record(self, code: int, data: bytes) -> Iterator[Scanned]:
        record = _Record(data)
        if code == _MESSAGE:
            channel, _, log_time, _ = _MESSAGE_HEAD.unpack_from(data)
            if channel in self.channels:
                yield Scanned(self.channels[channel], log_time, data[_MESSAGE_HEAD.size :])
        elif code == _SCHEMA:
            key = record.number("<H")
            self.schemas[key] = (record.text(), record.text(), record.text())
        elif code == _CHANNEL:
            key = record.number("<H")
            name, encoding, text = self.schemas.get(record.number("<H"), ("", "", ""))
            topic, _ = record.text(), record.text()
            more = _Record(record.bytes("<I"))
            qos = ""
            while more.at < len(more.data):
                entry, value = more.text(), more.text()
                qos = value if entry == _QOS_KEY else qos
            self.channels[key] = ScanChannel(topic, name, encoding, text, qos)

    def _chunk(self, data: bytes, whole: bool, start: int) -> Iterator[Scanned]:
        if len(data) < 32:
            return
        head = _Record(data)
        head.at = 28  # times, size and checksum, which are not needed
        size = struct.unpack_from("<Q", data, 16)[0]
        method, _ = head.text(), head.number("<Q")
        content = decompressed(data[head.at :], method)
        at = 0
        while at + _PREFIX.size <= len(content):
            code, length = _PREFIX.unpack_from(content, at)
            at += _PREFIX.size
            if at + length > len(content):
                break
            yield from self._record(code, content[at : at + length])
            at += length
        if whole and (at < len(content) or len(content) < size):
            raise ScanDamage(f"the chunk at byte {start} is damaged")


def scan(path: Path) -> Iterator[Scanned]:
    """Give the messages of an mcap file; in a chunk by log time, as rosbags does."""
    with path.open("rb") as file:
        yield from _Scanner(path).run(file, path.stat().st_size)
