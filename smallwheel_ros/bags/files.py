# SPDX-License-Identifier: Apache-2.0
"""What a bag is on disk, its topics and messages as values, and the error that names it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml

from smallwheel_ros.common.errors import SmallwheelError

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")
_SUFFIXES = (".mcap", ".db3", ".bag")
_LARGEST_METADATA = 4 << 20  # characters; a name and a quality of service for each topic
_LOADER = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader
REPAIR = (
    "it is damaged, was not closed, or is of another kind: try `ros2 bag reindex` (ROS 1:"
    " `rosbag reindex`), or record it again"
)


class BagError(SmallwheelError):
    """A bag cannot be read or written; the message names the file and what to do.

    Attributes
    ----------
    path : Path
        The bag.
    messages_read : int
        How many messages came out before the error.
    last_log_time : int or None
        Log time of the last one (ns), None when there was none.
    """

    def __init__(
        self, path: Path, text: str, *, messages_read: int = 0, last_log_time: int | None = None
    ) -> None:
        super().__init__(f"bag {path}: {text}")
        self.path = path
        self.messages_read = messages_read
        self.last_log_time = last_log_time


class BagTopic(NamedTuple):
    """One topic of a bag, or of one of its files.

    Attributes
    ----------
    readable
        False when nobody knows its message definition.
    encoding, definition
        ``ros2msg``, ``ros2idl``, or another that nobody here can read, and the text of the type's
        definition; empty where the bag has none.
    qos
        How it was offered, as rosbags has it.
    """

    name: str
    type: str
    message_count: int = 0
    readable: bool = False
    encoding: str = ""
    definition: str = ""
    qos: tuple[Any, ...] = ()


class BagMessage(NamedTuple):
    """One message: `log_time` is when it was recorded (ns since the epoch), not its header."""

    topic: str
    type: str
    log_time: int
    message: Any


class RawMessage(NamedTuple):
    """One message still serialised, CDR in rosbag2, ROS 1 format in a ``.bag``."""

    topic: str
    type: str
    log_time: int
    data: bytes


def reason(error: Exception) -> str:
    """Text of an error, or its kind where it has none."""
    text = str(getattr(error, "strerror", None) or error).strip().rstrip(".")
    return text or type(error).__name__


def storage_kind(path: Path) -> str | None:
    """Format of a storage file by its name: .mcap, .db3 or .bag; None for anything else.

    A rosbag2 file that is compressed as a whole has .zstd behind that.
    """
    name = path.name.removesuffix(".zstd")
    kind = next((kind for kind in _SUFFIXES if name.endswith(kind)), None)
    return None if kind == ".bag" and name != path.name else kind


def storage_files(path: Path, *, salvage: bool) -> tuple[list[Path], list[str]]:
    """Return a bag's storage files in order, and what is missing of them, in words.

    Raises BagError unless there is something at `path` that can be a bag. salvage: of a folder without
    metadata.yaml the storage files are enough.
    """
    if not path.exists():
        raise BagError(path, "does not exist; give a rosbag2 folder, or a .mcap, .db3 or .bag file")
    if not path.is_dir():
        if storage_kind(path) is None:
            text = f"the suffix {path.suffix!r} is not that of a bag (.mcap, .db3 or .bag)"
            raise BagError(path, text)
        return [path], []
    inside = sorted((file for file in path.iterdir() if storage_kind(file)), key=_natural)
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        if inside and salvage:
            return inside, ["metadata.yaml is missing"]
        mend = "and no .mcap, .db3 or .bag file in it: this is not a bag"
        if inside:
            mend = f"run `ros2 bag reindex {path}`, or give the file {inside[0]} itself"
        raise BagError(path, f"the folder has no metadata.yaml; {mend}")
    try:
        with metadata.open(encoding="utf-8") as file:
            # Nodes, not values: a few lines with references can make any number of values.
            node: Any = yaml.compose(file.read(_LARGEST_METADATA), Loader=_LOADER)
        for name in ("rosbag2_bagfile_information", "relative_file_paths"):
            node = next(value for key, value in node.value if key.value == name)
        files = [path / Path(entry.value).name for entry in node.value]
    except Exception:  # whatever YAML makes of a damaged text
        return inside, ["metadata.yaml cannot be read"]
    missing = [f"file {file.name} is missing" for file in files if not file.exists()]
    return [file for file in files if file.exists()], missing


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    """Order of names in which drive_10 comes after drive_9."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]


def check_new_bag(path: Path) -> None:
    """Raise `BagError` unless a bag can be made at `path`."""
    if path.exists():
        raise BagError(path, "exists already; nothing was changed: remove it or give another name")
    if not path.parent.is_dir():
        raise BagError(path, f"the folder {path.parent} does not exist: make it first")
