# SPDX-License-Identifier: Apache-2.0
"""What a robot sends and records: bags, the types that they define, messages on topics."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fuzz.target import Target
from smallwheel_ros.bags import BagReader, BagWriter, message_type

# Of numbers and texts that no middleware could put into a message of that type.
_UNSENDABLE = (struct.error, OverflowError, UnicodeError)


class Bag(Target):
    """A recorded bag, opened, and every message of it read, also where it is damaged."""

    suffix: str
    is_text = False
    words = (b"\x00" * 8, b"\xff" * 8, b"\x05\x89MCAP0\r\n", b"float64 x\n", b"string")

    def make_seeds(self) -> list[bytes]:
        folder = self.folder / f"seed_{self.suffix}"
        with BagWriter(folder, storage={"mcap": "mcap", "db3": "sqlite3"}[self.suffix]) as writer:
            time = message_type("builtin_interfaces/msg/Time")
            header = message_type("std_msgs/msg/Header")
            kind = message_type("smallwheel_ros/msg/WheelSinkage")
            for i in range(20):
                stamp = header(stamp=time(sec=i, nanosec=0), frame_id="front")
                message = kind(header=stamp, sinkage=0.01, variance=1e-6)
                writer.write(
                    "/front/sinkage", "smallwheel_ros/msg/WheelSinkage", i * 10**9, message
                )
        return [next(folder.glob(f"*.{self.suffix}")).read_bytes()]

    def run(self, data: bytes) -> Iterator[float]:
        with BagReader(self.written(data, f"bag.{self.suffix}")) as reader:
            for message in reader.messages():
                yield float(message.log_time)


class Mcap(Bag):
    """An mcap file."""

    name = "mcap"
    suffix = "mcap"


class Sqlite(Bag):
    """A sqlite3 file."""

    name = "sqlite"
    suffix = "db3"


class Messages(Target):
    """What comes over topics: a drive in which any field of any message may be anything.

    The bytes choose: which topic, which field, which value. What is spoilt comes beside the sound
    messages of the drive, of which some at least must still become estimates.
    """

    is_text = False
    name = "messages"
    words = (b"\x00", b"\xff", b"\x7f\xf0", b"\x01\x02\x03\x04")
    values = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -1.0, 1e9, -1e-9, 1e-9)
    integers = (0, -1, 2**31 - 1, -(2**31), 1, 999_999_999)

    def make_seeds(self) -> list[bytes]:
        return [bytes(range(60)), b"\x00" * 40, bytes(range(255, 0, -2))]

    def run(self, data: bytes) -> Iterator[float]:
        from fuzz import drive_messages

        fed, drive = drive_messages.fed(), drive_messages.drive()
        choices = iter(data)
        count = 0
        for topic, message, stamp in drive:
            fed.give(topic, message(), stamp)
            choice = next(choices, None)
            if choice is not None and choice % 3 == 0:
                spoilt = message()
                self._spoil(spoilt, next(choices, 0), next(choices, 0))
                with suppress(*_UNSENDABLE):
                    fed.give(topic, spoilt, stamp)
            for turn in fed.turns():
                count += len(turn.estimates)
                yield from drive_messages.numbers(fed, turn)
        for turn in fed.turns(last=True):
            count += len(turn.estimates)
            yield from drive_messages.numbers(fed, turn)
        if not count:
            yield math.nan  # one spoilt message in three must not silence the rest

    def _spoil(self, message: Any, which: int, how: int) -> None:
        """Set one field, however deep, to a value that it should not have."""
        leaves = list(_leaves(message))
        owner, name, value = leaves[which % len(leaves)]
        if isinstance(value, str):
            setattr(owner, name, ("", "\x00", "é" * 300, "map")[how % 4])
        elif isinstance(value, bool | int):
            setattr(owner, name, self.integers[how % len(self.integers)])
        elif isinstance(value, float):
            setattr(owner, name, self.values[how % len(self.values)])
        elif isinstance(value, np.ndarray):
            # A covariance has a fixed size: the middleware and rosbags deliver no other.
            change = 0 if "covariance" in name else how % 3 - 1
            bad = np.full(max(len(value) + change, 0), self.values[how % len(self.values)])
            setattr(owner, name, bad)
        elif isinstance(value, list):
            setattr(owner, name, [value[:1], [], value * 2, ["x"] * 40][how % 4])


def _leaves(message: Any) -> Iterator[tuple[Any, str, Any]]:
    """The fields of a message that are no messages, however deep: owner, name, value."""
    for field in fields(message):
        value = getattr(message, field.name)
        if is_dataclass(value):
            yield from _leaves(value)
        elif not field.name.startswith("__"):
            yield message, field.name, value


RECORDED = (Mcap, Sqlite, Messages)
