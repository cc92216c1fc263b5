"""What one storage file of a bag gives, whatever its format."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Protocol

from smallwheel_ros.bag_files import RawMessage
from smallwheel_ros.bags.library import Qos

Key = tuple[str, str]  # topic and type
_MOST_PROBLEMS = 5


@dataclass
class Channel:
    """A topic as a file describes it.

    Attributes
    ----------
    encoding, definition
        ``ros2msg``, ``ros2idl``, or another that nobody here can read, and the text of the type's
        definition; empty where the file has none.
    qos
        How it was offered.
    """

    encoding: str = ""
    definition: str = ""
    qos: tuple[Qos, ...] = ()
    messages: int = 0


@dataclass
class Contents:
    """What is in a file: topics, the span of log times (ns), and what is wrong, as far as known."""

    channels: dict[Key, Channel] = field(default_factory=dict)
    start: int | None = None
    end: int | None = None
    problems: list[str] = field(default_factory=list)

    def add(self, key: Key, first: int, last: int, count: int) -> None:
        """Count messages of a topic between two log times."""
        self.channels.setdefault(key, Channel()).messages += count
        self.start = first if self.start is None else min(self.start, first)
        self.end = last if self.end is None else max(self.end, last)

    def note(self, problem: str) -> None:
        """Note what is wrong, in words; of many such things the first ones."""
        if problem not in self.problems and len(self.problems) < _MOST_PROBLEMS:
            self.problems.append(problem)


class Storage(Protocol):
    """An open file. While it is read, more may be added to `contents.problems`."""

    contents: Contents

    def messages(self, wanted: Collection[Key]) -> Iterator[RawMessage]:
        """Give the messages of these topics by log time, all that can be read of them."""

    def close(self) -> None:
        """Let go of the file."""
