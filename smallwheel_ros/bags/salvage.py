"""What is left of a bag that is damaged, was not closed, or lacks its metadata or a file."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import yaml

from smallwheel_ros.bag_files import RawMessage, storage_kind
from smallwheel_ros.bags.library import Codec, decompressed, parse_qos, types_from, unpack_zstd
from smallwheel_ros.bags.scan import ScanChannel, ScanDamage, scan
from smallwheel_ros.bags.source import Key, SourceTopic

_ZSTD = b"\x28\xb5\x2f\xfd"  # begins every frame; no CDR message begins like this


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    """Order of names in which drive_10 comes after drive_9."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]


def storage_files(path: Path) -> tuple[list[Path], list[str]]:
    """Return a bag's storage files in order, and what is missing of them, in words."""
    if not path.is_dir():
        return [path], []
    inside = sorted((file for file in path.iterdir() if storage_kind(file)), key=_natural)
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        return inside, ["metadata.yaml is missing"]
    try:
        content = yaml.safe_load(metadata.read_text(encoding="utf-8"))
        listed = content["rosbag2_bagfile_information"]["relative_file_paths"]
        files = [path / Path(str(name)).name for name in listed]
    except (OSError, ValueError, TypeError, KeyError, yaml.YAMLError):
        return inside, ["metadata.yaml cannot be read"]
    missing = [f"file {file.name} is missing" for file in files if not file.exists()]
    return [file for file in files if file.exists()], missing


def unfinished_log(path: Path) -> Path | None:
    """Return the write-ahead log that a killed recorder left beside its sqlite3 file, if any.

    rosbags opens such a file without it, and the newest messages would be lost without a word.
    """
    files = path.glob("*.db3-wal") if path.is_dir() else [path.with_name(f"{path.name}-wal")]
    return next((file for file in files if file.exists() and file.stat().st_size), None)


class SalvageSource:
    """The readable messages of a bag, found by reading all of it once before."""

    def __init__(self, path: Path) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        files, problems = storage_files(path)
        self._files = [(file, *self._plain(file, problems)) for file in files]
        self.topics: dict[Key, SourceTopic] = {}
        self.start_time: int | None = None
        self.end_time: int | None = None
        try:
            channels = self._look_through(problems)
        except BaseException:
            self.close()
            raise
        self.damage = "; ".join(problems)
        self.sound = bool(files) and not problems
        ros2 = not any(channel.encoding == "ros1" for channel in channels)
        self.codec = Codec(types_from((c.type, c.encoding, c.definition) for c in channels), ros2)

    def _plain(self, file: Path, problems: list[str]) -> tuple[Path, str]:
        kind = storage_kind(file) or ""
        if not file.name.endswith(".zstd"):
            return file, kind
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="smallwheel-")
        plain = Path(self._folder.name) / file.name.removesuffix(".zstd")
        try:
            with file.open("rb") as source, plain.open("wb") as target:
                unpack_zstd(source, target)
        except Exception as error:  # damaged data makes the library raise as it likes
            problems.append(f"{file.name} cannot be decompressed to its end ({error})")
        return plain, kind

    def _look_through(self, problems: list[str]) -> list[ScanChannel]:
        found: dict[ScanChannel, int] = {}
        first: list[int] = []
        last: list[int] = []
        for file, plain, kind in self._files:
            time: int | None = None
            count = 0
            try:
                for channel, time, _ in scan(plain, kind):
                    count += 1
                    found[channel] = found.get(channel, 0) + 1
                    first = [min(first[0], time)] if first else [time]
                    last = [max(last[0], time)] if last else [time]
            except ScanDamage as damage:
                until = f", the last at {time / 1e9:.3f} s" if time is not None else ""
                problems.append(f"{file.name}: {damage}; {count} messages can be read{until}")
        if first:
            self.start_time, self.end_time = first[0], last[0]
        for channel, count in sorted(found.items()):
            key = (channel.topic, channel.type)
            before = self.topics.get(key)
            qos: tuple[object, ...] = before.qos if before else tuple(_qos(channel.qos))
            self.topics[key] = SourceTopic(count + (before.messages if before else 0), qos)
        return list(found)

    def stream(self, wanted: set[Key], start: int | None, stop: int | None) -> Iterator[RawMessage]:
        """Give the messages as they were written, file by file."""
        first, end = start or 0, stop if stop is not None else 1 << 63
        for _, plain, kind in self._files:
            try:
                for channel, time, data in scan(plain, kind):
                    key = (channel.topic, channel.type)
                    if key in wanted and first <= time < end:
                        packed = data[:4] == _ZSTD and kind != ".bag"
                        yield RawMessage(*key, time, decompressed(data, "zstd") if packed else data)
            except ScanDamage:
                continue  # said already, in `damage`; the next file may be good

    def close(self) -> None:
        """Remove what was decompressed."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


def _qos(text: str) -> list[object]:
    try:
        return list(parse_qos(text))
    except Exception:  # damaged text; the messages are worth having without it
        return []
