# SPDX-License-Identifier: Apache-2.0
"""What could not be used: counted by stream and reason, and put in words."""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

_KEPT = 1000


class Problem(NamedTuple):
    """Something that could not be used: of which stream, a key to count by, and in words."""

    stream: str
    reason: str
    text: str


class ProblemLog:
    """Counts since the start (`counts`, by stream and reason), and the words of what is new.

    rejected: measured sinkages that were not used for the soil, for whatever reason; whoever starts
    the soil over sets it to 0.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.counts: Counter[tuple[str, str]] = Counter()
        self._new: deque[Problem] = deque(maxlen=_KEPT)

    def add(self, stream: str, reason: str, text: str, *, unused: bool = True) -> None:
        """Note a problem; the words of all but the newest 1000 are forgotten.

        unused: the message was not used because of it.
        """
        self.counts[stream, reason] += 1
        self.rejected += unused and stream.endswith("/sinkage")
        self._new.append(Problem(stream, reason, text))

    def take(self) -> list[Problem]:
        """Give what is new since the last call."""
        taken = list(self._new)
        self._new.clear()
        return taken
