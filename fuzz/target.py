# SPDX-License-Identifier: Apache-2.0
"""A way in that is fuzzed: it takes bytes that nobody intended, and may refuse them in words only.

A target has seeds (valid inputs, from which mutations begin), words that mean something to it, and
`run`, which returns numbers that came out. What `run` raises besides SmallwheelError is a defect, and
so is a number that is not finite.
"""

from __future__ import annotations

import math
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path

from smallwheel_ros.common.errors import SmallwheelError

ROOT = Path(__file__).resolve().parent.parent
NUMBERS = (b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-0", b"0", b"99999999999999999999")


class Target(ABC):
    """One way in."""

    name: str
    words: Sequence[bytes] = NUMBERS
    refusals: type[Exception] = SmallwheelError
    is_text = True

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seeds = self.make_seeds()

    @abstractmethod
    def make_seeds(self) -> list[bytes]:
        """Return valid inputs."""

    @abstractmethod
    def run(self, data: bytes) -> Iterator[float]:
        """Take an input; return the numbers that came of it, or raise SmallwheelError."""

    def written(self, data: bytes, name: str) -> Path:
        """Write a file for a reader that needs one."""
        path = self.folder / name
        path.write_bytes(data)
        return path


def scratch() -> Path:
    """Return a folder for files of a target, in memory where there is such a place."""
    shared = Path("/dev/shm")
    return Path(
        tempfile.mkdtemp(prefix="fuzz-", dir=shared if os.access(shared, os.W_OK) else None)
    )


def is_good(value: float) -> bool:
    """Whether a number may come out."""
    return math.isfinite(value)
