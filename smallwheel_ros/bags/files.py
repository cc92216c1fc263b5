# SPDX-License-Identifier: Apache-2.0
"""What a bag is on disk, its messages as values, and the error that names it. Free of rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

from smallwheel_ros.common.errors import SmallwheelError

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")
STORAGE_SUFFIXES = (".mcap", ".db3", ".bag")


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
    """One topic of a bag; `readable` is false when nobody knows its message definition."""

    name: str
    type: str
    message_count: int
    readable: bool


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


REPAIR = (
    "it is damaged, was not closed, or is of another kind: try `ros2 bag reindex` (ROS 1:"
    " `rosbag reindex`), or record it again"
)


def reason(error: Exception) -> str:
    """Text of an error, or its kind where it has none."""
    text = str(getattr(error, "strerror", None) or error).strip().rstrip(".")
    return text or type(error).__name__


def storage_kind(path: Path) -> str | None:
    """Format of a storage file by its name: .mcap, .db3 or .bag; None for anything else.

    A rosbag2 file that is compressed as a whole has .zstd behind that.
    """
    name = path.name.removesuffix(".zstd")
    kind = next((kind for kind in STORAGE_SUFFIXES if name.endswith(kind)), None)
    return None if kind == ".bag" and name != path.name else kind


def check_is_bag(path: Path, *, needs_metadata: bool = True) -> None:
    """Raise `BagError` unless there is something at `path` that can be a bag.

    needs_metadata: a folder must have a metadata.yaml; else storage files in it are enough.
    """
    if not path.exists():
        raise BagError(path, "does not exist; give a rosbag2 folder, or a .mcap, .db3 or .bag file")
    if path.is_dir():
        if (path / "metadata.yaml").exists():
            return
        inside = sorted(file for file in path.iterdir() if storage_kind(file))
        if inside and not needs_metadata:
            return
        mend = (
            f"run `ros2 bag reindex {path}`, or give the file {inside[0]} itself"
            if inside
            else "and no .mcap, .db3 or .bag file in it: this is not a bag"
        )
        raise BagError(path, f"the folder has no metadata.yaml; {mend}")
    if storage_kind(path) is None:
        raise BagError(
            path, f"the suffix {path.suffix!r} is not that of a bag (.mcap, .db3 or .bag)"
        )


def check_new_bag(path: Path) -> None:
    """Raise `BagError` unless a bag can be made at `path`."""
    if path.exists():
        raise BagError(path, "exists already; nothing was changed: remove it or give another name")
    if not path.parent.is_dir():
        raise BagError(path, f"the folder {path.parent} does not exist: make it first")
